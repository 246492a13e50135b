"""Table of the supervisor: the step that each event causes in each state."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from typing import NamedTuple


class State(Enum):
    """State of a flight."""

    IDLE = "idle"
    CHECKS = "checks"
    ARMING = "arming"
    TAKE_OFF = "take-off"
    FLY = "fly"
    HOLD = "hold"
    LAND = "land"
    HAND_OVER = "hand-over"
    ABORT = "abort"
    DONE = "done"


class Event(Enum):
    """Event of a flight; its value is its name in logs and in the documentation."""

    START = "start"
    CHECKS_PASSED = "checks passed"
    CHECKS_PASSED_DRY = "checks passed, dry run"
    CHECK_FAILED = "a check does not hold"
    ARMED = "armed"
    DISARMED = "disarmed"
    AIRBORNE = "take-off height reached"
    LANDED = "on the ground"
    STILL = "landing without descending"
    FRAME_WRONG = "motion contradicts the frame"
    STATE_STALE = "state too old"
    STATE_JUMPED = "position jumped"
    SLIPS = "position contradicts velocity"
    LOOP_LATE = "loop too late"
    FILTER_REFUSED = "filter has no safe input"
    FILTER_FAILED = "filter failed"
    CRASHED = "crashed"
    TURNED_OVER = "upside down"
    FALLEN = "on the ground below its plan"
    FALLBACK_LONG = "fallback for too long"
    MODEL_WRONG = "motion contradicts the vehicle's model"
    FENCE = "too close to the fence"
    NOT_OBEYED = "vehicle does not follow"
    OFF_CLIMB = "off the climb path"
    DRIFTS = "drifts from its hold"
    PARAMETER_CHANGED = "parameter changed by another station"
    HEALTH_UNKNOWN = "health no longer reported"
    RECOVERED = "all is well again"
    HOLDS_USED_UP = "held too often"
    BATTERY_LOW = "battery low"
    LINK_LOST = "link lost"
    ESTIMATOR_BAD = "estimator not healthy"
    LANDED_AWAY = "landed away from the plan's end"
    FAILSAFE = "vehicle's own failsafe"
    FAILSAFE_IDLE = "failsafe without any action"
    RESTARTED = "vehicle restarted"
    MODE_CHANGED = "mode changed by the pilot"
    WATCHDOG = "watchdog took over"
    ORDER_REFUSED = "order refused"
    PLAN_FINISHED = "plan finished"
    TIMED_OUT = "took too long"
    INTERRUPT = "interrupted"
    INTERRUPT_ON_GROUND = "interrupted again, on the ground"
    INTERRUPT_IN_AIR = "interrupted again, in the air"


class Action(Enum):
    """Action of a step; its value is its name in logs and in the documentation."""

    NOTHING = "nothing"
    CHECK = "run the checks"
    ARM = "arm"
    TAKE_OFF = "take off"
    ENGAGE = "take control and send set-points"
    HOLD = "hold in place, by the vehicle itself"
    LAND = "land, by the vehicle itself"
    SETTLE = "let it lean less, so that it notices the ground"
    DISARM = "disarm"
    STOP = "stop the motors, by force"
    LET_GO = "stop sending"


class Step(NamedTuple):
    """Step of the table: the next state, an action, and a message for the log."""

    state: State
    action: Action
    words: str


_S, _E, _A = State, Event, Action
_Row = dict[Event, Step]


def _abort(*events: Event) -> _Row:
    return {event: Step(_S.ABORT, _A.DISARM, f"{event.value}: no take-off") for event in events}


def _land(*events: Event) -> _Row:
    return {event: Step(_S.LAND, _A.LAND, f"{event.value}: landing") for event in events}


def _stop(*events: Event) -> _Row:
    return {event: Step(_S.ABORT, _A.STOP, f"{event.value}: stopping the motors") for event in events}


def _hold(*events: Event) -> _Row:
    return {event: Step(_S.HOLD, _A.HOLD, f"{event.value}: holding") for event in events}


def _hand_over(*events: Event) -> _Row:
    words = "this program no longer controls the vehicle; Ctrl-C ends it and leaves the vehicle to the pilot"
    return {event: Step(_S.HAND_OVER, _A.LET_GO, f"{event.value}: {words}") for event in events}


def _done(*events: Event) -> _Row:
    return {event: Step(_S.DONE, _A.LET_GO, f"{event.value}: the flight is over") for event in events}


def _stay(state: State, action: Action, words: str, *events: Event) -> _Row:
    return {event: Step(state, action, f"{event.value}: {words}") for event in events}


_TAKEN_OVER = (_E.MODE_CHANGED, _E.FAILSAFE)
_WATCHED: _Row = {
    _E.WATCHDOG: Step(
        _S.HAND_OVER,
        _A.LET_GO,
        f"{_E.WATCHDOG.value}: it stops the vehicle and lands it; Ctrl-C ends this program",
    )
}

TABLE: Mapping[State, Mapping[Event, Step]] = {
    _S.IDLE: {_E.START: Step(_S.CHECKS, _A.CHECK, "pre-flight checks begin")} | _done(_E.INTERRUPT),
    _S.CHECKS: {
        _E.CHECKS_PASSED: Step(_S.ARMING, _A.ARM, "all checks passed: arming"),
        _E.CHECKS_PASSED_DRY: Step(_S.DONE, _A.LET_GO, "all checks passed: a dry run ends here"),
    }
    | _done(_E.CHECK_FAILED, _E.LINK_LOST, _E.TIMED_OUT)
    | _done(_E.INTERRUPT, _E.INTERRUPT_ON_GROUND, _E.INTERRUPT_IN_AIR),
    _S.ARMING: {
        _E.ARMED: Step(_S.TAKE_OFF, _A.TAKE_OFF, "armed: taking off"),
        _E.ORDER_REFUSED: Step(_S.ARMING, _A.ARM, "arming refused: arming is ordered again"),
    }
    | _hand_over(*_TAKEN_OVER)
    | _abort(
        _E.FAILSAFE_IDLE,
        _E.STATE_STALE,
        _E.LINK_LOST,
        _E.RESTARTED,
        _E.STATE_JUMPED,
        _E.ESTIMATOR_BAD,
        _E.BATTERY_LOW,
        _E.HEALTH_UNKNOWN,
        _E.PARAMETER_CHANGED,
        _E.OFF_CLIMB,
        _E.SLIPS,
        _E.TIMED_OUT,
    )
    | _abort(_E.INTERRUPT, _E.INTERRUPT_ON_GROUND, _E.INTERRUPT_IN_AIR),
    _S.TAKE_OFF: {_E.AIRBORNE: Step(_S.FLY, _A.ENGAGE, "take-off height reached: flying the plan")}
    | _WATCHED
    | _hand_over(*_TAKEN_OVER)
    | _done(_E.DISARMED)
    | _land(
        _E.FRAME_WRONG,
        _E.STATE_STALE,
        _E.LINK_LOST,
        _E.RESTARTED,
        _E.STATE_JUMPED,
        _E.ESTIMATOR_BAD,
        _E.BATTERY_LOW,
        _E.HEALTH_UNKNOWN,
        _E.PARAMETER_CHANGED,
    )
    # The vehicle is low and near the climb path that was proven clear; a hold would be in unproven space.
    | _land(_E.OFF_CLIMB, _E.SLIPS, _E.FENCE, _E.TURNED_OVER)
    | _stop(_E.CRASHED)
    | _land(_E.NOT_OBEYED, _E.ORDER_REFUSED, _E.TIMED_OUT, _E.FAILSAFE_IDLE)
    | _land(_E.INTERRUPT, _E.INTERRUPT_ON_GROUND, _E.INTERRUPT_IN_AIR),
    _S.FLY: _WATCHED
    | _hand_over(*_TAKEN_OVER)
    | _done(_E.DISARMED)
    # The vehicle levels itself out in its landing mode; on the ground no thrust may be commanded.
    | _land(_E.TURNED_OVER, _E.FALLEN)
    | _stop(_E.CRASHED)
    | _hold(_E.STATE_STALE, _E.LOOP_LATE, _E.FILTER_REFUSED, _E.FILTER_FAILED, _E.FALLBACK_LONG)
    | _hold(_E.SLIPS, _E.MODEL_WRONG, _E.FENCE)
    | _land(
        _E.PLAN_FINISHED,
        _E.FRAME_WRONG,
        _E.LINK_LOST,
        _E.RESTARTED,
        _E.STATE_JUMPED,
        _E.ESTIMATOR_BAD,
        _E.BATTERY_LOW,
        _E.HEALTH_UNKNOWN,
        _E.PARAMETER_CHANGED,
    )
    | _land(_E.NOT_OBEYED, _E.ORDER_REFUSED, _E.TIMED_OUT, _E.FAILSAFE_IDLE)
    | _land(_E.INTERRUPT, _E.INTERRUPT_ON_GROUND, _E.INTERRUPT_IN_AIR),
    _S.HOLD: {_E.RECOVERED: Step(_S.FLY, _A.ENGAGE, "all is well again: flying on")}
    | _WATCHED
    | _hand_over(*_TAKEN_OVER)
    | _done(_E.DISARMED)
    | _land(_E.TURNED_OVER, _E.FALLEN)
    | _stop(_E.CRASHED)
    | _land(
        _E.LINK_LOST,
        _E.RESTARTED,
        _E.STATE_JUMPED,
        _E.ESTIMATOR_BAD,
        _E.BATTERY_LOW,
        _E.HEALTH_UNKNOWN,
        _E.PARAMETER_CHANGED,
        _E.FRAME_WRONG,
        _E.HOLDS_USED_UP,
    )
    # The vehicle does not hold its position: land before it drifts into something.
    | _land(_E.DRIFTS, _E.NOT_OBEYED)
    | _land(_E.ORDER_REFUSED, _E.TIMED_OUT, _E.FAILSAFE_IDLE)
    | _land(_E.INTERRUPT, _E.INTERRUPT_ON_GROUND, _E.INTERRUPT_IN_AIR),
    _S.LAND: _WATCHED
    | _hand_over(*_TAKEN_OVER, _E.TIMED_OUT)
    | _done(_E.LANDED_AWAY, _E.DISARMED)
    | _stop(_E.CRASHED)
    | _stay(_S.LAND, _A.DISARM, "disarming", _E.LANDED, _E.INTERRUPT_ON_GROUND)
    | _stay(_S.LAND, _A.NOTHING, "landing continues", _E.ESTIMATOR_BAD)
    # In wind, and after a crash, ArduPilot leans on the ground and takes it for the air.
    | _stay(_S.LAND, _A.SETTLE, "it may lean less, so that it notices the ground", _E.STILL)
    | _stay(_S.LAND, _A.LAND, "landing is ordered again", _E.ORDER_REFUSED, _E.LINK_LOST, _E.NOT_OBEYED)
    | _stay(_S.LAND, _A.NOTHING, "motors stop on the ground only", _E.INTERRUPT_IN_AIR),
    _S.HAND_OVER: _done(_E.DISARMED, _E.LINK_LOST)
    | _done(_E.INTERRUPT, _E.INTERRUPT_ON_GROUND, _E.INTERRUPT_IN_AIR),
    _S.ABORT: _done(_E.DISARMED)
    | _hand_over(*_TAKEN_OVER, _E.TIMED_OUT)
    | _stay(_S.ABORT, _A.DISARM, "disarming is ordered again", _E.ORDER_REFUSED),
    _S.DONE: {},
}

# Events without effect in a state. Together with the table they cover every pair of state and event.
_OF_CHECKS = (_E.CHECKS_PASSED, _E.CHECKS_PASSED_DRY, _E.CHECK_FAILED)
_OF_FLIGHT = (
    *(_E.LOOP_LATE, _E.FILTER_REFUSED, _E.FILTER_FAILED, _E.FALLBACK_LONG, _E.MODEL_WRONG),
    _E.PLAN_FINISHED,
)
_OF_HOLD = (_E.RECOVERED, _E.HOLDS_USED_UP)
_HEALTH = (
    _E.FRAME_WRONG,
    _E.STATE_STALE,
    _E.RESTARTED,
    _E.STATE_JUMPED,
    _E.SLIPS,
    _E.ESTIMATOR_BAD,
    _E.BATTERY_LOW,
    _E.HEALTH_UNKNOWN,
    _E.PARAMETER_CHANGED,
    _E.FENCE,
)
_POSITION = (_E.OFF_CLIMB, _E.DRIFTS, _E.LANDED_AWAY)  # defined in a climb, in a hold, in a landing only
_CRASHES = (_E.CRASHED, _E.TURNED_OVER, _E.FALLEN)
_INTERRUPTS = (_E.INTERRUPT, _E.INTERRUPT_ON_GROUND, _E.INTERRUPT_IN_AIR)

IGNORED: Mapping[State, frozenset[Event]] = {
    _S.IDLE: frozenset(Event) - {_E.START, _E.INTERRUPT},
    # The checks themselves evaluate what the vehicle reports in the meantime.
    _S.CHECKS: frozenset(
        {_E.START, _E.ARMED, _E.DISARMED, _E.AIRBORNE, _E.LANDED, _E.STILL, *_OF_FLIGHT, *_OF_HOLD, *_HEALTH}
        | {_E.NOT_OBEYED, _E.ORDER_REFUSED, _E.FAILSAFE_IDLE, *_POSITION, *_CRASHES, *_TAKEN_OVER}
        | {_E.WATCHDOG}
    ),
    # The watchdog acts while this program is in control only; from arming it becomes so in a take-off.
    _S.ARMING: frozenset(
        {
            _E.START,
            _E.WATCHDOG,
            *_OF_CHECKS,
            _E.DISARMED,
            _E.AIRBORNE,
            _E.LANDED,
            _E.STILL,
            *_OF_FLIGHT,
            *_OF_HOLD,
        }
        | {_E.FRAME_WRONG, _E.FENCE, _E.NOT_OBEYED, _E.DRIFTS, _E.LANDED_AWAY, *_CRASHES}
    ),
    _S.TAKE_OFF: frozenset(
        {_E.START, *_OF_CHECKS, _E.ARMED, _E.LANDED, _E.STILL, *_OF_FLIGHT, *_OF_HOLD}
        | {_E.DRIFTS, _E.LANDED_AWAY, _E.FALLEN}
    ),
    # A report of having landed is no reason to stop the motors of a vehicle that is ordered to fly.
    _S.FLY: frozenset(
        {_E.START, *_OF_CHECKS, _E.ARMED, _E.AIRBORNE, _E.LANDED, _E.STILL, *_OF_HOLD, *_POSITION}
    ),
    # The cause of the hold is still present until it has recovered, or has lasted too long.
    _S.HOLD: frozenset(
        {_E.START, *_OF_CHECKS, _E.ARMED, _E.AIRBORNE, _E.LANDED, _E.STILL, *_OF_FLIGHT, _E.OFF_CLIMB}
        | {_E.STATE_STALE, _E.SLIPS, _E.FENCE, _E.LANDED_AWAY}
    ),
    # The landing continues whatever else is wrong: there is no better action, and wind may cause drift.
    _S.LAND: frozenset(
        {_E.START, *_OF_CHECKS, _E.ARMED, _E.AIRBORNE, *_OF_FLIGHT, *_OF_HOLD, *_HEALTH} - {_E.ESTIMATOR_BAD}
        | {_E.OFF_CLIMB, _E.DRIFTS, _E.TURNED_OVER, _E.FALLEN, _E.FAILSAFE_IDLE, _E.INTERRUPT}
    ),
    _S.HAND_OVER: frozenset(
        {_E.START, *_OF_CHECKS, _E.ARMED, _E.AIRBORNE, _E.LANDED, _E.STILL, *_OF_FLIGHT, *_OF_HOLD, *_HEALTH}
        | {_E.NOT_OBEYED, _E.ORDER_REFUSED, _E.TIMED_OUT, _E.FAILSAFE_IDLE}
        | {*_POSITION, *_CRASHES, *_TAKEN_OVER, _E.WATCHDOG}
    ),
    _S.ABORT: frozenset(
        {
            _E.START,
            _E.WATCHDOG,
            *_OF_CHECKS,
            _E.ARMED,
            _E.AIRBORNE,
            _E.LANDED,
            _E.STILL,
            *_OF_FLIGHT,
            *_OF_HOLD,
            *_HEALTH,
        }
        | {_E.NOT_OBEYED, _E.LINK_LOST, _E.FAILSAFE_IDLE, *_POSITION, *_CRASHES, *_INTERRUPTS}
    ),
    _S.DONE: frozenset(Event),
}


def described() -> str:
    """Table in Markdown for docs/guide/fly-states.md: event, next state and action per state."""
    lines = ["| in | when | then | and |", "| --- | --- | --- | --- |"]
    for state, row in TABLE.items():
        together: dict[tuple[State, Action], list[str]] = {}
        for event, step in row.items():
            together.setdefault((step.state, step.action), []).append(event.value)
        for (following, action), events in together.items():
            then = "stay" if following is state else following.value
            lines.append(f"| {state.value} | {'; '.join(events)} | {then} | {action.value} |")
    return "\n".join(lines) + "\n"
