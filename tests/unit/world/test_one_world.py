"""One builder: what filters are told is the same in `fly` as in `simulate`."""

import dataclasses

import msgspec
import numpy as np
import pytest

from alula.schemas.scenarios.scenario import decoded
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.world.world import make_world
from support.flights import flights
from support.scenes.small_scenes import ball_scene, box_cover, line_plan

MARGIN_M = 0.1
COVER, SCENE = box_cover(flights.PILLAR), ball_scene([(2.0, 2.2, 1.0), (2.0, -1.0, 1.0)], 0.3)
ALIGNED = dataclasses.replace(  # its alignment is known to 0.03 m
    SCENE, manifest=msgspec.structs.replace(SCENE.manifest, suggested_inflation_m=0.03)
)
KINDS = {"polytope-cbf": "velocity", "cone-backup": "body-rates"}


def told_by_fly(name, **given):
    return flights.mission(name, margin_m=MARGIN_M, is_clear=True, **given).world.told


def told_by_simulate(name, inflation_m=None, **given):
    radius_m = FASTBRIDGE.body.radius_m + MARGIN_M
    tree = {
        "vehicle": {"type": "fastbridge", "interface": KINDS[name], "radius_m": radius_m},
        "world": {role: role for role in given}
        | ({} if inflation_m is None else {"inflation_m": inflation_m}),
        "mission": {"kind": "goal", "start_m": flights.START, "goal_m": flights.GOAL},
        "safety": {"filters": [name]},
    }
    return make_world(decoded(tree, "case"), FASTBRIDGE, **given).told


@pytest.mark.parametrize(
    ("name", "maps"),
    [
        ("polytope-cbf", {"cover": COVER}),
        ("polytope-cbf", {"cover": COVER, "inflation_m": 0.05}),
        ("polytope-cbf", {"cover": COVER, "scene": ALIGNED}),
        ("cone-backup", {"cover": COVER, "scene": ALIGNED}),
        ("cone-backup", {"cover": COVER}),
        ("cone-backup", {"scene": SCENE}),
        ("cone-backup", {"cover": COVER, "scene": SCENE}),
    ],
)
def test_a_filter_is_told_in_fly_what_it_is_told_in_simulate(name, maps):
    """All of its world, so that any filter of `simulate` can be built for `fly` too."""
    flown, simulated = told_by_fly(name, **maps), told_by_simulate(name, **maps)
    assert flown.parts.keys() == simulated.parts.keys()
    for part in ("ellipsoids", "hulls", "fence"):
        assert flown.keeps_m(part) == simulated.keeps_m(part)
    points = np.array([flights.START, flights.GOAL, (2.0, 1.7, 1.0)])
    for part, own in flown.parts.items():
        assert (own.distance(points) == simulated.parts[part].distance(points)).all()
    same = ("radius_m", "rate_time_constant_s", "max_rate_rad_s", "motor_time_constant_s")
    same += ("max_acceleration_m_s2", "max_jerk_m_s3")
    assert [getattr(flown, each) for each in same] == [getattr(simulated, each) for each in same]
    assert (flown.hulls is None) == (simulated.hulls is None) == ("cover" not in maps)


def test_a_distance_that_is_kept_is_the_radius_and_the_largest_inflation_of_the_parts():
    told = FilterWorld(radius_m=0.2, inflation_m={"ellipsoids": 0.3, "hulls": 0.1}, dt_s=0.01)
    assert told.keeps_m("hulls") == 0.2 + 0.1
    assert told.keeps_m("hulls", "ellipsoids", "fence") == 0.2 + 0.3
    assert told.keeps_m("fence") == told.keeps_m() == 0.2


def test_a_real_flight_does_not_leave_the_crop_of_its_cover():
    """What lies outside of a map's crop is unknown, in `fly` as in `plan` and `simulate`."""
    plan = line_plan((0.3, 2.0, 1.0), (3.7, 2.0, 1.0))
    plan = dataclasses.replace(plan, manifest=msgspec.structs.replace(plan.manifest, beyond_map_m=0.0))
    wide = box_cover([((0, 0, 0), (40, 1, 20)), ((0, 39, 0), (40, 40, 20))])
    manifest = msgspec.structs.replace(wide.manifest, crop=[0.0, 0.0, 0.0, 2.5, 4.0, 2.0])
    for cover, holds in ((wide, True), (dataclasses.replace(wide, manifest=manifest), False)):
        made = flights.mission(cover=cover, plan=plan)
        assert made.is_clear[0] == holds, made.is_clear
    assert "m outside of the mapped box" in made.is_clear[1]
