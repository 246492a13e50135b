"""The index of ellipsoids finds what measuring every one of them finds, and grows them outward."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from support.effort import examples
from support.models.splat_filter_model import outer_matrix, rotation, scene


def index_of(rows, sigma=1.0, radius=0.2, loss=None):
    return _core.EllipsoidIndex(*rows, sigma=sigma, radius=radius, loss=loss)


def distances(rows, points, sigma=1.0, loss=None, ends=None):
    """Of every point (or segment) to every ellipsoid, by the exact distances that plans are judged with."""
    columns = []
    for i in range(len(rows[0])):
        one = [np.ascontiguousarray(a[i : i + 1]) for a in rows]
        part = None if loss is None else np.ascontiguousarray(loss[i : i + 1])
        alone = _core.EllipsoidSet(*one, sigma, part)
        columns.append(alone.clearance(points, points if ends is None else ends, np.inf))
    return np.stack(columns, axis=1)


def in_order(distance, reach, count):
    near = np.flatnonzero(distance < reach)
    return near[np.lexsort((near, distance[near]))][:count]


@settings(max_examples=examples(60), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(1, 64),
    sigma=st.sampled_from([1.0, 3.37]),
    reach=st.sampled_from([0.3, 1.0, np.inf]),
    lossy=st.booleans(),
)
def test_the_nearest_to_a_point_are_those_of_a_full_search(seed, count, sigma, reach, lossy):
    rng = np.random.default_rng(seed)
    rows = scene(rng, 120, low=-5.0)
    loss = rng.uniform(0, 0.02, (120, 3)).astype(np.float32) if lossy else None
    points = rng.uniform(-2.2, 2.2, (4, 3))
    index = index_of(rows, sigma, loss=loss)
    expected = distances(rows, points, sigma, loss)
    for point, row in zip(points, expected, strict=True):
        item, distance = index.nearest(point, point, reach=reach, count=count)
        order = in_order(row, reach, count)
        np.testing.assert_allclose(distance, row[order], rtol=1e-12, atol=1e-13)
        np.testing.assert_allclose(row[item], row[order], rtol=1e-12, atol=1e-13)
        assert np.all(np.diff(distance) >= 0)
        assert len(set(item)) == len(item)
    np.testing.assert_allclose(index.clearance(points), expected.min(axis=1), rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(
        index.clearance(points, cap=0.1), np.minimum(0.1, expected.min(axis=1)), atol=1e-13
    )


@settings(max_examples=examples(60), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 40), length=st.sampled_from([1e-6, 0.3, 2.0]))
def test_the_nearest_to_a_segment_are_those_of_a_full_search(seed, count, length):
    rng = np.random.default_rng(seed)
    rows = scene(rng, 120, low=-4.0)
    a = rng.uniform(-2, 2, (3, 3))
    b = a + length * rng.normal(size=(3, 3))
    index, reach = index_of(rows), 1.5
    to_segment, to_start = distances(rows, a, ends=b), distances(rows, a)
    for i in range(3):
        item, distance = index.nearest(a[i], b[i], reach=reach, count=count)
        key = np.where(to_segment[i] > 0, to_segment[i], to_start[i] - reach)
        key[to_start[i] >= reach] = np.inf
        order = in_order(key, reach, count)
        np.testing.assert_allclose(distance, np.maximum(0, key[order]), atol=1e-9 * reach)
        np.testing.assert_allclose(key[item], key[order], atol=1e-9 * reach)


def test_ties_go_by_number_and_nothing_is_farther_than_the_reach():
    mean = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 3]], np.float32)
    rows = mean, np.full((4, 3), 0.5, np.float32), np.tile(np.float32([1, 0, 0, 0]), (4, 1))
    index = index_of(rows)
    item, distance = index.nearest([0, 0, 0], [0, 0, 0], reach=2.5, count=2)
    assert item.tolist() == [0, 1]
    assert distance[0] == distance[1]
    np.testing.assert_allclose(distance, 0.5, rtol=1e-14)
    assert index.nearest([0, 0, 0], [0, 0, 0], reach=2.5, count=9)[0].tolist() == [0, 1, 2]
    assert index.nearest([0, 0, 0], [0, 0, 0], reach=0.4999, count=9)[0].tolist() == []
    assert index.nearest([1, 0, 0], [1, 0, 0], reach=9.0, count=1)[1].tolist() == [-0.5]
    assert len(index) == 4
    assert index.radius == 0.2


@settings(max_examples=examples(200), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    spread=st.floats(0, 6),
    radius=st.sampled_from([1e-3, 0.05, 0.2, 3.0]),
    sigma=st.sampled_from([1.0, 3.37]),
)
def test_no_point_of_the_sum_is_outside_the_grown_ellipsoid(seed, spread, radius, sigma):
    rng = np.random.default_rng(seed)
    rows = scene(rng, 3, low=-1.0 - spread)
    centre, A = index_of(rows, sigma, radius).grown()
    for i in range(3):
        scale, R = sigma * rows[1][i].astype(float), rotation(rows[2][i].astype(float))
        n = rng.normal(size=(400, 3))
        n[:6] = np.vstack([R.T, -R.T])
        n /= np.linalg.norm(n, axis=1)[:, None]
        support = (n @ R) * scale  # the boundary point of the sum with normal n
        y = (support / np.linalg.norm(support, axis=1)[:, None] * scale) @ R.T + radius * n
        assert np.einsum("ni,ij,nj->n", y, A[i], y).max() <= 1
        np.testing.assert_array_equal(A[i], A[i].T)
        np.linalg.cholesky(A[i])
        np.testing.assert_allclose(centre[i], rows[0][i])
        if spread < 2:
            np.testing.assert_allclose(A[i], outer_matrix(rows[1][i], rows[2][i], sigma, radius), rtol=1e-8)


def test_adding_the_radius_to_the_semi_axes_would_be_short():
    scale, radius = np.array([1.0, 0.2, 0.02]), 0.1
    rows = np.zeros((1, 3), np.float32), scale[None].astype(np.float32), np.float32([[1, 0, 0, 0]])
    _, A = index_of(rows, radius=radius).grown()
    n = np.random.default_rng(5).normal(size=(4000, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    y = n * scale**2 / np.linalg.norm(n * scale, axis=1)[:, None] + radius * n
    naive = np.sum((y / (scale + radius)) ** 2, axis=1)
    assert naive.max() > 1.05
    assert np.einsum("ni,ij,nj->n", y, A[0], y).max() <= 1
    # Short by this much along the worst normal: the sum's support function less that of the naive ellipsoid.
    short = np.linalg.norm(n * scale, axis=1) + radius - np.linalg.norm(n * (scale + radius), axis=1)
    assert short.max() > 0.5 * radius


def test_losses_grow_the_obstacle():
    rng = np.random.default_rng(2)
    rows = scene(rng, 20)
    loss = np.full((20, 3), [0.03, 0.0, 0.0], np.float32)
    plain, grown = index_of(rows), index_of(rows, loss=loss)
    points = rng.uniform(-3, 3, (50, 3))
    np.testing.assert_allclose(plain.clearance(points) - grown.clearance(points), np.float32(0.03), rtol=1e-7)
    _, A = grown.grown()
    _, expected = index_of(rows, radius=0.2 + float(np.float32(0.03))).grown()
    np.testing.assert_allclose(A, expected, rtol=1e-9)


def test_results_do_not_depend_on_threads_and_an_empty_map_is_clear():
    rng = np.random.default_rng(3)
    rows = scene(rng, 3000)
    points = rng.uniform(-3, 3, (2000, 3))
    index = index_of(rows)
    assert index.clearance(points, jobs=1).tobytes() == index.clearance(points, jobs=3).tobytes()
    empty = index_of(tuple(np.zeros((0, k), np.float32) for k in (3, 3, 4)))
    assert empty.clearance(points[:2], cap=7.0).tolist() == [7.0, 7.0]
    assert len(empty.nearest([0, 0, 0], [1, 0, 0], reach=5.0, count=3)[0]) == 0


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_a_radius_that_means_nothing_is_refused(radius):
    with pytest.raises(ValueError, match=r"radius|inflation"):
        index_of(scene(np.random.default_rng(0), 2), radius=radius)


def test_rows_that_are_no_ellipsoids_are_refused():
    mean, scale, quat = scene(np.random.default_rng(0), 2)
    with pytest.raises(ValueError, match="row 1"):
        index_of((mean, scale * np.float32([[1], [0]]), quat))
    with pytest.raises(ValueError, match="sigma"):
        index_of((mean, scale, quat), sigma=0.0)
