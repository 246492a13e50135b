"""Plans: always proven, within limits, refused with a reason; the proof against independent sampling."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula._core import HullMap, SearchStatus, find_path
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.kinds import PLAN
from alula.schemas.errors import ArtifactError, InfeasibleError, InputError, UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.planning.curve_certificate import certify_curve
from alula.stages.planning.fastest import MovingState
from alula.stages.planning.limits import motion_limits
from alula.stages.planning.path import find_polyline
from alula.stages.planning.plan import plan
from alula.stages.planning.space import plan_space
from alula.stages.planning.trajectory import evaluate
from alula.stages.planning.verify import verify_plan
from support.effort import examples
from support.models.clearances import clearance_to_hulls
from support.models.septic_splines import septic_spline
from support.scenes.covers import box_distance, boxes_cover, random_boxes

WALL_WITH_HOLE = [
    [10, 0, 0, 12, 30, 8],
    [10, 0, 16, 12, 30, 30],
    [10, 0, 8, 12, 11, 16],
    [10, 19, 8, 12, 30, 16],
]
CORRIDOR = [[0, 0, 0, 30, 30, 1], [0, 0, 29, 30, 30, 30], [0, 0, 1, 30, 1, 29], [0, 29, 1, 30, 30, 29]]


@pytest.mark.every(2)
@pytest.mark.parametrize("seed", range(6))
def test_in_random_worlds_plans_keep_the_radius_and_the_limits(seed):
    boxes = random_boxes(seed)
    config = PlanConfig(
        beyond_map_m=3.0,
        start=(-0.5, -0.5, -0.5),
        goal=(3.5, 3.5, 3.5),
        radius_m=0.2,
        speed_m_s=1.5,
        acceleration_m_s2=2.0,
    )
    result = plan(config, boxes_cover(boxes))
    time, c = result["time"], result["coefficient"]
    t = np.linspace(0, time[-1], 20001)
    points = evaluate(time, c, t)[:, :3]
    np.testing.assert_allclose(points[0], config.start, atol=1e-12)
    np.testing.assert_allclose(points[-1], config.goal, atol=1e-9)
    assert box_distance(points, boxes).min() >= 0.2
    assert np.linalg.norm(evaluate(time, c, t, 1)[:, :3], axis=1).max() <= 1.5
    assert np.linalg.norm(evaluate(time, c, t, 2)[:, :3], axis=1).max() <= 2.0
    summary, certificate = result.manifest.summary, result.manifest.certificate
    assert summary["min_clearance_m"] == pytest.approx(box_distance(points, boxes).min(), abs=1e-3)
    assert 0.2 <= certificate["min_proven_clearance_m"] <= max(summary["min_clearance_m"], 0.4)
    assert summary["length_m"] >= summary["straight_m"] == pytest.approx(4 * math.sqrt(3))
    assert certify_curve(
        result["time"], result["coefficient"], hull_obstacles(Hulls.from_cover(boxes_cover(boxes))), 0.2
    ).holds
    waypoints = result["waypoint"]
    np.testing.assert_allclose(evaluate(time, c, time), waypoints, atol=1e-9)
    for order in (1, 2, 3):
        before = evaluate(time, c, time[1:-1] - 1e-9, order)
        after = evaluate(time, c, time[1:-1] + 1e-9, order)
        np.testing.assert_allclose(before, after, atol=1e-4)


def test_a_plan_goes_through_a_hole_and_through_points_on_the_way():
    config = PlanConfig(
        beyond_map_m=3.0,
        start=(0.2, 0.3, 0.3),
        goal=(2.5, 0.3, 0.3),
        radius_m=0.15,
        bounds=(0, 0, 0, 3, 3, 3),
    )
    boxes = WALL_WITH_HOLE
    result = plan(config, boxes_cover(boxes))
    points = evaluate(result["time"], result["coefficient"], np.linspace(0, result["time"][-1], 5000))[:, :3]
    assert box_distance(points, boxes).min() >= 0.15
    assert (points >= -1e-9).all()
    assert (points <= 3 + 1e-9).all()
    inside = points[(points[:, 0] > 1.0) & (points[:, 0] < 1.2)]
    assert (inside[:, 1] > 1.1).all()
    assert (inside[:, 1] < 1.9).all()
    via = ((2.2, 2.6, 2.6), (0.5, 2.5, 0.5))
    config = PlanConfig(beyond_map_m=3.0, start=(0.2, 0.3, 0.3), goal=(2.5, 0.3, 0.3), via=via)
    result = plan(config, boxes_cover(boxes))
    waypoints = result["waypoint"][:, :3].tolist()
    assert waypoints.index(list(via[0])) < waypoints.index(list(via[1]))


@pytest.mark.parametrize("radius", [0.14998, 0.15 - 1.1e-6])
def test_a_narrow_corner_is_passed_without_a_stop(radius):
    """A duct 0.3 m wide, with 20 micrometres of room, or one."""
    boxes = [
        [0, 0, 0, 23, 20, 10],
        [0, 0, 13, 23, 20, 20],
        [0, 0, 10, 23, 10, 13],
        [0, 13, 10, 20, 20, 13],
        [23, 0, 0, 26, 20, 20],
        [-3, 0, 0, 0, 20, 20],
    ]
    config = PlanConfig(
        beyond_map_m=3.0,
        start=(0.2, 1.15, 1.15),
        goal=(2.15, 1.95, 1.15),
        radius_m=radius,
        resolution_m=0.05,
        speed_m_s=5.0,
    )
    result = plan(config, boxes_cover(boxes))
    points = evaluate(result["time"], result["coefficient"], np.linspace(0, result["time"][-1], 20000))[:, :3]
    assert box_distance(points, boxes).min() >= radius - 1e-12
    assert result.manifest.summary["min_clearance_m"] < 0.151
    assert result.manifest.summary["stops"] == 0
    assert verify_plan(result, cover=boxes_cover(boxes)).covered


@given(st.integers(0, 10**6), st.floats(0.02, 0.4))
@settings(deadline=None, max_examples=examples(60))
def test_the_certificate_agrees_with_dense_samples(seed, radius):
    """Random curves among boxes: never proven when a sample is too close, proven when none is by far."""
    rng = np.random.default_rng(seed)
    boxes = random_boxes(seed % 17, 6)
    waypoint = rng.uniform(-1, 4, (4, 3))
    duration = rng.uniform(0.5, 2, 3)
    time = np.concatenate([[0], np.cumsum(duration)])
    c = septic_spline(waypoint, duration)
    proof = certify_curve(time, c, hull_obstacles(Hulls.from_cover(boxes_cover(boxes))), radius)
    for k in range(3):
        t = np.linspace(time[k], np.nextafter(time[k + 1], 0), 2001)
        closest = box_distance(evaluate(time, c, t), boxes).min()
        if proof.proven[k]:
            assert closest >= radius
            assert closest >= proof.clearance_m[k] - 1e-12
        else:
            step = np.linalg.norm(np.diff(evaluate(time, c, t), axis=0), axis=1).max()
            assert closest < radius + step + 1e-6


def test_the_certificate_catches_a_curve_that_cuts_a_corner():
    boxes = [[0, 0, 0, 10, 10, 10]]
    hulls = Hulls.from_cover(boxes_cover(boxes))
    waypoint = np.array([[-0.3, 0.5, 0.5], [-0.3, 1.3, 0.5], [0.5, 1.3, 0.5]])
    for corner, proven in ((-0.3, True), (-0.05, False)):
        waypoint[1] = [corner, 1 - corner, 0.5]
        c = septic_spline(waypoint, [1.0, 1.0])
        samples = evaluate([0, 1, 2], c, np.linspace(0, 2, 1001))
        assert (box_distance(samples, boxes).min() >= 0.2) == proven
        assert certify_curve([0, 1, 2], c, hull_obstacles(hulls), 0.2).holds == proven


def test_near_an_edge_the_euclidean_distance_counts_not_the_planes():
    """At 0.15 m from an edge in the diagonal direction every plane of the box is only 0.106 m away."""
    boxes = [[0, 0, 0, 10, 10, 10]]
    away = 0.1501 / math.sqrt(2)
    c = septic_spline([[1 + away, 1 + away, 0.1], [1 + away, 1 + away, 0.9]], [1.0])
    obstacles = hull_obstacles(Hulls.from_cover(boxes_cover(boxes)))
    proof = certify_curve([0, 1], c, obstacles, 0.15)
    assert proof.holds
    assert proof.clearance_m[0] == pytest.approx(0.1501, abs=1e-9)
    assert not certify_curve([0, 1], c, obstacles, 0.1502).holds


@pytest.mark.parametrize(
    ("start", "goal", "message"),
    [
        ((0.5, 0.5, 0.5), (3, 3, 3), "the start .* is inside an obstacle, 0.5 m deep"),
        ((3, 3, 3), (0.5, 0.5, 1.1), "the goal .* is 0.1 m from an obstacle, and the plan must keep 0.25 m"),
        ((1.0, 0.5, 0.5), (3, 3, 3), "the start .* is 0 m from an obstacle, and the plan must keep 0.25 m"),
    ],
)
def test_points_in_obstacles_are_named_with_their_clearance(start, goal, message):
    with pytest.raises(InfeasibleError, match=message):
        plan(PlanConfig(beyond_map_m=3.0, start=start, goal=goal), boxes_cover([[0, 0, 0, 10, 10, 10]]))


def test_without_a_way_there_is_no_plan():
    box = (0, 0, 0, 3, 3, 3)
    wall = [[10, 0, 0, 12, 30, 30]]
    with pytest.raises(InfeasibleError, match="no path from --start to --goal"):
        plan(PlanConfig(beyond_map_m=3.0, start=(0.3, 1, 1), goal=(2.5, 1, 1), bounds=box), boxes_cover(wall))
    with pytest.raises(InfeasibleError, match="no path"):
        plan(
            PlanConfig(beyond_map_m=3.0, start=(0.3, 1, 1), goal=(2.5, 1, 1), bounds=box, radius_m=0.45),
            boxes_cover(WALL_WITH_HOLE),
        )
    around = plan(PlanConfig(beyond_map_m=3.0, start=(0.3, 1, 1), goal=(2.5, 1, 1)), boxes_cover(wall))
    assert around.manifest.summary["length_m"] > 3


def test_a_lattice_too_fine_is_refused_and_one_too_coarse_is_refined():
    cover = boxes_cover(CORRIDOR)
    with pytest.raises(UsageError, match="use a larger --resolution"):
        plan(PlanConfig(beyond_map_m=3.0, start=(1, 1, 1), goal=(2, 2, 2), resolution_m=0.001), cover)
    values = {"start": (0.3, 1, 1), "goal": (2.5, 1, 1), "radius_m": 0.3, "bounds": (0, 0, 0, 3, 3, 3)}
    for resolution in (
        0.9,
        None,
    ):  # where the lattice is too coarse, the search for the widest passage is not
        made = plan(
            PlanConfig(beyond_map_m=3.0, **values, resolution_m=resolution), boxes_cover(WALL_WITH_HOLE)
        )
        assert made.manifest.summary["min_clearance_m"] >= 0.3


def test_without_obstacles_a_plan_is_a_straight_line():
    result = plan(PlanConfig(beyond_map_m=3.0, start=(0, 0, 0), goal=(2, 0, 0), yaw="0.7"), boxes_cover([]))
    assert result.kind is PLAN
    assert result.manifest.summary["length_m"] == pytest.approx(2.0)
    assert result.manifest.summary["min_clearance_m"] is None
    np.testing.assert_allclose(
        evaluate(result["time"], result["coefficient"], 0.3)[1:], [0, 0, 0.7], atol=1e-4
    )


def test_threads_do_not_change_a_bit():
    cover = boxes_cover(random_boxes(3, 20))
    config = PlanConfig(beyond_map_m=3.0, start=(-0.5, -0.5, -0.5), goal=(3.5, 3.5, 3.5))
    one, four = plan(config, cover, jobs=1), plan(config, cover, jobs=4)
    assert one.manifest == four.manifest
    assert all((one[name] == four[name]).all() for name in one.arrays)


@pytest.mark.parametrize("seed", range(4))
def test_the_polyline_is_clear_and_hardly_longer_than_the_shortest(seed):
    boxes = random_boxes(seed, 10)
    hulls = Hulls.from_cover(boxes_cover(boxes))
    config = PlanConfig(beyond_map_m=3.0, start=(-0.5, -0.5, -0.5), goal=(3.5, 3.5, 3.5), radius_m=0.1)
    path = find_polyline(config, plan_space(config, boxes_cover(boxes)))
    assert clearance_to_hulls(path.point, hulls).min() >= 0.1
    length = np.linalg.norm(np.diff(path.point, axis=0), axis=1).sum()
    assert length <= 1.25 * 4 * math.sqrt(3)


def test_the_search_finds_the_shortest_lattice_path():
    """Against Dijkstra's algorithm of scipy on the same lattice with the same rule for edges."""
    from itertools import product

    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    from alula.stages.clearance import segment_clearance

    boxes, radius, spacing, count = [[5, -5, -5, 7, 12, 12], [10, 4, -5, 12, 25, 25]], 0.1, 0.2, (10, 9, 8)
    obstacles = hull_obstacles(Hulls.from_cover(boxes_cover(boxes)))
    index = np.array(list(product(*map(range, count))))
    steps = np.array([d for d in product((-1, 0, 1), repeat=3) if d > (0, 0, 0)])
    source = np.repeat(np.arange(len(index)), len(steps))
    target = np.repeat(index, len(steps), axis=0) + np.tile(steps, (len(index), 1))
    inside = ((target >= 0) & (target < count)).all(axis=1)
    source, target = source[inside], target[inside] @ [count[1] * count[2], count[2], 1]
    a, b = spacing * index[source], spacing * index[target]
    free = segment_clearance(a, b, obstacles) >= radius
    length = np.linalg.norm(a - b, axis=1)[free]
    graph = coo_array((length, (source[free], target[free])), shape=(len(index), len(index)))
    end = len(index) - 1
    expected = dijkstra(graph, directed=False, indices=0)[end]
    start, goal = (0.0, 0.0, 0.0), tuple(spacing * index[end])
    status, path, expanded = find_path(
        HullMap(obstacles), (0, 0, 0), spacing, count, start, goal, radius, 0.0
    )
    assert status == SearchStatus.found
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() <= expected + 1e-9
    assert clearance_to_hulls(path, Hulls.from_cover(boxes_cover(boxes))).min() >= radius
    # The joints to start and goal may be longer than a step of the lattice, so it can only be shorter.
    assert np.linalg.norm(np.diff(path, axis=0), axis=1).sum() >= expected - 4 * spacing
    assert 0 < expanded <= len(index)


@pytest.mark.parametrize(
    "values",
    [
        {"radius_m": 0.0},
        {"speed_m_s": -1.0},
        {"acceleration_m_s2": 0.0},
        {"resolution_m": 0.0},
        {"yaw": "90"},
        {"via": ((0.0, 0.0, 0.0),)},
        {"bounds": (1.0, 0.0, 0.0, 0.0, 1.0, 1.0)},
        {"bounds": (0.5, 0.5, 0.5, 2.0, 2.0, 2.0)},
    ],
)
def test_configurations_that_mean_nothing_are_refused(values):
    with pytest.raises(UsageError):
        PlanConfig(beyond_map_m=3.0, start=(0.0, 0.0, 0.0), goal=(1.0, 1.0, 1.0), **values)


def test_a_certificate_needs_a_radius():
    empty: Artifact = boxes_cover([])
    with pytest.raises(InputError, match="radius"):
        certify_curve([0, 1], np.zeros((1, 3, 8)), hull_obstacles(Hulls.from_cover(empty)), 0.0)


def constant(position, end=1.0):
    """A plan's arrays that rest at one point for one piece."""
    coefficient = np.zeros((1, 4, 8))
    coefficient[0, :3, 0] = position
    return np.array([0.0, end]), coefficient


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning", "ignore:overflow:RuntimeWarning")
@pytest.mark.parametrize("end", [1e45, 1e50])
def test_a_curve_without_finite_bounds_is_not_proven(end):
    """0 times an overflown power of time is no number, and compares as lying nowhere."""
    obstacles = hull_obstacles(Hulls.from_cover(boxes_cover([[0, 0, 0, 4, 4, 4]])))
    assert not certify_curve(*constant([0.2, 0.2, 0.2]), obstacles, 0.1).holds
    with pytest.raises(InputError, match="no finite bounds"):
        certify_curve(*constant([0.2, 0.2, 0.2], end), obstacles, 0.1)


def test_a_jump_over_a_wall_is_not_proven():
    obstacles = hull_obstacles(Hulls.from_cover(boxes_cover([[10, 0, 0, 12, 30, 30]])))
    coefficient = np.concatenate([constant([x, 1.5, 1.5])[1] for x in (0.5, 2.0)])
    found = certify_curve([0.0, 1.0, 2.0], coefficient, obstacles, 0.1)
    assert found.proven.tolist() == [False, True]
    coefficient[1, 0, 0] = 0.5 + 1e-9
    assert certify_curve([0.0, 1.0, 2.0], coefficient, obstacles, 0.1).holds


@pytest.mark.parametrize("spoil", ["vertex", "plane_offset", "plane_normal"])
def test_a_cover_whose_planes_and_vertices_disagree_is_not_planned_in(spoil):
    cover = boxes_cover(WALL_WITH_HOLE)
    array = cover[spoil].copy()
    array[5] += 3
    bad = dataclasses.replace(cover, arrays={**cover.arrays, spoil: array})
    with pytest.raises(ArtifactError, match=r"the cover is not sound: .*hull 0"):
        plan(PlanConfig(beyond_map_m=3.0, start=(0.5, 1.5, 1.5), goal=(2.5, 1.5, 1.5)), bad)


def test_a_plan_begins_in_motion_and_a_motion_that_leads_out_of_the_path_is_refused_in_words():
    config = PlanConfig(
        beyond_map_m=3.0,
        start=(0.2, 0.3, 0.3),
        goal=(2.5, 0.3, 0.3),
        radius_m=0.15,
        bounds=(0, 0, 0, 3, 3, 3),
        speed_m_s=2.0,
    )
    cover = boxes_cover(WALL_WITH_HOLE)
    still = np.zeros(3)
    result = plan(config, cover, motion=MovingState(np.array([0.0, 0.6, 0.3]), still, still))
    assert verify_plan(result, cover=cover).covered
    time, c = result["time"], result["coefficient"]
    np.testing.assert_allclose(evaluate(time, c, 0.0, 1)[:3], [0, 0.6, 0.3], atol=1e-9)
    assert time[-1] < plan(config, cover)["time"][-1]
    with pytest.raises(InfeasibleError, match="no curve leads from this motion along the path"):
        plan(config, cover, motion=MovingState(np.array([-1.9, 0, 0]), still, still))


def test_a_plan_records_the_limits_of_its_vehicle():
    config = PlanConfig(
        beyond_map_m=3.0, start=(0, 0, 0), goal=(2, 0, 0), radius_m=0.2, acceleration_m_s2=2.0
    )
    made = plan(config, boxes_cover([]))
    assert made.manifest.version == "1.2"
    assert made.manifest.vehicle == "fastbridge"
    assert made.manifest.limits == motion_limits(config, FASTBRIDGE).record()
    assert made.manifest.limits["tilt_rad"] == pytest.approx(math.asin(2.0 / 9.81))
