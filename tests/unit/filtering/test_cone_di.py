"""The collision cone filter of a double integrator: its rows, its answers, its refusals, its flights."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from support.effort import examples
from support.models.splat_filter_model import cone, gate, outer_matrix, scene

OK, FILTERED, RECOVERING, REFUSED = 0, 1, 3, 4
RADIUS = 0.15
SWELL = 1.01


def index_of(rows, sigma=1.0, radius=RADIUS):
    return _core.EllipsoidIndex(*rows, sigma=sigma, radius=radius)


def ball(*centres, scale=0.3):
    centres = np.atleast_2d(np.array(centres, np.float32))
    n = len(centres)
    return centres, np.full((n, 3), scale, np.float32), np.tile(np.float32([1, 0, 0, 0]), (n, 1))


def swollen(rows, i, sigma=1.0):
    """Centre and matrix of the ellipsoid that the rows are of."""
    return rows[0][i].astype(float), outer_matrix(rows[1][i], rows[2][i], sigma, RADIUS) / SWELL**2


def tick(filt, p, v, a, **errors):
    return filt.filter((*p, 0, 0, 0, *v, 0, 0, 0), tuple(a), **errors)


def contact_time(rows, i, p, v, sigma=1.0):
    """When the path p + t v enters the grown ellipsoid: the least root t >= 0, for a start outside."""
    mu, A = swollen(rows, i, sigma)
    beta, gamma, delta, _ = cone(mu, A, p, v)
    roots = np.roots([beta, -2 * delta, gamma])
    return roots.real.min() if gamma > 0 and np.all(np.isreal(roots)) and roots.real.min() > 0 else np.inf


def rows_of(rows, p, v, items, alpha=5.0, k=5.0, v_min=0.05, sigma=1.0):
    """(row, bound) of the ellipsoids, from their equations."""
    row, bound = [], []
    if np.linalg.norm(v) >= v_min:
        alpha = max([alpha, *(3 / max(contact_time(rows, i, p, v, sigma) - 0.1, 0.05) for i in items)])
    for i in items:
        mu, A = swollen(rows, i, sigma)
        r = mu - p
        beta, gamma, delta, h = cone(mu, A, p, v)
        if gamma >= 0 and np.linalg.norm(v) >= v_min:
            row.append(2 * A @ (gamma * v - delta * r))
            bound.append(-alpha * h)
        else:  # gamma'' + 2 k gamma' + k^2 gamma, gamma' = -2 delta, gamma'' = 2 beta - 2 r^T A a
            row.append(-2 * A @ r)
            bound.append(-(2 * beta - 4 * k * delta + k * k * gamma))
    row, bound = np.array(row).reshape(-1, 3), np.array(bound)
    length = np.linalg.norm(row, axis=1)
    return row / length[:, None], bound / length


def candidates(rows, p, v, count=64):
    """By the gates and the cap, from the distances to all ellipsoids."""
    one = [(rows[0][i : i + 1], rows[1][i : i + 1], rows[2][i : i + 1]) for i in range(len(rows[0]))]
    speed = np.linalg.norm(v)
    end = p + v * (0.3 + speed / 12)
    start, segment = (
        np.array([_core.EllipsoidSet(*r, 1.0).clearance(p[None], e[None], np.inf)[0] for r in one])
        for e in (p, end)
    )
    reach = gate(speed, RADIUS)
    key = np.where(segment > 0, segment, start - reach)
    for i, (mean, scale, quat) in enumerate(one):
        mu, A = mean[0].astype(float), outer_matrix(scale[0], quat[0], 1.0, RADIUS)
        _, gamma, delta, _ = cone(mu, A, p, v)
        if start[i] >= reach or (speed >= 0.05 and delta < 0 and gamma >= 0):
            key[i] = np.inf
    near = np.flatnonzero(key < np.inf)
    return near[np.argsort(key[near], kind="stable")][:count], len(near) > count, reach


def nearest_by_cvxpy(row, bound, nominal, box=None):
    import cvxpy as cp

    a = cp.Variable(3)
    constraints = [row @ a >= bound] + ([cp.abs(a) <= box] if box else [])
    problem = cp.Problem(cp.Minimize(cp.sum_squares(a - nominal)), constraints)
    problem.solve(solver=cp.CLARABEL)
    return a.value if problem.status == "optimal" else None


@settings(max_examples=examples(40), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    speed=st.sampled_from([0.0, 0.02, 0.4, 3.0]),
    count=st.sampled_from([5, 64]),
)
def test_the_answer_is_the_nearest_input_that_holds_the_rows_of_the_candidates(seed, speed, count):
    rng = np.random.default_rng(seed)
    rows = scene(rng, 80)
    p, direction = rng.uniform(-2, 2, 3), rng.normal(size=3)
    v = speed * direction / np.linalg.norm(direction)
    nominal = rng.normal(size=3) * 3
    filt = _core.ConeDi(
        index_of(rows), _core.ConeDiOptions(pruning=_core.Pruning(count=count), lateral_bias=0.0)
    )
    report = tick(filt, p, v, nominal)
    items, capped, reach = candidates(rows, p, v, count)
    assert (report["candidates"], report["capped"], report["rows"]) == (len(items), capped, len(items))
    assert report["gate_m"] == pytest.approx(reach, rel=1e-12)
    row, bound = rows_of(rows, p, v, items)
    expected = nearest_by_cvxpy(row, bound, nominal) if len(items) else nominal
    a = np.array(report["acceleration"])
    if expected is None:
        assert report["infeasible"]
        assert report["status"] in (FILTERED, RECOVERING)
        return
    assert not report["infeasible"]
    assert len(items) == 0 or (row @ a - bound).min() >= -1e-7 * (1 + np.linalg.norm(a))
    # Against the interior point solver by value: it is no better than its tolerance.
    assert np.linalg.norm(a - nominal) <= np.linalg.norm(expected - nominal) * (1 + 1e-5) + 1e-5
    np.testing.assert_allclose(a, expected, atol=1e-3 * (1 + np.linalg.norm(expected - nominal)))
    if len(items) == 0 or (row @ nominal - bound).min() > 1e-9:
        assert (
            report["acceleration"] == tuple(nominal.tolist())
            or list(report["acceleration"]) == nominal.tolist()
        )
        assert report["status"] in (OK, RECOVERING)


def test_the_margin_is_the_least_barrier_and_the_active_row_is_named():
    rows = ball([0.9, 0.05, 0], [0, 5, 0], [1.6, 3, 0])
    filt = _core.ConeDi(index_of(rows))
    p, v = np.zeros(3), np.array([2.0, 0, 0])
    report = tick(filt, p, v, (0, 0, 0))
    assert report["margin"] == pytest.approx(cone(*swollen(rows, 0), p, v)[3], rel=1e-9)
    assert report["active"] == 0
    assert report["status"] == FILTERED
    assert report["iterations"] > 0


def test_a_nominal_input_that_holds_comes_back_bit_by_bit():
    filt = _core.ConeDi(index_of(ball([3, 0, 0])))
    nominal = (0.1, 1 / 3, -7e-17)
    report = tick(filt, (0, 0, 0), (-1, 0.2, 0), nominal)
    assert tuple(report["acceleration"]) == nominal
    assert report["status"] == OK
    assert report["active"] == -1
    assert report["rows"] == 0
    assert report["margin"] == np.inf


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(bad):
    filt = _core.ConeDi(index_of(ball([1, 0, 0])), _core.ConeDiOptions(clf_weight=10.0))
    good = [(0.0, 0, 0), (1.0, 0, 0), (0.0, 0, 0)]
    for slot in range(3):
        values = [list(x) for x in good]
        values[slot][1] = bad
        report = tick(filt, *values)
        assert report["status"] == REFUSED
        assert tuple(report["acceleration"]) == (0, 0, 0)
    report = tick(filt, *good, position_error=(0, bad, 0))
    assert report["status"] == REFUSED
    assert tuple(report["acceleration"]) == (0, 0, 0)
    report = tick(filt, (0, 0, 0), (1e200, 0, 0), (0, 0, 0))
    assert report["status"] == REFUSED
    assert tuple(report["acceleration"]) == (0, 0, 0)


def test_a_program_without_solution_is_reported_and_braked():
    rows = ball([1.0, 0, 0], scale=0.5)
    filt = _core.ConeDi(index_of(rows), _core.ConeDiOptions(max_acceleration=2.0))
    v = np.array([3.0, 0.3, 0])
    report = tick(filt, (0, 0, 0), v, (9, 0, 0))
    a = np.array(report["acceleration"])
    assert report["infeasible"]
    assert report["status"] == RECOVERING
    np.testing.assert_allclose(a, -v * 2 / 3, rtol=1e-12)  # along the path, within the box
    assert np.abs(a).max() <= 2 * (1 + 1e-12)
    without = tick(_core.ConeDi(index_of(rows)), (0, 0, 0), v, (9, 0, 0))
    assert not without["infeasible"]
    assert without["status"] == FILTERED


@settings(max_examples=examples(60), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), box=st.sampled_from([1.0, 6.0, 30.0]))
def test_inputs_stay_within_the_box(seed, box):
    rng = np.random.default_rng(seed)
    rows = scene(rng, 60)
    filt = _core.ConeDi(index_of(rows), _core.ConeDiOptions(max_acceleration=box))
    p, v = rng.uniform(-2, 2, 3), rng.normal(size=3) * 2
    report = tick(filt, p, v, rng.normal(size=3) * 10)
    a = np.array(report["acceleration"])
    assert np.abs(a).max() <= box * (1 + 1e-8)
    row, bound = rows_of(rows, p, v, candidates(rows, p, v)[0])
    holds = len(bound) == 0 or (row @ a - bound).min() >= -1e-7 * (1 + box)
    assert holds or (report["infeasible"] and report["status"] == RECOVERING)
    if report["infeasible"]:
        assert np.linalg.norm(np.cross(a, v)) <= 1e-12 * np.linalg.norm(v) * box
        assert a @ v <= 0


def test_braking_along_the_path_meets_every_cone_with_equality():
    rng = np.random.default_rng(8)
    rows = scene(rng, 80)
    for _ in range(20):
        p, v = rng.uniform(-2, 2, 3), rng.normal(size=3)
        outside = [i for i in range(80) if cone(*swollen(rows, i), p, v)[1] > 0]
        row, bound = rows_of(rows, p, v, outside)
        alpha = max([5.0, *(3 / max(contact_time(rows, i, p, v) - 0.1, 0.05) for i in outside)])
        np.testing.assert_allclose(row @ (-alpha / 2 * v), bound, atol=1e-10 * alpha * np.linalg.norm(v))


def test_inside_it_leads_out_and_says_so():
    rows = ball([0.3, 0, 0], scale=0.5)
    filt = _core.ConeDi(index_of(rows))
    p, v, dt = np.zeros(3), np.zeros(3), 0.01
    A = outer_matrix(rows[1][0], rows[2][0], 1.0, RADIUS)
    gamma = cone(rows[0][0].astype(float), A, p, v)[1]
    assert gamma < 0
    for _ in range(300):
        report = tick(filt, p, v, (0, 0, 0))
        before = cone(rows[0][0].astype(float), A, p, v)[1]
        assert (report["status"] == RECOVERING) == (before < 0)
        a = np.array(report["acceleration"])
        p, v = p + dt * v + dt**2 / 2 * a, v + dt * a
    assert cone(rows[0][0].astype(float), A, p, v)[1] > -0.02 > gamma


def test_head_on_the_bias_turns_aside_and_without_it_the_vehicle_only_brakes():
    rows, goal = ball([2.0, 0, 0]), np.array([4.0, 0, 0])
    ends = {}
    for bias in (0.0, 0.5):
        filt = _core.ConeDi(index_of(rows), _core.ConeDiOptions(lateral_bias=bias))
        p, v, dt = np.zeros(3), np.array([0.5, 0, 0]), 0.01
        for _ in range(2000):
            a = np.array(tick(filt, p, v, 1.0 * (goal - p) - 2 * v)["acceleration"])
            p, v = p + dt * v + dt**2 / 2 * a, v + dt * a
        ends[bias] = p
    assert np.linalg.norm(ends[0.5] - goal) < 0.1
    assert ends[0.0][0] < 2.0
    assert abs(ends[0.0][1]) < 1e-9
    first = tick(_core.ConeDi(index_of(rows)), (1.3, 0, 0), (1, 0, 0), (1, 0, 0))
    assert first["acceleration"][1] == pytest.approx(-0.5)
    assert first["acceleration"][2] == 0


def test_the_tracking_row_is_soft():
    rows = ball([0.75, 0.02, 0])
    errors = {
        "position_error": (-0.5, 0.1, 0.4),
        "velocity_error": (0.3, 0, 0.8),
        "reference_acceleration": (1, 0, 0),
    }
    p, v = np.zeros(3), np.array([1.0, 0.1, 0])
    e = np.concatenate([errors["position_error"], errors["velocity_error"]])
    kp, kv, rate, weight = 3.0, 2.0, 0.5, 25.0
    from scipy.linalg import solve_continuous_lyapunov

    P = solve_continuous_lyapunov(np.array([[0, 1], [-kp, -kv]]).T, -np.eye(2))
    y = P[1, 0] * e[:3] + P[1, 1] * e[3:]
    x = P[0, 0] * e[:3] + P[0, 1] * e[3:]
    V = 0.5 * (e[:3] @ x + e[3:] @ y)
    # V' = e_v . x + y . (a - a_r) <= -c V + xi
    limit = y @ np.array([1.0, 0, 0]) - e[3:] @ x - rate * V
    row, bound = rows_of(rows, p, v, [0])

    import cvxpy as cp

    a, xi = cp.Variable(3), cp.Variable()
    nominal = np.array([2.0, 0.5, 0])
    cp.Problem(
        cp.Minimize(cp.sum_squares(a - nominal) / 2 + weight / 2 * xi**2),
        [row @ a >= bound, y @ a <= limit + xi, xi >= 0],
    ).solve(solver=cp.CLARABEL, tol_gap_abs=1e-12, tol_gap_rel=1e-12, tol_feas=1e-12)
    filt = _core.ConeDi(
        index_of(rows), _core.ConeDiOptions(clf_weight=weight, clf_rate=rate, lateral_bias=0.0)
    )
    report = tick(filt, p, v, nominal, **errors)
    np.testing.assert_allclose(report["acceleration"], a.value, atol=1e-6)
    off = tick(_core.ConeDi(index_of(rows), _core.ConeDiOptions(lateral_bias=0.0)), p, v, nominal, **errors)
    assert np.linalg.norm(np.subtract(off["acceleration"], a.value)) > 1e-3
    assert (row @ np.array(report["acceleration"]) - bound).min() >= -1e-9
    tracking = np.array([1.0, 0, 0]) - kp * e[:3] - kv * e[3:]
    free = tick(
        _core.ConeDi(index_of(ball([50, 0, 0])), _core.ConeDiOptions(clf_weight=weight)),
        p,
        v,
        tracking,
        **errors,
    )
    assert free["status"] == OK


def fly(filt, rows, start, goal, *, seconds, dt=1e-3, every=1, speed=2.0):
    """A double integrator towards a goal; its least clearance from the ungrown ellipsoids."""
    p, v, path, statuses = np.array(start, float), np.zeros(3), [], set()
    for step in range(round(seconds / dt)):
        if step % every == 0:
            to = goal - p
            wanted = to * min(1.0, speed / max(np.linalg.norm(to), 1e-9))
            report = tick(filt, p, v, 3 * (wanted - v))
            statuses.add(report["status"])
            a = np.array(report["acceleration"])
        p, v = p + dt * v + dt**2 / 2 * a, v + dt * a
        path.append(p)
    path = np.array(path)
    clearance = _core.EllipsoidSet(*rows, 1.0).clearance(path[:-1], path[1:], np.inf)
    return clearance.min(), path, statuses


@pytest.mark.parametrize("seed", [0, 1, 3, 4])
def test_a_double_integrator_never_comes_nearer_than_its_radius(seed):
    rng = np.random.default_rng(seed)
    mean, scale, quat = scene(rng, 400, size=2.0, low=-2.0, high=-0.8)
    start, goal = np.array([-2.5, 0.1, 0.0]), np.array([2.5, -0.2, 0.1])
    far = (np.linalg.norm(mean - start, axis=1) > 0.9) & (np.linalg.norm(mean - goal, axis=1) > 0.9)
    rows = mean[far], scale[far], quat[far]
    filt = _core.ConeDi(index_of(rows))
    least, path, statuses = fly(filt, rows, start, goal, seconds=3.5)
    assert least >= RADIUS
    assert REFUSED not in statuses
    assert np.linalg.norm(path - start, axis=1).max() > 1.0  # it does fly
    unfiltered = np.linspace(start, goal, 200)
    assert _core.EllipsoidSet(*rows, 1.0).clearance(unfiltered[:-1], unfiltered[1:], np.inf).min() < RADIUS


def test_the_published_rate_alone_is_too_slow_for_what_enters_the_gate_ahead():
    rows, start, goal = ball([2.0, 0.1, 0.05]), np.zeros(3), np.array([4.0, 0, 0])
    least = {}
    for recovery in (0.0, 3.0):
        filt = _core.ConeDi(
            index_of(rows),
            _core.ConeDiOptions(recovery=recovery, pruning=_core.Pruning(reaction_time_s=0.05)),
        )
        least[recovery] = fly(filt, rows, start, goal, seconds=2.5)[0]
    assert least[0.0] < RADIUS <= least[3.0]


def test_gates_can_be_switched_off_for_comparison():
    rng = np.random.default_rng(11)
    rows = scene(rng, 300)
    index = index_of(rows)
    p, v = np.array([0.5, 0, 0]), np.array([-1.0, 0.2, 0])
    everything = tick(
        _core.ConeDi(index, _core.ConeDiOptions(pruning=_core.Pruning(gate=False, approach=False))),
        p,
        v,
        (0, 0, 0),
    )
    assert everything["rows"] == 300
    assert everything["gate_m"] == np.inf
    assert not everything["capped"]
    approaching = tick(
        _core.ConeDi(index, _core.ConeDiOptions(pruning=_core.Pruning(gate=False))), p, v, (0, 0, 0)
    )
    assert 0 < approaching["rows"] < 300
    uncapped = tick(
        _core.ConeDi(index, _core.ConeDiOptions(pruning=_core.Pruning(count=0, floor_m=3.0))), p, v, (0, 0, 0)
    )
    capped = tick(
        _core.ConeDi(index, _core.ConeDiOptions(pruning=_core.Pruning(count=10, floor_m=3.0))),
        p,
        v,
        (0, 0, 0),
    )
    assert uncapped["rows"] > 10 == capped["rows"]
    assert capped["capped"]
    assert not uncapped["capped"]


def test_clones_agree_and_options_that_mean_nothing_are_refused():
    rng = np.random.default_rng(12)
    rows = scene(rng, 100)
    index = index_of(rows)
    filt = _core.ConeDi(index)
    p, v, a = (0, 0, 0), (1.0, 0.5, 0.1), (3.0, 0, 0)
    assert tick(filt, p, v, a) == tick(filt.clone(), p, v, a) == tick(filt, p, v, a)
    assert filt.kind == "acceleration"
    assert isinstance(filt, _core.SafetyFilter)
    for wrong in (
        {"alpha": 0.0},
        {"min_speed": 0.0},
        {"max_acceleration": -1.0},
        {"clf_weight": -1.0},
        {"clf_kp": 0.0},
        *({name: bad} for name in ("alpha", "min_speed", "clf_kp") for bad in (np.inf, np.nan, -1.0)),
    ):
        with pytest.raises(ValueError, match=r"must be"):
            _core.ConeDi(index, _core.ConeDiOptions(**wrong))
    with pytest.raises(ValueError, match="deceleration"):
        _core.ConeDi(index, _core.ConeDiOptions(pruning=_core.Pruning(max_deceleration=0.0)))
