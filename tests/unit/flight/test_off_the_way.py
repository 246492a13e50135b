"""Watches of the supervisor while the vehicle flies by itself: climb path, hold, and reported health."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.stages.flight.links.protocol import Order, VehicleState
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.flight.loop.watches import JumpWatch, PositionWatch, SlipWatch
from support.flights.flights import START, fly, loop_of, mission
from support.scenes.small_scenes import box_cover, line_plan
from support.vehicles.fake_vehicle import FakeClock, FakeVehicle

LEVEL = np.array([1.0, 0, 0, 0])


def state(position, velocity=(0, 0, 0), at=10.0):
    return VehicleState(at, np.array(position, float), np.array(velocity, float), LEVEL, np.zeros(3))


def climbing(do):
    """A fault at each poll of a take-off, from 0.1 m above the ground on."""

    def poll(vehicle, now):
        is_climbing = Order.TAKE_OFF in vehicle.orders and vehicle.orders[-1] is Order.TAKE_OFF
        if is_climbing and vehicle.x[2] > 0.1:
            do(vehicle)

    return poll


def holding(do):
    """A hold because of a state that was old for 0.3 s, and a fault at each poll of the hold."""

    def poll(vehicle, now):
        vehicle.first_s = getattr(vehicle, "first_s", now if vehicle.sent else math.inf)
        past = now - vehicle.first_s if vehicle.sent else -1.0
        if not vehicle.sent:
            del vehicle.first_s
        vehicle.is_frozen = 2.0 <= past < 2.3
        if Order.HOLD in vehicle.orders and Order.LAND not in vehicle.orders:
            do(vehicle)

    return poll


def ended(loop, cause, *path):
    assert loop.supervision.cause is cause
    assert tuple(loop.recorder.states) == ("checks", "arming", *path)


def blown(speed_m_s, axis=0):
    """Drift that the vehicle does not measure."""

    def do(vehicle):
        vehicle.x[axis] += speed_m_s * 0.01
        vehicle.hold_at = vehicle.hold_at + np.eye(3)[axis] * speed_m_s * 0.01

    return do


@pytest.mark.parametrize("axis", [0, 1])
def test_a_take_off_that_drifts_off_its_column_is_landed(axis):
    loop, vehicle = fly(on_poll=climbing(blown(0.4, axis)))
    ended(loop, Event.OFF_CLIMB, "take-off", "land", "done")
    assert not vehicle.sent
    room = loop.checks.room_m
    assert 0.1 <= room <= 0.5  # at least the margin, at most --near
    at = next(s for s in loop.recorder.samples if s.supervisor.state_name == "land")
    x, y, _ = at.state.position_m.tuple
    off = np.hypot(x - START[0], y - START[1])
    assert room < off < room + 0.03  # without delay
    assert any("off the climb path: landing" in words for _, words in loop.recorder.lines)


def test_a_take_off_in_its_column_is_left_alone():
    def sway(vehicle):
        vehicle.hold_at[:2] = np.array(START[:2]) + 0.05 * np.sin(3 * vehicle.time_s)

    loop, _ = fly(on_poll=climbing(sway))
    ended(loop, Event.PLAN_FINISHED, "take-off", "fly", "land", "done")


def test_a_take_off_that_shoots_past_its_height_is_landed():
    def shoot(vehicle):  # beyond the end of the climb between two ticks
        if vehicle.x[2] < START[2]:
            vehicle.x[2], vehicle.hold_at[2] = START[2] + 0.7, START[2] + 2.0
            loops[0]._jumps._last = None  # so that no jump is detected, as after a gap

    loops = []
    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    vehicle.on_poll = climbing(shoot)
    loops.append(loop_of(mission(), vehicle))
    loops[0].run()
    ended(loops[0], Event.OFF_CLIMB, "take-off", "land", "done")


def test_a_take_off_through_a_side_of_the_fence_is_landed():
    near = START[0] - 0.15 - 0.02  # 2 cm from its sphere
    made = mission(fence=(near, -1.0, 0.5, 6.0, 5.0, 3.0))  # and the ground lies below its bottom
    loop, _ = fly(made, on_poll=climbing(blown(-0.2)))
    ended(loop, Event.FENCE, "take-off", "land", "done")
    loop, _ = fly(made)
    ended(loop, Event.PLAN_FINISHED, "take-off", "fly", "land", "done")


def test_a_vehicle_that_is_carried_off_while_it_does_not_arm_is_not_flown():
    def carry(vehicle, now):
        vehicle.refuses = Order.ARM not in vehicle.orders or now < 110.0
        if Order.ARM in vehicle.orders:
            vehicle.x[0] += 0.003

    loop, vehicle = fly(on_poll=carry)
    ended(loop, Event.OFF_CLIMB, "abort", "done")
    assert Order.TAKE_OFF not in vehicle.orders


def test_a_hold_that_drifts_is_landed_before_its_time_is_over():
    loop, vehicle = fly(on_poll=holding(blown(3.0)))
    assert loop.supervision.cause is Event.DRIFTS
    held = loop.recorder.positions("hold")
    assert 1.0 < np.linalg.norm(held[-1] - held[0]) < 2.5
    assert vehicle.orders[-1] is Order.NOTHING
    assert Order.LAND in vehicle.orders


def test_a_hold_that_holds_is_left_alone():
    loop, _ = fly(on_poll=holding(lambda vehicle: None))
    assert loop.supervision.cause is Event.PLAN_FINISHED
    assert "hold" in loop.recorder.states


@pytest.mark.parametrize("when", ["take-off", "fly"])
def test_a_vehicle_whose_mode_is_unknown_and_which_does_not_follow_is_landed(when):
    def fault(vehicle, now):
        if loops[0].state.value == when or Order.LAND in vehicle.orders:
            vehicle.status.mode, vehicle.status.obeys = "", False
            vehicle.x[2] = min(vehicle.x[2], 0.5) if when == "take-off" else vehicle.x[2]  # it climbs slowly
            vehicle.status.armed = not (Order.LAND in vehicle.orders and vehicle.status.landed)

    loops = []
    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    vehicle.on_poll = fault
    loops.append(loop_of(mission(), vehicle))
    loops[0].run()
    assert loops[0].supervision.cause is Event.NOT_OBEYED
    at = next(i for i, s in enumerate(loops[0].recorder.samples) if s.supervisor.state_name == "land")
    deaf = next(i for i, s in enumerate(loops[0].recorder.samples) if s.supervisor.mode == "")
    assert (at - deaf) * 0.01 == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("name", ["armed", "is_estimator_ready", "battery_share"])
def test_what_is_no_longer_told_is_not_taken_for_good(name):
    def fault(vehicle, now):
        if vehicle.sent and now - vehicle.sent[0][0] > 1.0 and Order.LAND not in vehicle.orders:
            setattr(vehicle.status, name, None)
        elif name == "armed" and vehicle.status.armed is None:
            vehicle.status.armed = True

    loop, _ = fly(on_poll=fault)
    ended(loop, Event.HEALTH_UNKNOWN, "take-off", "fly", "land", "done")


def test_a_vehicle_that_may_still_be_arming_is_not_left():
    """The order to arm may arrive after the flight is aborted; not being armed yet does not end it."""

    def fault(vehicle, now):
        if Order.ARM in vehicle.orders:
            vehicle.armed_s = getattr(vehicle, "armed_s", now)
            if Order.DISARM not in vehicle.orders:
                vehicle.status.armed = False
            elif now - vehicle.armed_s < 0.5 and vehicle.orders[-1] is Order.DISARM:
                vehicle.status.armed = now - vehicle.armed_s > 0.3

    def asked():
        return int(Order.ARM in vehicle.orders)

    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    vehicle.on_poll = fault
    loop = loop_of(mission(), vehicle, interrupts=asked)
    loop.run()
    ended(loop, Event.INTERRUPT, "abort", *(["hand-over"] if vehicle.status.armed else []), "done")
    assert [s.supervisor.state_name for s in loop.recorder.samples].count("abort") > 100


def test_a_clock_that_goes_back_stops_nothing():
    clock = FakeClock()
    vehicle = FakeVehicle(clock, (START[0], START[1], 0.0))
    slept = []

    def sleep(seconds):
        slept.append(seconds)
        clock.sleep(seconds)

    loop = loop_of(mission(), vehicle)
    loop._sleep = sleep
    vehicle.on_poll = lambda v, now: clock.__dict__.update(now_s=90.0) if len(slept) == 50 else None
    steps = iter(range(100_000))
    loop._interrupts = lambda: int(next(steps) > 2000)
    loop.run()
    assert max(slept) <= 0.0101
    assert loop.state is State.DONE


def test_a_state_from_the_future_is_as_bad_as_an_old_one():
    def fault(vehicle, now):
        if vehicle.sent and now - vehicle.sent[0][0] > 1.0 and vehicle.state.received_s < now + 50:
            last = vehicle.state
            vehicle.state = VehicleState(now + 100.0, *(getattr(last, n) for n in last.__slots__[1:]))

    loop, _ = fly(on_poll=fault)
    assert Event.STATE_STALE in [taken.event for _, taken in loop.taken]
    assert loop.recorder.states[3:5] == ["fly", "hold"]


@given(st.sampled_from([math.nan, math.inf, -math.inf]), st.integers(0, 2))
def test_what_is_not_a_number_is_never_in_its_place(bad, axis):
    place = [0.0, 0.0, 0.5]
    watch = PositionWatch(1.0)
    assert not watch.off_climb_m(state(place)) <= 0  # nothing was proven
    watch.proven(np.zeros(3), 0.1)
    assert watch.off_climb_m(state(place)) == 0
    assert watch.drift_m(state(place)) == 0
    place[axis] = bad
    low = axis == 2 and bad == -math.inf
    assert low or not watch.off_climb_m(state(place)) <= 0
    assert not watch.drift_m(state(place)) <= 1.0
    jump = JumpWatch()
    jump.jump_m(state((0, 0, 0.5)))
    assert jump.jump_m(state(place, at=10.01)) == math.inf


def test_room_is_around_the_whole_way_up_and_a_hold_may_brake():
    watch = PositionWatch(2.0)
    watch.proven(np.array([1.0, 1.0, 0.5]), 0.2)
    for place, astray in (
        ((1.0, 1.0, -1.0), 0.0),  # a wrong estimate of the height
        ((1.2, 1.0, 0.5), 0.0),
        ((1.3, 1.0, 1.0), 0.1),
        ((1.0, 1.0, 2.2), 0.0),
        ((1.0, 1.3, 2.4), 0.3),
    ):
        assert watch.off_climb_m(state(place)) == pytest.approx(astray, abs=1e-9)
    watch.drift_m(state((0, 0, 1), (2.0, 0, 0)))
    assert watch.drift_m(state((2.0, 0, 1))) == 0  # 1 m to react, 1 m to brake
    assert watch.drift_m(state((2.5, 0, 1))) == pytest.approx(0.5)
    watch.moved()
    assert watch.drift_m(state((2.5, 0, 1))) == 0


def test_an_error_that_is_not_a_number_is_not_flown(monkeypatch):
    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    loop = loop_of(mission(), vehicle)
    kind, calls = type(loop.commander), []
    decide = kind.decide

    def nowhere(*arguments):
        calls.append(1)
        decision = decide(*arguments)
        return dataclasses.replace(decision, error_m=math.nan) if len(calls) == 100 else decision

    monkeypatch.setattr(kind, "decide", nowhere)
    loop.run()
    assert Event.FILTER_FAILED in [taken.event for _, taken in loop.taken]
    assert math.isfinite(loop.plan.time_s)
    assert loop.supervision.cause is Event.PLAN_FINISHED


def reported(slips_m_s=(0, 0, 0), *, runs_m_s=(0, 0, 0), begin_s=1.0):
    """An estimate that goes wrong: from so long after the first set-point on the position moves by itself.

    Args:
        runs_m_s: what the velocity is wrong by.
    """
    begun = []

    def poll(vehicle, now):
        if vehicle.sent and not begun:
            begun.append(now)
            seen = vehicle.seen

            def wrong(at):
                true, past = seen(at), max(0.0, at - begun[0] - begin_s)
                moved = past * np.array(slips_m_s)
                runs = np.array(runs_m_s) if past > 0 else np.zeros(3)
                return dataclasses.replace(
                    true, position=true.position + moved, velocity=true.velocity + runs
                )

            vehicle.seen = wrong

    return poll


@pytest.mark.parametrize("wrong", [{"slips_m_s": (0, 0.25, 0)}, {"runs_m_s": (0, 0.25, 0)}])
def test_a_position_that_contradicts_the_velocity_near_an_obstacle_is_held_and_landed(wrong):
    """A corridor of 0.7 m: 0.2 m beyond the radius on both sides."""
    walls = box_cover([((0, 0, 0), (40, 2, 30)), ((0, 9, 0), (40, 12, 30))])
    plan = line_plan((0.3, 0.55, 1.0), (3.7, 0.55, 1.0), 12.0)
    made = mission(cover=walls, plan=plan, margin_m=0.15)
    loop, _ = fly(made, reported(**wrong), position=(0.3, 0.55, 0.0))
    events = [taken.event for _, taken in loop.taken]
    assert Event.SLIPS in events
    first = next(at for at, taken in loop.taken if taken.event is Event.SLIPS)
    flying = next(at for at, taken in loop.taken if taken.event is Event.AIRBORNE)
    assert first - flying < 1.0 + 2.0  # its walls were 0.2 m away: 0.1 m of noise and 0.2 m take 1.2 s
    assert State.HOLD in [taken.step.state for _, taken in loop.taken]
    words = next(words for _, words in loop.recorder.lines if words.startswith(Event.SLIPS.value))
    assert "m from obstacles" in words
    assert loop.state is State.DONE
    assert loop.supervision.cause is not Event.PLAN_FINISHED


def test_the_same_slip_in_free_space_adds_itself_to_the_margin_and_the_flight_goes_on():
    far = box_cover([((0, 100, 0), (40, 102, 30))])
    loop, _ = fly(mission(cover=far), reported((0, 0.25, 0)))
    events = [taken.event for _, taken in loop.taken]
    assert Event.PLAN_FINISHED in events
    assert Event.SLIPS not in events
    found = [sample.safety.added_margin_m for sample in loop.recorder.samples if sample.safety]
    assert max(found) == pytest.approx(2.0 * 0.25 - 0.1, abs=0.05)
    assert max(s.supervisor.slip_m for s in loop.recorder.samples) == pytest.approx(0.4, abs=0.05)


def test_a_contradiction_of_more_than_a_metre_a_second_is_held_anywhere():
    far = box_cover([((0, 100, 0), (40, 102, 30))])
    loop, _ = fly(mission(cover=far, fence=(-50, -50, -1, 50, 50, 50)), reported((0, 1.2, 0)))
    assert Event.SLIPS in [taken.event for _, taken in loop.taken]


@pytest.mark.parametrize("crept_m", [0.105, 0.695])
def test_a_position_that_creeps_while_it_arms_is_said_and_beyond_the_proven_room_it_does_not_take_off(
    crept_m,
):
    def poll(vehicle, now):
        if vehicle.orders and vehicle.orders[-1] is Order.ARM:
            is_there = bool(vehicle.x[0] - START[0] >= crept_m)
            vehicle.x[0] += 0.0 if is_there else 0.01
            vehicle.status.armed = is_there

    loop, vehicle = fly(mission(), poll)
    lines = "\n".join(words for _, words in loop.recorder.lines)
    if crept_m < 0.5:
        assert "its position moved by 0.11 m on the ground since the checks" in lines
        assert loop.supervision.cause is Event.PLAN_FINISHED
    else:
        assert loop.supervision.cause is Event.OFF_CLIMB
        assert "off the climb path: no take-off (by 0.50 m, of which 0.50 m are proven clear)" in lines
        assert Order.TAKE_OFF not in vehicle.orders


@given(
    st.lists(st.floats(0.005, 0.2), min_size=5, max_size=60),
    st.floats(-3, 3),
    st.floats(-3, 3),
    st.floats(0.0, 1.0),
)
def test_motion_as_the_velocity_says_is_no_slip_and_a_creep_of_the_ground_is(steps, speed, pull, creep):
    at, flying, resting = 10.0, SlipWatch(), SlipWatch()
    for dt in [0.0, *steps]:
        at += dt
        t = at - 10.0
        moving = state((speed * t + 0.5 * pull * t * t, 0, 0), (speed + pull * t, 0, 0), at)
        assert flying.slip_m(moving, is_resting=False) == 0.0
        crept = resting.slip_m(state((creep * t, 0, 0), (creep, 0, 0), at), is_resting=True)
        assert crept == pytest.approx(max(0.0, creep * min(t, 2.0) - 0.1), abs=0.2 * creep + 1e-9)
    assert math.isinf(flying.slip_m(state((math.nan, 0, 0), at=at + 0.01), is_resting=False))


@pytest.mark.parametrize("settles", [True, False])
def test_a_landing_that_does_not_descend_is_an_event_only_where_something_can_be_ordered(settles):
    begun = []

    def poll(vehicle, now):
        vehicle.status.settles = settles
        if Order.LAND in vehicle.orders:
            begun[:] = begun or [now, *vehicle.x[:3]]
            low = np.array([*begun[1:3], vehicle.ground_m - 1.0])
            vehicle.hold_at = np.array(begun[1:]) if now - begun[0] < 5.0 else low

    loop, vehicle = fly(on_poll=poll)
    assert (Event.STILL in [taken.event for _, taken in loop.taken]) == settles
    assert (Order.SETTLE in vehicle.orders) == settles
    assert loop.supervision.cause is Event.PLAN_FINISHED
