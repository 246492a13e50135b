"""Every row of the supervisor's table is taken by a flight of the simulated autopilot."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from alula.stages.filtering.protocol import FilterResult, FilterStatus
from alula.stages.flight.loop.supervisor_table import TABLE, Event, State
from support.flights.flights import mission, refilter
from support.flights.foreign_filters import OfVelocities
from support.scenes.small_scenes import line_plan
from support.vehicles.lockstep import (
    Flight,
    Upset,
    allow,
    blow,
    cut,
    fault,
    interrupt,
    land_seen,
    mirror,
    mute,
    nearly_up,
    refuse,
    set_back,
    set_by_another,
    stall,
    topple,
    unmute,
    unseen,
)

S, E = State, Event
START, GOAL = (0.3, 2.0, 0.5), (2.7, 2.0, 0.5)
SHORT = {"duration": 0.4}

# No flight takes these. `ControlLoop` begins with the checks: Ctrl-C before that ends the command
# (test_fly_signals). Motion is compared with the frame in take-off and flight only, and the result is
# handled in the same tick.
NEVER = {(S.IDLE, E.INTERRUPT), (S.HOLD, E.FRAME_WRONG)}


@dataclasses.dataclass
class Plot:
    """Rows of the table that a flight must take, its faults, and its configuration."""

    rows: list[tuple[State, Event]]
    upsets: list[Upset]
    limits: dict[str, float] = dataclasses.field(default_factory=dict)
    words: dict[str, Any] = dataclasses.field(default_factory=dict)
    parameters: dict[str, float] = dataclasses.field(default_factory=dict)
    mission: dict[str, Any] = dataclasses.field(default_factory=dict)
    seen_is_true: bool = True
    watched: bool = False


def on(state, *do, after=0.1):
    return [Upset(state, after, each) for each in do]


def failsafe(flight):
    """The vehicle reports a failsafe and does nothing else."""
    flight.copter.failsafe = "Battery"


def left_to_itself(flight):
    """The link reports a failsafe and no mode: a failsafe need not change it."""
    status = flight.link.status
    status.is_failsafe, status.obeys, status.mode = True, False, ""
    flight.muted.add("HEARTBEAT")


def flat(flight):
    """The battery's failsafe acts: the vehicle lands by itself."""
    for name, value in (("BATT_LOW_TIMER", 0.0), ("BATT_FS_LOW_ACT", 1.0), ("BATT_LOW_VOLT", 13.0)):
        flight.copter.parameters.set(name, value)


def kill(flight):
    """The motors stop, in the air or on the ground."""
    flight.copter.disarm(forced=True)


def broken(status):
    """The filter returns this status as soon as the vehicle flies; `None` raises."""

    def do(flight):
        def answer(x, u):
            if status is None:
                raise RuntimeError("no more")
            return FilterResult(np.zeros(3), status, 1.0)

        flight.mended = lambda: refilter(flight.loop, flight.made)
        refilter(flight.loop, flight.made, lambda _: OfVelocities(answer))

    return do


def mend(flight):
    flight.mended()


ENDINGS = {  # in the air, from any state in which the program has control
    E.MODE_CHANGED: [fault("mode", amount=5)],  # LOITER
    E.FAILSAFE: [flat],
    E.DISARMED: [kill],
    E.LINK_LOST: [cut],
    E.RESTARTED: [set_back],
    E.STATE_JUMPED: [fault("jump", amount=0.9)],
    E.ESTIMATOR_BAD: [fault("estimator")],
    E.BATTERY_LOW: [fault("battery", amount=0.15)],
    E.FAILSAFE_IDLE: [failsafe],
    E.PARAMETER_CHANGED: [set_by_another("GUID_OPTIONS", 0.0)],
    E.INTERRUPT: [interrupt(1)],
    E.INTERRUPT_ON_GROUND: [land_seen, lambda flight: None],
    E.INTERRUPT_IN_AIR: [interrupt(2)],
}


def endings(state, before, after):
    """A flight for each of `ENDINGS` in a state; after a hand-over one more row ends it."""
    found = {}
    for event, dos in ENDINGS.items():
        rows, upsets, limits = [(state, event)], [*before, *on(state, *dos, after=after)], {}
        if event is E.INTERRUPT_ON_GROUND:
            upsets += on(state, interrupt(2), after=after + 0.3)
        if event in (E.MODE_CHANGED, E.FAILSAFE):
            end = HANDED[state, event]
            rows.append((S.HAND_OVER, end))
            upsets += [u for do in OVER[end] for u in on(S.HAND_OVER, do, after=0.3)]
            if end is E.INTERRUPT_ON_GROUND:
                upsets += on(S.HAND_OVER, interrupt(2), after=0.6)
        if event is E.FAILSAFE_IDLE:
            limits["failsafe_s"] = 0.5
        if event is E.LINK_LOST:
            limits["landing_s"] = 1.0
        found[f"{state.value}: {event.value}"] = Plot(
            rows, upsets, limits, seen_is_true=event not in (E.STATE_JUMPED, E.DISARMED)
        )
    return found


HANDED = {  # event that ends a flight after a hand-over
    (S.TAKE_OFF, E.MODE_CHANGED): E.INTERRUPT,
    (S.TAKE_OFF, E.FAILSAFE): E.INTERRUPT_IN_AIR,
    (S.FLY, E.MODE_CHANGED): E.LINK_LOST,
    (S.FLY, E.FAILSAFE): E.INTERRUPT_ON_GROUND,
    (S.HOLD, E.MODE_CHANGED): E.DISARMED,
    (S.HOLD, E.FAILSAFE): E.INTERRUPT,
}
OVER = {
    E.INTERRUPT: [interrupt(1)],
    E.INTERRUPT_IN_AIR: [interrupt(2)],
    E.INTERRUPT_ON_GROUND: [land_seen],
    E.LINK_LOST: [cut],
    E.DISARMED: [fault("mode", amount=9)],  # the pilot lands it
}


def armed_unseen(flight):
    """The motors start; no heartbeat has reported it yet."""
    return flight.copter.is_armed


UNARMED = on(S.CHECKS, refuse("arm"), after=0.0)
FROZEN = on(S.FLY, fault("freeze", **SHORT), after=0.3)
# Armed, but not reported as armed, when the operator ends the flight: the order to disarm is lost.
STRAY = on(S.ARMING, interrupt(1), fault("drop", way="in"), after=armed_unseen)

CRASHES = {"FS_CRASH_CHECK": 0.0}  # it does not disarm by itself
PLOTS = {
    "as planned, armed late": Plot(
        [
            *((S.IDLE, E.START), (S.CHECKS, E.CHECKS_PASSED), (S.ARMING, E.ORDER_REFUSED)),
            *((S.ARMING, E.ARMED), (S.TAKE_OFF, E.AIRBORNE), (S.FLY, E.PLAN_FINISHED), (S.LAND, E.DISARMED)),
        ],
        [*UNARMED, *on(S.ARMING, allow("arm"), after=1.8)],
    ),
    "dry run": Plot([(S.CHECKS, E.CHECKS_PASSED_DRY)], [], words={"dry_run": True}),
    "flat battery": Plot([(S.CHECKS, E.CHECK_FAILED)], on(None, fault("battery", amount=0.25))),
    "no answer before": Plot([(S.CHECKS, E.LINK_LOST)], on(S.CHECKS, cut)),
    "nobody moves it": Plot([(S.CHECKS, E.TIMED_OUT)], [], limits={"checks_s": 1.0}, words={"by_hand": True}),
    "checks: interrupted": Plot([(S.CHECKS, E.INTERRUPT)], on(S.CHECKS, interrupt(1))),
    "checks: twice": Plot([(S.CHECKS, E.INTERRUPT_ON_GROUND)], on(S.CHECKS, interrupt(2))),
    "checks: twice, landing unknown": Plot(
        [(S.CHECKS, E.INTERRUPT_IN_AIR)], [*on(None, mute("EXTENDED_SYS_STATE")), *on(S.CHECKS, interrupt(2))]
    ),
    **{
        f"arming: {event.value}": Plot(
            [(S.ARMING, event), (S.ABORT, E.DISARMED)], [*UNARMED, *on(S.ARMING, *dos, after=0.4)], limits
        )
        for event, dos, limits in (
            *(
                (event, ENDINGS[event], {})
                for event in ENDINGS
                if event
                not in (E.MODE_CHANGED, E.FAILSAFE, E.DISARMED, E.INTERRUPT_ON_GROUND, E.INTERRUPT_IN_AIR)
            ),
            (E.INTERRUPT_ON_GROUND, [interrupt(2)], {}),
            (E.STATE_STALE, [fault("freeze")], {}),
            (E.TIMED_OUT, [], {"arming_s": 1.0}),
        )
    },
    "arming: twice, landing unknown": Plot(
        [(S.ARMING, E.INTERRUPT_IN_AIR), (S.ABORT, E.DISARMED)],
        [
            *on(S.CHECKS, mute("EXTENDED_SYS_STATE"), after=0.3),
            *(*UNARMED, *on(S.ARMING, interrupt(2), after=3.2)),
        ],
    ),
    "arming: the pilot's switch": Plot(
        [(S.ARMING, E.MODE_CHANGED), (S.HAND_OVER, E.DISARMED)],
        [*UNARMED, *on(S.ARMING, fault("mode", amount=5), after=0.4)],
    ),
    "arming: its own failsafe": Plot(
        [(S.ARMING, E.FAILSAFE)],
        [*UNARMED, *on(S.CHECKS, refuse("set_mode")), *on(S.ARMING, failsafe, after=0.2)],
    ),
    "arming: interrupted as the motors start": Plot(
        [(S.ARMING, E.INTERRUPT), (S.ABORT, E.DISARMED)], on(S.ARMING, interrupt(1), after=armed_unseen)
    ),
    "abort: armed for ever": Plot([(S.ABORT, E.TIMED_OUT)], STRAY, limits={"abort_s": 1.5}),
    "abort: the pilot's switch": Plot(
        [(S.ABORT, E.MODE_CHANGED)], [*STRAY, *on(S.ABORT, fault("mode", amount=5), after=0.5)]
    ),
    "abort: its own failsafe": Plot(
        [(S.ABORT, E.FAILSAFE)], [*STRAY, *on(S.ABORT, left_to_itself, after=0.5)]
    ),
    "abort: disarming refused": Plot(
        [(S.ABORT, E.ORDER_REFUSED)], on(S.ARMING, refuse("disarm"), interrupt(1), after=armed_unseen)
    ),
    **endings(S.TAKE_OFF, [], 0.5),
    **endings(S.FLY, [], 0.3),
    **endings(S.HOLD, FROZEN, 0.4),
    "take-off: frozen": Plot(
        [(S.TAKE_OFF, E.STATE_STALE)], on(S.TAKE_OFF, fault("freeze", **SHORT), after=1.0)
    ),
    "take-off: mirrored": Plot([(S.TAKE_OFF, E.FRAME_WRONG)], on(S.ARMING, mirror, after=0.0)),
    "take-off: refused": Plot(
        [(S.TAKE_OFF, E.ORDER_REFUSED), (S.LAND, E.LANDED)], on(S.CHECKS, refuse("take_off"))
    ),
    "take-off: too slow": Plot([(S.TAKE_OFF, E.TIMED_OUT)], [], limits={"take_off_s": 1.2}),
    "interrupted before it lifts": Plot(
        [(S.TAKE_OFF, E.INTERRUPT), (S.LAND, E.LANDED), (S.LAND, E.INTERRUPT_ON_GROUND)],
        [*on(S.TAKE_OFF, interrupt(1), after=0.02), *on(S.LAND, interrupt(2), after=0.02)],
    ),
    "holds": Plot(
        [
            *((S.FLY, event) for event in (E.STATE_STALE, E.LOOP_LATE, E.FILTER_REFUSED, E.FILTER_FAILED)),
            *((S.FLY, E.FALLBACK_LONG), (S.HOLD, E.RECOVERED), (S.HOLD, E.HOLDS_USED_UP)),
        ],
        [],
        limits={"settle_s": 0.2, "fallback_s": 0.2, "holds": 5},
    ),
    "blown away": Plot(
        [(S.FLY, E.MODEL_WRONG)],
        on(S.FLY, blow(0.0, 25.0, 0.0), after=0.5),
        mission={"fence": (-5.0, -5.0, -0.5, 9.0, 30.0, 9.0)},
    ),
    "over the fence": Plot(
        [(S.FLY, E.FENCE)],
        on(S.FLY, fault("jump", amount=0.3), after=0.3),
        mission={"fence": (-0.5, 1.0, -0.5, 4.0, 2.35, 2.0)},
        seen_is_true=False,
    ),
    "fly: mirrored": Plot([(S.FLY, E.FRAME_WRONG)], on(S.FLY, mirror, after=0.0)),
    "fly: too slow": Plot([(S.FLY, E.TIMED_OUT)], [], limits={"flight_s": 0.4}),
    "fly: not seen to follow": Plot(
        [(S.FLY, E.NOT_OBEYED)], [*on(S.FLY, unseen, after=0.0), *on(S.LAND, unmute)]
    ),
    "fly: control refused, then landing": Plot(
        [(S.FLY, E.ORDER_REFUSED), (S.LAND, E.ORDER_REFUSED), (S.LAND, E.NOT_OBEYED)],
        [
            *on(S.TAKE_OFF, unseen, refuse("set_mode"), after=nearly_up),
            *on(S.LAND, unmute, after=0.1),
            *on(S.LAND, allow("set_mode"), after=2.5),
        ],
    ),
    "hold: control refused": Plot(
        [(S.HOLD, E.ORDER_REFUSED)],
        [
            *on(S.TAKE_OFF, unseen, refuse("set_mode"), after=nearly_up),
            *on(S.FLY, fault("freeze"), after=0.3),
            *on(S.LAND, unmute, allow("set_mode"), after=0.2),
        ],
    ),
    "hold: not seen to follow": Plot(
        [(S.HOLD, E.NOT_OBEYED)], [*on(S.FLY, unseen, fault("freeze"), after=0.3), *on(S.LAND, unmute)]
    ),
    "take-off: not seen to follow": Plot(
        [(S.TAKE_OFF, E.NOT_OBEYED)],
        [*on(S.TAKE_OFF, unseen, after=0.3), *on(S.LAND, unmute)],
        parameters={"WPNAV_SPEED_UP": 12.0},
    ),
    "arming: health not told": Plot(
        [(S.ARMING, E.HEALTH_UNKNOWN)], [*UNARMED, *on(S.CHECKS, mute("EKF_STATUS_REPORT"), after=0.3)]
    ),
    "take-off: health not told": Plot(
        [(S.TAKE_OFF, E.HEALTH_UNKNOWN)],
        on(S.CHECKS, mute("EKF_STATUS_REPORT"), after=0.3),
        parameters={"WPNAV_SPEED_UP": 12.0},
    ),
    "fly: health not told": Plot([(S.FLY, E.HEALTH_UNKNOWN)], on(S.TAKE_OFF, mute("EKF_STATUS_REPORT"))),
    "hold: health not told": Plot(
        [(S.HOLD, E.HEALTH_UNKNOWN)],
        [*on(S.TAKE_OFF, mute("EKF_STATUS_REPORT")), *on(S.FLY, fault("freeze"), after=0.5)],
    ),
    "arming: off the climb path": Plot(
        [(S.ARMING, E.OFF_CLIMB)],
        [*UNARMED, *on(S.ARMING, fault("jump", amount=0.35))],
        mission={"near_m": 0.2},
    ),
    "take-off: off the climb path": Plot(
        [(S.TAKE_OFF, E.OFF_CLIMB)],
        on(S.TAKE_OFF, fault("jump", amount=0.35)),
        mission={"near_m": 0.2},
        seen_is_true=False,
    ),
    **{
        f"{state.value}: slips": Plot(
            [(state, E.SLIPS)],
            [*before, *on(state, fault("jump", amount=0.25), after=0.3)],
            limits={"slip_m": 0.1},
            seen_is_true=False,
        )
        for state, before in ((S.ARMING, UNARMED), (S.TAKE_OFF, []), (S.FLY, []))
    },
    "take-off: over the fence": Plot(
        [(S.TAKE_OFF, E.FENCE)],
        on(S.TAKE_OFF, fault("jump", amount=0.35)),
        mission={"fence": (-0.5, 1.0, -0.5, 4.0, 2.17, 2.0)},
        seen_is_true=False,
    ),
    "hold: drifts": Plot(
        [(S.HOLD, E.DRIFTS)],
        [*on(S.FLY, stall(0.2), after=0.2), *on(S.HOLD, fault("jump", amount=0.38), after=0.3)],
        limits={"drift_m": 0.1},
        seen_is_true=False,
    ),
    "hold: for too long": Plot(
        [(S.HOLD, E.TIMED_OUT)], on(S.FLY, fault("freeze"), after=0.3), limits={"hold_s": 1.0}
    ),
    **{
        f"{state.value}: stalls": Plot(
            [(state, E.WATCHDOG), (S.HAND_OVER, E.INTERRUPT if state is S.LAND else E.DISARMED)],
            [*before, *on(state, stall(0.6), after=after)],
            watched=True,
        )
        for state, before, after in (
            (S.TAKE_OFF, [], 0.8),
            (S.FLY, [], 0.3),
            (S.HOLD, FROZEN, 0.2),
            (S.LAND, on(S.FLY, fault("drop", way="in", duration=0.5), interrupt(1), after=0.3), 0.02),
        )
    },
    "land: the pilot's switch": Plot(
        [(S.LAND, E.MODE_CHANGED), (S.HAND_OVER, E.INTERRUPT)],
        [*on(S.FLY, interrupt(1)), *on(S.LAND, fault("mode", amount=5), after=0.4)],
    ),
    "land: its own failsafe": Plot(
        [(S.LAND, E.FAILSAFE)], [*on(S.FLY, interrupt(1)), *on(S.LAND, failsafe, after=0.4)]
    ),
    "land: no satellites": Plot(
        [(S.FLY, E.PLAN_FINISHED), (S.LAND, E.ESTIMATOR_BAD)], on(S.LAND, fault("satellites"), after=0.0)
    ),
    **{
        f"{state.value}: {event.value}": Plot(
            [(state, event)],
            [*before, *on(state, do, after=after)],
            {"jump_m": 9.0, "drift_m": 9.0, "settle_s": 3.0, "model_s": 9.0},
            {},
            CRASHES,
            {},
            False,
        )
        for state, before, after in ((S.TAKE_OFF, [], 1.0), (S.FLY, [], 0.3), (S.HOLD, FROZEN, 0.45))
        for event, do in (
            (E.CRASHED, topple(1.2, falls=True)),
            (E.TURNED_OVER, topple(seconds=0.4)),
            (E.FALLEN, fault("rotors")),
        )
        if (state, event) != (S.TAKE_OFF, E.FALLEN)
    },
    "land: crashed": Plot(
        [(S.LAND, E.CRASHED)],
        on(S.LAND, topple(1.2, falls=True), after=0.1),
        {"jump_m": 9.0},
        {},
        CRASHES,
        {},
        False,
    ),
    "land: leaning on the ground": Plot(
        [(S.LAND, E.STILL)],
        on(S.LAND, blow(12.0, 0.0, 0.0)),
        {"landed_m": 9.0, "jump_m": 9.0},
        seen_is_true=False,
    ),
    "land: away": Plot([(S.LAND, E.LANDED_AWAY)], [], limits={"landed_m": 0.0}),
    "land: too slow": Plot([(S.LAND, E.TIMED_OUT)], on(S.FLY, interrupt(1)), limits={"landing_s": 0.5}),
    "land: silence": Plot(
        [(S.LAND, E.LINK_LOST), (S.LAND, E.INTERRUPT_IN_AIR)],
        [*on(S.FLY, interrupt(1)), *on(S.LAND, interrupt(2), fault("drop", duration=1.7), after=0.1)],
        parameters={"LAND_SPEED": 30.0},
    ),
}


def pairs(plots):
    return {row for plot in plots for row in plot.rows}


def test_every_row_of_the_table_has_a_flight():
    table = {(state, event) for state, row in TABLE.items() for event in row}
    assert table >= NEVER
    assert pairs(PLOTS.values()) == table - NEVER


def holds(flight):
    """One fault after another, each as soon as the last one is over."""
    troubles = [
        fault("freeze", duration=0.3),
        stall(0.2),
        broken(FilterStatus.REFUSED),
        broken(None),
        broken(FilterStatus.RECOVERING),
        stall(0.2),
    ]

    def look(flight):
        flying = flight.loop is not None and flight.loop.state is S.FLY
        if flying and not flight.was_flying and troubles:
            flight.upsets += on(S.FLY, troubles.pop(0), after=0.1)
        if flight.was_flying and not flying and hasattr(flight, "mended"):
            flight.mended()
            del flight.mended
        flight.was_flying = flying

    flight.was_flying, flight.each = False, look


@pytest.fixture(autouse=True)
def at_once(monkeypatch):
    """Rotors obey as soon as they are armed: two seconds less of each flight."""
    monkeypatch.setattr("alula.stages.sim_vehicle.ardupilot.copter.ArduCopter.ARMING_DELAY_S", 0.1)


@pytest.mark.every(10)
@pytest.mark.parametrize("name", PLOTS)
def test_a_flight_takes_its_rows_and_ends_well(name):
    plot = PLOTS[name]
    made = mission(plan=line_plan(START, GOAL, 3.5), rate_hz=50.0, **plot.mission)
    flight = Flight(made, list(plot.upsets), plot.limits, plot.parameters, plot.words, watched=plot.watched)
    if name == "holds":
        holds(flight)
    flight.fly()
    if plot.watched:
        flight.watchdog.program.close()
    missing = [row for row in plot.rows if row not in flight.rows]
    assert not missing, (missing, flight.rows, flight.recorder.lines[-8:])
    flight.judge(seen_is_true=plot.seen_is_true)
