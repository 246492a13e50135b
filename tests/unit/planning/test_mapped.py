"""What is outside of the mapped box is unknown: no point, no path and no moved point is there unasked."""

import dataclasses

import numpy as np
import pytest

from alula.schemas.errors import InfeasibleError, UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.scenario import decoded
from alula.stages.planning.endpoints import free_points
from alula.stages.planning.mapped import Mapped
from alula.stages.planning.plan import plan
from alula.stages.planning.space import plan_space
from alula.stages.planning.trajectory import evaluate
from alula.stages.simulation.simulate import simulate_world
from support.scenes.covers import with_manifest
from support.scenes.small_scenes import box_cover

# A room of 8 x 6 x 3 m within, of voxels of 0.1 m, with a wall across it that leaves a gap at the top.
SHELL = [
    ((-2, -2, -2), (82, 62, 0)),
    ((-2, -2, 30), (82, 62, 32)),
    ((-2, -2, 0), (0, 62, 30)),
    ((80, -2, 0), (82, 62, 30)),
    ((0, -2, 0), (80, 0, 30)),
    ((0, 60, 0), (80, 62, 30)),
]
ROOM = box_cover([*SHELL, ((39, 0, 0), (41, 60, 20))])
PILLAR = box_cover([((18, 18, 0), (22, 22, 20))])  # 0.4 x 0.4 x 2 m
CONFIG = PlanConfig(start=(1, 1, 1), goal=(7, 5, 1), radius_m=0.25)


@pytest.mark.parametrize(
    ("start", "words"),
    [
        (
            (80, 80, 100),
            r"the start \(80 80 100\) is 97.1 m outside of the mapped box .* \(in centimetres\?\)",
        ),
        ((4, 3, 50), r"outside of the mapped box .* is unknown; --beyond-map"),  # metres along two axes
        ((1500, 2500, 1200), r"outside .* is unknown \(in millimetres\?\)"),
        ((41.00824, 28.97836, 30), r"outside .* is unknown \(latitude and longitude in degrees\?\)"),
        ((666000, 4541000, 30), r"outside .* is unknown \(coordinates of a map projection\?\)"),
        (
            (4, 3, 4.05),
            r"is 1.1 m outside .* m\), and what is there is unknown; --beyond-map 1.1 takes so much",
        ),
    ],
)
def test_points_outside_are_refused_with_the_distance_and_the_likely_unit(start, words):
    with pytest.raises(InfeasibleError, match=words):
        plan(dataclasses.replace(CONFIG, start=start), ROOM)
    with pytest.raises(InfeasibleError, match=words):
        plan(dataclasses.replace(CONFIG, start=start, straight=True), ROOM)
    with pytest.raises(InfeasibleError, match="outside of the mapped box"):
        plan(dataclasses.replace(CONFIG, start=start, nearest_free=True), ROOM)


def test_what_lies_outside_of_the_crop_is_outside_of_the_mapped_box():
    cropped = with_manifest(ROOM, crop=[0.0, 0.0, 0.0, 8.0, 6.0, 2.0])
    high = dataclasses.replace(CONFIG, start=(1, 1, 2.2))
    assert plan(high, ROOM)["waypoint"][0, 2] == pytest.approx(2.2)
    with pytest.raises(InfeasibleError, match=r"0.451 m outside of the mapped box \(-?0 -?0 -?0 8 6 2 m"):
        plan(high, cropped)
    tree = {"world": {"cover": "x"}, "mission": {"kind": "waypoints", "start_m": (1, 1, 2.2)}}
    tree["mission"]["waypoints_m"] = [(2, 1, 1.0)]
    with pytest.raises(UsageError, match="outside of the mapped box"):
        simulate_world(decoded(tree | {"safety": {"filters": ["polytope-cbf"]}}), cover=cropped, jobs=1)


def test_free_points_moved_points_and_paths_stay_in_the_mapped_box():
    """A path around the pillar stays within the box; a point in a wall is moved into the room."""
    points = free_points(CONFIG, plan_space(CONFIG, ROOM), 8)
    assert (points > 0.25).all()
    assert (points < (7.75, 5.75, 2.75)).all()
    made = plan(dataclasses.replace(CONFIG, start=(-0.05, 3, 1.5), nearest_free=True), ROOM)
    np.testing.assert_allclose(
        evaluate(made["time"], made["coefficient"], 0.0)[:3], (0.251, 3, 1.5), atol=0.01
    )
    at = evaluate(made["time"], made["coefficient"], np.linspace(0, made["time"][-1], 500))[:, :3]
    assert (at > 0).all()
    assert (at < (8, 6, 3)).all()
    beside = PlanConfig(start=(1.7, 2, 1), goal=(2.3, 2, 1), radius_m=0.05, beyond_map_m=0.5)
    made = plan(beside, PILLAR)
    at = evaluate(made["time"], made["coefficient"], np.linspace(0, made["time"][-1], 500))[:, :3]
    assert np.maximum((1.8, 1.8, 0) - at, at - (2.2, 2.2, 2)).max() <= 0.45 + 1e-6


def test_a_plan_that_was_told_to_take_unknown_space_for_free_says_so():
    made = plan(dataclasses.replace(CONFIG, start=(1, 1, 3.5), goal=(7, 5, 3.5), beyond_map_m=2.0), ROOM)
    assert made.manifest.beyond_map_m == 2.0
    assert made.manifest.guarantee.claims["beyond_map_m"] == 2.0
    assert "up to 2 m around the mapped box counts as free, though it is unknown" in (
        made.manifest.guarantee.statement
    )
    inside = plan(CONFIG, ROOM)
    assert "beyond_map_m" not in inside.manifest.guarantee.claims
    mapped = Mapped(np.array((-0.2, -0.2, -0.2)), np.array((8.2, 6.2, 3.2)))
    assert mapped.refusal_of_plan(inside, 0.25, "--x ") is None
    words = mapped.refusal_of_plan(made, 0.25, "--x ")
    assert words is not None
    assert words.startswith("the plan is ")


def test_a_curve_that_leaves_the_box_between_its_ends_is_found():
    """Both ends of the plan are inside; its height in between is that of its samples, from above."""
    made = plan(dataclasses.replace(CONFIG, via=((4, 3, 2.7),)), ROOM)
    highest = evaluate(made["time"], made["coefficient"], np.linspace(0, made["time"][-1], 4000))[:, 2].max()
    for above, is_out in ((1e-3, True), (-0.02, False)):
        box = Mapped(np.full(3, -10.0), np.array((20.0, 20.0, highest - above)))
        assert (box.refusal_of_plan(made, 1e-9, "--x ") is not None) == is_out
