"""Watches of the supervisor while the vehicle flies by itself: climb path, hold, and reported health."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.stages.flight.links.protocol import Order, VehicleState
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.flight.loop.watches import JumpWatch, PositionWatch
from support.fake_vehicle import FakeClock, FakeVehicle
from support.flights import START, fly, loop_of, mission

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
