"""Control loop over a fake vehicle with an injected clock: flights as planned, and faults in flight."""

import numpy as np
import pytest

from alula.stages.filtering.protocol import FilterStatus, FlightState, Nominal
from alula.stages.flight.links.protocol import Order
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, VelocitySetpoint
from support.flights.flights import (
    BALL,
    GOAL,
    PILLAR,
    START,
    Breaking,
    after,
    fly,
    loop_of,
    mission,
    refilter,
    safety_of,
)
from support.flights.foreign_filters import OfVelocities
from support.scenes.small_scenes import ball_scene, box_cover, line_plan
from support.vehicles.fake_vehicle import FakeClock, FakeVehicle

RATES, ACCELERATIONS, VELOCITIES = (
    frozenset({kind}) for kind in (RatesSetpoint, AccelerationSetpoint, VelocitySetpoint)
)
AS_PLANNED = ["checks", "arming", "take-off", "fly", "land", "done"]
RADIUS_M = 0.15


def causes(loop):
    return [taken.event for _, taken in loop.taken]


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("name", "accepts"),
    [
        ("cone-backup", RATES),
        ("cone-ecbf", RATES),
        ("cone-di", ACCELERATIONS),
        ("cone-di", RATES),
        ("safer-splat", ACCELERATIONS | RATES),
    ],
    ids=["cone-backup", "cone-ecbf", "cone-di", "cone-di by rates", "safer-splat"],
)
def test_filters_among_ellipsoids_lead_around_one_in_the_way(name, accepts):
    loop, vehicle = fly(mission(name, scene=BALL, is_clear=True), accepts=accepts)
    assert loop.recorder.states == AS_PLANNED
    assert loop.supervision.cause is Event.PLAN_FINISHED
    path = loop.recorder.positions("fly")
    assert np.linalg.norm(path - (2.0, 2.2, 1.0), axis=1).min() > 0.3 + RADIUS_M
    assert np.linalg.norm(path[-1] - GOAL) < 0.25
    flown = [s.safety for s in loop.recorder.samples if s.safety]
    assert any(f.status != FilterStatus.OK for f in flown)
    assert {type(s) for _, _, s in vehicle.sent} <= accepts
    assert all(mode == "GUIDED" for _, mode, _ in vehicle.sent)


def test_velocities_are_filtered_among_hulls():
    through = line_plan((0.3, 1.0, 1.0), (3.7, 1.0, 1.0))  # straight into the pillar
    loop, _ = fly(mission(plan=through, is_clear=True, max_time_s=15.0), position=(0.3, 1.0, 0.0))
    path = loop.recorder.positions("fly", "hold")
    assert path[:, 0].max() < 1.8 - RADIUS_M  # it stays in front of it until it times out
    assert loop.supervision.cause in (Event.TIMED_OUT, Event.HOLDS_USED_UP)
    margins = [s.safety.h_m for s in loop.recorder.samples if s.safety]
    assert min(margins) > -0.05


def test_a_shield_is_certified_against_hulls_without_a_scene():
    through = line_plan((0.3, 1.0, 1.0), (3.7, 1.0, 1.0))  # straight into the pillar
    made = mission("shield", plan=through, is_clear=True, max_time_s=12.0)
    loop, _ = fly(made, accepts=RATES, position=(0.3, 1.0, 0.0))
    path = loop.recorder.positions("fly", "hold")
    assert 1.2 < path[:, 0].max() < 1.8 - RADIUS_M - made.config.margin_m  # it comes near, and stays in front
    flown = [s.safety for s in loop.recorder.samples if s.safety]
    assert any(f.status == FilterStatus.BACKUP for f in flown)
    assert all(f.certified for f in flown)


@pytest.mark.every(2)
@pytest.mark.parametrize(
    "scene", [None, ball_scene([(2.0, -3.0, 1.0)], 0.3)], ids=["cover", "cover and scene"]
)
def test_the_shield_of_a_plan_past_hulls_lets_it_pass(scene):
    against_hulls = {"shield_map": "hulls"}
    made = mission("shield", cover=box_cover(PILLAR), scene=scene, filter_parameters=against_hulls)
    loop, _ = fly(made, accepts=RATES)
    assert loop.recorder.states == AS_PLANNED


def test_without_a_filter_the_plan_is_tracked():
    clear = line_plan((0.3, 1.0, 1.0), (3.7, 1.0, 1.0))
    for accepts in (RATES, ACCELERATIONS):
        loop, _ = fly(mission("none", scene=BALL, plan=clear), accepts=accepts, position=(0.3, 1.0, 0.0))
        assert loop.recorder.states == AS_PLANNED
        assert max(s.supervisor.error_m for s in loop.recorder.samples if s.safety) < 0.1


def test_a_dry_run_checks_everything_and_orders_nothing():
    loop, vehicle = fly(dry_run=True)
    assert loop.recorder.states == ["checks", "done"]
    assert loop.supervision.cause is Event.CHECKS_PASSED_DRY
    assert vehicle.orders == [Order.NOTHING]
    assert not vehicle.sent
    assert len(loop.checks.verdicts) == 20
    assert all(v.holds for v in loop.checks.verdicts)


def freeze(vehicle):
    vehicle.is_frozen = True


def thaw(vehicle):
    vehicle.is_frozen = False


def test_a_frozen_state_is_held_within_the_limit_and_never_flown_on():
    loop, vehicle = fly(on_poll=after(2.0, freeze))
    assert loop.recorder.states == ["checks", "arming", "take-off", "fly", "hold", "land", "done"]
    assert loop.supervision.cause is Event.TIMED_OUT  # of the hold
    assert causes(loop).count(Event.STATE_STALE) == 1
    flown = [s for s in loop.recorder.samples if s.safety]
    assert max(s.supervisor.state_age_s for s in flown) <= 0.15
    assert not [at for at, mode, _ in vehicle.sent if mode != "GUIDED"]


def test_after_a_gap_it_flies_on_to_the_goal():
    def fault(vehicle, now, start=[]):  # noqa: B006  one list per function is what is wanted
        if vehicle.sent:
            start.append(now)
            vehicle.is_frozen = 2.0 <= now - start[0] < 2.5

    loop, _ = fly(on_poll=fault)
    assert loop.recorder.states == [*AS_PLANNED[:4], "hold", "fly", "land", "done"]
    assert loop.supervision.cause is Event.PLAN_FINISHED
    assert Order.HOLD in loop.link.orders


def test_a_lost_link_is_told_to_land_and_given_up():
    def lose(vehicle):
        vehicle.is_silent = True

    loop, vehicle = fly(on_poll=after(1.0, lose))
    assert loop.recorder.states[-3:] == ["hold", "land", "hand-over"] or "land" in loop.recorder.states
    assert loop.supervision.cause is Event.LINK_LOST
    assert Order.LAND in vehicle.orders


@pytest.mark.every(2)
@pytest.mark.parametrize(
    ("fault", "cause", "path"),
    [
        (lambda v: setattr(v.status, "battery_share", 0.1), Event.BATTERY_LOW, ["fly", "land", "done"]),
        (
            lambda v: setattr(v.status, "is_estimator_ready", False),
            Event.ESTIMATOR_BAD,
            ["fly", "land", "done"],
        ),
        (lambda v: setattr(v.status, "clock_jumps", 1), Event.RESTARTED, ["fly", "land", "done"]),
        (lambda v: setattr(v.status, "armed", False), Event.DISARMED, ["fly", "done"]),
    ],
    ids=["battery", "estimator", "restart", "disarmed"],
)
def test_faults_of_the_vehicle_end_the_flight(fault, cause, path):
    loop, _ = fly(on_poll=after(1.0, fault))
    assert loop.recorder.states == [*AS_PLANNED[:3], *path]
    assert loop.supervision.cause is cause


@pytest.mark.every(9)
@pytest.mark.parametrize("seconds", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("mode", ["STABILIZE", "LAND", "RTL"])
def test_the_pilot_takes_it_and_keeps_it(mode, seconds):
    def take(vehicle):
        vehicle.status.mode, vehicle.status.obeys, vehicle.setpoint = mode, False, None
        vehicle.hold_at = vehicle.x[:3].copy()
        vehicle.taken_s = vehicle.time_s

    def give_back(vehicle, now):  # as if the pilot switched back: control stays with the pilot
        take_it(vehicle, now)
        if hasattr(vehicle, "taken_s") and 2 < now - vehicle.taken_s < 4:
            vehicle.status.mode, vehicle.status.obeys = "GUIDED", True
        if hasattr(vehicle, "taken_s") and now - vehicle.taken_s > 6:
            vehicle.status.armed = False

    take_it = after(seconds, take)
    loop, vehicle = fly(on_poll=give_back)
    assert loop.recorder.states[-2:] == ["hand-over", "done"]
    assert loop.supervision.cause is Event.MODE_CHANGED
    assert vehicle.sent[-1][0] <= vehicle.taken_s + 0.011
    since = vehicle.orders[vehicle.orders.index(Order.TAKE_CONTROL) + 1 :]
    assert set(since) == {Order.NOTHING}


def test_a_failsafe_of_its_own_is_left_to_the_vehicle():
    def fail(vehicle):
        vehicle.status.is_failsafe, vehicle.status.armed = True, True
        vehicle.status.mode, vehicle.status.obeys = "RTL", False

    def poll(vehicle, now):
        first(vehicle, now)
        if vehicle.status.is_failsafe and now - vehicle.sent[-1][0] > 2:
            vehicle.status.armed = False

    first = after(1.0, fail)
    loop, vehicle = fly(on_poll=poll)
    assert loop.recorder.states[-2:] == ["hand-over", "done"]
    assert vehicle.orders[-1] is Order.NOTHING
    assert Order.LAND not in vehicle.orders


def test_orders_that_are_refused():
    loop, vehicle = fly(on_poll=lambda v, now: setattr(v, "refuses", True))
    assert loop.recorder.states[:2] == ["checks", "arming"]
    assert loop.supervision.cause is Event.TIMED_OUT
    assert 20 < vehicle.orders.count(Order.ARM) < 90  # about once a second for a minute
    said = [words for _, words in loop.recorder.lines]
    assert said.count("vehicle refuses to arm: it does not want to") == 1
    assert sum("arming refused: arming is ordered again" in words for words in said) == 1
    assert not vehicle.sent


def test_silence_declines_nothing_and_is_told_once():
    told = []

    def dies(vehicle, now):
        if len(vehicle.sent) > 5:
            vehicle.is_silent, vehicle.time_s = True, now  # and does not move any more
        if vehicle.orders.count(Order.LAND) > len(told):
            told.append(now)
            vehicle.status.refusals.append((Order.LAND, "no answer for 5 s"))

    loop, _ = fly(on_poll=dies, interrupts=lambda: 0 if len(told) < 20 else 2)
    assert len(told) >= 20
    said = [words for _, words in loop.recorder.lines]
    assert said.count("command to land: no answer for 5 s") == 1
    assert not any("refuses" in words for words in said)
    handed = [words for words in said if "no longer controls the vehicle" in words]
    assert handed
    assert all("Ctrl-C ends it and leaves the vehicle to the pilot" in words for words in handed)


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("how", "event"),
    [
        ("raises", Event.FILTER_FAILED),
        ("nan", Event.FILTER_FAILED),
        ("too fast", Event.FILTER_FAILED),
        ("refuses", Event.FILTER_REFUSED),
        ("falls back", Event.FALLBACK_LONG),
    ],
)
def test_a_filter_that_fails_is_held_then_landed(how, event):
    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    made = mission(velocity_lag_s=0.0)  # without a lag a tick is one call
    loop = loop_of(made, vehicle)
    refilter(loop, made, lambda inner: Breaking(inner, how, 100))
    loop.run()
    assert event in causes(loop)
    assert loop.recorder.states[-2:] == ["land", "done"]
    held = [taken for _, taken in loop.taken if taken.step.state is State.HOLD]
    assert len(held) == 4  # three more tries
    assert all(np.isfinite(s.velocity).all() for _, _, s in vehicle.sent)
    first = next(i for i, s in enumerate(loop.recorder.samples) if s.supervisor.state_name == "hold")
    assert vehicle.orders.count(Order.HOLD) == 4  # a filtered hold also begins with an order
    if how != "falls back":  # in the very tick
        assert loop.recorder.samples[first - 1].safety is not None
        assert not [s for s in loop.recorder.samples[first + 1 :] if s.safety and s.safety.sent]
        assert len([s for s in loop.recorder.samples[:first] if s.safety]) == 99


def test_a_hold_is_filtered_where_state_and_filter_are_well():
    def fault(vehicle, now, start=[]):  # noqa: B006  one list per function is what is wanted
        if vehicle.sent and not start:
            start.append(now)
        vehicle.is_frozen = bool(start) and 1.5 < now - start[0] < 2.0

    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    vehicle.on_poll = fault
    made, asked = mission(), []
    loop = loop_of(made, vehicle)

    def watched(inner):
        def watching(x, u):
            result = inner(FlightState(x), Nominal(u))
            asked.append((vehicle.clock(), loop.state, u.copy(), result.u))
            return result

        return OfVelocities(watching)

    refilter(loop, made, watched)
    loop.run()
    loop.commander = None  # the collector of garbage does not see into the native flight
    assert loop.supervision.cause is Event.PLAN_FINISHED
    held = [s for s in loop.recorder.samples if s.supervisor.state_name == "hold"]
    fresh = [s for s in held if s.supervisor.state_age_s < 0.02][2:]
    stale = [s for s in held if s.supervisor.state_age_s > 0.15]
    assert len(fresh) > 80
    assert all(s.safety is not None and s.safety.sent == "velocity" for s in fresh)
    assert not any(s.safety for s in stale)
    place = fresh[0].state.position_m.array
    nominal = [u for _, state, u, _ in asked if state is State.HOLD]
    assert np.linalg.norm(nominal[0]) < 0.05  # to stand still, here
    assert np.linalg.norm(fresh[-1].state.position_m.array - place) < 0.2
    assert len({s.supervisor.plan_s for s in fresh}) == 1


def test_a_hold_whose_filter_fails_is_the_vehicles_own():
    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    made, calls = mission(velocity_lag_s=0.0), []  # without a lag a tick is one call
    loop = loop_of(made, vehicle)

    def failing_once(inner):
        breaking = Breaking(inner, "falls back", 100)

        def failing(x, u):
            if loop.state is State.HOLD:
                calls.append(1)
                if len(calls) == 20:
                    raise RuntimeError("no more")
            return breaking(FlightState(x), Nominal(u))

        return OfVelocities(failing)

    refilter(loop, made, failing_once)
    loop.run()
    loop.commander = None  # the collector of garbage does not see into the native flight
    orders = [order for order in vehicle.orders if order is not Order.NOTHING]
    first = orders.index(Order.HOLD)
    assert orders[first : first + 3] == [Order.HOLD, Order.HOLD, Order.TAKE_CONTROL]
    holds = [s for s in loop.recorder.samples if s.supervisor.state_name == "hold"]
    assert not any(s.safety for s in holds[20:100])


def test_a_late_loop_is_held_counted_and_not_made_up_for():
    clock = FakeClock()
    vehicle = FakeVehicle(clock, (START[0], START[1], 0.0))
    vehicle.on_poll = after(1.0, lambda v: v.clock.extra_s.extend([0.3]))
    loop = loop_of(mission(), vehicle)
    loop.run()
    assert Event.LOOP_LATE in causes(loop)
    assert loop.supervision.cause is Event.PLAN_FINISHED
    assert loop.counters.skipped == 30
    assert loop.counters.overruns >= 1
    assert loop.counters.late_s.max_s == pytest.approx(0.3, abs=1e-6)
    times = [s.supervisor.time_s for s in loop.recorder.samples]
    assert min(np.diff(times)) > 1e-3  # no burst
    assert np.allclose(np.diff(times)[-300:], 0.01, atol=1e-6)  # and back on the grid


@pytest.mark.every(2)
@pytest.mark.parametrize("late_s", [0.03, 0.07])
def test_what_was_sent_is_remembered_for_as_long_as_it_was_followed(late_s):
    """An old state is predicted over all of its age, including the ticks that were left out."""
    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    vehicle.on_poll = after(1.0, lambda v: v.clock.extra_s.append(late_s))
    loop = loop_of(mission(), vehicle)
    sent, times, inner = [], [], loop.commander

    class Watching:
        ticks, setpoint = 0, inner.setpoint

        def reset(self):
            self.ticks = 0
            inner.reset()

        def sent(self, setpoint):
            self.ticks += 1
            inner.sent(setpoint)

        def decide(self, *seen):
            times.append(vehicle.clock())
            sent.append(self.ticks)
            return inner.decide(*seen)

    loop.commander = Watching()
    loop.run()
    assert loop.recorder.states == AS_PLANNED
    assert loop.counters.skipped == round(100 * late_s)
    known = [(at - times[0], ticks) for at, ticks in zip(times, sent, strict=True) if ticks < 180]
    assert known[-1][0] > 1.5
    assert max(abs(at * 100 - ticks) for at, ticks in known[-20:]) < 1.5


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("how", "point"),
    [("raises", 1), ("raises", 4), ("nan", 4), ("nan", 1), ("refuses", 1), ("refuses", 4)],
)
def test_a_filter_that_fails_at_any_point_of_the_chord_is_held_in_that_tick(how, point):
    """With the default lag a tick calls the filter several times; if any call fails, nothing is sent."""
    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    made, failed, calls = mission(), [], {}
    loop, inner = loop_of(made, vehicle), safety_of(made)

    def failing(x, u):
        now = vehicle.clock()
        calls[now] = calls.get(now, 0) + 1
        if not failed and len(vehicle.sent) > 150 and calls[now] == point:
            failed.append(now)
            return Breaking(inner, how, 1)(FlightState(x), Nominal(u))
        return inner(FlightState(x), Nominal(u))

    refilter(loop, made, lambda _: OfVelocities(failing))
    loop.run()
    assert len(failed) == 1
    assert failed[0] not in [at for at, _, _ in vehicle.sent]
    first = next(taken for _, taken in loop.taken if taken.step.state is State.HOLD)
    assert first.event is (Event.FILTER_REFUSED if how == "refuses" else Event.FILTER_FAILED)
    assert loop.supervision.cause is Event.PLAN_FINISHED  # one failure causes one hold


@pytest.mark.every(3)
@pytest.mark.parametrize("late_s", [0.08, 0.0])
def test_a_fallback_is_as_long_as_the_clock_says_however_few_its_ticks(late_s):
    vehicle = FakeVehicle(FakeClock(), (START[0], START[1], 0.0))
    made = mission(velocity_lag_s=0.0)
    loop = loop_of(made, vehicle)
    breaking = refilter(loop, made, lambda inner: Breaking(inner, "falls back", 100))

    def every_other(vehicle, now):
        if breaking.left < 0 and not vehicle.clock.extra_s:
            vehicle.clock.extra_s.extend([late_s, 0.0])

    vehicle.on_poll = every_other
    loop.run()
    first = next(s.supervisor.time_s for s in loop.recorder.samples if s.safety and s.safety.status == 3)
    held = next(at for at, taken in loop.taken if taken.event is Event.FALLBACK_LONG)
    assert held - first == pytest.approx(3.0, abs=0.12)
