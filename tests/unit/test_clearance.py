"""The exact clearance and the path metrics against independent references."""

import math

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog, minimize_scalar
from scipy.spatial import ConvexHull

from alula.schemas.artifacts.artifact import make_artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.errors import InputError
from alula.stages.clearance import (
    hull_obstacles,
    is_collision,
    path_clearance,
    path_metrics,
    scene_obstacles,
    segment_clearance,
    sphere_clearance,
)
from alula.stages.compression.hulls import Hulls
from support.effort import examples
from support.models.clearances import clearance_to_hulls, clearance_to_scene

QP_TOLERANCE = 2e-7  # of the interior-point solver, in metres, at distances of the order of one

NO_HULLS = Hulls(
    np.empty((0, 3)), np.empty(0), np.zeros(1, np.int64), np.empty((0, 3)), np.zeros(1, np.int64)
)


def hulls_of(clouds):
    normals, offsets, vertices, plane_start, vertex_start = [], [], [], [0], [0]
    for cloud in clouds:
        hull = ConvexHull(cloud)
        normal = np.unique(np.round(hull.equations[:, :3], 13), axis=0)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        corner = cloud[hull.vertices]
        normals.append(normal)
        offsets.append((normal @ corner.T).max(axis=1))
        vertices.append(corner)
        plane_start.append(plane_start[-1] + len(normal))
        vertex_start.append(vertex_start[-1] + len(corner))
    return Hulls(
        np.vstack(normals),
        np.concatenate(offsets),
        np.array(plane_start, np.int64),
        np.vstack(vertices),
        np.array(vertex_start, np.int64),
    )


def box(lower, upper):
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    return np.array([np.where([i & 1, i & 2, i & 4], upper, lower) for i in range(8)])


def scene_of(mean, scale, quat_wxyz):
    n = len(mean)
    quat_wxyz = np.asarray(quat_wxyz, float)
    return make_artifact(
        SCENE,
        {
            "mean": mean,
            "scale": scale,
            "quat_wxyz": quat_wxyz / np.linalg.norm(quat_wxyz, axis=1)[:, None],
            "opacity": np.ones(n),
            "color": np.zeros((n, 3)),
        },
        frame="world",
        unit="m",
        parameters={},
        summary={},
        source={},
    )


def rotation(q):
    w, x, y, z = q / np.linalg.norm(q)
    v = np.array([x, y, z])
    hat = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return (w * w - v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * w * hat


@pytest.mark.parametrize("seed", range(12))
def test_segments_outside_a_polytope_agree_with_a_quadratic_program(seed):
    rng = np.random.default_rng(seed)
    hulls = hulls_of([rng.normal(size=(12, 3))])
    a, b = rng.normal(size=(2, 3)) * 1.5 + rng.normal(size=3) * 3
    x, t = cp.Variable(3), cp.Variable()
    problem = cp.Problem(
        cp.Minimize(cp.sum_squares(x - a - t * (b - a))),
        [hulls.normal_world @ x <= hulls.offset_m, t >= 0, t <= 1],
    )
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-13, tol_gap_rel=1e-13, tol_feas=1e-13)
    expected = math.sqrt(max(problem.value, 0.0))
    found = clearance_to_hulls(np.array([a, b]), hulls)
    if expected > 1e-3:
        assert found == pytest.approx([expected], abs=QP_TOLERANCE)
    else:
        assert found[0] <= 1e-3


@pytest.mark.parametrize("seed", range(20))
def test_segments_into_a_polytope_report_their_deepest_penetration(seed):
    rng = np.random.default_rng(seed)
    hulls = hulls_of([rng.normal(size=(20, 3))])
    inside = rng.dirichlet(np.ones(len(hulls.vertices_world))) @ hulls.vertices_world
    a, b = inside + rng.normal(size=3), inside - rng.normal(size=3) * rng.uniform(0, 1)
    slope = hulls.normal_world @ (b - a)
    value = hulls.normal_world @ a - hulls.offset_m
    # min s over (t, s) with value + t slope <= s
    lp = linprog(
        [0, 1], np.column_stack([slope, -np.ones_like(slope)]), -value, bounds=[(0, 1), (None, None)]
    )
    found = clearance_to_hulls(np.array([a, b]), hulls)[0]
    if lp.fun <= 0:
        assert found == pytest.approx(lp.fun, abs=1e-9)
    else:
        assert found > 0


def test_closed_forms_for_a_box():
    hulls = hulls_of([box([0, 0, 0], [2, 1, 1])])

    def between(a, b):
        return clearance_to_hulls(np.array([a, b], float), hulls)[0]

    assert between([-1, 0.5, 0.5], [-3, 0.5, 0.5]) == 1.0  # a face
    assert between([-1, 2, 0.5], [-1, 2, 0.7]) == pytest.approx(math.sqrt(2), abs=1e-15)  # an edge
    assert between([3, 2, 2], [4, 3, 3]) == pytest.approx(math.sqrt(3), abs=1e-15)  # a vertex
    assert between([-5, 0.5, 3], [5, 0.5, 3]) == 2.0  # parallel to a face, beyond both ends
    assert between([-5, 2, 2], [5, 2, 2]) == pytest.approx(math.sqrt(2), abs=1e-15)  # parallel to an edge
    assert between([0.5, 0.5, 2], [1.5, 0.5, 2]) == 1.0
    assert between([-1, 1, 0.5], [3, 1, 0.5]) == 0.0  # slides along a face
    assert between([-1, 0.5, 0.5], [0, 0.5, 0.5]) == 0.0  # touches with its end
    assert between([-1, -1, 0.5], [1, -1, 0.5]) == 1.0
    assert between([-1, 0.5, 0.5], [3, 0.5, 0.5]) == -0.5  # through the middle
    assert between([0.1, 0.5, 0.5], [0.3, 0.5, 0.5]) == pytest.approx(-0.3, abs=1e-15)  # inside
    assert between([1, 0.5, 0.5], [1, 0.5, 0.5]) == -0.5
    assert between([1e6, 0.5, 0.5], [1e6 + 1, 0.5, 0.5]) == 1e6 - 2


@pytest.mark.parametrize("width", [2, 100_000])
def test_beside_a_corner_no_clearance_exceeds_the_distance_to_it(width):
    """Long or large hulls almost in contact, where the closest points are found least well."""
    rng = np.random.default_rng(width)
    most = 0.0
    for _ in range(200):
        cloud = np.column_stack([rng.integers(0, 100_000, 12), rng.integers(0, width, (12, 2))]) * 0.05
        hulls = hulls_of([cloud])
        corner = hulls.vertices_world[rng.integers(len(hulls.vertices_world))]
        a = corner + rng.standard_normal(3) * 10.0 ** rng.uniform(-11, -3)
        b = a + rng.standard_normal(3) * 10.0 ** rng.uniform(-11, -3)
        found = clearance_to_hulls(np.array([a, b]), hulls)[0]
        most = max(most, found - min(np.linalg.norm(a - corner), np.linalg.norm(b - corner)))
    assert most <= 1e-11  # a few roundings of 5 km


@given(st.integers(0, 2**32 - 1), st.floats(-9, -3))
@settings(deadline=None, max_examples=examples(60))
def test_close_to_contact_the_sign_is_right_and_the_distance_accurate(seed, exponent):
    rng = np.random.default_rng(seed)
    cloud = rng.integers(0, 5, (14, 3)) * 0.05
    if np.linalg.matrix_rank(cloud - cloud[0]) < 3:
        return
    hulls = hulls_of([cloud])
    facet = rng.integers(len(hulls.offset_m))
    on = np.abs(hulls.vertices_world @ hulls.normal_world[facet] - hulls.offset_m[facet]) < 1e-12
    contact = rng.dirichlet(np.ones(on.sum())) @ hulls.vertices_world[on]
    gap = 10.0**exponent
    a = contact + gap * hulls.normal_world[facet]
    b = a + hulls.normal_world[facet] * rng.uniform(0, 1)
    assert clearance_to_hulls(np.array([a, b]), hulls)[0] == pytest.approx(gap, abs=1e-12)


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=examples(60))
def test_lattice_hulls_and_lattice_segments_are_never_below_dense_samples(seed):
    """Degenerate on purpose: parallel faces, shared coordinates, segments of length zero."""
    rng = np.random.default_rng(seed)
    cloud = rng.integers(0, 4, (10, 3)) * 0.25
    if np.linalg.matrix_rank(cloud - cloud[0]) < 3:
        return
    hulls = hulls_of([cloud])
    a, b = rng.integers(-6, 10, (2, 3)) * 0.25
    samples = a + np.linspace(0, 1, 201)[:, None] * (b - a)
    obstacles = hull_obstacles(hulls)
    exact = path_clearance(np.array([a, b]), obstacles)[0]
    sampled = segment_clearance(samples, samples, obstacles).min()
    spacing = np.linalg.norm(b - a) / 200
    assert exact <= sampled + 1e-12
    assert exact >= sampled - spacing / 2 - 1e-12


def ellipsoid_reference(z, e):
    """Distance to an ellipsoid by bisection of the secular equation in Python's floats, outside only."""
    low, high = 0.0, max(e) * np.linalg.norm(z) + 1.0
    for _ in range(2000):
        middle = (low + high) / 2
        if sum((ei * zi / (middle + ei * ei)) ** 2 for ei, zi in zip(e, z, strict=True)) > 1:
            low = middle
        else:
            high = middle
        if high - low < 1e-17 * high:
            break
    return math.sqrt(sum((zi * high / (high + ei * ei)) ** 2 for ei, zi in zip(e, z, strict=True)))


@pytest.mark.every(3)
@pytest.mark.parametrize("flat", [0.3, 1e-3, 1e-6, 1e-9])
def test_points_outside_an_ellipsoid_agree_with_bisection(flat):
    rng = np.random.default_rng(7)
    for _ in range(50):
        mean, q = rng.normal(size=3).astype(np.float32), rng.normal(size=4).astype(np.float32)
        scale = np.array([flat, *rng.uniform(0.01, 1, 2)], np.float32)
        scene = scene_of(mean[None], scale[None], q[None])
        point = mean + rng.normal(size=3) * rng.choice([0.5, 2, 50])
        q_used = scene["quat_wxyz"][0].astype(float)
        z = rotation(q_used).T @ (point - mean.astype(float))
        e = 2.0 * scale.astype(float)
        found = clearance_to_scene(point[None], scene, 2.0)[0]
        if ((z / e) ** 2).sum() > 1:
            assert found == pytest.approx(ellipsoid_reference(z, e), rel=1e-11, abs=1e-13)
        else:
            assert found <= 0


@pytest.mark.parametrize("flat", [0.3, 1e-4, 1e-9])
def test_points_inside_an_ellipsoid_report_minus_the_distance_to_its_surface(flat):
    """The surface is parametrised densely; no surface point may be closer, one must be nearly as close."""
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(40000, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    e = np.array([np.float32(flat), np.float32(0.5), np.float32(0.7)], float)
    scene = scene_of(np.zeros((1, 3)), e[None], [[1, 0, 0, 0]])
    inner = rng.normal(size=(20, 3))
    inner *= (rng.uniform(0, 1, 20) / np.linalg.norm(inner, axis=1))[:, None]
    for unit in (
        *inner,
        np.zeros(3),
        np.array([0, 0.5, 0]),
        np.array([0, 0, 0.999]),
        np.array([0, 0.3, 0.3]),
    ):
        z = unit * e
        found = clearance_to_scene(z[None], scene, 1.0)[0]
        # Along the flat axis the surface is at e0 sqrt(1 - ...), an upper bound on the distance.
        upper = min(
            np.linalg.norm(direction * e - z, axis=1).min(),
            abs(e[0] * math.sqrt(max(0.0, 1 - unit[1] ** 2 - unit[2] ** 2)) - abs(z[0])),
        )
        assert found <= 0
        assert -found <= upper * (1 + 1e-9) + 1e-18
        assert -found >= 0.5 * upper - 1e-18 if flat < 0.01 else -found >= upper - 0.02


def test_the_ball_and_the_cases_without_a_unique_closest_point():
    ball = scene_of([[1, 2, 3]], [[0.5, 0.5, 0.5]], [[1, 0, 0, 0]])
    assert clearance_to_scene([[1, 2, 3]], ball, 2.0)[0] == pytest.approx(-1.0, abs=1e-15)
    assert clearance_to_scene([[1, 2, 3.25]], ball, 2.0)[0] == pytest.approx(-0.75, abs=1e-15)
    assert clearance_to_scene([[1, 2, 4]], ball, 2.0)[0] == pytest.approx(0.0, abs=1e-15)
    assert clearance_to_scene([[-9, 2, 3], [11, 2, 3]], ball, 2.0)[0] == pytest.approx(-1.0, abs=1e-14)
    assert clearance_to_scene([[-9, 4, 3], [11, 4, 3]], ball, 2.0)[0] == pytest.approx(1.0, abs=1e-14)
    disc = scene_of([[0, 0, 0]], [[1e-9, 1, 1]], [[1, 0, 0, 0]])
    assert clearance_to_scene([[0, 0, 0]], disc, 1.0)[0] == pytest.approx(-1e-9, rel=1e-6)
    assert clearance_to_scene([[0, 3, 0]], disc, 1.0)[0] == pytest.approx(2.0, abs=1e-15)
    assert clearance_to_scene([[0.25, 0, 0.5]], disc, 1.0)[0] == pytest.approx(0.25, abs=1e-8)
    assert clearance_to_scene([[-1, 0.2, 0.1], [1, 0.2, 0.1]], disc, 1.0)[0] < 0
    oblate = scene_of([[0, 0, 0]], [[0.25, 1, 1]], [[1, 0, 0, 0]])
    assert clearance_to_scene([[0, 0, 0], [0, 0.01, 0]], oblate, 1.0)[0] == pytest.approx(-0.25, abs=1e-15)


@pytest.mark.parametrize("seed", range(8))
def test_segments_and_ellipsoids_agree_with_scalar_minimisation(seed):
    rng = np.random.default_rng(seed)
    scale = rng.uniform(0.05, 1, (1, 3)) * rng.choice([1, 1e-3], (1, 3))
    scene = scene_of(rng.normal(size=(1, 3)), scale, rng.normal(size=(1, 4)))
    obstacles = scene_obstacles(scene, 1.0)
    a, b = rng.normal(size=(2, 3)) * 2

    def at(t):
        return float(path_clearance([a + t * (b - a)], obstacles)[0])

    best = minimize_scalar(at, bounds=(0, 1), method="bounded", options={"xatol": 1e-12})
    expected = min(best.fun, at(0), at(1))
    assert path_clearance([a, b], obstacles)[0] == pytest.approx(expected, abs=1e-9)


@pytest.mark.every(3)
@pytest.mark.parametrize("cap", [math.inf, 0.3, 0.0])
def test_culling_changes_nothing(cap):
    rng = np.random.default_rng(5)
    clouds = [rng.integers(0, 5, (12, 3)) * 0.1 + rng.uniform(0, 6, 3) for _ in range(60)]
    hulls = hulls_of(clouds)
    points = rng.uniform(-1, 7, (300, 3))
    every = np.min([clearance_to_hulls(points, hulls_of([cloud])) for cloud in clouds], axis=0)
    np.testing.assert_allclose(
        clearance_to_hulls(points, hulls, cap_m=cap), np.minimum(every, cap), rtol=0, atol=1e-13
    )
    n = 150
    mean, scale = rng.uniform(0, 6, (n, 3)), rng.uniform(0.001, 0.5, (n, 3))
    quat = rng.normal(size=(n, 4))
    scene = scene_of(mean, scale, quat)
    every = np.min(
        [
            clearance_to_scene(points, scene_of(mean[i : i + 1], scale[i : i + 1], quat[i : i + 1]), 1.5)
            for i in range(n)
        ],
        axis=0,
    )
    np.testing.assert_allclose(
        clearance_to_scene(points, scene, 1.5, cap_m=cap), np.minimum(every, cap), rtol=0, atol=1e-13
    )


def test_threads_and_guesses_do_not_change_a_bit():
    rng = np.random.default_rng(9)
    hulls = hulls_of([rng.integers(0, 5, (12, 3)) * 0.1 + rng.uniform(0, 6, 3) for _ in range(40)])
    obstacles = hull_obstacles(hulls)
    points = rng.uniform(0, 6, (2000, 3))
    one = path_clearance(points, obstacles, jobs=1)
    assert (path_clearance(points, obstacles, jobs=4) == one).all()
    alone = [path_clearance(points[i : i + 2], obstacles)[0] for i in range(0, 1999, 37)]
    assert (one[0:1999:37] == alone).all()


def test_shapes_and_empty_worlds():
    assert clearance_to_hulls([[0, 0, 0]], NO_HULLS).tolist() == [math.inf]
    assert clearance_to_hulls([[0, 0, 0], [1, 0, 0], [2, 0, 0]], NO_HULLS, cap_m=5).tolist() == [5, 5]
    assert len(clearance_to_hulls([[3, 0, 0]], hulls_of([box([0, 0, 0], [1, 1, 1])]))) == 1
    for bad in (np.empty((0, 3)), np.zeros((2, 2)), [[math.nan, 0, 0]]):
        with pytest.raises(InputError):
            clearance_to_hulls(bad, NO_HULLS)
    with pytest.raises(InputError, match="level"):
        scene_obstacles(scene_of([[0, 0, 0]], [[1, 1, 1]], [[1, 0, 0, 0]]), 0.0)


def test_path_metrics_of_a_cubic():
    dt, t = 0.01, np.arange(0, 1.005, 0.01)
    path = np.stack([t**3, 0 * t, 0 * t], axis=1)
    metrics = path_metrics(path, dt)
    assert metrics.length_m == pytest.approx(1.0)
    assert metrics.max_speed_m_s == pytest.approx(3.0, rel=0.02)
    assert metrics.mean_jerk_m_s3 == pytest.approx(6.0, rel=1e-6)
    assert metrics.max_jerk_m_s3 == pytest.approx(6.0, rel=1e-6)
    single = path_metrics([[1, 2, 3]], 0.1)
    assert (single.length_m, single.max_speed_m_s, single.max_jerk_m_s3) == (0, 0, 0)
    with pytest.raises(InputError):
        path_metrics(path, 0)
    for bad in (np.empty((0, 3)), np.zeros((2, 2)), np.zeros(3), [[0, 0, math.nan]]):
        with pytest.raises(InputError, match="shape"):
            path_metrics(bad, dt)


def test_the_clearance_of_a_sphere_is_that_of_its_path_less_the_radius():
    cube = hull_obstacles(hulls_of([box([0, 0, 0], [1, 1, 1])]))
    path = [[3, 0.5, 0.5], [1.5, 0.5, 0.5], [3, 0.5, 0.5]]
    assert sphere_clearance(path, cube, 0.2) == pytest.approx(0.3)
    assert sphere_clearance(path, hull_obstacles(NO_HULLS), 0.2) is None


@pytest.mark.parametrize("reach", [8.0, 3.0, 0.2])  # far from all, among them, and inside one
def test_the_clearance_of_a_sphere_is_that_of_every_segment_bit_by_bit(reach):
    rng = np.random.default_rng(7)
    clouds = [rng.uniform(0, 1, (12, 3)) + rng.uniform(-3, 3, 3) for _ in range(30)] + [
        rng.normal(size=(30, 3))
    ]
    mean, scale, quat = rng.uniform(-3, 3, (40, 3)), rng.uniform(0.01, 0.4, (40, 3)), rng.normal(size=(40, 4))
    scene = scene_obstacles(scene_of(mean, scale, quat), 1.5)
    for obstacles in (hull_obstacles(hulls_of(clouds)), scene):
        for _ in range(20):
            start = reach * rng.normal(size=3) / 2
            path = start + np.cumsum(rng.normal(scale=0.02, size=(int(rng.integers(1, 400)), 3)), axis=0)
            assert sphere_clearance(path, obstacles, 0.2) == path_clearance(path, obstacles).min() - 0.2


def test_a_touch_and_a_missing_obstacle_are_no_collision():
    assert not is_collision()
    assert not is_collision(None, 0.0, -1e-7)
    assert is_collision(None, 1.0, -2e-6)
