"""Table of the supervisor: every pair is defined, and facts lead to every step."""

import dataclasses
import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.stages.flight.links.protocol import Order, VehicleStatus
from alula.stages.flight.loop.supervisor import (
    Action,
    Event,
    Facts,
    FilterHealth,
    State,
    Supervision,
    SupervisorLimits,
    advance,
    begun,
    observe,
    sends_setpoints,
)
from alula.stages.flight.loop.supervisor_table import IGNORED, TABLE, described
from alula.stages.flight.loop.watches import ModeWatch
from support.paths import ROOT

LIMITS = SupervisorLimits(flight_s=100.0)
NOW = 1000.0
REPORTED = {"armed": True, "landed": False, "obeys": True}
WELL = Facts(now_s=NOW, state_age_s=0.01, silence_s=0.01, **REPORTED, height_m=1.0, fence_m=1.0)
ON_GROUND = dataclasses.replace(WELL, armed=False, landed=True, obeys=False)
# Facts that show one event only; some events depend on the state or its duration.
SHOWN = {
    Event.CHECKS_PASSED: {"checks": True},
    Event.CHECKS_PASSED_DRY: {"checks": True, "dry_run": True},
    Event.CHECK_FAILED: {"checks": False},
    Event.ARMED: {"armed": True},
    Event.DISARMED: {"armed": False},
    Event.LANDED_AWAY: {"armed": False, "from_goal_m": 0.51},
    Event.AIRBORNE: {"climbed_m": 0.96},
    Event.LANDED: {"landed": True},
    Event.STILL: {"is_still": True, "landed": False},
    Event.FRAME_WRONG: {"frame_wrong": True},
    Event.STATE_STALE: {"state_age_s": 0.16},
    Event.STATE_JUMPED: {"jump_m": 0.41},
    Event.SLIPS: {"slip_m": 0.21, "free_m": 0.2},
    Event.LOOP_LATE: {"late_s": 0.11},
    Event.FILTER_REFUSED: {"filter": FilterHealth.REFUSED},
    Event.FILTER_FAILED: {"filter": FilterHealth.FAILED},
    Event.CRASHED: {"is_lying": True},
    Event.TURNED_OVER: {"is_over": True},
    Event.FALLEN: {"is_fallen": True},
    Event.FALLBACK_LONG: {"fallback_s": 3.1},
    Event.MODEL_WRONG: {"model_off_s": 0.51},
    Event.FENCE: {"fence_m": -0.01},
    Event.BATTERY_LOW: {"battery_share": 0.19},
    Event.HEALTH_UNKNOWN: {"health_unknown": True},
    Event.PARAMETER_CHANGED: {"parameter_changed": True},
    Event.OFF_CLIMB: {"off_climb_m": 0.01},
    Event.DRIFTS: {"drift_m": 1.01},
    Event.LINK_LOST: {"silence_s": 1.6},
    Event.ESTIMATOR_BAD: {"estimator_ready": False},
    Event.FAILSAFE: {"is_failsafe": True, "obeys": False},
    Event.FAILSAFE_IDLE: {"is_failsafe": True, "obeys": True},
    Event.RESTARTED: {"restarted": True},
    Event.MODE_CHANGED: {"is_ours": False},
    Event.WATCHDOG: {"watchdog": True},
    Event.ORDER_REFUSED: {"order_refused": True},
    Event.PLAN_FINISHED: {"plan_done": True},
    Event.INTERRUPT: {"interrupts": 1},
    Event.INTERRUPT_ON_GROUND: {"interrupts": 2, "landed": True},
    Event.INTERRUPT_IN_AIR: {"interrupts": 2, "landed": False},
}
_FOR_LONG = {Event.TIMED_OUT: 1e6, Event.NOT_OBEYED: 2.1, Event.DISARMED: 1.1}


def standing(state, event=None):
    """Supervision that has been in a state for as long as the event requires."""
    since = NOW - _FOR_LONG.get(event, 0.5)
    if (state, event) == (State.ABORT, Event.DISARMED):
        since = NOW - 1.1
    unheeded = NOW - 2.1 if event is Event.NOT_OBEYED else math.inf
    holds = 4 if event is Event.HOLDS_USED_UP else 1
    well = NOW - 1.1 if event is Event.RECOVERED else math.inf
    engaged = event is not Event.NOT_OBEYED
    failsafe = NOW - 1.1 if event is Event.FAILSAFE_IDLE else math.inf
    return Supervision(
        state,
        since,
        engaged=engaged,
        unheeded_s=unheeded,
        holds=holds,
        well_since_s=well,
        failsafe_s=failsafe,
        cause=Event.PLAN_FINISHED if event in (Event.LANDED_AWAY, Event.ESTIMATOR_BAD) else None,
    )


def facts_of(event, state):
    usual = {"armed": None} if state in (State.CHECKS, State.ARMING, State.ABORT) else {}
    shown = SHOWN.get(event, {})
    obeys = {
        "obeys": (event is Event.NOT_OBEYED) == (state is State.LAND)
    }  # in LAND the mode follows no set-points
    if event is Event.TIMED_OUT and state is State.HOLD:
        obeys |= {"late_s": 0.2}  # otherwise it has recovered
    return dataclasses.replace(WELL, **{**obeys, **usual, **shown})


def test_what_was_said_before_the_motors_started_does_not_end_an_abort():
    early = dataclasses.replace(standing(State.ABORT), since_s=NOW - 0.9)
    assert Event.DISARMED not in set(observe(early, dataclasses.replace(WELL, armed=False), LIMITS))


def test_every_event_is_defined_in_every_state_once():
    for state in State:
        assert TABLE[state].keys() | IGNORED[state] == set(Event), state
        assert not TABLE[state].keys() & IGNORED[state], state


STEPS = [
    (state, event)
    for state in State
    for event in TABLE[state]
    if event is not Event.START and state is not State.IDLE
]


@pytest.mark.parametrize(("state", "event"), STEPS, ids=lambda part: part.value)
def test_each_step_of_the_table_is_taken(state, event):
    before, expected = standing(state, event), TABLE[state][event]
    after, taken = advance(before, facts_of(event, state), LIMITS)
    assert (state, event, expected) in taken
    assert after.state is expected.state
    if expected.state is state:
        assert event in after.seen
    else:
        assert after.since_s == NOW
        assert after.seen == frozenset()


IGNORING = [
    (state, event)
    for state in State
    for event in sorted(IGNORED[state], key=str)  # the same order in each process of a run
    if event in SHOWN and state is not State.IDLE
]


@pytest.mark.parametrize(("state", "event"), IGNORING, ids=lambda part: part.value)
def test_what_is_ignored_changes_nothing(state, event):
    before = standing(state)
    facts = facts_of(event, state)
    others = [e for e in observe(before, facts, LIMITS) if e not in IGNORED[state]]
    after, taken = advance(before, facts, LIMITS)
    assert [t.event for t in taken] == others[: len(taken)]
    if not others:
        assert (after.state, taken) == (state, [])


def reachable(start):
    found, todo = set(), [start]
    while todo:
        state = todo.pop()
        for step in TABLE[state].values():
            if step.state not in found:
                found.add(step.state)
                todo.append(step.state)
    return found


def test_no_way_leads_from_hand_over_to_set_points_or_orders():
    after = reachable(State.HAND_OVER)
    assert after == {State.DONE}
    assert not any(sends_setpoints(state) for state in after | {State.HAND_OVER})
    for step in TABLE[State.HAND_OVER].values():
        assert step.action is Action.LET_GO


def test_the_documentation_has_the_table():
    text = (ROOT / "docs" / "guide" / "fly-states.md").read_text()
    assert described() in text


def test_landing_is_never_taken_back():
    assert not reachable(State.LAND) & {State.FLY, State.HOLD, State.TAKE_OFF, State.ARMING}


def test_only_flying_sends_set_points():
    assert [state for state in State if sends_setpoints(state)] == [State.FLY]
    for state, row in TABLE.items():
        for step in row.values():
            if step.state is State.FLY and state is not State.FLY:
                assert step.action is Action.ENGAGE


def test_motors_are_armed_after_checks_alone_and_take_off_after_arming():
    for state, row in TABLE.items():
        for step in row.values():
            if step.action is Action.ARM:
                assert state in (State.CHECKS, State.ARMING)
            if step.action is Action.TAKE_OFF:
                assert state is State.ARMING
    assert all(
        step.state is not State.ARMING
        for e, step in TABLE[State.CHECKS].items()
        if e is not Event.CHECKS_PASSED
    )


def test_the_pilot_comes_before_everything_else():
    left_out = ("armed", "watchdog")
    worst = {key: value for shown in SHOWN.values() for key, value in shown.items() if key not in left_out}
    for state in (State.ARMING, State.TAKE_OFF, State.FLY, State.HOLD, State.LAND):
        facts = dataclasses.replace(facts_of(Event.MODE_CHANGED, state), **{**worst, "is_ours": False})
        after, taken = advance(standing(state), facts, LIMITS)
        assert (after.state, taken[0].event, taken[0].step.action) == (
            State.HAND_OVER,
            Event.MODE_CHANGED,
            Action.LET_GO,
        )


def test_a_mode_that_the_watchdog_changed_is_not_called_the_pilots():
    for state in (State.TAKE_OFF, State.FLY, State.HOLD, State.LAND):
        facts = facts_of(Event.MODE_CHANGED, state)
        facts = dataclasses.replace(facts, watchdog=True, is_failsafe=True, obeys=False, by_failsafe=True)
        after, _ = advance(standing(state), facts, LIMITS)
        assert (after.state, after.cause) == (State.HAND_OVER, Event.WATCHDOG)


def test_a_vehicle_has_a_while_to_follow():
    facts = dataclasses.replace(WELL, obeys=False)
    for seconds, expected in ((0.5, State.FLY), (2.5, State.LAND)):
        fresh = Supervision(State.FLY, NOW - seconds)
        assert advance(fresh, facts, LIMITS)[0].state is expected
        assert advance(fresh, WELL, LIMITS)[0].engaged


def test_what_says_it_is_on_the_ground_is_not_flown_however_high_it_seems():
    high = dataclasses.replace(WELL, climbed_m=2.0)
    for landed, expected in ((True, State.TAKE_OFF), (False, State.FLY), (None, State.FLY)):
        facts = dataclasses.replace(high, landed=landed)
        assert advance(Supervision(State.TAKE_OFF, NOW), facts, LIMITS)[0].state is expected


def test_holds_do_not_begin_the_time_of_a_flight_anew():
    where = Supervision(State.TAKE_OFF, NOW)
    now = NOW
    for _ in range(3):
        for facts in ({"climbed_m": 1.0}, {"state_age_s": 1.0}, {}, {}):
            now += 10.0 if where.state is State.FLY else 1.1
            where, _ = advance(where, dataclasses.replace(WELL, now_s=now, **facts), LIMITS)
    assert now - NOW < LIMITS.flight_s
    assert (where.state, where.flying_s) == (State.FLY, NOW + 1.1)
    late = dataclasses.replace(WELL, now_s=NOW + 1.1 + LIMITS.flight_s + 0.1)
    assert advance(where, late, LIMITS)[0].cause is Event.TIMED_OUT


def test_a_failsafe_that_leaves_the_vehicle_in_our_mode_is_answered_by_landing():
    facts = dataclasses.replace(WELL, is_failsafe=True)
    where = dataclasses.replace(standing(State.FLY), engaged=True)
    for seconds, expected in ((0.0, State.FLY), (0.9, State.FLY), (1.1, State.LAND)):
        where, _ = advance(where, dataclasses.replace(facts, now_s=NOW + seconds), LIMITS)
        assert where.state is expected
    assert where.cause is Event.FAILSAFE_IDLE


STATUS = {"GUIDED": True, "LAND": False, "LOITER": False, "STANDBY": False, "": False}


@pytest.mark.parametrize(
    ("story", "lost_at"),
    [  # orders, and the modes reported after them
        (
            ["STANDBY", Order.ARM, "STANDBY", "GUIDED", Order.HOLD, "GUIDED", Order.LAND, "GUIDED", "LAND"],
            None,
        ),
        (["LOITER"], None),  # nothing was ordered yet
        ([Order.ARM, "STANDBY", "LOITER"], 2),
        ([Order.ARM, "GUIDED", "LOITER", "GUIDED"], 2),  # permanently
        ([Order.ARM, "GUIDED", "", "GUIDED"], None),
        ([Order.ARM, "GUIDED", Order.HOLD, "LOITER"], 3),
        ([Order.ARM, "GUIDED", "LAND"], 2),  # the pilot lands it
        ([Order.ARM, "GUIDED", Order.LAND, "LOITER"], 3),
        ([Order.ARM, "GUIDED", Order.LAND, "LAND", "GUIDED"], 4),
        ([Order.ARM, "GUIDED", Order.LAND, "LAND", "LOITER"], 4),
    ],
)
def test_whose_the_mode_is(story, lost_at):
    watch, status = ModeWatch(), VehicleStatus(armed=True, mode="STANDBY")
    for i, each in enumerate(story):
        if isinstance(each, Order):
            watch.ordered(each, status)
        else:
            status.mode, status.obeys = each, STATUS[each]
        assert watch.is_ours(status) == (lost_at is None or i < lost_at), i


def test_a_hold_ends_when_all_was_well_for_a_while_and_not_too_often():
    where = Supervision(State.HOLD, NOW, holds=1)
    stale = dataclasses.replace(WELL, state_age_s=1.0)
    where, taken = advance(where, stale, LIMITS)
    assert (where.state, taken) == (State.HOLD, [])
    for later, expected in ((0.5, State.HOLD), (1.0, State.HOLD), (1.6, State.FLY)):
        where, taken = advance(where, dataclasses.replace(WELL, now_s=NOW + later), LIMITS)
        assert where.state is expected
    assert where.holds == 1
    worn = Supervision(State.HOLD, NOW, holds=LIMITS.holds + 1)
    assert advance(worn, WELL, LIMITS)[0].state is State.LAND


def test_second_ctrl_c_disarms_on_the_ground_only():
    landing = Supervision(State.LAND, NOW)
    in_air, taken = advance(landing, dataclasses.replace(WELL, interrupts=2), LIMITS)
    assert [t.step.action for t in taken] == [Action.NOTHING]
    down = dataclasses.replace(WELL, interrupts=2, landed=True)
    _, taken = advance(in_air, down, LIMITS)
    assert Action.DISARM in [t.step.action for t in taken]
    unknown = dataclasses.replace(WELL, interrupts=2, landed=None)
    assert Action.DISARM not in [t.step.action for t in advance(landing, unknown, LIMITS)[1]]


def test_a_condition_that_stays_acts_once_but_refusals_act_again():
    where, actions = Supervision(State.LAND, NOW), []
    for _ in range(3):
        where, taken = advance(where, dataclasses.replace(WELL, silence_s=9.0), LIMITS)
        actions += [t.step.action for t in taken]
    assert actions == [Action.LAND]
    where, actions = Supervision(State.ARMING, NOW), []
    for _ in range(3):
        facts = dataclasses.replace(ON_GROUND, order_refused=True)
        where, taken = advance(where, facts, LIMITS)
        actions += [t.step.action for t in taken]
    assert actions == [Action.ARM] * 3


def test_the_cause_is_the_first_that_ended_the_flight():
    where = standing(State.FLY)
    where, _ = advance(where, dataclasses.replace(WELL, battery_share=0.1), LIMITS)
    assert (where.state, where.cause) == (State.LAND, Event.BATTERY_LOW)
    where, _ = advance(where, dataclasses.replace(WELL, is_ours=False), LIMITS)
    where, _ = advance(where, dataclasses.replace(WELL, armed=False), LIMITS)
    assert (where.state, where.cause) == (State.DONE, Event.BATTERY_LOW)


def test_a_flight_as_planned():
    where, taken = begun(NOW)
    assert (where.state, taken[0].step.action) == (State.CHECKS, Action.CHECK)
    actions = []
    for facts in (
        ON_GROUND,
        dataclasses.replace(ON_GROUND, checks=True),
        dataclasses.replace(ON_GROUND, checks=True, armed=True),
        dataclasses.replace(WELL, climbed_m=0.5),
        dataclasses.replace(WELL, climbed_m=0.97),
        WELL,
        dataclasses.replace(WELL, plan_done=True),
        dataclasses.replace(WELL, landed=True),
        ON_GROUND,
    ):
        where, taken = advance(where, facts, LIMITS)
        actions += [t.step.action for t in taken]
    wanted = [Action.ARM, Action.TAKE_OFF, Action.ENGAGE, Action.LAND, Action.DISARM, Action.LET_GO]
    assert actions == wanted
    assert (where.state, where.cause) == (State.DONE, Event.PLAN_FINISHED)


maybe = st.sampled_from([None, True, False])
anything = st.builds(
    Facts,
    now_s=st.just(NOW),
    state_age_s=st.sampled_from([0.01, 0.5, math.inf, math.nan]),
    silence_s=st.sampled_from([0.01, 5.0, math.inf]),
    armed=maybe,
    landed=maybe,
    obeys=st.booleans(),
    is_failsafe=st.booleans(),
    restarted=st.booleans(),
    estimator_ready=maybe,
    battery_share=st.sampled_from([None, 0.05, 0.9]),
    is_ours=st.booleans(),
    order_refused=st.booleans(),
    checks=maybe,
    climbed_m=st.sampled_from([None, 0.0, 2.0]),
    height_m=st.just(1.0),
    frame_wrong=st.booleans(),
    late_s=st.sampled_from([0.0, 1.0]),
    filter=st.sampled_from(FilterHealth),
    fallback_s=st.sampled_from([0.0, 9.0]),
    fence_m=st.sampled_from([None, 1.0, -1.0]),
    plan_done=st.booleans(),
    interrupts=st.integers(0, 3),
)


@given(st.lists(anything, max_size=12))
def test_whatever_happens_the_rules_hold(facts):
    where, _ = begun(NOW)
    given_up = False
    for each in facts:
        before = where
        where, taken = advance(where, each, LIMITS)
        given_up = given_up or before.state in (State.HAND_OVER, State.DONE)
        for step, following in itertools.pairwise(taken):
            assert step.step.state is following.state
        if given_up:
            assert where.state in (State.HAND_OVER, State.DONE)
            assert all(t.step.action is Action.LET_GO for t in taken)
        if before.state is State.FLY and where.state is State.FLY:
            assert each.state_age_s <= LIMITS.stale_s
            assert each.armed is not False
            assert each.is_ours


@pytest.mark.parametrize(
    ("from_goal_m", "strayed_m", "event"),
    [
        (0.4, 0.5, Event.DISARMED),
        (0.4, 0.7, Event.LANDED_AWAY),
        (0.1, 0.95, Event.LANDED_AWAY),
        (0.6, 0.0, Event.LANDED_AWAY),
        (math.nan, 0.0, Event.LANDED_AWAY),
    ],
)
def test_a_plan_is_flown_only_where_its_end_is_certain_to_a_metre(from_goal_m, strayed_m, event):
    was = Supervision(State.LAND, NOW - 5.0, cause=Event.PLAN_FINISHED)
    down = dataclasses.replace(ON_GROUND, from_goal_m=from_goal_m, strayed_m=strayed_m)
    _, (taken,) = advance(was, down, LIMITS)
    assert taken.event is event
