"""Rows of obstacles of any map: exact projections, finite differences, and ellipsoids in their place."""

import numpy as np
import pytest
from scipy.optimize import nnls
from scipy.spatial import ConvexHull

from alula import _core
from support.models.wrench_flight import HOVER, OK, RADIUS, VEHICLE, empty_scene, moving, tick

ALPHA, BETA = 5.0, 1.0
POLICY = _core.BackupPolicy(VEHICLE, "brake")
WRENCH_FILTERS = {
    "cone-backup": (_core.ConeBackup, _core.ConeBackupOptions),
    "cone-ecbf": (_core.ConeEcbf, _core.ConeEcbfOptions),
}


def least_norm(rows, bounds):
    """The shortest y with rows y >= bounds: least-distance programming of Lawson and Hanson."""
    residual = np.append(np.zeros(rows.shape[1]), 1.0)
    dual, _ = nnls(np.vstack([rows.T, bounds]), residual)
    r = np.vstack([rows.T, bounds]) @ dual - residual
    return -r[:-1] / r[-1]


class Hulls:
    """Hulls of random points, or given ones, each as its planes normal . x <= offset."""

    def __init__(self, clouds):
        self.planes, vertices = [], []
        for points in clouds:
            hull = ConvexHull(points)
            normal = np.unique(hull.equations[:, :3].round(13), axis=0)
            normal /= np.linalg.norm(normal, axis=1, keepdims=True)
            self.planes.append((normal, (points @ normal.T).max(axis=0)))
            vertices.append(points[hull.vertices])
        self.set_ = _core.PolytopeSet(
            normals=np.vstack([normal for normal, _ in self.planes]),
            offsets=np.concatenate([offset for _, offset in self.planes]),
            plane_start=np.cumsum([0] + [len(offset) for _, offset in self.planes]),
            vertices=np.vstack(vertices),
            vertex_start=np.cumsum([0] + [len(each) for each in vertices]),
        )
        self.map = _core.HullMap(self.set_)

    @classmethod
    def random(cls, rng, count, size=3.0):
        return cls(
            rng.uniform(-size, size, 3) + rng.normal(size=(8, 3)) * rng.uniform(0.05, 0.3, 3)
            for _ in range(count)
        )

    def offset(self, k, p):
        """The vector from the point of hull k nearest to p, to p."""
        normal, offset = self.planes[k]
        depth = normal @ p - offset
        if depth.max() > 0:
            return -least_norm(-normal, depth)
        return depth.max() * normal[depth.argmax()]

    def distance(self, k, p):
        normal, offset = self.planes[k]
        inside = (normal @ p - offset).max() <= 0
        return np.linalg.norm(self.offset(k, p)) * (-1 if inside else 1)


def box(lower, upper):
    corner = np.array([[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)])
    return np.where(corner, upper, lower).astype(float)


def safer(map_, radius=RADIUS, **options):
    return _core.SaferSplat(
        empty_scene().index,
        _core.SaferSplatOptions(alpha=ALPHA, beta=BETA, **options),
        near_map=map_,
        near_radius_m=radius,
    )


def accelerate(flown, p, v, a):
    return flown.filter((*p, 0, 0, 0, *v, 0, 0, 0), tuple(a))


def outside(rng, hulls, count, size=3.0):
    """A state that is clear of all hulls."""
    while True:
        p = rng.uniform(-size, size, 3)
        if min(hulls.distance(k, p) for k in range(count)) > RADIUS:
            return p, 1.5 * rng.normal(size=3), 3 * rng.normal(size=3)


def test_the_row_of_a_hull_is_sufficient_for_its_true_distance():
    """h'' + (alpha + beta) h' + alpha beta h of h = d^2 - r^2, by differences of exact projections."""
    rng, step, values = np.random.default_rng(1), 1e-3, []
    for _ in range(150):
        hull = Hulls.random(rng, 1, size=0.5)
        p, v, nominal = outside(rng, hull, 1, size=1.5)
        report = accelerate(safer(hull.map), p, v, nominal)
        u = np.array(report["acceleration"])
        h = [
            hull.distance(0, p + v * t + u * t * t / 2) ** 2 - RADIUS**2
            for t in (-2 * step, -step, 0, step, 2 * step)
        ]
        assert report["margin"] == pytest.approx(h[2], abs=1e-12)
        first = (h[0] - 8 * h[1] + 8 * h[3] - h[4]) / (12 * step)
        second = (-h[0] + 16 * h[1] - 30 * h[2] + 16 * h[3] - h[4]) / (12 * step**2)
        value = second + (ALPHA + BETA) * first + ALPHA * BETA * h[2]
        if report["status"] == OK:
            np.testing.assert_array_equal(u, nominal)
        else:
            values.append(value)
        # The distance is smooth on each side of the boundary between the regions of two faces.
        assert value > -1e-4 * (1 + v @ v + u @ u)
    assert len(values) > 20


def test_the_row_of_a_face_is_exact():
    """Beside a face d is affine, so the row leaves out nothing: the minimum of the left side is 0."""
    hull = Hulls([box([-5, -5, -1], [5, 5, 0])])
    p, v = np.array([0.3, -0.2, 0.8]), np.array([0.4, 0.1, -1.1])
    report = accelerate(safer(hull.map), p, v, (0, 0, -20))
    a = report["acceleration"][2]
    d, rate = 0.8, -1.1
    assert 2 * rate**2 + 2 * d * a + 6 * 2 * d * rate + 5 * (d**2 - RADIUS**2) == pytest.approx(0, abs=1e-9)
    assert report["acceleration"][:2] == pytest.approx([0, 0], abs=1e-12)


@pytest.mark.parametrize("rows", ["all", "nearest"])
@pytest.mark.parametrize("brute", [False, True])
def test_rows_of_many_hulls_make_the_program_of_all(rows, brute):
    """The nearest acceleration by another method; hulls far away matter only where the speed is high."""
    rng, count, changed = np.random.default_rng(2), 40, 0
    hulls = Hulls.random(rng, count)
    flown = safer(hulls.map, rows=rows, brute=brute)
    for _ in range(25):
        p, v, nominal = outside(rng, hulls, count)
        report = accelerate(flown, p, v, nominal)
        near = [k for k in range(count) if hulls.distance(k, p) < report["gate_m"]]
        o = np.array([hulls.offset(k, p) for k in near])
        d = np.linalg.norm(o, axis=1)
        assert report["margin"] == pytest.approx((d**2 - RADIUS**2).min(), rel=1e-9)
        h, along = d**2 - RADIUS**2, o @ v
        bound = -(2 * (along / d) ** 2 + (ALPHA + BETA) * 2 * along + ALPHA * BETA * h)
        expected = nominal + least_norm(2 * o, bound - 2 * o @ nominal)
        if not (2 * o @ expected >= bound - 1e-6).all():  # there is none
            assert report["infeasible"]
            continue
        np.testing.assert_allclose(report["acceleration"], expected, atol=1e-6)
        changed += report["status"] != OK
        if report["active"] >= 0:
            k = report["active"] - 1  # behind the one ellipsoid far away
            assert 2 * o[near.index(k)] @ expected == pytest.approx(bound[near.index(k)], abs=1e-6)
    assert changed > 10


@pytest.mark.parametrize("brute", [False, True])
def test_hulls_at_the_same_distance_all_have_rows(brute):
    """Six boxes around the vehicle; each row is violated by a nominal input of its own."""
    sides = [sign * axis for axis in np.eye(3) for sign in (1, -1)]
    hulls = Hulls([box(*np.sort([side - 0.5 * abs(side), side + 0.5], axis=0)) for side in sides])
    assert set(hulls.map.near((0, 0, 0), 1.0, 6)["distance"]) == {0.5}
    flown = safer(hulls.map, brute=brute)
    for side in sides:
        report = accelerate(flown, np.zeros(3), np.zeros(3), 9 * side)
        most = ALPHA * BETA * (0.25 - RADIUS**2) / (2 * 0.5)
        assert report["acceleration"] == pytest.approx(list(most * side), abs=1e-12)


def test_inside_a_hull_the_row_drives_the_vehicle_out():
    hull = Hulls([box([-1, -1, -1], [1, 1, 1])])
    report = accelerate(safer(hull.map), (0.9, 0, 0), (0, 0, 0), (0, 0, 0))
    assert report["margin"] == pytest.approx(-(0.1**2) - RADIUS**2)
    assert report["acceleration"] == pytest.approx([5 * (0.1**2 + RADIUS**2) / 0.2, 0, 0])


def test_a_double_integrator_stays_inside_a_fence_and_off_a_hull():
    planes = np.vstack([np.eye(3), -np.eye(3)])
    hull = Hulls([box([-0.3, -0.3, -0.3], [0.3, 0.3, 0.3])])
    both = _core.MapUnion([_core.FenceMap(planes, np.full(6, 1.5)), hull.map])
    flown, memory = safer(both, 0.1), []
    p, v, dt = np.array([-1.0, 0.2, 0.1]), np.zeros(3), 0.01
    rng = np.random.default_rng(4)
    for i in range(2400):
        if i % 400 == 0:
            target = rng.uniform(-2.5, 2.5, 3)
        a = np.array(accelerate(flown, p, v, 4 * (target - p) - 3 * v)["acceleration"])
        p, v = p + v * dt + a * dt * dt / 2, v + a * dt
        memory.append(min(hull.distance(0, p), (1.5 - np.abs(p)).min()))
    assert 0.0999 < min(memory) < 0.15


@pytest.mark.parametrize("name", WRENCH_FILTERS)
@pytest.mark.parametrize("v", [(2.0, 0.3, 0.1), (0.02, 0, 0.01)])
def test_cones_of_a_hull_are_those_of_a_ball_that_touches_it(name, v):
    """The ball of 0.3 m inside the face, as an ellipsoid of an index."""
    hull = Hulls([box([0.7, -2, -2], [1.7, 2, 2])])
    made, options = WRENCH_FILTERS[name]
    ball = _core.EllipsoidIndex(
        *(np.array([row], np.float32) for row in ([1.0, 0, 0], [0.3, 0.3, 0.3], [1, 0, 0, 0])),
        sigma=1.0,
        radius=RADIUS,
    )
    for shield in (False, True):
        own, others = (
            options(shield=shield, pruning=_core.Pruning(floor_m=1.0)),
            {"map": hull.map, "radius_m": RADIUS},
        )
        one = made(POLICY, ball, own, **others)
        two = made(POLICY, empty_scene().index, own, near_map=hull.map, **others)
        x, wrench = moving(v), (HOVER, 0, -0.02, 0)
        expected, found = (tick(each, x, wrench) for each in (one, two))
        assert found["rows"] == expected["rows"] > 0
        assert found["status"] == expected["status"]
        assert found["margin"] == pytest.approx(expected["margin"], rel=1e-5)
        np.testing.assert_allclose(found["wrench"], expected["wrench"], rtol=1e-4, atol=1e-6)
        assert found["active"] == (expected["active"] + 1 if expected["active"] >= 0 else -1)


@pytest.mark.parametrize("name", WRENCH_FILTERS)
def test_hulls_and_ellipsoids_share_the_rows_of_a_tick(name):
    """The nearest `count` of both; those behind the vehicle have no rows."""
    made, options = WRENCH_FILTERS[name]
    rng = np.random.default_rng(5)
    centres = np.array([[1, y, 0] for y in np.linspace(-0.4, 0.4, 4)] + [[-0.6, 0, 0]])
    hulls = Hulls(centre + 0.05 * rng.normal(size=(8, 3)) for centre in centres)
    index = _core.EllipsoidIndex(
        *(np.array([row], np.float32) for row in ([1.1, 0, 0.3], [0.05, 0.05, 0.05], [1, 0, 0, 0])),
        sigma=1.0,
        radius=RADIUS,
    )
    for count, expected, capped in ((32, 5, False), (3, 3, True)):
        pruning = _core.Pruning(count=count, floor_m=2.0)
        flown = made(POLICY, index, options(shield=False, pruning=pruning), near_map=hulls.map)
        report = tick(flown, moving((2, 0, 0)), (HOVER, 0, 0, 0))
        assert report["candidates"] == expected
        assert report["capped"] == capped
    with pytest.raises(ValueError, match="radius_m is for a map"):
        made(POLICY, index, near_radius_m=0.1)
