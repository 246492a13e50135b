"""Corridors: no point of a cell is nearer to an obstacle than the radius; the check accepts nothing else."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import HalfspaceIntersection

from alula._core import EllipsoidSet, check_cells, corridor_cells
from alula.stages.clearance import hull_obstacles, path_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.planning.corridor import Kept, divided, find_corridor
from support.effort import examples
from support.models.chains import box_chain
from support.scenes.covers import box_distance, boxes_cover, random_boxes

RADIUS = 0.2
LOWER, UPPER = (-1.0, -1.0, -1.0), (4.0, 4.0, 4.0)


def hulls_of(boxes):
    return hull_obstacles(Hulls.from_cover(boxes_cover(boxes)))


def random_ellipsoids(rng, count=30):
    quat = rng.normal(size=(count, 4))
    return EllipsoidSet(
        mean=rng.uniform(0, 3, (count, 3)).astype(np.float32),
        scale=np.exp(rng.uniform(-4, -1, (count, 3))).astype(np.float32),
        quat_wxyz=(quat / np.linalg.norm(quat, axis=1)[:, None]).astype(np.float32),
        k=2.0,
    )


def free_segments(rng, obstacles, count=6):
    segments = []
    while len(segments) < count:
        a = rng.uniform(-0.8, 3.8, 3)
        b = np.clip(a + rng.normal(scale=0.4, size=3), -0.9, 3.9)
        if all(path_clearance([a, b], each).min() >= RADIUS + 1e-9 for each in obstacles):
            segments.append((a, b))
    return [np.ascontiguousarray(side) for side in np.array(segments).transpose(1, 0, 2)]


def cell_vertices(normal, offset, inside):
    rows = np.column_stack([normal, -offset])
    return HalfspaceIntersection(rows, inside).intersections


@given(st.integers(0, 10**6))
@settings(deadline=None, max_examples=examples(25))
def test_the_vertices_of_cells_keep_the_radius_and_segments_are_in_their_cells(seed):
    rng = np.random.default_rng(seed)
    boxes = random_boxes(seed % 17, 8)
    hulls, ellipsoids = hulls_of(boxes), random_ellipsoids(rng)
    begin, end = free_segments(rng, [hulls, ellipsoids])
    normal, offset, start, free = corridor_cells([hulls], [ellipsoids], begin, end, RADIUS, 1.0, LOWER, UPPER)
    assert free.all()
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1, atol=1e-15)
    proven, clearance, _ = check_cells([hulls], [ellipsoids], normal, offset, start, RADIUS)
    assert proven.all()
    assert (clearance >= RADIUS).all()
    for i in range(len(begin)):
        rows = slice(start[i], start[i + 1])
        a, b = normal[rows], offset[rows]
        assert (np.stack([begin[i], end[i]]) @ a.T <= b + 1e-9).all()
        # The point of a cell that is nearest to an obstacle need not be a vertex.
        middle = 0.5 * (begin[i] + end[i])
        has_room = (b - a @ middle).min() > 1e-6
        corners = cell_vertices(a, b - 1e-9, middle) if has_room else np.stack([begin[i], end[i]])
        points = np.concatenate([corners, rng.dirichlet(np.full(len(corners), 0.3), 300) @ corners])
        assert box_distance(points, boxes).min() >= RADIUS - 1e-8
        assert ellipsoids.clearance(points, points, 1.0).min() >= RADIUS - 1e-8
        assert (points >= np.array(LOWER) - 1e-8).all()
        assert (points <= np.array(UPPER) + 1e-8).all()


@pytest.mark.parametrize("seed", range(5))
def test_in_exact_arithmetic_a_row_of_the_cell_separates_every_hull_by_the_radius(seed):
    rng = np.random.default_rng(seed)
    boxes = random_boxes(seed)
    hulls = hulls_of(boxes)
    begin, end = free_segments(rng, [hulls], 4)
    normal, offset, start, _ = corridor_cells([hulls], [], begin, end, RADIUS, 1.0, LOWER, UPPER)
    corners = Hulls.from_cover(boxes_cover(boxes))
    radius2 = Fraction(RADIUS) ** 2
    for i in range(len(begin)):
        for k in range(len(boxes)):
            vertices = corners.vertices_world[corners.vertex_start[k] : corners.vertex_start[k + 1]]
            assert any(
                separates(normal[row], offset[row], vertices, radius2)
                for row in range(start[i], start[i + 1])
            )


def separates(normal, offset, vertices, radius2):
    """Exactly: min n . v - offset >= radius |n|."""
    n = [Fraction(x) for x in normal.tolist()]
    least = min(sum(a * Fraction(x) for a, x in zip(n, v, strict=True)) for v in vertices.tolist())
    gap = least - Fraction(float(offset))
    return gap > 0 and gap * gap >= radius2 * sum(a * a for a in n)


@pytest.mark.parametrize("kind", ["hulls", "ellipsoids"])
def test_a_cell_that_is_too_near_by_a_nanometre_is_not_proven(kind):
    rng = np.random.default_rng(3)
    hulls, ellipsoids = hulls_of(random_boxes(3)), random_ellipsoids(rng)
    sets = ([hulls], []) if kind == "hulls" else ([], [ellipsoids])
    begin, end = free_segments(rng, sets[0] + sets[1])
    normal, offset, start, _ = corridor_cells(*sets, begin, end, RADIUS, 1.0, LOWER, UPPER)
    assert check_cells(*sets, normal, offset, start, RADIUS)[0].all()
    refused = 0
    for i in range(len(begin)):
        for row in range(start[i] + 6, start[i + 1]):  # planes that obstacles made
            moved = offset.copy()
            moved[row] += 1e-9
            proven = check_cells(*sets, normal, moved, start, RADIUS)[0]
            assert np.delete(proven, i).all()
            refused += not proven[i]
    assert refused >= 0.5 * (start[-1] - 6 * len(begin)) > 0  # others do not touch what made them


def test_a_segment_that_is_too_near_is_reported_and_an_unbounded_or_empty_cell_is_not_proven():
    hulls = hulls_of([[10, 10, 10, 20, 20, 20]])
    near = np.array([[0.9, 1.5, 1.5]]), np.array([[0.9, 1.6, 1.6]])
    assert corridor_cells([hulls], [], *near, RADIUS, 1.0, LOWER, UPPER)[3].tolist() == [0]
    one = np.array([[1.0, 0, 0]]), np.array([0.0]), np.array([0, 1])
    assert check_cells([hulls], [], *one, RADIUS)[0].tolist() == [0]
    faces = np.concatenate([np.eye(3), -np.eye(3)])
    empty = faces, np.array([0, 1, 1, -1, 1, 1.0]), np.array([0, 6])
    assert check_cells([hulls], [], *empty, RADIUS)[0].tolist() == [0]
    box = faces, np.array([0.79, 3, 3, 0, 0, 0.0]), np.array([0, 6])
    proven, clearance, pairs = check_cells([hulls], [], *box, RADIUS)
    assert proven.tolist() == [1]
    assert clearance[0] == pytest.approx(0.21, abs=1e-12)
    assert pairs == 1


def test_cells_of_a_path_meet_at_inner_points_and_keep_its_points_to_pass():
    boxes = [[10, 0, 0, 12, 14, 30], [18, 6, 0, 20, 30, 30]]
    hulls = hulls_of(boxes)
    corners = np.array(
        [[0.3, 0.3, 1.5], [0.4, 1.0, 1.5], [0.6, 1.7, 1.5], [1.4, 1.7, 1.5], [1.5, 0.2, 1.5], [2.6, 0.2, 1.5]]
    )
    via = np.array([False, False, True, False, False, False])
    corridor = find_corridor(corners, via, [Kept(hulls)], RADIUS, (np.array(LOWER), np.array(UPPER)))
    assert corridor.is_free.all()
    assert corridor.is_open.all()
    assert len(corridor.point) < len(corners)  # the second point is passed by
    assert corridor.joint[corridor.is_via].tolist() == [corners[2].tolist()]
    for i, joint in enumerate(corridor.joint):
        for cell in (i, i + 1):
            normal, offset = corridor.rows(cell)
            assert (normal @ joint < offset - 1e-3).all()


def test_where_a_path_has_no_room_its_joint_is_closed():
    """A duct of the ball's own width."""
    boxes = [[0, 0, 0, 30, 5, 30], [0, 9, 0, 30, 14, 30]]
    corners = np.array([[0.3, 0.7, 0.5], [1.5, 0.7, 1.5], [2.5, 0.7, 0.5]])
    corridor = find_corridor(
        corners, [False, True, False], [Kept(hulls_of(boxes))], 0.2 - 1e-9, (np.array(LOWER), np.array(UPPER))
    )
    assert corridor.is_open.tolist() == [False]
    np.testing.assert_array_equal(corridor.joint[0], corners[1])


@pytest.mark.parametrize("seed", range(4))
def test_parts_of_a_divided_cell_lie_in_it_and_share_inner_joints(seed):
    whole = box_chain(seed, 4, via=seed % 2 == 1)
    parts, part = divided(whole, [1, 3], 0.3)
    length = np.linalg.norm(np.diff(parts.point, axis=0), axis=1)
    assert sorted(set(part)) == [0, 1, 2, 3]
    assert list(part).count(0) == list(part).count(2) == 1
    assert length[np.isin(part, [1, 3])].max() <= 0.3 + 1e-12
    for i, old in enumerate(part):
        normal, offset = parts.rows(i)
        given_normal, given_offset = whole.rows(old)
        np.testing.assert_array_equal(normal[: len(given_normal)], given_normal)
        np.testing.assert_array_equal(offset[: len(given_offset)], given_offset)
        along = (parts.point[i + 1] - parts.point[i]) / length[i]
        at = np.array([parts.point[i], parts.point[i + 1]])
        assert (at @ normal.T <= offset).all()
        beyond = parts.point[i + 1] + 0.03 * along
        assert (beyond @ normal.T <= offset).all() == (i + 1 == len(part) or part[i + 1] != old)
    for i, joint in enumerate(parts.joint):
        for side in (i, i + 1):
            normal, offset = parts.rows(side)
            assert (joint @ normal.T < offset).all()
    kept = [i for i in range(len(part) - 1) if part[i] != part[i + 1]]
    np.testing.assert_array_equal(parts.joint[kept], whole.joint)
    np.testing.assert_array_equal(parts.is_via[kept], whole.is_via)
    assert parts.is_via.sum() == whole.is_via.sum()
