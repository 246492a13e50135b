"""Who flies: the states of a flight and what leads from one to the next, as a table.

The vehicle is sent set-points along the plan in `State.FLY` alone. Taking off, holding and landing are done
by the vehicle itself, and need neither our state nor our filter; a hold is filtered by the loop where it can
be. Nothing leads from `State.HAND_OVER` back.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from alula.stages.flight.loop.supervisor_table import IGNORED, TABLE, Action, Event, State, Step


class FilterHealth(Enum):
    """How the filter answered last."""

    GOOD = "good"
    REFUSED = "refused"
    FAILED = "failed"


@dataclass(frozen=True, kw_only=True)
class SupervisorLimits:
    """When an observation is an event.

    Attributes:
        stale_s: oldest state that is flown on.
        jump_m: of a position beyond what velocities explain.
        silence_s: without any word of the vehicle for this long the link is lost.
        late_s: a tick that begins this late is an event, as are `overruns` that overran in a row.
        fallback_s: how long a filter may fly its fallback.
        fence_m: least distance to the fence.
        battery_share: least charge, of 1.
        settle_s: all must be well for this long before a hold ends.
        engage_s: how long the vehicle may take to follow us, at first and whenever it does not.
        drift_m: from where a hold began, beyond what it takes to brake.
        failsafe_s: how long a vehicle in a failsafe may take to leave our mode; many are told to do nothing.
        holds: of one flight; after the last it lands.
        checks_s, arming_s, take_off_s, flight_s, hold_s, landing_s, abort_s: longest time in a state.
    """

    stale_s: float = 0.15
    jump_m: float = 0.4
    silence_s: float = 1.5
    late_s: float = 0.1
    overruns: int = 20
    fallback_s: float = 3.0
    fence_m: float = 0.0
    battery_share: float = 0.2
    settle_s: float = 1.0
    engage_s: float = 2.0
    drift_m: float = 1.0
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
    """What is known at one time; None is unknown.

    Attributes:
        now_s: monotonic clock.
        state_age_s: of the newest state; jump_m: how far it lies from where velocities led to.
        silence_s: since anything valid arrived.
        armed, landed, obeys, is_failsafe, estimator_ready, battery_share: as the vehicle says.
        is_ours: False once somebody else has changed the mode.
        order_refused: the vehicle has declined the last order, some time ago.
        untold: the vehicle no longer says of its health what it said when it was armed.
        astray_m: how far it is beyond what was proven clear of its way up; 0 is within.
        drift_m: how far a hold has let it go, beyond what it takes to brake.
        restarted: the vehicle has started anew since the checks, and forgotten what it was told.
        checks: whether all pre-flight checks passed; None while they run.
        dry_run: checks are all there is to do.
        climbed_m: since the motors were armed.
        height_m: to take off to.
        frame_wrong: motion contradicts the frame.
        late_s: of the last tick; overruns: in a row.
        filter: its last answer; fallback_s: for how long it has flown a fallback.
        fence_m: distance to the fence; unknown without a state.
        plan_done: the end of the plan is reached.
        interrupts: how often the operator has asked to end.
    """

    now_s: float
    state_age_s: float = math.inf
    jump_m: float = 0.0
    silence_s: float = math.inf
    armed: bool | None = None
    landed: bool | None = None
    obeys: bool = False
    is_failsafe: bool = False
    restarted: bool = False
    untold: bool = False
    astray_m: float = 0.0
    drift_m: float = 0.0
    estimator_ready: bool | None = None
    battery_share: float | None = None
    is_ours: bool = True
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
    fence_m: float | None = None
    plan_done: bool = False
    interrupts: int = 0


@dataclass(frozen=True, slots=True)
class Supervision:
    """Where a flight stands.

    Attributes:
        state: since `since_s`.
        seen: events of this state that were dealt with and left it as it is.
        well_since_s: since when all has been well in a hold.
        engaged: whether the vehicle has followed set-points since it was told to.
        unheeded_s: since when it has not been in the mode that it should be in.
        flying_s: when it first flew the plan: holds do not begin its time anew.
        holds: how many there were.
        failsafe_s: since when the vehicle tells of a failsafe, and follows us nevertheless.
        cause: the first event that ended the flight as planned or otherwise; None so far.
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
    """A step that was taken: from where, on which event, and what the table says."""

    state: State
    event: Event
    step: Step


_REPEATS = frozenset({Event.ORDER_REFUSED})  # may come again in the same state and means the same again
_HOLDING = frozenset({Event.STATE_STALE, Event.LINK_LOST, Event.LOOP_LATE, Event.FENCE})
_OBEYING = frozenset(
    {State.TAKE_OFF, State.FLY, State.HOLD}
)  # in a mode that follows set-points; not in LAND
_ENDS = frozenset({State.LAND, State.HAND_OVER, State.ABORT, State.DONE})


def sends_setpoints(state: State) -> bool:
    """Whether set-points along the plan are sent in a state."""
    return state is State.FLY


def advance(was: Supervision, facts: Facts, limits: SupervisorLimits) -> tuple[Supervision, list[Taken]]:
    """One look at the facts: the first event in order of urgency that the state has not dealt with yet.

    Returns:
        Where the flight stands now, and the steps that were taken, at most one that leaves the state.
    """
    now = _timed(was, facts, limits)
    taken: list[Taken] = []
    for event in observe(now, facts, limits):
        if event in IGNORED[now.state] or (event in now.seen and event not in _REPEATS):
            continue
        step = TABLE[now.state][event]
        taken.append(Taken(now.state, event, step))
        if step.state is not now.state:
            return _entered(now, step.state, event, facts.now_s), taken
        # A landed vehicle that declines to disarm is asked again: it may not do so by itself.
        forgotten = {Event.LANDED} if event is Event.ORDER_REFUSED else set()
        now = dataclasses.replace(now, seen=(now.seen | {event}) - forgotten)
    return now, taken


def begun(now_s: float) -> tuple[Supervision, list[Taken]]:
    """The operator starts: the checks begin."""
    step = TABLE[State.IDLE][Event.START]
    start = Supervision(since_s=now_s)
    return _entered(start, step.state, Event.START, now_s), [Taken(State.IDLE, Event.START, step)]


def observe(was: Supervision, facts: Facts, limits: SupervisorLimits) -> Iterator[Event]:
    """All that is the case, most urgent first; what is not a number is as bad as can be."""
    state = was.state
    longest = _longest(limits)[state]
    fence = facts.fence_m
    battery = facts.battery_share
    engaged = was.engaged if state is State.FLY else True
    second = facts.interrupts >= 2
    begin_s = min(was.since_s, was.flying_s) if state is State.FLY else was.since_s
    since_s = facts.now_s - was.since_s
    # An order to arm may still be on its way to a vehicle that says it is not.
    is_disarmed = facts.armed is False and (state is not State.ABORT or since_s > limits.settle_s)
    for event, is_so in (
        # Whoever took the vehicle has it, before anything else.
        (Event.MODE_CHANGED, not facts.is_ours),
        (Event.FAILSAFE, facts.is_failsafe and not facts.obeys),
        (Event.DISARMED, is_disarmed),
        (Event.LINK_LOST, not abs(facts.silence_s) <= limits.silence_s),
        (Event.INTERRUPT_ON_GROUND, second and facts.landed is True),
        (Event.INTERRUPT_IN_AIR, second and facts.landed is not True),
        (Event.INTERRUPT, facts.interrupts == 1),
        (Event.FRAME_WRONG, facts.frame_wrong),
        (Event.RESTARTED, facts.restarted),
        (Event.FAILSAFE_IDLE, facts.now_s - was.failsafe_s > limits.failsafe_s),
        (Event.ESTIMATOR_BAD, facts.estimator_ready is False),
        (Event.BATTERY_LOW, battery is not None and not battery >= limits.battery_share),
        (Event.UNTOLD, facts.untold),
        (Event.STATE_STALE, not abs(facts.state_age_s) <= limits.stale_s),  # nor from the future
        (Event.STATE_JUMPED, not facts.jump_m <= limits.jump_m),
        (Event.OFF_WAY, not facts.astray_m <= 0.0),
        (Event.DRIFTS, not facts.drift_m <= limits.drift_m),
        (Event.LOOP_LATE, not facts.late_s <= limits.late_s or facts.overruns >= limits.overruns),
        (Event.FILTER_FAILED, facts.filter is FilterHealth.FAILED),
        (Event.FILTER_REFUSED, facts.filter is FilterHealth.REFUSED),
        (Event.FENCE, fence is not None and not fence >= limits.fence_m),
        (Event.FALLBACK_LONG, not facts.fallback_s <= limits.fallback_s),
        (Event.ORDER_REFUSED, facts.order_refused),
        (Event.CHECK_FAILED, facts.checks is False),
        (Event.CHECKS_PASSED_DRY, facts.checks is True and facts.dry_run),
        (Event.CHECKS_PASSED, facts.checks is True),
        (Event.LANDED, facts.landed is True),
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


def _longest(limits: SupervisorLimits) -> Mapping[State, float]:
    return {
        State.IDLE: math.inf,
        State.CHECKS: limits.checks_s,
        State.ARMING: limits.arming_s,
        State.TAKE_OFF: limits.take_off_s,
        State.FLY: limits.flight_s,
        State.HOLD: limits.hold_s,
        State.LAND: limits.landing_s,
        State.HAND_OVER: math.inf,
        State.ABORT: limits.abort_s,
        State.DONE: math.inf,
    }


def _timed(was: Supervision, facts: Facts, limits: SupervisorLimits) -> Supervision:
    """Since when all has been well, in a failsafe or not as told, and whether it has begun to follow."""
    is_idle = facts.is_failsafe and facts.obeys
    is_deaf = (was.state in _OBEYING and not facts.obeys) or (was.state is State.LAND and facts.obeys)
    failsafe = min(was.failsafe_s, facts.now_s) if is_idle else math.inf
    unheeded = min(was.unheeded_s, facts.now_s) if is_deaf else math.inf
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
        cause=event if was.cause is None and state in _ENDS else was.cause,
    )


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
