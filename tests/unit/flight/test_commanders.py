"""Commanders against the loops of `simulate`: the same filter, controller and set-points tick by tick."""

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula import _core
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.flight.loop.fence_guard import FenceGuard
from alula.stages.flight.loop.plan_clock import PlanClock, heading_of
from alula.stages.flight.mission import make_commander
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, VelocitySetpoint
from support.flights.flights import BALL, START, mission, safety_of
from support.flights.reference_flights import along, vehicle_of
from support.scenes.small_scenes import box_cover, line_plan

DT = 0.01


def quat_of(sigma):
    n = float(sigma @ sigma)
    return np.array([1 - n, *(2 * sigma)]) / (1 + n)


@pytest.mark.parametrize("name", ["cone-backup", "cone-ecbf", "cone-di", "safer-splat"])
def test_thrust_and_filter_are_those_of_simulate(name):
    made = mission(name, scene=BALL, is_clear=True)
    body, gains = quadrotor(FASTBRIDGE), tracking_gains(FASTBRIDGE, made.config.catch_up_m_s)
    safety = safety_of(made)
    assert safety is not None
    vehicle = vehicle_of(body, gains=gains, interface="body-rates")
    (log,) = along(
        [made.curve],
        [safety],
        vehicle,
        dt_s=DT,
        max_time_s=450 * DT,
        ends_at_goal=False,
        disturbance_time_s=0.1,
    )
    assert len(log["mark"]) == 450
    commander = make_commander(made, frozenset({RatesSetpoint}))
    changed = 0
    for i, (x, status, margin) in enumerate(
        zip(log["state"], log["status"][:, 0], log["margin"][:, 0], strict=False)
    ):
        seen = VehicleState(0.0, x[:3].copy(), x[6:9].copy(), quat_of(x[3:6]), x[9:].copy())
        decision = commander.decide(seen, 0.0, made.curve.at(np.array([i * DT])))
        commander.sent(decision.setpoint)
        assert decision.status == status
        assert decision.certified == bool(log["flags"][i, 0] & 4)
        np.testing.assert_allclose(decision.nominal, log["nominal"][i], rtol=0, atol=1e-9)
        if math.isfinite(margin):
            assert decision.margin == pytest.approx(margin, rel=1e-6, abs=1e-8)
        changed += status != FilterStatus.OK
        if i % 50 == 0:
            thrust = decision.setpoint.thrust_m_s2 * body.mass
            assert thrust == pytest.approx(log["command"][i, 3], rel=1e-9)
    assert changed > 20


def test_gains_faster_than_the_rate_loop_are_noted_of_flights_by_rates():
    lazy = msgspec.structs.replace(FASTBRIDGE.rates, axis_time_constant_s=(0.1, 0.1, 0.5))
    vehicle = msgspec.structs.replace(FASTBRIDGE, rates=lazy)
    swings = "tracking.rate_n_m_s is faster than the rate loop of fastbridge about x, y, z: "
    assert any(swings in note for note in mission("shield", scene=BALL, vehicle=vehicle).notes)
    others = (
        mission("shield", scene=BALL),
        mission("cone-di", scene=BALL, vehicle=vehicle),
        mission(vehicle=vehicle),
    )
    for made in others:
        assert not any("rate loop" in note for note in made.notes)


def test_velocities_are_those_of_simulate():
    made = mission(plan=line_plan((0.3, 1.2, 1.0), (3.7, 1.2, 1.0)), is_clear=True)
    commander = make_commander(made, frozenset({VelocitySetpoint}))
    vehicle = _core.VehicleSpec(
        quadrotor(FASTBRIDGE),
        model="single-integrator",
        interface="velocity",
        gains=_core.TrackingGains(),
        max_speed_m_s=made.config.speed_m_s,
    )
    simulation = _core.SimulationSpec(
        vehicle,
        options=_core.FlightOptions(dt_s=DT),
        rules=_core.SimulationRules(plant_steps=1, stuck_ticks=10**6),
    )
    rows = made.curve.at(np.arange(301) * DT)
    start = np.zeros(12)
    start[:3] = rows[0, :3]
    speed = made.config.speed_m_s
    task = _core.Task(start, _core.Mission.along(made.curve, gain_per_s=2.0, speed_m_s=speed), max_time_s=3.0)
    (log,) = _core.simulate(simulation, [task], [safety_of(made).native])
    assert len(log["mark"]) == 300
    for i in range(300):
        seen = VehicleState(0.0, log["state"][i, :3], np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3))
        decision = commander.decide(seen, 0.0, rows[i : i + 1].copy())
        np.testing.assert_allclose(decision.nominal, log["nominal"][i], rtol=0, atol=1e-12)
        np.testing.assert_allclose(decision.setpoint.velocity, log["command"][i, :3], rtol=0, atol=1e-12)


def test_a_late_state_is_taken_on_by_its_velocity():
    made = mission()
    commander = make_commander(made, frozenset({VelocitySetpoint}))
    v, target = np.array([0.5, -0.2, 0.1]), made.curve.at(np.array([1.0]))
    at = lambda p, age: commander.decide(  # noqa: E731
        VehicleState(0.0, p, v, np.array([1.0, 0, 0, 0]), np.zeros(3)), age, target
    )
    here = np.array([0.5, 2.0, 1.0])
    np.testing.assert_allclose(at(here, 0.1).safe, at(here + 0.1 * v, 0.0).safe, atol=1e-12)


def test_the_time_of_the_plan_waits_and_its_derivatives_are_those_of_the_slowed_time():
    curve = mission().curve
    clock = PlanClock(curve, _core.PlanClockOptions())
    for _ in range(100):
        clock.advance(DT, 0.0)
    assert clock.rate == 1.0
    for _ in range(100):
        clock.advance(DT, 0.65)
    assert clock.rate == pytest.approx(0.5)
    row, plain = clock.target()[0], curve.at(np.array([clock.time_s]))[0]
    np.testing.assert_allclose(row[:3], plain[:3])
    np.testing.assert_allclose(row[3:6], 0.5 * plain[3:6])
    np.testing.assert_allclose(row[6:9], 0.25 * plain[6:9])
    for _ in range(100):
        clock.advance(DT, 2.0)
    assert clock.rate == 0
    before = clock.time_s
    clock.advance(DT, 5.0)
    assert clock.time_s == before


@given(st.floats(-3.1, 3.1))
def test_the_heading_turns_slowly_to_the_plans(heading):
    clock = PlanClock(mission_curve(), _core.PlanClockOptions())
    clock.pause(heading)
    seen = [clock.target()[0, 15]]
    for _ in range(600):
        clock.advance(DT, 0.0)
        seen.append(clock.target()[0, 15])
    assert seen[0] == pytest.approx(heading)
    assert np.abs(np.diff(seen)).max() <= 0.7 * DT + 1e-9
    assert seen[-1] == pytest.approx(0.0, abs=1e-9)
    assert clock.target()[0, 16] == 0


def mission_curve(made=[]):  # noqa: B006  made once
    if not made:
        made.append(mission().curve)
    return made[0]


def test_headings():
    for yaw in (-3.0, -1.0, 0.0, 0.5, 2.0):
        assert heading_of(np.array([math.cos(yaw / 2), 0, 0, math.sin(yaw / 2)])) == pytest.approx(yaw)


LEVEL = np.array([1.0, 0, 0, 0])
BOX = _core.Fence(box=((0.0, 0.0, 0.0), (6.0, 4.0, 3.0)))


def at(position, velocity=(0, 0, 0)):
    return VehicleState(0.0, np.array(position, float), np.array(velocity, float), LEVEL, np.zeros(3))


def test_far_from_the_fence_a_set_point_passes_as_it_is():
    guard = FenceGuard(
        _core.Fence(box=((-50, -50, -50), (50, 50, 50))), FASTBRIDGE, dt_s=DT, takes_rates=True
    )
    for setpoint in (
        RatesSetpoint(9.81, np.array([0.1, 0.2, 0.3])),
        VelocitySetpoint(np.ones(3), 0.0),
        AccelerationSetpoint(np.ones(3), np.zeros(3), np.zeros(3), 0.0),
    ):
        found = guard.guard(at((0, 0, 0)), 0.0, setpoint)
        assert found.setpoint is setpoint
        assert (found.regulation, found.takes_over) == (1.0, False)
    assert guard.distance(at((49, 0, 0))) == pytest.approx(0.85)


@pytest.mark.parametrize("takes_rates", [True, False])
def test_who_flies_at_the_fence_is_braked_or_told_to_hold(takes_rates):
    guard = FenceGuard(BOX, FASTBRIDGE, dt_s=DT, takes_rates=takes_rates)
    found = guard.guard(at((5.0, 2, 1.5), (4.0, 0, 0)), 0.0, VelocitySetpoint(np.array([4.0, 0, 0]), 0.0))
    assert found.h_m <= 0
    assert found.takes_over
    if not takes_rates:
        assert found.setpoint is None
        return
    assert isinstance(found.setpoint, RatesSetpoint)
    assert found.setpoint.omega[1] < -1  # it pitches up


@pytest.mark.parametrize("kind", [VelocitySetpoint, AccelerationSetpoint])
def test_the_fence_sees_where_a_set_point_leads_before_a_take_over_acts(kind):
    guard = FenceGuard(BOX, FASTBRIDGE, dt_s=DT, takes_rates=True, latency_s=0.03)
    height, speed = (1.7, 3.5) if kind is VelocitySetpoint else (1.5, 3.0)
    rising, zero = at((3.0, 2, height), (0, 0, speed)), np.zeros(3)
    for desired, takes_over in ((0.0, False), (9.0 if kind is VelocitySetpoint else 25.0, True)):
        up = np.array([0, 0, desired])
        setpoint = kind(up, 0.0) if kind is VelocitySetpoint else kind(up, zero, zero, 0.0)
        guard.reset()
        found = guard.guard(rising, 0.0, setpoint)
        assert found.takes_over == takes_over, found


@pytest.mark.parametrize("name", ["rates", "velocity"])
def test_a_bad_filter_does_not_get_through_the_fence(name):
    """A body with a rate loop that flies at a wall at full speed stays inside the fence."""
    guard = FenceGuard(BOX, FASTBRIDGE, dt_s=DT, takes_rates=True, reserve_m=0.05, latency_s=0.02)
    body = quadrotor(FASTBRIDGE)
    inertia = np.array(body.inertia)
    x = np.array([3.0, 2, 1.5, 0, 0, 0, 0, 0, 0, 0, 0, 0.0])
    flown_by_fence = 0
    for i in range(400):
        quat = quat_of(x[3:6])
        state = VehicleState(0.0, x[:3].copy(), x[6:9].copy(), quat, x[9:].copy())
        desired = (
            RatesSetpoint(13.0, np.array([0, 1.0 if i < 60 else 0.0, 0]))
            if name == "rates"
            else VelocitySetpoint(np.array([3.0, 0, 0]), 0.0)
        )
        found = guard.guard(state, 0.0, desired)
        flown_by_fence += found.regulation < 0.5
        told = found.setpoint
        for _ in range(4):
            omega = x[9:]
            if isinstance(told, RatesSetpoint):
                torque = np.cross(omega, inertia * omega) + inertia * (told.omega - omega) / 0.02
                u = np.array([[told.thrust_m_s2 * body.mass, *torque]])
            else:
                row = np.zeros((1, 18))
                row[0, :3], row[0, 3:6] = x[:3], x[6:9]
                row[0, 6:9] = np.clip(4 * (told.velocity - x[6:9]), -5, 5)
                u = _core.track(body, _core.TrackingGains(max_tilt_rad=0.6), x[None], row)["wrench"]
            x = body.step(x[None], body.limited(np.ascontiguousarray(u)), dt_s=DT / 4)[0]
        assert guard.distance(at(x[:3])) > 0, (i, x)
    assert flown_by_fence > 0


def test_a_fence_around_a_map_keeps_out_of_its_hulls():
    made = mission(cover=box_cover([((18, 0, 0), (22, 15, 20))]), fence_map=True)
    assert made.fence.clearance((2.0, 1.0, 1.0), (2.0, 1.0, 1.0)) < 0
    assert made.fence.clearance(START, START) > 0.5
