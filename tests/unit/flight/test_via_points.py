"""The plan's time waits at via points, so that a vehicle that follows late does not cut them."""

import math

import msgspec
import numpy as np
import pytest

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.flight.loop.plan_clock import PlanClock
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.flight.replan.of_mission import replan_facts
from alula.stages.planning.plan import plan
from alula.stages.sim_vehicle.common.quaternions import to_euler
from support.flights.flights import PILLAR, mission
from support.scenes.small_scenes import box_cover
from support.vehicles.lockstep import Flight

DT = 0.01
VIA = (2.0, 1.78, 1.0)  # as near to the pillar as the filter lets it


def around(speed_m_s):
    config = PlanConfig(
        beyond_map_m=6.0,
        start=(0.4, 0.7, 1.0),
        goal=(3.6, 0.7, 1.0),
        via=(VIA,),
        radius_m=0.27,
        speed_m_s=speed_m_s,
    )
    return mission("polytope-cbf", cover=box_cover(PILLAR), plan=plan(config, box_cover(PILLAR)))


@pytest.mark.slow
@pytest.mark.parametrize("speed_m_s", [1.0, 2.0, 3.0])
def test_a_vehicle_that_follows_velocities_late_passes_its_via_points(speed_m_s):
    made = around(speed_m_s)
    flight = Flight(made).fly()
    assert flight.cause is Event.PLAN_FINISHED
    path = flight.path(State.FLY, State.HOLD)[:, 1:]
    result = made.along.result(path)
    assert result.missed == [], result
    assert flight.clearance(State.FLY, State.HOLD) > 0


def clock_of(made, via_s):
    return PlanClock(made.curve, _core.PlanClockOptions(via_s=via_s, via_m=0.15))


def at_via(clock, error_m, seconds):
    for _ in range(round(seconds / DT)):
        clock.advance(DT, error_m)
    return clock.time_s


def test_the_time_stops_at_a_via_point_until_the_vehicle_is_there():
    made = around(1.0)
    (via_s,) = made.along.waits.via_s
    np.testing.assert_allclose(made.curve.at(np.array([via_s]))[0, :3], VIA, atol=1e-9)
    clock = clock_of(made, [via_s])
    assert at_via(clock, 0.14, via_s + 3.0) == pytest.approx(via_s, abs=0.01)
    assert at_via(clock, 0.13, 1.0) > via_s + 0.4


def test_a_via_point_that_cannot_be_reached_is_waited_for_and_left():
    made = around(1.0)
    (via_s,) = made.along.waits.via_s
    clock = clock_of(made, [via_s])
    assert at_via(clock, 0.2, via_s + 3.0) <= via_s
    assert at_via(clock, 0.2, 10.0) > via_s + 1.0


def test_a_vehicle_that_keeps_up_is_not_delayed():
    made = around(1.0)
    waiting, free = (clock_of(made, via) for via in (made.along.waits.via_s, []))
    for _ in range(800):
        waiting.advance(DT, 0.1)
        free.advance(DT, 0.1)
        assert waiting.time_s == free.time_s


@pytest.mark.slow
def test_a_real_loop_flies_through_gates_in_two_laps_with_the_heading_of_the_plan():
    config = PlanConfig(
        beyond_map_m=6.0,
        start=(0.4, 0.7, 1.0),
        goal=(0.4, 0.7, 1.0),
        gate=((2.0, 2.1, 1.2, 1.0, 0.0, 0.0, 0.4), (3.0, 0.7, 1.0, 0.0, -1.0, 0.0, 0.45)),
        loops=2,
        radius_m=0.27,
        margin_m=0.1,
        yaw="along",
        speed_m_s=1.5,
    )
    course = plan(config, box_cover(PILLAR))
    made = mission("polytope-cbf", cover=box_cover(PILLAR), plan=course)
    assert replan_facts(around(1.0)) is not None
    assert replan_facts(made) is None  # a new plan passes points, not gates
    large = msgspec.structs.replace(
        FASTBRIDGE, body=msgspec.structs.replace(FASTBRIDGE.body, radius_m=0.41), name="large"
    )
    with pytest.raises(UsageError, match=r"gate 1 of lap 1 has a radius of 0\.4 m, and large one of 0\.41 m"):
        mission("polytope-cbf", cover=box_cover(PILLAR), plan=course, vehicle=large)
    flight, turned = Flight(made), []

    def follow(flight):
        if flight.loop is not None and flight.loop.state is State.FLY:
            planned = made.curve.at(np.array([flight.loop.plan.time_s]))[0, 15]
            turned.append(
                (to_euler(flight.copter.airframe.truth.attitude)[2], flight.frame.yaw_to_ned(planned))
            )

    flight.each = follow
    flight.fly()
    assert flight.cause is Event.PLAN_FINISHED
    heading, planned = np.array(turned).T
    error = np.remainder(heading - planned + np.pi, 2 * np.pi) - np.pi
    assert np.abs(error[200:]).max() < 1.2  # the autopilot turns later than it is told
    assert np.abs(error[200:]).mean() < 0.3
    assert np.ptp(np.unwrap(planned)) > 9
    rows = flight.path(State.FLY, State.HOLD)
    result = made.along.result(rows[:, 1:], rows[:, 0])
    assert result.missed == [], result
    assert flight.clearance(State.FLY, State.HOLD) > 0


def test_each_via_point_of_a_clock_has_its_own_distance():
    made = around(1.0)
    half, end = 0.5 * made.curve.duration_s, made.curve.duration_s
    clock = PlanClock(made.curve, _core.PlanClockOptions(via_s=[half, 0.9 * end], own_via_m=[0.3, 0.1]))
    assert at_via(clock, 0.2, half + 0.5) > half
    assert at_via(clock, 0.2, end) == pytest.approx(0.9 * end, abs=0.01)
    for wrong in ([0.1], [0.1, 0.0], [0.1, math.nan]):
        with pytest.raises(ValueError, match="distance"):
            PlanClock(made.curve, _core.PlanClockOptions(via_s=[half, end], own_via_m=wrong))
