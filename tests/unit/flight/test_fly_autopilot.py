"""Whole flights against the simulated autopilot through sockets, on one clock."""

import msgspec
import numpy as np
import pytest

from alula.schemas.vehicle import FASTBRIDGE
from alula.stages.flight.loop.supervisor import Event
from alula.stages.sim_vehicle.ardupilot.modes import Mode
from alula.stages.sim_vehicle.px4.modes import Px4Mode
from support.flights import BALL, GOAL, START, mission
from support.small_scenes import box_cover, line_plan
from support.watched_flights import (
    AS_PLANNED,
    Watched,
    WatchedPx4,
    clearance,
    fly,
    true_path,
)


@pytest.fixture(scope="module")
def among_hulls():
    return mission(plan=line_plan(START, GOAL, 4.5))


# With FastBridge's own gains the heading swings on ArduPilot's yaw loop, which takes 0.28 s for a step.
SOFT_YAW = msgspec.structs.replace(
    FASTBRIDGE,
    tracking=msgspec.structs.replace(
        FASTBRIDGE.tracking, attitude_n_m=(0.35, 0.35, 0.03), rate_n_m_s=(0.025, 0.025, 0.010)
    ),
)


@pytest.mark.parametrize(("kind", "vehicle"), [(Watched, SOFT_YAW), (WatchedPx4, FASTBRIDGE)])
def test_cone_backup_flies_around_an_ellipsoid_and_lands(kind, vehicle):
    made = mission("cone-backup", scene=BALL, is_clear=True, vehicle=vehicle)
    loop, served = fly(made, kind=kind)
    assert loop.recorder.states == AS_PLANNED
    assert loop.supervision.cause is Event.PLAN_FINISHED
    path = true_path(loop, served, "fly")
    assert clearance(made, path) > 0
    assert np.linalg.norm(path[-1] - GOAL) < 0.3
    assert not served.is_armed
    assert {s.filter.sent for s in loop.recorder.samples if s.filter} == {"rates"}


@pytest.mark.parametrize(
    ("kind", "flown", "land"), [(Watched, "mode", Mode.LAND), (WatchedPx4, "flown", Px4Mode.LAND)]
)
def test_polytope_cbf_flies_past_a_pillar_and_lands(among_hulls, kind, flown, land):
    loop, served = fly(among_hulls, kind=kind)
    assert loop.recorder.states == AS_PLANNED
    assert clearance(among_hulls, true_path(loop, served, "fly")) > 0
    assert {s.filter.sent for s in loop.recorder.samples if s.filter} == {"velocity"}
    assert getattr(served.copter, flown) is land


def test_a_plan_that_ends_fast_before_a_wall_leaves_all_of_the_margin():
    """At 3 m/s a filter that ignores the lag of the autopilot hits the wall."""
    wall = box_cover([((40, 0, 0), (44, 40, 30))])
    made = mission(cover=wall, plan=line_plan(START, GOAL, 2.5), speed_m_s=3.0)
    loop, served = fly(made)
    assert loop.recorder.states == AS_PLANNED
    assert clearance(made, true_path(loop, served, "fly")) >= made.config.margin_m
