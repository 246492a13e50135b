"""Whole flights against the simulated autopilot through sockets, on one clock."""

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import FASTBRIDGE, read_vehicle
from alula.stages.flight.loop.supervisor import Event
from alula.stages.sim_vehicle.ardupilot.copter import ArduCopter
from alula.stages.sim_vehicle.ardupilot.modes import Mode
from alula.stages.sim_vehicle.px4.modes import Px4Mode
from support.flights.flights import BALL, GOAL, START, mission
from support.flights.watched_flights import (
    AS_PLANNED,
    INDOORS,
    Watched,
    WatchedPx4,
    clearance,
    fly,
    true_path,
)
from support.paths import VEHICLES
from support.scenes.small_scenes import box_cover, line_plan


@pytest.fixture(scope="module")
def among_hulls():
    return mission(plan=line_plan(START, GOAL, 4.5))


# It knows that ArduPilot's yaw loop takes 0.3 s for a step; behind FastBridge's own loops the heading swings.
COPTER = read_vehicle(VEHICLES / "arducopter.toml")


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "vehicle"), [(Watched, COPTER), (WatchedPx4, FASTBRIDGE)])
def test_cone_backup_flies_around_an_ellipsoid_and_lands(kind, vehicle):
    made = mission("cone-backup", scene=BALL, is_clear=True, vehicle=vehicle)
    loop, served = fly(made, kind=kind)
    assert loop.recorder.states == AS_PLANNED
    assert loop.supervision.cause is Event.PLAN_FINISHED
    path = true_path(loop, served, "fly")
    assert clearance(made, path) > 0
    assert np.linalg.norm(path[-1] - GOAL) < 0.3
    assert not served.is_armed
    assert {s.safety.sent for s in loop.recorder.samples if s.safety} == {"rates"}
    turns = [s.state.attitude for s in loop.recorder.samples if s.safety][-200:]
    w, x, y, z = np.array([(q.w, q.x, q.y, q.z) for q in turns]).T
    heading = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    assert np.ptp(heading) < np.radians(5)


@pytest.mark.every(2)
@pytest.mark.parametrize(
    ("kind", "flown", "then"), [(WatchedPx4, "flown", Px4Mode.OFFBOARD), (Watched, "mode", Mode.LAND)]
)
def test_polytope_cbf_flies_past_a_pillar_and_lands(among_hulls, kind, flown, then):
    loop, served = fly(among_hulls, kind=kind)
    assert loop.recorder.states == AS_PLANNED
    assert clearance(among_hulls, true_path(loop, served, "fly")) > 0
    assert {s.safety.sent for s in loop.recorder.samples if s.safety} == {"velocity"}
    assert getattr(served.copter, flown) is then  # PX4 returns to it when it has landed


class AsShipped(Watched):
    """Climbs and stops as slowly as with the parameters that ArduPilot comes with."""

    kind, fast = ArduCopter, INDOORS


@pytest.mark.slow
@pytest.mark.parametrize("speed", [2.0, 1.5])
def test_a_climb_that_ends_below_a_ceiling_leaves_all_of_the_margin(speed):
    """With an assumed lag of 0.5 s the vehicle stops 7 cm from the ceiling, 3 cm inside the margin."""
    ceiling = box_cover([((-40, -40, 30), (80, 80, 34))])
    made = mission(cover=ceiling, plan=line_plan((0.3, 2, 0.6), (0.3, 2, 2.8), 2.5), speed_m_s=speed)
    loop, served = fly(made, kind=AsShipped)
    assert loop.recorder.states == AS_PLANNED
    assert clearance(made, true_path(loop, served, "fly")) >= made.config.margin_m


@pytest.mark.slow
def test_a_plan_that_ends_fast_before_a_wall_leaves_all_of_the_margin():
    """At 3 m/s a filter that ignores the lag of the autopilot hits the wall."""
    wall = box_cover([((40, 0, 0), (44, 40, 30))])
    made = mission(cover=wall, plan=line_plan(START, GOAL, 2.5), speed_m_s=3.0)
    loop, served = fly(made)
    assert loop.recorder.states == AS_PLANNED
    assert clearance(made, true_path(loop, served, "fly")) >= made.config.margin_m
