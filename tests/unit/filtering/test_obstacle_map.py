"""Static obstacle maps: distances, contacts and swept clearance against independent references."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from scipy.spatial import ConvexHull

from alula import _core
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from support.effort import examples
from support.models.splat_filter_model import rotation
from support.scenes.small_scenes import box_cover


def ellipsoids(rng, count=30, size=3.0):
    """The maps of their index and of their set, and centres, rotations and semi-axes."""
    mean = rng.uniform(-size, size, (count, 3)).astype(np.float32)
    scale = rng.uniform(0.05, 0.6, (count, 3)).astype(np.float32)
    quat = rng.normal(size=(count, 4)).astype(np.float32)
    index = _core.EllipsoidIndex(mean, scale, quat, sigma=1.0, radius=0.15)
    made = [_core.EllipsoidMap(index), _core.EllipsoidSetMap(_core.EllipsoidSet(mean, scale, quat, 1.0))]
    return made, (mean.astype(float), np.array([rotation(q) for q in quat]), scale.astype(float))


def hulls(rng, count=12, size=3.0):
    """Hulls of random points; their set, and planes and vertices of each."""
    planes, vertices = [], []
    for _ in range(count):
        points = rng.uniform(-size, size, 3) + rng.normal(size=(12, 3)) * rng.uniform(0.1, 0.6, 3)
        hull = ConvexHull(points)
        planes.append(np.unique(hull.equations.round(13), axis=0))
        planes[-1][:, :3] /= np.linalg.norm(planes[-1][:, :3], axis=1, keepdims=True)
        planes[-1][:, 3] = -(points @ planes[-1][:, :3].T).max(axis=0)
        vertices.append(points[hull.vertices])
    made = _core.PolytopeSet(
        normals=np.ascontiguousarray(np.vstack(planes)[:, :3]),
        offsets=np.ascontiguousarray(-np.vstack(planes)[:, 3]),
        plane_start=np.cumsum([0, *map(len, planes)]),
        vertices=np.ascontiguousarray(np.vstack(vertices)),
        vertex_start=np.cumsum([0, *map(len, vertices)]),
    )
    return made, (planes, vertices)


def fence(rng, size=3.0):
    """A box of random rotation with a cut corner; the map and its rows (n, d)."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    cut = np.array([1, 1, 1]) / np.sqrt(3)
    normals = np.vstack([turn, -turn, cut @ turn])
    offsets = np.append(np.full(6, size), 1.2 * size)
    return _core.FenceMap(np.ascontiguousarray(normals), offsets), np.column_stack([normals, offsets])


def distance_to_ellipsoid(p, centre, turn, semi):
    """Signed distance by minimisation over the surface, from many starts."""
    local = turn.T @ (p - centre)

    def squared(n):
        length = np.linalg.norm(n)
        off = semi * n / length - local
        slope = 2 * semi * off / length
        return off @ off, slope - (slope @ n) * n / length**2

    starts = np.vstack([np.eye(3), -np.eye(3), local / (np.linalg.norm(local) + 1e-12)])
    found = [minimize(squared, start, jac=True, method="BFGS", options={"gtol": 1e-12}) for start in starts]
    best = np.sqrt(min(each.fun for each in found))
    return best if np.sum((local / semi) ** 2) > 1 else -best


def distance_to_hull(p, planes, vertices):
    """Signed distance by a quadratic program over the weights of the vertices."""
    depth = (planes[:, :3] @ p + planes[:, 3]).max()
    if depth <= 0:
        return depth
    n = len(vertices)
    found = minimize(
        lambda w: np.sum((w @ vertices - p) ** 2),
        np.full(n, 1 / n),
        jac=lambda w: 2 * vertices @ (w @ vertices - p),
        bounds=[(0, 1)] * n,
        constraints={"type": "eq", "fun": lambda w: w.sum() - 1, "jac": lambda _: np.ones(n)},
        method="SLSQP",
        options={"ftol": 1e-16, "maxiter": 500},
    )
    return np.sqrt(found.fun)


def maps(rng):
    """One map of each kind, and their union."""
    parts = [*ellipsoids(rng)[0], _core.HullMap(hulls(rng)[0]), fence(rng)[0]]
    return [*parts, _core.MapUnion(parts)]


def sampled(a, b, count=201):
    """Points of a segment."""
    return np.ascontiguousarray(a + np.linspace(0, 1, count)[:, None] * (b - a))


def test_distances_are_those_of_other_programs():
    rng = np.random.default_rng(0)
    rounded, (centre, turn, semi) = ellipsoids(rng, 4)
    made, (planes, vertices) = hulls(rng, 4)
    fenced, rows = fence(rng)
    points = rng.uniform(-3, 3, (7, 3))
    points[:2] = centre[:2] + 0.02
    points[2:4] = [v.mean(axis=0) for v in vertices[:2]]
    for p in points:
        of_ellipsoids = min(distance_to_ellipsoid(p, *each) for each in zip(centre, turn, semi, strict=True))
        of_hulls = min(distance_to_hull(p, *each) for each in zip(planes, vertices, strict=True))
        of_fence = (rows[:, 3] - rows[:, :3] @ p).min()
        for each in rounded:
            assert each.distance(p[None])[0] == pytest.approx(of_ellipsoids, abs=1e-6)
        assert _core.HullMap(made).distance(p[None])[0] == pytest.approx(of_hulls, abs=1e-6)
        assert fenced.distance(p[None])[0] == pytest.approx(of_fence, abs=1e-12)


@settings(max_examples=examples(40), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), upto=st.sampled_from([-0.2, 0.0, 0.3, 5.0]))
def test_distances_are_exact_below_a_bound_and_1_lipschitz(seed, upto):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-4, 4, (40, 3))
    step = rng.normal(size=(40, 3)) * np.exp(rng.uniform(-8, 0, (40, 1)))
    for each in maps(rng):
        exact = each.distance(points)
        bounded = each.distance(points, upto=upto)
        np.testing.assert_array_equal(bounded[exact < upto], exact[exact < upto])
        assert (bounded[exact >= upto] >= upto).all()
        moved = each.distance(np.ascontiguousarray(points + step))
        assert (np.abs(moved - exact) <= np.linalg.norm(step, axis=1) * (1 + 1e-9) + 1e-9).all()


@settings(max_examples=examples(40), deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_an_index_and_a_set_of_the_same_ellipsoids_are_one_map(seed):
    rng = np.random.default_rng(seed)
    (one, other), _ = ellipsoids(rng)
    a = rng.uniform(-4, 4, (40, 3))
    b = a + rng.normal(size=(40, 3))
    np.testing.assert_allclose(one.distance(a), other.distance(a), rtol=0, atol=1e-12)
    np.testing.assert_allclose(
        one.segment_distance(a, b, 9.0), other.segment_distance(a, b, 9.0), rtol=0, atol=1e-8
    )
    np.testing.assert_array_equal(one.is_clear(a, b, 0.1), other.is_clear(a, b, 0.1))
    assert one.near(a[0], 3.0, 9)["index"].tolist() == other.near(a[0], 3.0, 9)["index"].tolist()


@settings(max_examples=examples(40), deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_union_is_the_minimum_of_its_parts(seed):
    rng = np.random.default_rng(seed)
    *parts, union = maps(rng)
    a, b = rng.uniform(-4, 4, (2, 30, 3))
    np.testing.assert_array_equal(union.distance(a), np.min([part.distance(a) for part in parts], axis=0))
    np.testing.assert_array_equal(
        union.is_clear(a, b, 0.1), np.all([part.is_clear(a, b, 0.1) for part in parts], axis=0)
    )
    every = [part.near(a[0], 2.0, 100) for part in parts]
    nearest = union.near(a[0], 2.0, 7)
    together = np.sort(np.concatenate([one["distance"] for one in every]))
    np.testing.assert_array_equal(nearest["distance"], together[:7])


@settings(max_examples=examples(40), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), length=st.sampled_from([0.0, 1e-3, 0.2, 3.0]))
def test_a_sweep_is_never_wrongly_clear(seed, length):
    rng = np.random.default_rng(seed)
    a = rng.uniform(-3, 3, (25, 3))
    b = a + length * rng.normal(size=(25, 3))
    for each in maps(rng):
        least = np.array([each.distance(sampled(*ends)).min() for ends in zip(a, b, strict=True)])
        spacing = np.linalg.norm(b - a, axis=1) / 200
        for radius in (0.0, 0.05, 0.4):
            clear = each.is_clear(a, b, radius)
            assert (least[clear] >= radius).all()
            assert clear[least > radius + spacing + 1e-6].all()  # nor needlessly blocked
        of_segments = each.segment_distance(a, b, 10.0)
        assert (of_segments <= np.maximum(least, 0) + 1e-7).all()
        assert (of_segments >= np.maximum(least - spacing, 0) - 1e-7).all()


def test_a_sweep_at_the_edge_of_contact_is_not_clear():
    box = _core.FenceMap(np.vstack([np.eye(3), -np.eye(3)]), np.ones(6))
    origin = np.zeros((1, 3))
    assert box.is_clear(origin, origin, 1 - 1e-6)[0]
    assert not box.is_clear(origin, origin, 1.0)[0]
    assert not box.is_clear(origin, origin, 1 - 1e-10)[0]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_not_clear(bad):
    for each in maps(np.random.default_rng(1)):
        a, b = np.full((1, 3), 30.0), np.array([[30.0, bad, 30.0]])
        assert not each.is_clear(a, b, 0.1)[0]
        assert not each.is_clear(b, a, 0.1)[0]
        assert not each.is_clear(a, a, bad)[0]


@settings(max_examples=examples(30), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), reach=st.sampled_from([0.0, 0.5, 3.0]), most=st.integers(1, 12))
def test_contacts_are_the_nearest_with_their_gradients(seed, reach, most):
    rng = np.random.default_rng(seed)
    rounded, (_, _, semi) = ellipsoids(rng)
    made, (planes, vertices) = hulls(rng)
    p = rng.uniform(-3, 3, 3)
    for each, count in (*((one, len(semi)) for one in rounded), (_core.HullMap(made), len(planes))):
        found = each.near(p, reach, most)
        assert len(found["index"]) <= most
        assert (found["distance"] < reach).all()
        assert (np.diff(found["distance"]) >= 0).all()
        np.testing.assert_allclose(np.linalg.norm(found["normal"], axis=1), 1, rtol=1e-12)
        np.testing.assert_allclose(
            found["point"], p - found["distance"][:, None] * found["normal"], atol=1e-12
        )
        every = each.near(p, 100.0, 1000)
        assert sorted(every["index"]) == list(range(count))
        cut = (every["distance"] < reach).nonzero()[0][:most]
        np.testing.assert_array_equal(found["index"], every["index"][cut])
        if abs(every["distance"][0]) > 1e-3 and every["distance"][1] - every["distance"][0] > 1e-3:
            step = 1e-6
            moved = p + step * np.vstack([np.eye(3), -np.eye(3)])
            value = each.distance(np.ascontiguousarray(moved))
            gradient = (value[:3] - value[3:]) / (2 * step)
            np.testing.assert_allclose(gradient, every["normal"][0], atol=1e-3)
    for k, distance in zip(every["index"], every["distance"], strict=True):
        if distance < 1.0:
            assert distance == pytest.approx(distance_to_hull(p, planes[k], vertices[k]), abs=1e-5)


def test_ties_go_by_kind_and_then_by_number():
    """Six obstacles at the same distance from the origin."""
    mean = np.array([[2, 0, 0], [-2, 0, 0]], np.float32)
    index = _core.EllipsoidIndex(
        mean,
        np.full((2, 3), 1.0, np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (2, 1)),
        sigma=1.0,
        radius=0.1,
    )
    corners = np.array([[x, y, z] for x in (-1.0, 1) for y in (1.0, 3) for z in (-1.0, 1)])
    rows = np.vstack([np.eye(3), -np.eye(3)])
    boxes = _core.PolytopeSet(
        normals=np.vstack([rows, rows]),
        offsets=np.array([1.0, 3, 1, 1, -1, 1, 1, -1, 1, 1, 3, 1]),
        plane_start=np.array([0, 6, 12]),
        vertices=np.vstack([corners, corners * [1, -1, 1]]),
        vertex_start=np.array([0, 8, 16]),
    )
    walls = _core.FenceMap(np.array([[0.0, 0, 1], [0, 0, -1]]), np.ones(2))
    parts = [walls, _core.HullMap(boxes), _core.EllipsoidMap(index)]
    for most in range(1, 7):
        found = _core.MapUnion(parts).near((0, 0, 0), 5.0, most)
        assert found["kind"] == ["ellipsoid", "ellipsoid", "hull", "hull", "fence", "fence"][:most]
        assert found["index"].tolist() == [0, 1, 0, 1, 0, 1][:most]
        np.testing.assert_allclose(found["distance"], 1, rtol=1e-12)


def test_memory_of_earlier_queries_changes_no_bit():
    rng = np.random.default_rng(5)
    points = rng.uniform(-3, 3, (60, 3))
    shuffled = rng.permutation(60)
    for each in maps(rng):
        one = np.array([each.distance(p[None])[0] for p in points])
        np.testing.assert_array_equal(each.distance(points), one)
        np.testing.assert_array_equal(each.distance(np.ascontiguousarray(points[shuffled])), one[shuffled])


def test_maps_refuse_what_is_no_map():
    with pytest.raises(ValueError, match="a union of maps needs a map"):
        _core.MapUnion([])
    with pytest.raises(ValueError, match="not a unit vector"):
        _core.FenceMap(np.array([[2.0, 0, 0]]), np.ones(1))
    with pytest.raises(ValueError, match="not finite"):
        _core.FenceMap(np.array([[1.0, 0, 0]]), np.array([np.inf]))
    with pytest.raises(ValueError, match="differ in length"):
        _core.FenceMap(np.array([[1.0, 0, 0]]), np.ones(2))


@pytest.mark.parametrize("size", [1.0, 1000.0])
def test_an_image_never_claims_more_than_the_hulls_of_its_cover(size):
    """Boxes and prisms on a lattice: psi is a lower bound of the distance, and close to it beside a face."""
    cover = box_cover([((k * 7, -3, 0), (k * 7 + 4, 2 + k, 5 + k)) for k in range(5)])
    image = _core.ImageMap(encode_map(cover))
    exact = _core.HullMap(hull_obstacles(Hulls.from_cover(cover)))
    rng = np.random.default_rng(4)
    a = rng.uniform([-1, -1, -1], [4, 1.5, 1.5], (300, 3))
    b = a + 0.4 * rng.normal(size=(300, 3))
    true = exact.distance(a)
    psi = image.distance(a)
    assert (psi <= true).all()
    assert (psi[true < 0] > true[true < 0] - 1e-4).all()
    assert image.distance(np.array([[0.2, -0.5, 0.2]]))[0] == pytest.approx(0.2, abs=1e-4)
    for radius in (0.0, 0.1, 0.3):
        clear = image.is_clear(a, b, radius)
        assert exact.is_clear(a[clear], b[clear], radius - 1e-6 if radius else 0.0).all()
        assert 10 < clear.sum() < 290
    least = np.array([image.distance(sampled(*ends)).min() for ends in zip(a, b, strict=True)])
    of_segments = image.segment_distance(a, b, size)
    assert (of_segments <= np.minimum(np.maximum(least, 0), size) + 1e-7).all()
    assert (of_segments >= np.minimum(np.maximum(least - 0.012, 0), size)).all()
    found = image.near((0.2, -0.5, 0.2), 1.0, 5)
    assert found["kind"] == ["hull"]
    np.testing.assert_allclose(found["normal"], [[0, -1, 0]], atol=1e-6)
    assert image.near((0.2, -0.5, 0.2), 0.1, 5)["kind"] == []
    assert not image.is_clear(np.full((1, 3), 1e13), np.full((1, 3), 1e13), 0.1)[0]


def test_an_image_must_be_one():
    with pytest.raises(ValueError, match="map"):
        _core.ImageMap(b"no image")
