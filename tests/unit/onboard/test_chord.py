"""The onboard filter of a vehicle that lags: rows against linear programs, flights against the hulls."""

import math

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import linprog

from alula import _core
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.filtering.protocol import FilterStatus
from support.effort import examples
from support.scenes.covers import boxes_cover
from support.scenes.fabricate import exact_hull, make_cover
from support.scenes.maps import decode, half_spaces

OK, FILTERED, SHORTENED, RECOVERING, REFUSED, _ = FilterStatus
SLACK_M = 2e-3  # of planes that are moved outward, and of single precision


def planes_of(image, g):
    """Per hull: unit normals (L, 3) and offsets (L), in double precision [m]."""
    found = []
    for hull in decode(image):
        rows = half_spaces(hull)
        normal = np.array([n for n, _ in rows], float)
        length = np.linalg.norm(normal, axis=1)
        found.append((normal / length[:, None], g * np.array([d for _, d in rows], float) / length))
    return found


def psi(hulls, points):
    """The largest plane value of the nearest hull at points (n, 3) [m]."""
    return np.min([np.max(points @ n.T - d, axis=1) for n, d in hulls], axis=0)


def least_on_chord(normal, offset, p, q):
    """D_k, by a linear program over (theta, value)."""
    rise = normal @ (q - p)
    done = linprog(
        [0, 1], np.stack([rise, -np.ones(len(rise))], 1), offset - normal @ p, bounds=[(0, 1), (None, None)]
    )
    assert done.status == 0
    return done.fun


def blobs(seed, count, g=0.1, extent=60):
    """A cover of oblique hulls, and the edge of its voxels."""
    rng = np.random.default_rng(seed)
    hulls = []
    while len(hulls) < count:
        points = rng.integers(0, 14, (rng.integers(6, 30), 3)) + rng.integers(0, extent, 3)
        if np.linalg.matrix_rank(points[1:] - points[0]) == 3:
            hulls.append(exact_hull(points))
    return make_cover(hulls, g)


def filter_on(image, lag_s=0.3, **fields):
    config = {"radius_m": 0.15, "beta": 2.0, "dt_s": 0.01, "v_max": 1.0} | fields
    return _core.OnboardChord(image, _core.PolytopeCbfConfig(**config), lag_s, 30.0)


def fly(made, hulls, p, v, wanted, lag_s, seconds, dt=0.01, *, taking_off=False):
    """Fly commands that hold for dt on a vehicle of first order; positions (n, 3) at a tenth of that."""
    path, statuses = [], []
    share = math.exp(-dt / 10 / lag_s)
    for k in range(round(seconds / dt)):
        u, status, *_ = made.filter(tuple(p), tuple(v), tuple(wanted(k * dt, p)), taking_off)
        u = np.array(u)
        statuses.append(status)
        for _ in range(10):
            p = p + u * dt / 10 + lag_s * (1 - share) * (v - u)
            v = u + share * (v - u)
            path.append(p)
    return np.array(path), np.array(statuses)


def clear_states(hulls, rng, count, extent, r, lag_s):
    """Positions and velocities whose chords keep r from all hulls."""
    found = []
    while len(found) < count:
        p, v = rng.uniform(0, extent, 3), rng.normal(size=3)
        v *= rng.uniform(0, 1) / np.linalg.norm(v)
        if r + SLACK_M < min(least_on_chord(n, d, p, p + lag_s * v) for n, d in hulls) < r + 0.3:
            found.append((p, v))
    return found


@pytest.mark.parametrize("seed", range(4))
def test_the_margin_is_that_of_linear_programs(seed):
    image = encode_map(blobs(seed, 1))
    (hull,) = planes_of(image, 0.1)
    made, rng = filter_on(image), np.random.default_rng(seed)
    (box,) = decode(image)
    near = 0.1 * np.mean([box["lower"], box["upper"]], axis=0)
    told = 0
    for _ in range(200):
        p, v = near + rng.uniform(-1.6, 1.6, 3), rng.normal(size=3)
        _, _, margin, _ = made.filter(tuple(p), tuple(v), (0, 0, 0))
        least = least_on_chord(*hull, p, p + 0.3 * v) - 0.15
        if least < 0.5 - SLACK_M:
            assert least - SLACK_M <= margin <= least + 1e-6
            told += 1
    assert told > 10


@pytest.mark.parametrize("seed", range(3))
def test_the_velocity_is_the_nearest_that_keeps_all_rows(seed):
    image = encode_map(blobs(seed, 25))
    hulls, made = planes_of(image, 0.1), filter_on(image)
    rng, bound = np.random.default_rng(seed), 0
    for p, v in clear_states(hulls, rng, examples(15), 6.5, 0.15, 0.3):
        wanted = rng.normal(size=3)
        wanted *= 0.9 / np.linalg.norm(wanted)
        u = np.array(made.filter(tuple(p), tuple(v), tuple(wanted))[0])
        q, rows = p + 0.3 * v, []
        for normal, offset in hulls:
            done = linprog(
                [0, 1],
                np.stack([normal @ (q - p), -np.ones(len(normal))], 1),
                offset - normal @ p,
                bounds=[(0, 1), (None, None)],
            )
            rows.append((-done.ineqlin.marginals @ normal, -2.0 * (done.fun - 0.15)))
        x = cp.Variable(3)
        cp.Problem(cp.Minimize(cp.sum_squares(x - wanted)), [n @ x >= b for n, b in rows]).solve(
            solver=cp.CLARABEL
        )
        if np.linalg.norm(x.value) > 0.95:
            continue
        np.testing.assert_allclose(u, x.value, atol=5e-3)
        bound += np.linalg.norm(x.value - wanted) > 1e-3
    assert bound > 0


@pytest.mark.parametrize("lag_s", [0.15, 0.35])
def test_a_vehicle_of_first_order_keeps_the_radius_whatever_is_wanted(lag_s):
    image = encode_map(blobs(7, 30))
    hulls, made = planes_of(image, 0.1), filter_on(image, lag_s)
    rng, changed = np.random.default_rng(7), 0
    for p, v in clear_states(hulls, rng, examples(6), 6.5, 0.15, lag_s):
        goals = rng.uniform(0, 6.5, (8, 3))
        path, status = fly(made, hulls, p, v, lambda t, x, g=goals: 3 * (g[int(t)] - x), lag_s, 8.0)
        assert psi(hulls, path).min() >= 0.15
        assert set(status) <= {OK, FILTERED, SHORTENED}
        changed += (status != OK).sum()
    assert changed > 100


ROOM = [
    [0, 0, 0, 60, 60, 2],
    [0, 0, 2, 2, 60, 40],
    [2, 58, 2, 60, 60, 40],
    [20, 20, 2, 24, 58, 40],
]  # of 0.1 m


@pytest.mark.parametrize("speed", [0.3, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("late_s", [0.0, 0.1])
def test_corners_are_met_by_at_most_two_centimetres(speed, late_s):
    """Between walls that form corners; the vehicle's acceleration follows its velocity loop late."""
    image = encode_map(boxes_cover(ROOM))
    hulls = planes_of(image, 0.1)
    made = filter_on(image, 0.35, v_max=speed)
    for goal in ([-1, 7, 1.0], [1.9, 9, -1], [-2, 9, 1.5]):
        p, v, a = np.array([1.0, 3.0, 1.0]), np.zeros(3), np.zeros(3)
        path = []
        for k in range(6000):
            if k % 5 == 0:
                u = np.array(made.filter(tuple(p), tuple(v), tuple(speed * np.array(goal - p)))[0])
            wanted = (u - v) / 0.22
            a = wanted if late_s == 0 else a + 0.002 / late_s * (wanted - a)
            v = v + 0.002 * a
            p = p + 0.002 * v
            path.append(p)
        least = psi(hulls, np.array(path)).min()
        assert least >= 0.15 - 0.02
        assert least < 0.4


def test_a_chord_through_a_thin_wall_is_driven_back_to_the_side_of_the_vehicle():
    made = filter_on(encode_map(boxes_cover([[20, 0, 0, 21, 40, 40]])), 0.35)
    for wanted in ((1.0, 0, 0), (0, 0, 0), (-0.1, 0.5, 0)):
        u, status, *_ = made.filter((1.7, 2.0, 2.0), (2.0, 0, 0), wanted)
        assert status == RECOVERING
        assert u[0] <= -0.49


FLOOR = [0, 0, 0, 60, 60, 1]  # 0.1 m thick


def test_a_vehicle_on_a_floor_whose_underside_is_nearer_takes_off_upwards():
    image = encode_map(boxes_cover([FLOOR, [0, 0, 9, 60, 60, 10]]))
    hulls, made = planes_of(image, 0.1), filter_on(image, 0.35)
    resting = np.array([3.0, 3.0, 0.03])
    assert made.filter(tuple(resting), (0, 0, 0), (0, 0, 0))[0][2] < 0
    for wanted in ((0, 0, 0.5), (0, 0, 0)):
        path, _ = fly(made, hulls, resting, np.zeros(3), lambda t, x, w=wanted: w, 0.35, 4.0, taking_off=True)
        assert np.diff(path[:, 2]).min() >= -1e-9
        assert np.abs(path[:, :2] - 3).max() < 1e-6
        assert path[-1, 2] > (0.24 if wanted[2] == 0 else 0.7)
        assert path[:, 2].max() <= 0.75  # the ceiling's underside is at 0.9 m


def test_a_ceiling_above_the_start_is_not_climbed_into():
    """It is nearer than the radius: p is outside of its hull, so its underside stays the way out."""
    made = filter_on(encode_map(boxes_cover([[0, 0, 3, 60, 60, 4]])), 0.35)
    u, status, *_ = made.filter((3, 3, 0.2), (0, 0, 0), (0, 0, 0.5), True)
    assert status == RECOVERING
    assert u[2] < 0


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1e9])
def test_numbers_that_cannot_be_flown_are_refused(bad):
    made = filter_on(encode_map(boxes_cover(ROOM)))
    good = [(1.0, 3.0, 1.0), (0.1, 0.0, 0.0), (0.5, 0.0, 0.0)]
    assert made.filter(*good)[1] == OK
    for k in range(2 if bad == 1e9 else 3):
        words = list(good)
        words[k] = (bad, 0.0, 0.0)
        assert made.filter(*words)[:2] == ([0.0, 0.0, 0.0], REFUSED)


def test_parameters_that_no_proof_covers_are_refused():
    image = encode_map(boxes_cover(ROOM))
    for lag_s, fields in (
        (-0.1, {}),
        (5.1, {}),
        (math.nan, {}),
        (0.3, {"beta": 200.0}),
    ):
        with pytest.raises(ValueError, match="rejects"):
            filter_on(image, lag_s, **fields)


def test_more_hulls_than_rows_limit_the_speed_instead():
    """A tunnel of thin slats: each is a hull, and many are as near."""
    slats = [[4 * k, 0, 0, 4 * k + 4, 40, 2] for k in range(40)] + [
        [4 * k, 0, 5, 4 * k + 4, 40, 7] for k in range(40)
    ]
    image = encode_map(boxes_cover(slats))
    hulls, made = planes_of(image, 0.1), filter_on(image, 0.3, radius_m=0.1, beta=0.5)
    start = np.array([1.0, 2.0, 0.35])
    path, status = fly(
        made, hulls, start, np.zeros(3), lambda t, x: (1.0, 0.0, 0.4 * math.sin(5 * t)), 0.3, 6.0
    )
    assert psi(hulls, path).min() >= 0.1
    assert path[-1, 0] > 1.3
    assert REFUSED not in status
