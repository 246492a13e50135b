"""The distance filter of SAFER-Splat against a NumPy model of the published algorithm."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from support.effort import examples
from support.models.splat_filter_model import distance_barrier, gate, scene

OK, FILTERED, RECOVERING, REFUSED = 0, 1, 3, 4
RADIUS = 0.1


def index_of(rows, sigma=1.0, radius=RADIUS, loss=None):
    return _core.EllipsoidIndex(*rows, sigma=sigma, radius=radius, loss=loss)


def everything(rows, **options):
    """As published: the rows of all ellipsoids, each measured, in one program."""
    pruning = _core.Pruning(gate=False)
    return _core.SaferSplat(
        index_of(rows), _core.SaferSplatOptions(rows="nearest", brute=True, pruning=pruning, **options)
    )


def tick(filt, p, v, a):
    return filt.filter((*p, 0, 0, 0, *v, 0, 0, 0), tuple(a))


def model(rows, p, v, *, published=False, sigma=1.0, items=None):
    numbers = range(len(rows[0])) if items is None else items
    barriers = [
        distance_barrier(*(a[i].astype(float) for a in rows), sigma, RADIUS, p, v, published=published)
        for i in numbers
    ]
    h = np.array([b[0] for b in barriers])
    return h, np.array([b[1] for b in barriers]).reshape(-1, 3), np.array([b[2] for b in barriers])


@pytest.mark.parametrize("hessian", ["correct", "published"])
@settings(max_examples=examples(50), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), sigma=st.sampled_from([1.0, 3.37]))
def test_barriers_are_those_of_the_model(hessian, seed, sigma):
    rng = np.random.default_rng(seed)
    rows = scene(rng, 20, low=-2.5, high=0.0)
    p, v = rng.uniform(-2, 2, 3), rng.normal(size=3)
    filt = _core.SaferSplat(index_of(rows, sigma), _core.SaferSplatOptions(hessian=hessian))
    h, row, bound = model(rows, p, v, published=hessian == "published", sigma=sigma)
    for i in range(20):
        actual = filt.barrier(i, tuple(p), tuple(v))
        assert actual[0] == pytest.approx(h[i], rel=1e-8, abs=1e-9)
        np.testing.assert_allclose(actual[1], row[i], rtol=1e-7, atol=1e-8)
        assert actual[2] == pytest.approx(bound[i], rel=1e-6, abs=1e-7 * (1 + np.abs(bound[i])))


@pytest.mark.parametrize("inside", [False, True])
def test_the_hessian_is_the_derivative_of_the_gradient(inside):
    rng = np.random.default_rng(int(inside))
    mean, scale, quat = np.zeros((1, 3), np.float32), np.float32([[0.5, 0.9, 0.3]]), rng.normal(size=(1, 4))
    rows = mean, scale, quat.astype(np.float32)
    filt = _core.SaferSplat(index_of(rows))
    for _ in range(30):
        p = rng.normal(size=3)
        p *= (0.15 if inside else 2.0) / np.linalg.norm(p)
        v, step = rng.normal(size=3), 1e-6
        ahead, behind = (np.array(filt.barrier(0, tuple(p + s * step * v), (0, 0, 0))[1]) for s in (1, -1))
        curvature = v @ (ahead - behind) / (2 * step)
        h, row, bound = filt.barrier(0, tuple(p), tuple(v))
        assert -(bound + 6 * np.dot(row, v) + 5 * h) == pytest.approx(curvature, rel=1e-5, abs=1e-7)
        values = [filt.barrier(0, tuple(p + s * step * v), (0, 0, 0))[0] for s in (1, -1)]
        assert np.dot(row, v) == pytest.approx((values[0] - values[1]) / (2 * step), rel=1e-6, abs=1e-8)


def test_the_published_hessian_differs_where_the_frames_do():
    rng = np.random.default_rng(3)
    rows = scene(rng, 200, low=-1.5, high=0.0)
    p, v = np.array([0.3, 0.1, -0.2]), np.array([0.5, -0.4, 0.3])
    correct, published = (
        _core.SaferSplat(index_of(rows), _core.SaferSplatOptions(hessian=name))
        for name in ("correct", "published")
    )
    pairs = [[f.barrier(i, tuple(p), tuple(v))[2] for f in (correct, published)] for i in range(200)]
    differences = np.abs(np.diff(pairs, axis=1)).ravel()
    assert np.median(differences) > 1e-2
    # A rotation that only sorts and mirrors leaves nothing to differ.
    plain = np.zeros((1, 3), np.float32), np.float32([[0.9, 0.5, 0.3]]), np.float32([[1, 0, 0, 0]])
    pair = [
        _core.SaferSplat(index_of(plain), _core.SaferSplatOptions(hessian=name)).barrier(
            0, (1, 1, 1), tuple(v)
        )
        for name in ("correct", "published")
    ]
    assert pair[0] == pair[1]


def nearest_by_cvxpy(row, bound, nominal):
    import cvxpy as cp

    a = cp.Variable(3)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(a - nominal)), [row @ a >= bound])
    problem.solve(solver=cp.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)
    return a.value if problem.status == "optimal" else None


@pytest.mark.parametrize("hessian", ["correct", "published"])
@settings(max_examples=examples(20), deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_answer_is_that_of_the_model_and_an_interior_point_solver(hessian, seed):
    rng = np.random.default_rng(seed)
    rows = scene(rng, 60)
    p, v, nominal = rng.uniform(-2, 2, 3), rng.normal(size=3) * 0.3, rng.normal(size=3)
    report = tick(everything(rows, hessian=hessian), p, v, nominal)
    h, row, bound = model(rows, p, v, published=hessian == "published")
    assert report["rows"] == 60
    assert report["gate_m"] == np.inf
    assert report["margin"] == pytest.approx(h.min(), rel=1e-8, abs=1e-9)
    length = np.linalg.norm(row, axis=1)
    row, bound = row / length[:, None], bound / length
    expected = nearest_by_cvxpy(row, bound, nominal)
    if report["infeasible"] or expected is None:
        assert report["infeasible"]
        assert expected is None
        return
    a = np.array(report["acceleration"])
    assert (row @ a - bound).min() >= -1e-6 * (1 + np.linalg.norm(a))
    np.testing.assert_allclose(a, expected, atol=1e-5 * (1 + np.linalg.norm(expected - nominal)))
    assert (report["status"] == RECOVERING) == (h.min() < 0)


@settings(max_examples=examples(30), deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.sampled_from([0, 4, 64]))
def test_the_index_changes_nothing(seed, count):
    rng = np.random.default_rng(seed)
    rows, index = scene(rng, 150), None
    index = index_of(rows)
    pruning = _core.Pruning(count=count, floor_m=1.0)
    p, v, nominal = rng.uniform(-2, 2, 3), rng.normal(size=3), rng.normal(size=3) * 2
    by_tree, by_scan = (
        tick(
            _core.SaferSplat(index, _core.SaferSplatOptions(rows="nearest", brute=brute, pruning=pruning)),
            p,
            v,
            nominal,
        )
        for brute in (False, True)
    )
    np.testing.assert_allclose(by_tree.pop("acceleration"), by_scan.pop("acceleration"), atol=1e-9)
    assert by_tree.pop("margin") == pytest.approx(by_scan.pop("margin"), abs=1e-12)
    if count == 0:  # rows on demand: those that decide, of the same ellipsoids
        for report in (by_tree, by_scan):
            for name in ("candidates", "rows", "iterations", "active"):
                del report[name]
    assert by_tree == by_scan
    assert by_tree["gate_m"] == pytest.approx(gate(np.linalg.norm(v), RADIUS, floor_m=1.0))


def test_a_nominal_input_that_holds_comes_back_bit_by_bit_and_nonsense_is_refused():
    rows = np.float32([[2, 0, 0]]), np.full((1, 3), 0.2, np.float32), np.float32([[1, 0, 0, 0]])
    filt = _core.SaferSplat(index_of(rows))
    nominal = (0.1, 1 / 3, -7e-17)
    report = tick(filt, (0, 0, 0), (-0.1, 0, 0), nominal)
    assert tuple(report["acceleration"]) == nominal
    assert report["status"] == OK
    assert report["candidates"] == 1
    assert report["rows"] == 0  # it takes none to see that
    for bad in (np.nan, np.inf):
        for slot in range(3):
            values = [[0.0, 0, 0], [0.1, 0, 0], [0.0, 0, 0]]
            values[slot][2] = bad
            refused = tick(filt, *values)
            assert refused["status"] == REFUSED
            assert tuple(refused["acceleration"]) == (0, 0, 0)


def test_a_program_without_solution_is_reported_and_braked():
    mean = np.float32([[0.35, 0, 0], [-0.35, 0, 0]])
    rows = mean, np.full((2, 3), 0.2, np.float32), np.tile(np.float32([1, 0, 0, 0]), (2, 1))
    v = np.array([0.3, 0.05, 0])
    report = tick(everything(rows, max_acceleration=0.5), (0, 0, 0), v, (0, 0, 0))
    assert report["infeasible"]
    assert report["status"] == RECOVERING
    np.testing.assert_allclose(report["acceleration"], -v * 0.5 / 0.3)


def test_losses_add_to_the_radius():
    rows = np.zeros((1, 3), np.float32), np.full((1, 3), 0.25, np.float32), np.float32([[1, 0, 0, 0]])
    loss = np.float32([[0.125, 0, 0]])
    h = _core.SaferSplat(index_of(rows, loss=loss)).barrier(0, (1.0, 0, 0), (0, 0, 0))[0]
    assert h == pytest.approx(0.75**2 - (RADIUS + 0.125) ** 2, rel=1e-7)


def test_a_double_integrator_keeps_its_distance_and_slows_down_far_away():
    rows = np.float32([[2, 0.05, 0]]), np.full((1, 3), 0.3, np.float32), np.float32([[1, 0, 0, 0]])
    filt = _core.SaferSplat(index_of(rows))
    p, v, dt, goal, path = np.zeros(3), np.zeros(3), 1e-3, np.array([4.0, 0, 0]), []
    for _ in range(6000):
        to = goal - p
        a = np.array(tick(filt, p, v, 3 * (to * min(1, 3 / np.linalg.norm(to)) - v))["acceleration"])
        p, v = p + dt * v + dt**2 / 2 * a, v + dt * a
        path.append((*p, np.linalg.norm(v)))
    path = np.array(path)
    clearance = _core.EllipsoidSet(*rows, 1.0).clearance(path[:-1, :3].copy(), path[1:, :3].copy(), np.inf)
    assert clearance.min() >= RADIUS - 1e-6
    heading = (clearance > 0.5) & (path[1:, 0] < 1.3) & (path[1:, 3] > 0.3)
    assert path[1:, 3][heading].max() < 1.5  # far below the 3 m/s that were asked for


def test_options_that_mean_nothing_are_refused():
    index = index_of(scene(np.random.default_rng(0), 3))
    for wrong in (
        {"alpha": 0.0},
        {"beta": -1.0},
        {"max_braking": np.inf},
        {"hessian": "both"},
        {"rows": "some"},
    ):
        with pytest.raises(ValueError, match=r"must be"):
            _core.SaferSplat(index, _core.SaferSplatOptions(**wrong))
    with pytest.raises(IndexError):
        _core.SaferSplat(index).barrier(3, (0, 0, 0), (0, 0, 0))


def wall(x, step=0.1):
    """Balls of 6 cm in a plane across the way."""
    y, z = np.mgrid[-1.5:1.55:step, -1.5:1.55:step]
    mean = np.stack([np.full(y.size, x), y.ravel(), z.ravel()], axis=1).astype(np.float32)
    count = len(mean)
    return mean, np.full((count, 3), 0.06, np.float32), np.tile(np.float32([1, 0, 0, 0]), (count, 1))


@pytest.mark.parametrize("speed", [1.0, 2.0, 4.0, 6.0])
def test_a_ball_that_enters_the_default_gate_asks_for_half_of_the_slow_pole_times_the_speed(speed):
    """With the gate of the cones, no quadrotor realises what the first row asks for."""

    def asked(options):
        far = np.float32([[90, 0, 0]]), np.full((1, 3), 0.2, np.float32), np.float32([[1, 0, 0, 0]])
        v = (speed, 0, 0)
        gate_m = tick(_core.SaferSplat(index_of(far), options), (0, 0, 0), v, (0, 0, 0))["gate_m"]
        x = 90 - 0.2 - gate_m + 1e-6
        return -tick(_core.SaferSplat(index_of(far), options), (x, 0, 0), v, (0, 0, 0))["acceleration"][0]

    assert asked(_core.SaferSplatOptions(rows="nearest")) <= speed / 2 + 0.1  # beta = 1
    cones = _core.Pruning(floor_m=0.5, count=64)
    assert asked(_core.SaferSplatOptions(rows="nearest", pruning=cones)) > 2.5 * speed


def test_kept_candidates_are_those_of_the_first_call():
    rows = wall(2.0)
    kept = _core.SaferSplat(
        index_of(rows),
        _core.SaferSplatOptions(rows="nearest", pruning=_core.Pruning(count=4, floor_m=3.0, prune_ticks=3)),
    )
    here, there, nominal = (0, 1, 0), (0, -1, 0), (1.0, 0, 0)
    first = tick(kept, here, (1, 0, 0), nominal)["margin"]
    margins = [tick(kept, there, (1, 0, 0), nominal)["margin"] for _ in range(3)]
    assert margins[0] == margins[1] > margins[2]  # of ellipsoids 2 m to the side, until the gate looks again
    assert margins[2] == pytest.approx(first)
    tick(kept, here, (1, 0, 0), nominal)
    kept.reset()
    assert tick(kept, there, (1, 0, 0), nominal)["margin"] == pytest.approx(first)
    with pytest.raises(ValueError, match="at least 1"):
        _core.SaferSplat(index_of(rows), _core.SaferSplatOptions(pruning=_core.Pruning(prune_ticks=0)))
