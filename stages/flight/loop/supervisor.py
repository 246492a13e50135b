"""Supervisor of a flight: turns facts into events and takes the steps of the table.

Set-points along the plan are sent in `State.FLY` only. The vehicle takes off, holds and lands by itself,
which needs neither the loop's state nor its filter; the loop filters a hold where it can. No step leads from
`State.HAND_OVER` back to a flight.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from alula.stages.flight.loop.supervisor_table import IGNORED, TABLE, Action, Event, State, Step


class FilterHealth(Enum):
    """Result of the last call of the filter."""

    GOOD = "good"
    REFUSED = "refused"
    FAILED = "failed"


@dataclass(frozen=True, kw_only=True)
class SupervisorLimits:
    """Limits beyond which a fact is an event.

    Attributes:
        stale_s: maximum age of a state [s].
        jump_m: maximum jump of the position, see `JumpWatch` [m].
        slip_m: maximum slip of the position against the velocity, see `SlipWatch` [m].
        silence_s: maximum time without any message of the vehicle [s].
        late_s: maximum lateness of a tick [s].
        overruns: number of ticks that overran in a row.
        fallback_s: maximum time for which the filter or the geofence may fly a fallback [s].
        model_s: maximum time for which the motion may contradict the vehicle's model [s].
        fence_m: minimum distance to the fence [m].
        battery_share: minimum charge of the battery, from 0 to 1.
        settle_s: time without any cause of a hold, after which a hold ends [s].
        engage_s: maximum time in which the vehicle does not follow orders, at first and later [s].
        drift_m: maximum drift of a hold, see `PositionWatch` [m].
        landed_m: maximum horizontal distance between the plan's end and where the vehicle lands after it [m].
        arrived_m: maximum of that with what the position may have strayed, see `VehicleStatus`; at least
            `landed_m` [m].
        failsafe_s: maximum time for which a vehicle in a failsafe may stay in the mode that follows
            set-points; many failsafes are configured to do nothing [s].
        holds: maximum number of holds of a flight; the vehicle lands at the next one.
        checks_s, arming_s, take_off_s, flight_s, hold_s, landing_s, abort_s: maximum time in a state [s].
    """

    stale_s: float = 0.15
    jump_m: float = 0.4
    slip_m: float = 2.0
    silence_s: float = 1.5
    late_s: float = 0.1
    overruns: int = 20
    fallback_s: float = 3.0
    model_s: float = 0.5
    fence_m: float = 0.0
    battery_share: float = 0.2
    settle_s: float = 1.0
    engage_s: float = 2.0
    drift_m: float = 1.0
    landed_m: float = 0.5
    arrived_m: float = 1.0
    failsafe_s: float = 1.0
    holds: int = 3
    checks_s: float = 120.0
    arming_s: float = 60.0
    take_off_s: float = 30.0
    flight_s: float = math.inf
    hold_s: float = 5.0
    landing_s: float = 60.0
    abort_s: float = 5.0


@dataclass(slots=True)
class Facts:
    """Facts of one tick; None is unknown.

    Attributes:
        state_age_s: age of the newest state [s].
        jump_m: distance of its position from the predicted one, see `JumpWatch` [m].
        slip_m: distance by which its position and its velocity contradict each other, see `SlipWatch` [m].
        free_m: distance from the nearest obstacle beyond the radius, by the filter's last decision [m];
            infinite where no filter measures it.
        silence_s: time since the last valid message [s].
        armed, landed, obeys, is_failsafe, estimator_ready, battery_share: as reported by the vehicle.
        is_ours: False after somebody else has changed the mode.
        by_failsafe: one of the vehicle's own failsafes has changed it.
        order_refused: the vehicle refused the last order more than 1 s ago.
        health_unknown: the vehicle no longer reports a health value that it reported when it was armed.
        parameter_changed: another station has changed a parameter that the flight relies on.
        off_climb_m: distance from the climb path beyond the room that was proven clear; 0 within [m].
        drift_m: drift of a hold beyond the distance needed to brake; 0 within [m].
        from_goal_m: horizontal distance from the plan's end [m]; NaN without a state.
        strayed_m, sinks: as `VehicleStatus` has them.
        is_lying, is_over, is_fallen, is_still: as `CrashWatch` found.
        restarted: the vehicle has rebooted since the checks, and has lost all orders and parameters.
        checks: result of the pre-flight checks; None while they run.
        climbed_m: height above the position of the checks [m].
        height_m: height of the take-off above the same position [m].
        overruns: number of ticks that overran in a row.
        filter: result of the last call of the filter.
        fallback_s: time for which the filter or the geofence has flown a fallback [s].
        model_off_s: time for which the motion has contradicted the vehicle's model, see `ModelWatch` [s].
        fence_m: distance to the fence [m]; None without a state.
    """

    now_s: float
    state_age_s: float = math.inf
    jump_m: float = 0.0
    slip_m: float = 0.0
    free_m: float = math.inf
    silence_s: float = math.inf
    armed: bool | None = None
    landed: bool | None = None
    obeys: bool = False
    is_failsafe: bool = False
    restarted: bool = False
    health_unknown: bool = False
    parameter_changed: bool = False
    off_climb_m: float = 0.0
    drift_m: float = 0.0
    from_goal_m: float = 0.0
    strayed_m: float = 0.0
    sinks: bool = False
    is_lying: bool = False
    is_over: bool = False
    is_fallen: bool = False
    is_still: bool = False
    estimator_ready: bool | None = None
    battery_share: float | None = None
    is_ours: bool = True
    by_failsafe: bool = False
    order_refused: bool = False
    checks: bool | None = None
    dry_run: bool = False
    climbed_m: float | None = None
    height_m: float = math.inf
    frame_wrong: bool = False
    late_s: float = 0.0
    overruns: int = 0
    filter: FilterHealth = FilterHealth.GOOD
    fallback_s: float = 0.0
    model_off_s: float = 0.0
    fence_m: float | None = None
    plan_done: bool = False
    watchdog: bool = False
    interrupts: int = 0


@dataclass(frozen=True, slots=True)
class Supervision:
    """State of the supervisor and what it remembers.

    Attributes:
        seen: events that were handled in this state without leaving it.
        well_since_s: time since which no cause of a hold has been present, in a hold [s].
        engaged: the vehicle has followed set-points since it was ordered to.
        unheeded_s: time since which the vehicle has not been in the ordered mode [s].
        flying_s: time at which the plan was first flown; a hold does not reset it [s].
        failsafe_s: time since which the vehicle reports a failsafe and still follows set-points [s].
        cause: first event that ended the flight, as planned or not; after a finished plan the first one that
            spoilt its landing; None so far.
    """

    state: State = State.IDLE
    since_s: float = 0.0
    seen: frozenset[Event] = frozenset()
    well_since_s: float = math.inf
    engaged: bool = False
    unheeded_s: float = math.inf
    flying_s: float = math.inf
    holds: int = 0
    failsafe_s: float = math.inf
    cause: Event | None = None


class Taken(NamedTuple):
    """A step that was taken: the state before, the event, and the step of the table."""

    state: State
    event: Event
    step: Step


_REPEATS = frozenset({Event.ORDER_REFUSED})  # acts each time it occurs in a state, not only once
_HOLDING = frozenset(
    {Event.STATE_STALE, Event.LINK_LOST, Event.LOOP_LATE, Event.SLIPS, Event.MODEL_WRONG, Event.FENCE}
)
# The vehicle must be in a mode that follows set-points in these states, and in none in LAND.
_OBEYING = frozenset({State.TAKE_OFF, State.FLY, State.HOLD})
_ENDS = frozenset({State.LAND, State.HAND_OVER, State.ABORT, State.DONE})
# A plan was finished; with one of these in the landing the flight did not end as planned nevertheless.
_SPOILS = frozenset({Event.FAILSAFE, Event.ESTIMATOR_BAD, Event.LANDED_AWAY, Event.CRASHED, Event.TIMED_OUT})
# Names of the limits of the time in a state; the other states have none.
_LONGEST = {
    State.CHECKS: "checks_s",
    State.ARMING: "arming_s",
    State.TAKE_OFF: "take_off_s",
    State.FLY: "flight_s",
    State.HOLD: "hold_s",
    State.LAND: "landing_s",
    State.ABORT: "abort_s",
}


def sends_setpoints(state: State) -> bool:
    """Return True if set-points along the plan are sent in a state."""
    return state is State.FLY


def advance(was: Supervision, facts: Facts, limits: SupervisorLimits) -> tuple[Supervision, list[Taken]]:
    """Take the steps of the events in the facts, most urgent first, up to one that leaves the state.

    Args:
        limits: beyond which a fact is an event.

    Returns:
        The state now, and the steps that were taken; at most one of them leaves the state.
    """
    now = _timed(was, facts, limits)
    ignored = IGNORED[now.state]  # until a step leaves the state, and this function with it
    taken: list[Taken] = []
    for event in observe(now, facts, limits):
        if event in ignored or (event in now.seen and event not in _REPEATS):
            continue
        step = TABLE[now.state][event]
        taken.append(Taken(now.state, event, step))
        if step.state is not now.state:
            return _entered(now, step.state, event, facts.now_s), taken
        # If a landed vehicle refuses to disarm, the order is repeated: it may not disarm by itself.
        forgotten = {Event.LANDED} if event is Event.ORDER_REFUSED else set()
        now = dataclasses.replace(
            now, seen=(now.seen | {event}) - forgotten, cause=_cause(now, event, now.state)
        )
    return now, taken


def begun(now_s: float) -> tuple[Supervision, list[Taken]]:
    """Start a flight: the checks begin.

    Returns:
        The state now, and the step that was taken.
    """
    step = TABLE[State.IDLE][Event.START]
    start = Supervision(since_s=now_s)
    return _entered(start, step.state, Event.START, now_s), [Taken(State.IDLE, Event.START, step)]


def observe(was: Supervision, facts: Facts, limits: SupervisorLimits) -> Iterator[Event]:
    """Yield all events that the facts show, most urgent first; NaN counts as beyond its limit.

    Args:
        limits: beyond which a fact is an event.
    """
    state = was.state
    longest = getattr(limits, _LONGEST[state]) if state in _LONGEST else math.inf
    fence = facts.fence_m
    battery = facts.battery_share
    engaged = was.engaged if state is State.FLY else True
    second = facts.interrupts >= 2
    begin_s = min(was.since_s, was.flying_s) if state is State.FLY else was.since_s
    since_s = facts.now_s - was.since_s
    # An order to arm may still be on its way to a vehicle that reports that it is not armed.
    is_disarmed = facts.armed is False and (state is not State.ABORT or since_s > limits.settle_s)
    is_landing_over = is_disarmed or facts.landed is True or was.cause is not Event.PLAN_FINISHED
    is_moot = state is State.LAND and is_landing_over  # or what led to the landing is worse
    from_goal_m = facts.from_goal_m
    is_there = from_goal_m <= limits.landed_m and (
        from_goal_m + facts.strayed_m <= max(limits.arrived_m, limits.landed_m)
    )
    is_away = is_disarmed and was.cause is Event.PLAN_FINISHED and not is_there
    for event, is_so in (
        # Somebody who takes the vehicle over has priority over every other event; the watchdog changes the
        # mode, too.
        (Event.WATCHDOG, facts.watchdog),
        (Event.MODE_CHANGED, not (facts.is_ours or facts.by_failsafe)),
        (Event.FAILSAFE, (facts.is_failsafe and not facts.obeys) or facts.by_failsafe),
        (Event.LANDED_AWAY, is_away),
        (Event.DISARMED, is_disarmed),
        (Event.LINK_LOST, not abs(facts.silence_s) <= limits.silence_s),
        (Event.CRASHED, facts.is_lying),
        (Event.TURNED_OVER, facts.is_over),
        (Event.FALLEN, facts.is_fallen),
        (Event.INTERRUPT_ON_GROUND, second and facts.landed is True),
        (Event.INTERRUPT_IN_AIR, second and facts.landed is not True),
        (Event.INTERRUPT, facts.interrupts == 1),
        (Event.FRAME_WRONG, facts.frame_wrong),
        (Event.RESTARTED, facts.restarted),
        (Event.FAILSAFE_IDLE, facts.now_s - was.failsafe_s > limits.failsafe_s),
        (Event.ESTIMATOR_BAD, facts.estimator_ready is False and not is_moot),
        (Event.BATTERY_LOW, battery is not None and not battery >= limits.battery_share),
        (Event.HEALTH_UNKNOWN, facts.health_unknown),
        (Event.PARAMETER_CHANGED, facts.parameter_changed),
        (Event.STATE_STALE, not abs(facts.state_age_s) <= limits.stale_s),  # nor in the future
        (Event.STATE_JUMPED, not facts.jump_m <= limits.jump_m),
        (Event.OFF_CLIMB, not facts.off_climb_m <= 0.0),
        (Event.SLIPS, not facts.slip_m <= min(limits.slip_m, max(0.0, facts.free_m))),
        (Event.DRIFTS, not facts.drift_m <= limits.drift_m),
        (Event.LOOP_LATE, not facts.late_s <= limits.late_s or facts.overruns >= limits.overruns),
        (Event.FILTER_FAILED, facts.filter is FilterHealth.FAILED),
        (Event.FILTER_REFUSED, facts.filter is FilterHealth.REFUSED),
        (Event.FENCE, fence is not None and not fence >= limits.fence_m),
        (Event.MODEL_WRONG, not facts.model_off_s <= limits.model_s),
        (Event.FALLBACK_LONG, not facts.fallback_s <= limits.fallback_s),
        (Event.ORDER_REFUSED, facts.order_refused),
        (Event.CHECK_FAILED, facts.checks is False),
        (Event.CHECKS_PASSED_DRY, facts.checks is True and facts.dry_run),
        (Event.CHECKS_PASSED, facts.checks is True),
        (Event.LANDED, facts.landed is True),
        (Event.STILL, facts.is_still and facts.landed is False),
        (Event.ARMED, facts.armed is True),
        (Event.AIRBORNE, facts.landed is not True and _has_climbed(facts)),
        (Event.PLAN_FINISHED, facts.plan_done),
        (Event.NOT_OBEYED, not engaged and since_s > limits.engage_s),
        (Event.NOT_OBEYED, facts.now_s - was.unheeded_s > limits.engage_s),
        (Event.HOLDS_USED_UP, state is State.HOLD and was.holds > limits.holds),
        (Event.RECOVERED, facts.now_s - was.well_since_s > limits.settle_s),
        (Event.TIMED_OUT, not facts.now_s - begin_s <= longest),
    ):
        if is_so:
            yield event


def _has_climbed(facts: Facts) -> bool:
    return facts.climbed_m is not None and facts.climbed_m >= 0.95 * facts.height_m


def _timed(was: Supervision, facts: Facts, limits: SupervisorLimits) -> Supervision:
    """Update the times since which a condition holds, and `engaged`."""
    is_idle = facts.is_failsafe and facts.obeys
    is_landing_late = was.state is State.LAND and facts.obeys and not facts.sinks
    is_unheeded = (was.state in _OBEYING and not facts.obeys) or is_landing_late
    failsafe = min(was.failsafe_s, facts.now_s) if is_idle else math.inf
    unheeded = min(was.unheeded_s, facts.now_s) if is_unheeded else math.inf
    if (failsafe, unheeded) != (was.failsafe_s, was.unheeded_s):
        was = dataclasses.replace(was, failsafe_s=failsafe, unheeded_s=unheeded)
    if was.state is State.FLY and facts.obeys and not was.engaged:
        return dataclasses.replace(was, engaged=True)
    if was.state is not State.HOLD:
        return was
    is_well = _HOLDING.isdisjoint(observe(was, facts, limits))
    since = min(was.well_since_s, facts.now_s) if is_well else math.inf
    return was if since == was.well_since_s else dataclasses.replace(was, well_since_s=since)


def _entered(was: Supervision, state: State, event: Event, now_s: float) -> Supervision:
    return Supervision(
        state=state,
        since_s=now_s,
        flying_s=min(was.flying_s, now_s) if state is State.FLY else was.flying_s,
        holds=was.holds + (state is State.HOLD),
        failsafe_s=was.failsafe_s,
        cause=_cause(was, event, state),
    )


def _cause(was: Supervision, event: Event, state: State) -> Event | None:
    """Cause of the end of the flight after an event that leads to a state, or stays in it."""
    if was.cause is Event.PLAN_FINISHED and was.state is State.LAND and event in _SPOILS:
        return event
    return event if was.cause is None and was.state is not state and state in _ENDS else was.cause


__all__ = [
    "Action",
    "Event",
    "Facts",
    "FilterHealth",
    "State",
    "Step",
    "Supervision",
    "SupervisorLimits",
    "Taken",
    "advance",
    "begun",
    "observe",
    "sends_setpoints",
]
