"""The stack of onboard filters: rows and projection against others, flights of a vehicle that lags."""

import math

import cvxpy as cp
import numpy as np
import pytest
from scipy.optimize import linprog

from alula import _core
from alula.stages.compression.onboard.layout import encode_map
from support.effort import examples
from support.scenes.fabricate import exact_hull, make_cover
from support.scenes.maps import decode, half_spaces

G = 0.05  # edge of a voxel [m]
OK, FILTERED, SHORTENED, RECOVERING, REFUSED = range(5)
EXTENT, RADIUS, BALL, LAG, DT, BETA = 8.0, 0.15, 0.12, 0.35, 0.01, 2.0
HULLS = {"radius_m": RADIUS, "beta": BETA, "dt_s": DT, "v_max": 1.0}
MOVING = {"radius_m": RADIUS, "v_max": 1.0}
SPREAD = np.diag([1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-2])[np.tril_indices(6)]
HALF = np.array([3.0, 3.0, 1.5])
LOW, HIGH = -HALF - 0.8, HALF + 0.8
FACE = np.array([0.6, 0.8, 0.0, 3.9])  # cuts a corner off the box
NO_TRACKS = np.empty((0, 29))
SLACK_M = 1e-3  # of planes that are moved outward, and of single precision


def cover(count=24):
    """Round hulls, 0.4 to 0.8 m across."""
    rng, parts = np.random.default_rng(1), []
    for _ in range(count):
        way = rng.normal(size=(30, 3))
        way /= np.linalg.norm(way, axis=1)[:, None]
        parts.append(
            exact_hull(np.rint(rng.uniform(-HALF, HALF) / G + way * rng.uniform(4, 8, 3)).astype(int))
        )
    return make_cover(parts, g=G)


COVER = cover()
IMAGE = encode_map(COVER, indexed=True)


def unit_rows(hull):
    """Unit normals and offsets (n, 4) of a decoded hull [m]."""
    rows = np.array([(*normal, offset * G) for normal, offset in half_spaces(hull)], float)
    return rows / np.linalg.norm(rows[:, :3], axis=1)[:, None]


ROWS = [unit_rows(hull) for hull in decode(encode_map(COVER, indexed=False))]
OUTSIDE = np.vstack([np.c_[np.eye(3), HIGH], np.c_[-np.eye(3), -LOW], FACE])  # n . p <= d inside the fence


def psi(points):
    """The largest plane value of the nearest hull at points (n, 3) [m]."""
    return np.min([np.max(points @ rows[:, :3].T - rows[:, 3], axis=1) for rows in ROWS], axis=0)


def room(points):
    """Distance of points (n, 3) from the fence, negative outside [m]."""
    return np.min(OUTSIDE[:, 3] - points @ OUTSIDE[:, :3].T, axis=1)


def stack(**others):
    fence = _core.Fence(box=(tuple(LOW.tolist()), tuple(HIGH.tolist())), faces=FACE[None])
    parts = {"fence": fence, "dr_acbf": MOVING} | others
    image, hulls = parts.pop("image", IMAGE), parts.pop("hulls", {})
    return _core.OnboardStack(
        image, _core.PolytopeCbfConfig(**HULLS | hulls), parts.pop("lag_s", LAG), EXTENT, **parts
    )


def single(x):
    """Round to single precision."""
    return np.asarray(x, np.float32).astype(float)


def ball(p, v, number=1, radius=BALL):
    return single(np.concatenate([[number], p, v, SPREAD, [radius]]))[None]


def chord_row(p, q, rows):
    """Normal and bound of a hull's row, by a linear program over (theta, value)."""
    normal, offset = rows[:, :3], rows[:, 3]
    done = linprog(
        [0, 1],
        np.stack([normal @ (q - p), -np.ones(len(normal))], 1),
        offset - normal @ p,
        bounds=[(0, 1), (None, None)],
    )
    assert done.status == 0
    outward = -done.ineqlin.marginals @ normal
    return -outward, BETA * (done.fun - RADIUS), done.fun - RADIUS


def obstacle_rows(p, v, tracks, horizon):
    """Normals and bounds for accelerations of obstacles that close in, in a first tick."""
    gap = tracks[:, 1:4] - p
    d = np.linalg.norm(gap, axis=1)
    n = gap / d[:, None]
    closing = np.maximum(0, -np.sum(n * (tracks[:, 4:7] - v), axis=1))
    weight = np.where(closing > 0, (1 + closing / (closing.max() + 1e-6)) / d, 0)
    near = closing > 0
    n, d, closing, weight = n[near], d[near], closing[near], weight[near]
    alpha = 0.1 * weight / weight.sum()
    sigma = np.sqrt(1e-4 + horizon**2 * 1e-2)
    reff = RADIUS + BALL + 1.0 * 0.02 + 0.5 * 6 * 0.02**2 + 0.5 * 1.0 * horizon**2
    return n, 2 / horizon**2 * (d - reff - closing * horizon - np.sqrt((1 - alpha) / alpha) * sigma)


def encounters(count, seed):
    """States with chords clear of all margins, each with one to three slow obstacles near."""
    rng = np.random.default_rng(seed)
    while count > 0:
        p, v, nominal = rng.uniform(LOW, HIGH), rng.normal(size=3), rng.normal(size=3)
        v *= rng.uniform(0, 0.9) / np.linalg.norm(v)
        nominal *= rng.uniform(0.2, 1.4) / np.linalg.norm(nominal)
        chord = np.linspace(p, p + LAG * v, 20)
        if not RADIUS + SLACK_M < min(psi(chord).min(), room(chord).min()) < RADIUS + 0.4:
            continue
        tracks = []
        for k in range(rng.integers(1, 4)):
            way = rng.normal(size=3)
            way *= rng.uniform(0.3, 1.0) / np.linalg.norm(way)
            tracks.append(ball(p + way, v - 0.3 * way + 0.1 * rng.normal(size=3), k))
        count -= 1
        yield single(p), single(v), single(nominal), np.concatenate(tracks)


def test_the_command_is_the_nearest_velocity_with_all_rows_and_the_speed():
    one, cases, bound, recovering, impossible = stack(), 0, 0, 0, 0
    for p, v, nominal, tracks in encounters(examples(1200), 2):
        one.reset()
        result = one.filter(p, v, nominal, tracks)
        rows = one.rows(result)
        assert result.status < REFUSED
        hard = rows[rows[:, 4] > 0]
        assert (hard[:, 4] == 1).all()
        assert (hard[:, :3] @ result.velocity <= hard[:, 3] + 1e-6).all()
        if result.mode != 0 and result.status != RECOVERING:
            continue  # the manoeuvre's wish is not known here
        x = cp.Variable(3)
        wanted = nominal / max(1.0, np.linalg.norm(nominal))
        among = [rows[:, :3] @ x <= rows[:, 3], cp.norm(x) <= 1]
        problem = cp.Problem(cp.Minimize(cp.sum_squares(x - wanted)), among)
        problem.solve(solver=cp.CLARABEL)
        if result.status == RECOVERING:
            recovering += 1
            impossible += problem.status != "optimal"
            continue
        assert problem.status == "optimal"
        assert np.linalg.norm(result.velocity) <= 1 + 1e-6
        obstacles = rows[rows[:, 4] == 0]
        assert (obstacles[:, :3] @ result.velocity <= obstacles[:, 3] + 4e-4).all()
        assert np.linalg.norm(result.velocity - wanted) <= np.linalg.norm(x.value - wanted) + 1e-3
        assert np.linalg.norm(result.velocity - x.value) < 0.02
        cases += 1
        bound += len(obstacles) > 0 and np.linalg.norm(x.value - wanted) > 1e-2
    assert cases > 0.3 * examples(1200)
    assert bound > 0.05 * examples(1200)
    assert impossible >= 0.98 * recovering > 0  # thin sets may count as empty


def test_rows_are_those_of_linear_programs_the_fence_and_dr_acbf():
    one, hulls, faces, moving = stack(), 0, 0, 0
    for p, v, nominal, tracks in encounters(examples(60), 3):
        one.reset()
        result = one.filter(p, v, nominal, tracks)
        rows, q, wanted = one.rows(result), p + LAG * v, []
        for hull in ROWS:
            n, b, spare = chord_row(p, q, hull)
            if spare < 0.5 - SLACK_M:
                wanted.append((n, b))
                hulls += 1
        for face in OUTSIDE:
            spare = face[3] - RADIUS - max(face[:3] @ p, face[:3] @ q)
            if spare < 0.5 - SLACK_M:
                wanted.append((face[:3], BETA * spare))
                faces += 1
        found = rows[rows[:, 4] > 0]
        for n, b in wanted:
            length = np.linalg.norm(n)
            off = np.abs(found[:, :3] - n / length).max(axis=1) + np.abs(found[:, 3] - b / length)
            assert off.min() < 2e-2
        n, b = obstacle_rows(p, v, tracks, result.horizon_s)
        if result.mode != 0:
            continue
        found = rows[rows[:, 4] == 0]
        assert len(found) == len(n)
        mean = DT / (1 - math.exp(-DT / LAG))
        np.testing.assert_allclose(found[:, :3], n, atol=1e-5)
        np.testing.assert_allclose(
            found[:, 3], n @ v + b * np.where(b < 0, mean, LAG), atol=1e-3 * np.abs(b).max()
        )
        if result.status < RECOVERING:  # the mean acceleration of the tick, and that at its start
            begins = (result.velocity - v) / LAG
            mean_a = (result.velocity - v) / mean
            assert (n @ mean_a <= b + 2e-3)[b < 0].all()
            assert (n @ begins <= b + 2e-3)[b >= 0].all()
            moving += len(n)
    assert min(hulls, faces, moving) > 5


def fly(one, seed, *, has_radar, ticks=600, steps=5):
    """A flight of a vehicle of first order to random goals among thrown balls.

    Returns:
        Minimum psi and room; balls thrown, those that hit; those during which all rows held, and of
        them those that hit.
    """
    rng, share = np.random.default_rng(seed), math.exp(-DT / steps / LAG)

    def place():
        p = rng.uniform(-HALF, HALF)
        while min(psi(p[None])[0], room(p[None])[0]) < RADIUS + 0.05:
            p = rng.uniform(-HALF, HALF)
        return p

    p, v, goal, path, encounters = place(), np.zeros(3), place(), [], []
    one.reset()
    at = way = None
    for tick in range(ticks):
        if tick % 250 == 249:
            goal = place()
        if tick % 120 == 60:
            start = rng.normal(size=3) * [1, 1, 0.3]
            start *= 4 / np.linalg.norm(start)
            time = 4 / rng.uniform(3, 6)
            at, way = p + start, (0.5 * time * v - start) / time
            encounters.append({"hit": False, "held": True})
        tracks = ball(at, way, len(encounters)) if has_radar and encounters else NO_TRACKS
        result = one.filter(p, v, 2 * (goal - p), tracks)
        assert result.status < REFUSED
        u = result.velocity
        if encounters and result.status == RECOVERING:
            encounters[-1]["held"] = False
        for _ in range(steps):
            p, v = p + u * DT / steps + LAG * (1 - share) * (v - u), u + share * (v - u)
            path.append(p)
            if encounters:
                at = at + DT / steps * way
                encounters[-1]["hit"] |= np.linalg.norm(at - p) < RADIUS + BALL
    path = np.array(path)
    held = [e["hit"] for e in encounters if e["held"]]
    return (
        psi(path).min(),
        room(path).min(),
        len(encounters),
        sum(e["hit"] for e in encounters),
        len(held),
        sum(held),
    )


def test_a_vehicle_that_lags_keeps_hulls_and_fence_exactly_and_dodges_thrown_balls():
    one = stack()
    seen, unseen = (
        np.array([fly(one, seed, has_radar=radar) for seed in range(examples(8))]) for radar in (True, False)
    )
    for flights in (seen, unseen):
        assert flights[:, 0].min() >= RADIUS
        assert flights[:, 1].min() >= RADIUS
    assert 5 * seen[:, 3].sum() < unseen[:, 3].sum()
    assert seen[:, 5].sum() == 0  # where all rows held, no ball hit
    assert unseen[:, 3].sum() > 8


def test_without_obstacles_and_fence_it_is_the_chord_filter():
    one, other = stack(fence=None), _core.OnboardChord(IMAGE, _core.PolytopeCbfConfig(**HULLS), LAG, EXTENT)
    rng, seen = np.random.default_rng(5), set()
    for _ in range(300):
        p, v, u = (
            single(rng.uniform(LOW, HIGH)),
            single(rng.normal(size=3) / 2),
            single(rng.normal(size=3) / 2),
        )
        result = one.filter(p, v, u, NO_TRACKS)
        want, status, margin, _ = other.filter(p, v, u)
        assert (result.status, result.margin_m) == (status, margin)
        assert (result.velocity == want).all()
        seen.add(status)
    assert {OK, FILTERED, RECOVERING} <= seen


def test_a_vehicle_that_is_cornered_by_a_ball_sinks_but_into_no_hull_and_not_out_of_the_fence():
    """Against a face of the fence, with a ball that stands in the way for longer than it waits."""
    one = stack()
    p, v, lowest = np.array([HIGH[0] - 0.16, -2.0, LOW[2] + 0.5]), np.zeros(3), np.inf
    statuses = []
    for _ in range(600):
        result = one.filter(p, v, (1.0, 0, 0), ball(p - np.array([0.35, 0, 0]), v + np.array([0.6, 0, 0])))
        u = result.velocity
        p, v = p + u * DT, v + (u - v) * (1 - math.exp(-DT / LAG))
        statuses.append(result.status)
        lowest = min(lowest, psi(p[None])[0])
        assert room(p[None])[0] > RADIUS - 0.01
    assert RECOVERING in statuses
    assert lowest > RADIUS - 0.01


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_not_finite_are_refused_and_the_vehicle_brakes(bad):
    one = stack()
    place = [single([0.3, -2.9, 1.9]), single([0.5, 0, 0]), single([0.5, 0, 0])]
    tracks = ball(place[0] + [3, 0, 0], (-1.0, 0, 0))
    assert one.filter(*place, tracks).status < REFUSED
    for word in range(3):
        for axis in range(3):
            words = [w.copy() for w in place]
            words[word][axis] = bad
            result = one.filter(*words, NO_TRACKS)
            assert result.status == REFUSED
            assert np.abs(result.velocity).max() == 0
    for column in range(1, 29):
        damaged = tracks.copy()
        damaged[0, column] = bad
        result = one.filter(*place, damaged)
        assert result.status == REFUSED
        assert np.abs(result.velocity).max() == 0
    assert one.filter(*place, NO_TRACKS).status < REFUSED


@pytest.mark.parametrize(
    "others",
    [
        {"lag_s": 0.005},
        {"lag_s": math.nan},
        {"lag_s": 0.3},
        {"hulls": {"v_max": 1.2}},
        {"hulls": {"beta": 200.0}},
        {"dr_acbf": {"dt_s": 0.02}},
        {"dr_acbf": {"a_max": 5.0}},
        {"dr_acbf": {"speed": 1.0}},
        {"image": IMAGE[:-1]},
    ],
)
def test_bad_combinations_raise(others):
    with pytest.raises(ValueError, match=r"stack|no such option|truncated"):
        stack(**others)
