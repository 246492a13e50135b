"""Search in maps: paths, the widest passage with true bounds, the nearest free point, free points."""

import dataclasses
import math
from itertools import pairwise

import msgspec
import numpy as np
import pytest
from scipy import ndimage

from alula import _core
from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.errors import InfeasibleError, InputError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.planning.curve_certificate import certify_curve, certify_in
from alula.stages.planning.endpoints import free_points
from alula.stages.planning.path import find_polyline
from alula.stages.planning.plan import plan
from alula.stages.planning.space import PlanSpace, plan_space
from alula.stages.planning.trajectory import evaluate
from support.models.septic_splines import septic_spline
from support.scenes.covers import SIZE_M, boxes_cover

BOX = (0.0, 0.0, 0.0, 3.0, 3.0, 3.0)


def wall(low, high):
    """A wall 0.2 m thick at x = 1 m with a hole between y, z = low and high, in voxels."""
    return [
        [10, 0, 0, 12, 30, low],
        [10, 0, high, 12, 30, 30],
        [10, 0, low, 12, low, high],
        [10, high, low, 12, 30, high],
    ]


def balls(centres, radius_m, suggested_m=0.0, frame="world"):
    """A scene of balls, whose ellipsoids at one standard deviation have the radius."""
    centres = np.asarray(centres, np.float32).reshape(-1, 3)
    n = len(centres)
    return make_artifact(
        SCENE,
        {
            "mean": centres,
            "scale": np.full((n, 3), radius_m),
            "quat_wxyz": np.tile([1.0, 0, 0, 0], (n, 1)),
            "opacity": np.ones(n),
            "color": np.zeros((n, 3)),
        },
        frame=frame,
        unit="m",
        parameters={},
        summary={},
        source={},
        suggested_inflation_m=suggested_m,
    )


def config(start=(0.4, 1.5, 1.5), goal=(2.5, 0.5, 0.5), radius=0.2, **fields):
    return PlanConfig(beyond_map_m=3.0, start=start, goal=goal, radius_m=radius, **fields)


def space_of(values, cover=None, scene=None, image=None) -> PlanSpace:
    return plan_space(values, cover, scene, image)


def length_of(points):
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def box_distance(points, boxes):
    """Independent: distance of points to axis-aligned boxes, 0 inside."""
    low, high = SIZE_M * np.asarray(boxes)[:, :3], SIZE_M * np.asarray(boxes)[:, 3:]
    gap = np.maximum(np.maximum(low - points[:, None], points[:, None] - high), 0)
    return np.linalg.norm(gap, axis=2).min(axis=1)


@pytest.mark.parametrize(("low", "high"), [(13, 17), (11, 17), (9, 10)])
def test_the_bracket_of_the_widest_passage_contains_the_radius_of_a_square_hole(low, high):
    """The widest ball through a square hole has half its width; another wide way is closed by the box."""
    true = 0.5 * SIZE_M * (high - low)
    values = config(radius=0.4, goal=(2.5, 1.5, 1.5), bounds=BOX)
    space = space_of(values, boxes_cover(wall(low, high)))
    lower, upper, path, narrowest, _ = _core.widest_passage(
        space.map, BOX[:3], BOX[3:], values.start, values.goal, 0.4, 0.004, 500_000
    )
    assert lower <= true + 1e-9 <= upper + 2e-9
    assert upper - lower <= 0.004
    assert 0.99 <= narrowest[0] <= 1.21
    assert (np.abs(np.array(narrowest[1:]) - 0.5 * SIZE_M * (low + high)) < 0.05).all()
    np.testing.assert_array_equal(path[[0, -1]], [values.start, values.goal])
    samples = np.concatenate([a + np.linspace(0, 1, 50)[:, None] * (b - a) for a, b in pairwise(path)])
    assert box_distance(samples, wall(low, high)).min() >= lower - 1e-9
    with pytest.raises(
        InfeasibleError, match=r"a radius of 0\.\d+ m would pass, and none above .* place is at \("
    ) as error:
        find_polyline(values, space)
    assert "\n" not in str(error.value)


def test_a_round_hole_among_ellipsoids_has_the_radius_that_was_left():
    """Balls on a circle: the widest ball through it has the circle's radius less theirs."""
    turn = np.linspace(0, 2 * math.pi, 60, endpoint=False)
    ring = np.column_stack([np.full(60, 1.5), 1.5 + 0.8 * np.cos(turn), 1.5 + 0.8 * np.sin(turn)])
    y, z = (each.ravel() for each in np.meshgrid(np.arange(0, 3.1, 0.15), np.arange(0, 3.1, 0.15)))
    outside = np.hypot(y - 1.5, z - 1.5) >= 0.8
    sheet = np.column_stack([np.full(outside.sum(), 1.5), y[outside], z[outside]])
    space = space_of(config(), scene=balls(np.vstack([ring, sheet]), 0.2))
    lower, upper, *_ = _core.widest_passage(
        space.map, BOX[:3], BOX[3:], (0.75, 1.5, 1.5), (2.25, 1.5, 1.5), 0.7, 0.01, 500_000
    )
    assert lower - 1e-6 <= 0.6 <= upper + 1e-3  # 60 balls let a little more pass than the circle
    assert upper - lower <= 0.01


def test_points_that_are_not_connected_have_no_passage():
    closed = [[10, 0, 0, 12, 30, 30]]
    with pytest.raises(InfeasibleError, match=r"no path from --start to --goal keeps 0.2 m: no radius above"):
        find_polyline(config(bounds=BOX), space_of(config(), boxes_cover(closed)))


def maze(seed, size=10):
    """Random blocks of 0.3 m in a box of 3 m, in voxels; about a third is solid."""
    rng = np.random.default_rng(seed)
    at = np.argwhere(rng.random((size, size, size)) < 0.3)
    return np.hstack([3 * at, 3 * at + 3])


@pytest.mark.every(2)
@pytest.mark.parametrize("seed", range(6))
def test_every_pair_that_a_fine_grid_connects_has_a_path(seed):
    """Points of a grid of 0.025 m with the radius and 0.0125 m connect by steps that keep the radius."""
    boxes, radius, step = maze(seed), 0.12, 0.025
    axis = np.arange(step / 2, 3, step)
    solid = np.zeros((30, 30, 30), bool)
    for low, high in zip(boxes[:, :3], boxes[:, 3:], strict=True):
        solid[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
    fine = np.repeat(np.repeat(np.repeat(solid, 4, 0), 4, 1), 4, 2)
    # Distance between centres less half a diagonal is below the distance to the solid.
    distance = step * ndimage.distance_transform_edt(~fine)
    surely, hardly = distance - step * math.sqrt(3) / 2, distance + step * math.sqrt(3) / 2
    part, _ = ndimage.label(surely >= radius + step / 2)
    loose, _ = ndimage.label(hardly >= radius - step * math.sqrt(3) / 2, np.ones((3, 3, 3)))
    rng = np.random.default_rng(seed)
    free = np.argwhere(part > 0)
    cover = boxes_cover(boxes)
    for _ in range(8):
        a, b = free[rng.integers(len(free), size=2)]
        values = config(tuple(axis[a]), tuple(axis[b]), radius, bounds=BOX)
        if math.dist(values.start, values.goal) < 0.1:
            continue
        try:
            path = find_polyline(values, space_of(values, cover)).point
        except InfeasibleError:
            assert part[tuple(a)] != part[tuple(b)]
            continue
        samples = np.concatenate([p + np.linspace(0, 1, 40)[:, None] * (q - p) for p, q in pairwise(path)])
        assert box_distance(samples, boxes).min() >= radius
        assert loose[tuple(a)] == loose[tuple(b)]


def test_the_path_around_a_wall_is_as_long_as_the_taut_string():
    """Without comfort the shortest way over the edge of a wall for a ball is two tangents and an arc."""
    boxes = [[10, -40, -40, 12, 70, 15]]
    radius, start, goal = 0.2, (0.1, 1.5, 1.0), (2.1, 1.5, 1.0)
    space = space_of(config(), boxes_cover(boxes))
    lattice = ((-0.9, -0.5, 0.0), 0.1, (41, 41, 31))
    _, path, _ = _core.find_path(space.map, *lattice, start, goal, radius, 0.0)
    found = length_of(_core.tighten_path(space.map, path, radius, 0.0, 0.05, 3))
    # From the start to the corner at (1, 1.5) m in x, z: a tangent, an arc about the corner, a line.
    away = math.dist((0.1, 1.0), (1.0, 1.5))
    tangent = math.sqrt(away**2 - radius**2)
    rise = math.atan2(0.5, 0.9) + math.asin(radius / away)
    true = 2 * (tangent + radius * rise) + 0.2
    assert true - 1e-9 <= found <= 1.01 * true


def test_a_cover_its_image_and_their_union_give_nearly_the_same_path():
    cover = boxes_cover(wall(11, 19))
    image = encode_map(cover, indexed=True)
    spaces = [space_of(config(), *each) for each in ((cover,), (None, None, image), (cover, None, image))]
    lengths = [length_of(find_polyline(config(bounds=BOX), space).point) for space in spaces]
    assert max(lengths) <= 1.03 * min(lengths)
    for part in ({"cover": cover}, {"image": image}, {"cover": cover, "image": image}):
        made = plan(config(bounds=BOX), **part)
        points = evaluate(made["time"], made["coefficient"], np.linspace(0, made["time"][-1], 4001))[:, :3]
        assert box_distance(points, wall(11, 19)).min() >= 0.2
        assert [each["map"] for each in made.manifest.maps] == list(part)


def test_a_plan_keeps_from_hulls_and_ellipsoids_the_distance_of_each():
    """Both keep radius, margin and what of the suggested inflation their obstacles have not grown by."""
    scene = balls([[2.0, 1.5, 1.5], [0.5, 2.5, 0.4]], 0.25, suggested_m=0.07)
    values = PlanConfig(
        beyond_map_m=3.0,
        start=(0.4, 1.5, 1.5),
        goal=(2.6, 1.5, 1.5),
        bounds=BOX,
        speed_m_s=2.0,
        margin_m=0.05,
    )
    grown = boxes_cover(wall(9, 21))
    grown = dataclasses.replace(grown, manifest=msgspec.structs.replace(grown.manifest, inflation_m=0.04))
    made = plan(values, grown, scene=scene)
    cover, among = made.manifest.maps
    radius = FASTBRIDGE.body.radius_m
    assert (cover["keep_m"], among["keep_m"]) == pytest.approx((radius + 0.08, radius + 0.12))
    assert made.manifest.radius_m == cover["keep_m"]
    points = evaluate(made["time"], made["coefficient"], np.linspace(0, made["time"][-1], 8001))[:, :3]
    apart = np.linalg.norm(points[:, None] - np.array(scene["mean"], float), axis=2).min() - 0.25
    assert box_distance(points, wall(9, 21)).min() >= cover["keep_m"]
    assert apart >= among["keep_m"] - 1e-6
    assert made.manifest.certificate["min_proven_clearance_m"] <= min(apart, 2 * among["keep_m"]) + 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_the_proof_among_ellipsoids_agrees_with_dense_samples(seed):
    rng = np.random.default_rng(seed)
    centres = rng.uniform(0, 3, (12, 3)).astype(np.float32)
    among = space_of(config(), scene=balls(centres, 0.2)).maps[0]
    time = np.array([0.0, 1.0, 2.5, 3.0])
    c = septic_spline(rng.uniform(-0.5, 3.5, (4, 3)), np.diff(time))
    for radius in (0.02, 0.1, 0.3):
        proof = certify_curve(time, c, among.obstacles, radius, extent_m=among.extent_m)
        for k in range(3):
            t = np.linspace(time[k], np.nextafter(time[k + 1], 0), 3001)
            points = evaluate(time, c, t)
            closest = (np.linalg.norm(points[:, None] - centres.astype(float), axis=2) - 0.2).min()
            if proof.proven[k]:
                assert closest >= radius
                assert closest >= proof.clearance_m[k]
            else:
                assert closest < radius + np.linalg.norm(np.diff(points, axis=0), axis=1).max() + 1e-6


def test_a_point_that_is_not_free_names_the_nearest_that_is_and_snap_takes_it():
    cover, start = boxes_cover([[0, 0, 0, 10, 10, 10]]), (0.5, 0.6, 0.93)
    values = config(start, (2.5, 2.5, 2.5), via=((2, 2, 1),))
    with pytest.raises(
        InfeasibleError,
        match=r"deep; the nearest free point is \(0\.\d+ 0\.\d+ 1\.20\d\), and --nearest-free",
    ) as error:
        plan(values, cover)
    assert "\n" not in str(error.value)
    made = plan(config(start, (2.5, 2.5, 2.5), via=((2, 2, 1),), nearest_free=True), cover)
    first = made["waypoint"][0, :3]
    assert math.dist(first, start) <= 0.27 + 0.005
    assert box_distance(first[None], [[0, 0, 0, 10, 10, 10]])[0] >= 0.2
    assert made.manifest.parameters["start"] == list(start)
    (note,) = made.manifest.summary["notes"]
    assert note.startswith("the start (0.5 0.6 0.93) is not free; the plan has (")
    assert made.manifest.via_m == [[2, 2, 1]]


def test_free_points_are_free_connected_and_far_apart():
    """Two rooms joined by a hole too small for the vehicle: all points are in the larger one."""
    boxes = wall(13, 16)
    space = space_of(config(radius=0.25), boxes_cover(boxes))
    found = free_points(config(radius=0.25, bounds=BOX), space, 9, seed=4)
    assert found.shape == (9, 3)
    assert box_distance(found, boxes).min() >= 0.25
    assert (found[:, 0] > 1.2).all()
    apart = np.linalg.norm(found[:, None] - found, axis=2)[~np.eye(9, dtype=bool)]
    assert apart.min() > 0.9
    np.testing.assert_array_equal(found, free_points(config(radius=0.25, bounds=BOX), space, 9, seed=4))
    assert (found != free_points(config(radius=0.25, bounds=BOX), space, 9, seed=5)).any()
    with pytest.raises(InfeasibleError, match="not 900000"):
        free_points(config(radius=0.25, bounds=BOX), space, 900_000)


def test_the_search_is_the_same_every_time():
    values, cover = config(radius=0.12, bounds=BOX), boxes_cover(maze(3))
    space = space_of(values, cover)
    start, goal = free_points(values, space, 2)
    values = config(tuple(start), tuple(goal), 0.12, bounds=BOX)
    one, two = (find_polyline(values, space_of(values, cover), jobs=jobs) for jobs in (1, 4))
    np.testing.assert_array_equal(one.point, two.point)
    assert one.visited == two.visited


def test_maps_of_different_frames_are_refused():
    with pytest.raises(InputError, match="the cover is in frame 'world', the scene is in frame 'hall'"):
        plan_space(config(), boxes_cover([]), balls([[9, 9, 9]], 0.1, frame="hall"))


def test_a_grown_map_is_nearer_by_its_length():
    space = space_of(config(), boxes_cover(wall(11, 19)))
    grown = _core.GrownMap(space.map, 0.1)
    points = np.random.default_rng(0).uniform(0, 3, (200, 3))
    ends = points[::-1].copy()
    np.testing.assert_allclose(grown.distance(points), space.map.distance(points) - 0.1, atol=1e-12)
    near, far = grown.segment_distance(points, ends, 2.0), space.map.segment_distance(points, ends, 2.1)
    np.testing.assert_allclose(near, np.maximum(far - 0.1, 0), atol=1e-12)
    assert (grown.is_clear(points, ends, 0.1) == space.map.is_clear(points, ends, 0.2)).all()
    with pytest.raises(ValueError, match="grow"):
        _core.GrownMap(space.map, -0.1)


def test_a_plan_is_proven_in_each_part():
    values = config(bounds=BOX)
    cover, scene = boxes_cover(wall(11, 19)), balls([[2.5, 2.5, 2.5]], 0.2)
    made = plan(values, cover, scene=scene)
    space = space_of(values, cover, scene)
    assert certify_in(made["time"], made["coefficient"], space).holds
    closer = space_of(values, cover, balls([made["waypoint"][2, :3]], 0.1))
    assert not certify_in(made["time"], made["coefficient"], closer).holds
