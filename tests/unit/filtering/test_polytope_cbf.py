"""The onboard polytope filter against double-precision brute force, exact arithmetic and a QP solver."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.stages.filtering.protocol import FilterStatus
from support.effort import examples

OK, FILTERED, SHORTENED, RECOVERING, REFUSED, _ = FilterStatus
LARGEST_FLOAT = float(np.finfo(np.float32).max)


def boxes(lower, upper):
    """Planes of axis-aligned boxes: normal (6n, 3), offset (6n), plane_start (n + 1)."""
    lower, upper = np.atleast_2d(lower), np.atleast_2d(upper)
    normal = np.tile(np.vstack([np.eye(3), -np.eye(3)]), (len(lower), 1))
    offset = np.hstack([upper, -lower]).ravel()
    return normal, offset, 6 * np.arange(len(lower) + 1)


def polytopes(rng, count, size=0.5, spread=3.0):
    """Random convex hulls of points: every other one with the planes of its box as well."""
    from scipy.spatial import ConvexHull

    normals, offsets = [], []
    for k in range(count):
        points = rng.uniform(-spread, spread, 3) + rng.normal(scale=size, size=(rng.integers(5, 30), 3))
        planes = ConvexHull(points).equations
        normal, offset = planes[:, :3], -planes[:, 3]
        if k % 2:
            normal = np.vstack([normal, np.eye(3), -np.eye(3)])
            offset = np.concatenate([offset, points.max(0), -points.min(0)])
        normals.append(normal / np.linalg.norm(normal, axis=1)[:, None])
        offsets.append(offset)
    start = np.cumsum([0] + [len(o) for o in offsets])
    return np.vstack(normals), np.concatenate(offsets), start


def reference(planes, points, kappa, smoothing="sound"):
    """psi, smooth psi and its gradient in double precision, all planes."""
    normal, offset, start = planes
    value = points @ normal.T - offset
    hard, soft, slope = [], [], []
    for a, b in pairwise(start):
        v = value[:, a:b]
        top = v.max(axis=1)
        weight = np.exp(kappa * (v - top[:, None]))
        total = weight.sum(axis=1)
        count = b - a if smoothing == "sound" else 1
        hard.append(top)
        soft.append(top + np.log(total / count) / kappa)
        slope.append(weight @ normal[a:b] / total[:, None])
    hard, soft, slope = np.array(hard).T, np.array(soft).T, np.array(slope)
    least = soft.min(axis=1)
    weight = np.exp(-kappa * (soft - least[:, None]))
    total = weight.sum(axis=1)
    gradient = np.einsum("nk,kni->ni", weight, slope) / total[:, None]
    return hard.min(axis=1), least - np.log(total) / kappa, gradient


def make(planes, **options):
    return _core.PolytopeCbf(*planes, **{"extent_m": 20.0, "radius_m": 0.1, **options})


@pytest.mark.parametrize("smoothing", ["sound", "paper"])
@pytest.mark.parametrize("kappa", [1.0, 20.0, 100.0, 1e4])
def test_values_and_gradients_agree_with_double_precision(kappa, smoothing):
    rng = np.random.default_rng(0)
    planes, points = polytopes(rng, 25), rng.uniform(-5, 5, (400, 3))
    cbf = make(planes, kappa=kappa, smoothing=smoothing)
    smooth, hard, gradient = cbf.psi(points)
    want_hard, want_smooth, want_gradient = reference(planes, points, kappa, smoothing)
    slack = cbf.map_arrays()[5]
    assert slack < 1e-4
    # logarithms and sums of floats: a few 1e-7 of 18 / kappa; leaving out terms: 25 of 1.5e-8 / kappa
    tolerance = slack + 1e-5 / kappa
    assert np.abs(hard - want_hard).max() < tolerance
    assert np.abs(smooth - want_smooth).max() < tolerance
    # a value off by `slack` turns a softmax weight by the factor exp(kappa * slack)
    assert np.abs(gradient - want_gradient).max() < 1e-5 + 4 * kappa * slack


def test_the_smooth_barrier_never_exceeds_the_hard_one_nor_the_hard_one_the_truth():
    rng = np.random.default_rng(1)
    planes, points = polytopes(rng, 30, size=1.0), rng.uniform(-4, 4, (3000, 3))
    smooth, hard, _ = make(planes).psi(points)
    true_hard, _, _ = reference(planes, points, 100.0)
    assert (smooth <= hard).all()
    assert (hard <= true_hard).all()


def test_the_printed_smoothing_believes_itself_outside_while_inside():
    rng = np.random.default_rng(2)
    planes = polytopes(rng, 1, size=0.05)
    inside = rng.normal(scale=0.02, size=(2000, 3)) + reference_centre(planes)
    true_hard, _, _ = reference(planes, inside, 100.0)
    inside = np.ascontiguousarray(inside[true_hard < 0])
    assert len(inside) > 100
    assert (make(planes, smoothing="paper").psi(inside)[0] > 0).any()
    assert (make(planes).psi(inside)[0] < 0).all()


def reference_centre(planes):
    """The deepest point, by linear programming."""
    from scipy.optimize import linprog

    normal, offset, _ = planes
    columns = np.hstack([normal, np.ones((len(normal), 1))])
    done = linprog([0, 0, 0, -1], A_ub=columns, b_ub=offset, bounds=[(None, None)] * 4)
    return done.x[:3]


@pytest.mark.parametrize("extent", [1.0, 50.0, 3e3, 1e6])
def test_outward_rounding_holds_in_exact_arithmetic(extent):
    rng = np.random.default_rng(3)
    normal = rng.normal(size=(300, 3))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    offset = rng.uniform(-extent, extent, 300)
    points = rng.uniform(-extent, extent, (40, 3))
    for n, d in zip(normal, offset, strict=True):
        cbf = _core.PolytopeCbf(n[None], d[None], np.array([0, 1]), extent_m=extent, radius_m=0.0)
        point = points[rng.integers(len(points))]
        (hard,) = cbf.psi(point[None])[1]
        exact = sum(Fraction(a) * Fraction(b) for a, b in zip(n, point, strict=True)) - Fraction(d)
        assert Fraction(hard) <= exact
        assert float(exact) - hard < 4e-6 * extent  # outward, but not by much


@pytest.mark.parametrize("smoothing", ["sound", "paper"])
@pytest.mark.parametrize("kappa", [2.0, 100.0, 1e5])
def test_culling_changes_no_bit(kappa, smoothing):
    rng = np.random.default_rng(4)
    planes, points = polytopes(rng, 60, spread=6.0), rng.uniform(-8, 8, (1500, 3))
    options = {"kappa": kappa, "smoothing": smoothing, "dt_s": 0.3, "beta": 3.0, "v_max": 4.0}
    culled, brute = make(planes, **options), make(planes, **options, brute_force=True)
    for a, b in zip(culled.psi(points), brute.psi(points), strict=True):
        assert a.tobytes() == b.tobytes()
    seen = set()
    for x, u in zip(points[:500], rng.normal(scale=2.0, size=(500, 3)), strict=True):
        result = culled.filter(x, u)
        assert result == brute.filter(x, u)
        seen.add(result[1])
    assert {OK, FILTERED} <= seen
    assert smoothing == "paper" or {RECOVERING, REFUSED} & seen
    assert (SHORTENED in seen) == (smoothing == "sound" and kappa > 2)


@pytest.mark.parametrize(("v_max", "beta"), [(10.0, 2.0), (1.0, 5.0), (0.5, 50.0)])
def test_the_filter_solves_its_quadratic_programme(v_max, beta):
    import cvxpy as cp

    rng = np.random.default_rng(5)
    planes, points = polytopes(rng, 12), rng.uniform(-4, 4, (3000, 3))
    cbf = make(planes, v_max=v_max, beta=beta, kappa=15.0)  # soft: the margin is often negative outside
    smooth, hard, gradient = cbf.psi(points)
    u, row, slope, target = (cp.Variable(3), cp.Parameter(), cp.Parameter(3), cp.Parameter(3))
    problem = cp.Problem(
        cp.Minimize(0.5 * cp.sum_squares(u - target)), [slope @ u >= row, cp.norm(u) <= v_max]
    )
    compared = pushed = 0
    for i in np.flatnonzero((hard > 0.1) & (smooth < 0.3))[:120]:
        nominal = rng.normal(size=3)
        nominal *= v_max * rng.uniform(0.2, 1.0) / np.linalg.norm(nominal)
        got, status, margin, _, _ = cbf.filter(points[i], nominal)
        row.value, slope.value, target.value = -beta * (smooth[i] - 0.1), gradient[i], nominal
        assert margin == pytest.approx(smooth[i] - 0.1, abs=1e-6)
        if status in (OK, FILTERED):
            problem.solve(solver=cp.CLARABEL)
            assert problem.status == "optimal"
            assert np.allclose(got, u.value, atol=2e-4 * v_max)
            compared += 1
            pushed += margin < 0
        elif status == RECOVERING:  # the row asks for more than the speed limit
            assert row.value > np.linalg.norm(gradient[i]) * v_max * (1 - 1e-5)
            assert np.linalg.norm(got) <= v_max * (1 + 1e-5)
    assert compared > 50
    assert pushed > 5 or beta == 50  # then the speed limit forbids most


def test_an_inactive_filter_passes_the_input_bit_by_bit():
    cbf = make(boxes([0, 0, 0], [1, 1, 1]))
    nominal = [0.1, -1 / 3, 2 / 7]  # none of them is a float
    u, status, margin, hard, nearest = cbf.filter([5.0, 5.0, 5.0], nominal)
    assert (u, status, nearest) == (nominal, OK, 0)
    assert margin <= hard == pytest.approx(3.9, abs=1e-4)


def test_without_hulls_everything_passes_but_nothing_exceeds_the_speed_limit():
    cbf = make((np.empty((0, 3)), np.empty(0), np.array([0])))
    assert cbf.filter([1, 2, 3], [0.5, 0, 0]) == ([0.5, 0, 0], OK, LARGEST_FLOAT, LARGEST_FLOAT, -1)
    u, status, *_ = cbf.filter([1, 2, 3], [3e30, 4e30, 0])
    assert status == FILTERED
    assert u == pytest.approx([0.6, 0.8, 0], abs=1e-6)


coordinate = st.floats(-3, 3, allow_subnormal=False)
vector = st.tuples(coordinate, coordinate, coordinate).map(np.array)


@settings(deadline=None, max_examples=examples(300))
@given(
    corners=st.lists(st.tuples(vector, vector), min_size=1, max_size=5),
    x=vector,
    nominal=vector.map(lambda v: 4 * v),
    radius=st.floats(0, 0.5),
    kappa=st.sampled_from([5.0, 100.0, 1e4]),
    dt=st.sampled_from([0.01, 0.1, 0.5]),
)
def test_a_held_step_keeps_the_radius_at_all_times(corners, x, nominal, radius, kappa, dt):
    planes = boxes(
        np.array([np.minimum(a, b) for a, b in corners]),
        np.array([np.maximum(a, b) for a, b in corners]) + 0.05,
    )
    cbf = make(planes, radius_m=radius, kappa=kappa, dt_s=dt, beta=1 / dt, v_max=5.0)
    u, status, _, hard_margin, _ = cbf.filter(x, nominal)
    assert np.isfinite(u).all()
    assert np.linalg.norm(u) <= 5.0 * (1 + 1e-5)
    if hard_margin >= 0:
        path = x + np.linspace(0, dt, 201)[:, None] * np.array(u)
        assert reference(planes, path, kappa)[0].min() >= radius
    elif status != REFUSED:
        assert status == RECOVERING


def test_a_step_through_another_hull_is_cut_where_it_enters():
    # the near wall decides the row; the step runs along it, right through the second block
    planes = boxes([[0, 0, -5], [-1, 2, -5]], [[1, 1, 5], [0, 3, 5]])
    cbf = make(planes, radius_m=0.2, kappa=1e4, dt_s=1.0, beta=1.0, v_max=5.0)
    x, nominal = np.array([-0.3, 0.5, 0.0]), np.array([0.0, 4.0, 0.0])
    through = x + np.linspace(0, 1, 1001)[:, None] * nominal
    clear = reference(planes, through, 1e4)[0]
    assert clear[[0, -1]].min() > 0.25  # the samples alone would not tell
    assert clear.min() < 0
    u, status, *_ = cbf.filter(x, nominal)
    assert status == SHORTENED
    path = reference(planes, x + np.linspace(0, 1, 1001)[:, None] * np.array(u), 1e4)[0]
    assert path.min() >= 0.2
    assert path[-1] < 0.2002  # up to the block, not short of it


def test_in_a_closed_loop_a_clear_start_never_becomes_unclear():
    rng = np.random.default_rng(6)
    planes = polytopes(rng, 40)
    cbf = make(planes, dt_s=0.1, beta=10.0, v_max=2.0)
    for _ in range(20):
        x = rng.uniform(-5, 5, 3)
        if cbf.psi(x[None])[1][0] < 0.1:
            continue
        for _ in range(100):
            u, status, _, hard, _ = cbf.filter(x, rng.normal(scale=2.0, size=3))
            assert status in (OK, FILTERED, SHORTENED) or (status == RECOVERING and hard >= 0)
            assert reference(planes, x[None], 100.0)[0][0] >= 0.1
            x = x + 0.1 * np.array(u)


def test_inside_it_drives_out_and_then_stays_out():
    planes = boxes([0, 0, 0], [1, 2, 2])
    cbf = make(planes)
    x, statuses = np.array([0.6, 1.0, 1.0]), []
    for _ in range(1500):
        u, status, *_ = cbf.filter(x, [-1.0, 0.0, 0.0])
        statuses.append(status)
        x = x + 0.01 * np.array(u)
    assert statuses[0] == RECOVERING
    assert RECOVERING not in statuses[statuses.index(FILTERED) :]
    assert x[0] >= 1.1


@pytest.mark.parametrize("kappa", [1.0, 30.0, 100.0])
def test_a_step_out_never_leads_deeper(kappa):
    """Into this hull or another; the smooth gradient alone does, by centimetres."""
    rng = np.random.default_rng(11)
    steps = 0
    for _ in range(40):
        planes = polytopes(rng, 4, spread=0.6)
        cbf = make(planes, kappa=kappa, dt_s=0.1, v_max=0.5)
        for x in rng.uniform(-1, 1, (40, 3)):
            u, status, *_ = cbf.filter(x.tolist(), [1.0, 0.0, 0.0])
            if status != RECOVERING:
                continue
            steps += 1
            along = x + np.linspace(0, 0.1, 20)[:, None] * np.array(u)
            psi = reference(planes, along, kappa)[0]
            assert psi.min() >= min(psi[0], 0.1) - 1e-4  # what rounding the map outward may cost at 20 m
    assert steps > 300


def test_where_no_direction_leads_out_it_refuses():
    assert make(boxes([-1, -1, -1], [1, 1, 1])).filter([0, 0, 0], [1, 0, 0])[:2] == ([0, 0, 0], REFUSED)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_what_is_not_finite_is_refused(bad, axis):
    cbf = make(boxes([0, 0, 0], [1, 1, 1]))
    good, wrong = [3.0, 3.0, 3.0], [3.0, 3.0, 3.0]
    wrong[axis] = bad
    assert cbf.filter(wrong, good)[:2] == ([0, 0, 0], REFUSED)
    assert cbf.filter(good, wrong)[:2] == ([0, 0, 0], REFUSED)


def test_positions_beyond_the_extent_are_refused():
    cbf = make(boxes([0, 0, 0], [1, 1, 1]))
    assert cbf.filter([20.1, 0, 0], [0, 0, 0])[1] == REFUSED
    assert cbf.filter([19.9, 0, 0], [0, 0, 0])[1] == OK


def test_far_from_the_origin_it_stays_safe():
    shift = np.array([9e5, -8e5, 7e5])
    planes = boxes(shift, shift + 10.0)
    cbf = make(planes, extent_m=1e6, radius_m=1.0, v_max=5.0, dt_s=0.1)
    x = shift + np.array([-8.0, 5.0, 5.0])
    for _ in range(300):
        u, status, *_ = cbf.filter(x, [5.0, 0.0, 0.0])
        assert status in (OK, FILTERED, SHORTENED, RECOVERING)
        x = x + 0.1 * np.array(u)
        assert reference(planes, x[None], 100.0)[0][0] >= 1.0


@pytest.mark.parametrize(
    "options",
    [
        {"radius_m": -0.1},
        {"radius_m": np.nan},
        {"beta": 0.0},
        {"beta": 101.0},
        {"kappa": 0.0},
        {"kappa": np.inf},
        {"dt_s": 0.0},
        {"v_max": 0.0},
        {"v_max": np.inf},
        {"extent_m": 0.0},
        {"extent_m": 0.1},
        {"extent_m": np.nan},
        {"smoothing": "none"},
    ],
)
def test_parameters_without_meaning_are_refused(options):
    with pytest.raises(ValueError):
        make(boxes([0, 0, 0], [1, 1, 1]), **options)


def test_maps_that_do_not_fit_together_are_refused():
    normal, offset, start = boxes([0, 0, 0], [1, 1, 1])
    for planes in [
        (normal[:5], offset, start),
        (2 * normal, offset, start),
        (normal, offset * np.nan, start),
        (normal, offset, np.array([0, 5])),
        (normal, offset, np.array([0, 0, 6])),
        (normal, offset, np.array([], np.int64)),
    ]:
        with pytest.raises(ValueError):
            make(planes)
