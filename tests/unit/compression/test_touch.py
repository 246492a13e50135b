"""Voxels that triangles, points and octrees touch: against other algorithms, and proven independently."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from alula import _core

EDGE = 0.25  # a power of two: corners of voxels are exact
AXES = np.eye(3, dtype=int)


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def exactly_touched(triangle, voxels):
    """Separating-axis test of closed sets in rational numbers."""
    corner = [[Fraction(c) for c in p] for p in triangle.tolist()]
    edge = [[b - a for a, b in zip(corner[i], corner[(i + 1) % 3], strict=True)] for i in range(3)]
    axes = [[Fraction(int(c)) for c in axis] for axis in AXES]
    axes += [cross(edge[0], edge[1])] + [cross(a, e) for a in axes for e in edge]
    side, found = Fraction(EDGE), []
    for v in voxels.tolist():
        apart = False
        for n in axes:
            shadow = [sum(a * c for a, c in zip(n, p, strict=True)) for p in corner]
            ends = [sorted((a * i * side, a * (i + 1) * side)) for a, i in zip(n, v, strict=True)]
            low, high = sum(e[0] for e in ends), sum(e[1] for e in ends)
            apart |= max(shadow) < low or min(shadow) > high
        if not apart:
            found.append(tuple(v))
    return set(found)


def distance(triangle, voxel):
    """Distance of a triangle and a cube: a bounded least-squares problem of scipy."""
    a, b, c = triangle
    lower = np.asarray(voxel) * EDGE
    matrix = np.vstack([np.column_stack([a, b, c, -EDGE * np.eye(3)]), [1e7, 1e7, 1e7, 0, 0, 0]])
    result = lsq_linear(matrix, np.append(lower, 1e7), bounds=(0, 1), tol=1e-15)
    weights = result.x[:3] / result.x[:3].sum()
    p = weights @ triangle
    return float(np.linalg.norm(p - np.clip(p, lower, lower + EDGE)))


def around(points, reach):
    low = np.floor((points.min(axis=0) - reach) / EDGE).astype(int) - 1
    high = np.floor((points.max(axis=0) + reach) / EDGE).astype(int) + 1
    return np.stack(np.meshgrid(*map(np.arange, low, high + 1), indexing="ij"), axis=-1).reshape(-1, 3)


def as_set(index):
    return set(map(tuple, index.tolist()))


def triangles(seed, count):
    """Random triangles, half of them with corners on the lattice: contacts of faces, edges and corners."""
    rng = np.random.default_rng(seed)
    free = rng.uniform(-0.7, 0.7, (count, 3, 3))
    on_lattice = rng.integers(-3, 4, (count, 3, 3)) * (EDGE / 2)
    return np.concatenate([free, on_lattice])


def test_a_voxel_is_marked_exactly_when_rational_numbers_find_no_separating_axis():
    for triangle in triangles(0, 1):
        index, count, below, most = _core.touched_by_triangles(triangle[None], 0.0, EDGE)
        assert as_set(index) == exactly_touched(triangle, around(triangle, 0))
        assert (count == 1).all()
        assert below == 0
        assert most == 1


@pytest.mark.parametrize("radius", [0.1, 0.6])
def test_a_thick_triangle_marks_what_is_within_the_radius_and_no_more(radius):
    for triangle in triangles(1, 1):
        marked = as_set(_core.touched_by_triangles(triangle[None], radius, EDGE)[0])
        for voxel in around(triangle, radius)[::23].tolist():
            apart = distance(triangle, voxel)
            if abs(apart - radius) > 1e-6:  # of the oracle
                assert (tuple(voxel) in marked) == (apart < radius)


@pytest.mark.parametrize("radius", [0.0, 0.1, 0.6])
def test_a_point_marks_what_a_triangle_without_size_does(radius):
    points = triangles(2, 10).reshape(-1, 3)
    for least in (1, 2):
        by_points = _core.touched_by_points(points, radius, EDGE, None, least)
        corners = np.repeat(points[:, None], 3, axis=1)
        by_triangles = _core.touched_by_triangles(corners, radius, EDGE, None, least)
        assert np.array_equal(by_points[0], by_triangles[0])
        assert np.array_equal(by_points[1], by_triangles[1])
        assert by_points[2:] == by_triangles[2:]
        assert _core.unproven_triangles(corners, radius, EDGE, None, least, by_points[0])[0] == 0


@pytest.mark.parametrize("radius", [0.0, 1e-6, 0.1, 0.6])
@pytest.mark.parametrize("crop", [None, (-0.3, -0.3, -0.3, 0.25, 0.5, 0.2)])
def test_the_proof_holds_and_finds_each_missing_voxel(radius, crop):
    corners = triangles(3, 20)
    index = _core.touched_by_triangles(corners, radius, EDGE, crop)[0]
    assert _core.unproven_triangles(corners, radius, EDGE, crop, 1, index)[0] == 0
    for row in range(0, len(index), 7):
        less = np.ascontiguousarray(np.delete(index, row, axis=0))
        total, voxel, triangle = _core.unproven_triangles(corners, radius, EDGE, crop, 1, less)
        assert total == 1
        assert voxel.tolist() == [index[row].tolist()]
        assert as_set(index[row : row + 1]) <= as_set(
            _core.touched_by_triangles(corners[triangle], radius, EDGE)[0]
        )


def test_voxels_do_not_depend_on_threads_and_long_triangles_are_cut():
    corners = 8 * triangles(4, 40)
    one, three = (_core.touched_by_triangles(corners, 0.01, EDGE, jobs=jobs) for jobs in (1, 3))
    assert np.array_equal(one[0], three[0])
    assert np.array_equal(one[1], three[1])
    assert _core.unproven_triangles(corners[:5], 0.0, EDGE, None, 1, one[0])[0] == 0


def box(low, high):
    import trimesh

    shape = trimesh.creation.box(bounds=[low, high])
    return np.ascontiguousarray(shape.triangles, np.float64)


def test_the_inside_is_filled_but_no_cavity_and_no_hollow():
    outer, inner = box([-1.1] * 3, [1.1] * 3), box([-0.6] * 3, [0.6] * 3)[:, ::-1]
    bowl = np.concatenate([outer, inner])
    for corners, lowest in ((outer, 0), (bowl, 3)):
        surface = _core.touched_by_triangles(corners, 0.0, EDGE)
        index, count, _, _ = _core.with_inside(surface[0], surface[1], np.ascontiguousarray(corners), EDGE)
        cells = around(np.array([[-1.1] * 3, [1.1] * 3]), 0)
        far = np.abs((cells + 0.5) * EDGE).max(axis=1) - EDGE / 2  # of the nearest point, along an axis
        reach = far + EDGE
        wanted = (far <= 1.1) & (reach >= 0.6 if lowest else np.ones(len(cells), bool))
        assert as_set(index) == as_set(cells[wanted])
        assert (count[np.isin(index, surface[0]).all(axis=1)] >= 0).all()
        assert _core.unproven_outside(np.ascontiguousarray(corners), EDGE, None, index)[0] == 0
        hollow = _core.unproven_outside(np.ascontiguousarray(corners), EDGE, None, surface[0])
        assert hollow[0] == len(index) - len(surface[0]) > 0


def test_a_surface_that_is_not_closed_has_no_inside():
    corners = box([-1.1] * 3, [1.1] * 3)
    index, count, _, _ = _core.touched_by_triangles(corners, 0.0, EDGE)
    with pytest.raises(ValueError, match="not closed"):
        _core.with_inside(index, count, corners[:-1], EDGE)


@pytest.mark.parametrize("radius", [-1.0, float("nan"), float("inf")])
def test_a_radius_out_of_range_is_refused(radius):
    with pytest.raises(ValueError, match="radius"):
        _core.touched_by_triangles(triangles(0, 1), radius, EDGE)


def test_coordinates_that_are_not_finite_are_refused():
    for number in (np.nan, np.inf):
        with pytest.raises(ValueError, match="finite"):
            _core.touched_by_points(np.full((1, 3), number), 0.0, EDGE)
