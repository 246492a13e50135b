"""Flights in lock-step over ground that is not flat: simulated vehicles rest and land on the map."""

import math

import numpy as np
import pytest

from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.loop.supervisor import Event
from alula.stages.sim_vehicle.common.airframe import Terrain
from alula.stages.vehicles.ground import Footing, Ground, ground_of
from support.flights.flights import loop_of, mission
from support.scenes.small_scenes import ball_scene, box_cover, rest_plan
from support.vehicles.lockstep import Flight
from support.vehicles.mavlink_peer import Time

STEP = [((-10, 0, -2), (20, 40, 0)), ((20, 0, -12), (50, 40, -10))]  # down by 1 m at x = 2
START, GOAL = (0.5, 2.0, 1.0), (3.5, 2.0, -0.4)


def flown(ground, query="", plan=None, **fields):
    """The loop and the link of a flight from the upper part."""
    made = mission(cover=box_cover(STEP), plan=plan or rest_plan(START, GOAL, 0.8), **fields)
    time = Time()
    of_map = (lambda: ground_of(made.cover)) if ground else None
    options = LinkOptions(clock=time, sleep=time.sleep, ground=of_map)
    link = open_link(f"sim:?start=0.5,2,0{query}", options)
    link.clock = time
    link.open(1.0)
    loop = loop_of(made, link)
    loop.run()
    return loop, link


def test_a_plan_that_leads_down_a_step_is_flown_and_landed_at_its_foot():
    loop, link = flown(ground=True)
    assert loop.supervision.cause is Event.PLAN_FINISHED
    assert not link.status.armed
    assert link.status.landed
    assert link.body.position == pytest.approx([3.5, 2.0, -1.0], abs=0.1)
    assert link.body.position[2] == pytest.approx(-1.0, abs=2e-6)
    assert link.body.impact_m_s < 0.8


@pytest.mark.slow
def test_a_simulated_autopilot_lands_at_the_foot_of_a_step():
    made = mission(cover=box_cover(STEP), plan=rest_plan(START, GOAL, 0.8))
    terrain = Terrain(ground_of(made.cover), (START[0], START[1], 0.0))
    flight = Flight(made, terrain=terrain).fly()
    flight.judge()
    assert flight.cause is Event.PLAN_FINISHED
    assert not flight.copter.is_armed
    assert flight.copter.airframe.on_ground
    assert flight.copter.airframe.truth.position[2] == pytest.approx(1.0, abs=2e-6)  # down
    assert flight.copter.airframe.touchdown_m_s < 2.0


def test_without_a_map_the_floor_is_flat_at_the_height_of_the_start():
    loop, link = flown(ground=False)
    assert loop.supervision.cause is not Event.PLAN_FINISHED
    assert link.body.position[2] == 0.0


def test_over_a_map_that_is_level_a_flight_is_that_over_the_flat_floor():
    plan = rest_plan(START, (1.2, 2.5, 0.8), 0.8)
    flat, mapped = (flown(each, "&noise=1&seed=4", plan)[1] for each in (False, True))
    assert mapped.body.position == pytest.approx(flat.body.position, abs=1e-5)
    assert mapped.body.impact_m_s == pytest.approx(flat.body.impact_m_s, abs=1e-5)


def test_the_ground_is_the_first_obstacle_below():
    boxes = [((0, 0, 0), (40, 40, 1)), ((10, 10, 8), (20, 20, 9)), ((30, 30, -20), (60, 60, -10))]
    ground = ground_of(box_cover(boxes))
    random = np.random.default_rng(5)
    for x, y, z in random.uniform((-1, -1, -1.5), (6.5, 6.5, 2), (400, 3)):
        tops = []
        inside = False
        for (a, b, c), (d, e, f) in np.array(boxes) / 10:
            if a <= x <= d and b <= y <= e and c <= z:
                inside = inside or z <= f
                tops.append(f)
        found = ground.below(np.array([x, y, z]))
        if inside:
            assert math.isnan(found)
        else:
            assert found == pytest.approx(max(tops, default=-math.inf), abs=2e-6)


def test_balls_are_ground_where_they_are_met():
    ground = ground_of(None, ball_scene([(0, 0, 0)], 0.5), sigma=2.0)  # of radius 1 m
    assert ground.below(np.array([0.6, 0.0, 3.0])) == pytest.approx(0.8, abs=1e-6)
    assert ground.below(np.array([1.01, 0.0, 3.0])) == -math.inf


def test_where_nothing_is_below_it_is_the_known_floor_or_the_start():
    obstacles = ground_of(box_cover(STEP)).obstacles
    far = np.array([9.0, 9.0, 2.0])
    start = np.array([0.5, 2.0, 0.7])
    assert Footing(Ground(obstacles, -1.2), start).height(far) == 0.7
    assert Footing(Ground(obstacles, -1.2, floor_m=0.1), start).height(far) == 0.1
    assert Footing(Ground(obstacles, -1.2), start).height(far - (0, 0, 1.9)) == -1.2
    footing = Footing(Ground(obstacles, -1.2), start)
    assert footing.height(np.array([1.0, 2.0, 0.5])) == pytest.approx(0.0, abs=2e-6)
    assert footing.height(np.array([1.0, 2.0, -0.1])) == pytest.approx(0.0, abs=2e-6)  # in the slab
