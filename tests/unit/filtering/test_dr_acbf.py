"""The DR-ACBF filter: closed forms, its parts against numpy, the manoeuvre's states, walls, refusals."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from alula import _core
from support.effort import examples
from support.scenes.moving_scenes import NO_TRACKS, NO_WALLS, crowd, track, tracks

DEFAULTS = _core.moving_filter_defaults()
BARE = {"latency_s": 0.0, "j_max": 0.0}
OK, FILTERED, RECOVERING, REFUSED = 0, 1, 3, 4
AVOID = 1
ZERO = [0.0, 0.0, 0.0]


def make(**options):
    return _core.moving_filter("dr_acbf", options)


def tick(filter_, position, velocity, rows=NO_TRACKS, nominal=ZERO, walls=NO_WALLS):
    return filter_.filter(list(position), list(velocity), rows, walls, list(nominal))[0]


# Closed forms


@pytest.mark.parametrize(("distance", "speed"), [(1.0, 2.0), (5.0, 3.0), (0.7, 6.0)])
def test_the_bound_is_least_at_the_horizon_of_a_constant_deceleration_stop(distance, speed):
    horizons = np.linspace(0.05, 8, 4000)
    bounds = [
        _core.row_bound(distance, speed, h, 0.0, radius_m=0.0, envelope=0.0, options=BARE) for h in horizons
    ]
    assert min(bounds) == pytest.approx(-(speed**2) / (2 * distance), rel=1e-4)
    assert horizons[int(np.argmin(bounds))] == pytest.approx(2 * distance / speed, rel=0.02)


def test_following_the_active_row_oscillates_as_the_closed_form_says():
    horizon, speed, dt = 0.4, 3.0, 1e-4
    distance, rate, hardest, lowest = speed * horizon, -speed, 0.0, np.inf
    for step in range(12000):
        t = step * dt
        exact = speed * horizon * np.exp(-t / horizon) * np.cos(t / horizon)
        assert distance == pytest.approx(exact, abs=2e-3)
        bound = (2 / horizon**2) * (distance + rate * horizon)
        if step % 3000 == 0:
            row = _core.row_bound(distance, -rate, horizon, 0.0, radius_m=0.0, envelope=0.0, options=BARE)
            assert row == pytest.approx(bound, abs=1e-4)
        hardest, lowest = max(hardest, -bound), min(lowest, distance)
        distance, rate = distance + dt * rate - dt**2 / 2 * bound, rate - dt * bound
    assert hardest == pytest.approx(0.6448 * speed / horizon, rel=2e-3)
    assert lowest == pytest.approx(-0.0670 * speed * horizon, rel=1e-2)


def test_constants_of_the_specification():
    assert _core.recursive_speed(6.0, 0.4) == pytest.approx(3.72, abs=5e-3)
    for alpha, expected in ((0.1, 3.0), (0.05, 4.3589), (0.025, 6.2450)):
        assert _core.cantelli(alpha) == pytest.approx(expected, abs=1e-4)

    def clearance(**options):
        given_options = {**BARE, **options}
        envelope = given_options.pop("envelope", 0.0)
        return -0.08 * _core.row_bound(
            0.0, 0.0, 0.4, 0.0, radius_m=0.0, envelope=envelope, options=given_options
        )

    assert clearance(j_max=60.0) == pytest.approx(0.64, abs=1e-4)
    assert clearance(envelope=1.0) == pytest.approx(0.08, abs=1e-5)
    assert clearance(latency_s=0.02, a_max=1e-3, wall_deceleration=1e-3) == pytest.approx(0.24, abs=1e-4)


@settings(deadline=None, max_examples=examples(100))
@given(st.floats(0.1, 40), st.floats(0, 20), st.floats(0.15, 0.4), st.floats(0, 2), st.floats(0, 2))
def test_the_bound_is_the_formula_and_less_risk_never_loosens_it(distance, speed, horizon, sp, sv):
    def bound(alpha):
        return _core.row_bound(distance, speed, horizon, _core.cantelli(alpha), sigma2_p=sp, sigma2_v=sv)

    clearance = 0.3 + 12 * 0.02 + 3 * 0.02**2 + 10 * horizon**3 + 0.5 * horizon**2
    sigma = np.sqrt(sp + horizon**2 * sv)
    expected = 2 / horizon**2 * (distance - clearance - speed * horizon - 3 * sigma)
    assert bound(0.1) == pytest.approx(expected, rel=1e-5, abs=1e-2)
    assert bound(0.2) >= bound(0.1) >= bound(0.05) >= bound(0.001)


@settings(deadline=None, max_examples=examples(50))
@given(st.lists(st.tuples(st.floats(0, 40), st.floats(-5, 15)), min_size=1, max_size=30))
def test_the_risk_is_shared_out_as_printed(pairs):
    distance, closing = np.array(pairs).T.copy()
    alpha = _core.allocate_risk(distance, closing, 0.1)
    active = closing.astype(np.float32) > 0
    weight = np.where(active, (1 + closing / (closing.max() + 1e-6)) / np.maximum(distance, 1e-3), 0)
    assert (alpha[~active] == 0).all()
    if active.any():
        assert alpha.sum() == pytest.approx(0.1, rel=1e-4)
        assert np.allclose(alpha, 0.1 * weight / weight.sum(), rtol=1e-4, atol=1e-9)


# Envelope and warning


def test_the_envelope_is_the_sliding_mode_differentiator():
    rng = np.random.default_rng(3)
    dt = DEFAULTS["dt_s"]
    time = dt * np.arange(400)
    velocity = np.c_[3 + 1.5 * time, np.sin(2 * time), np.zeros_like(time)] + 0.01 * rng.normal(size=(400, 3))
    got = _core.acceleration_envelope(velocity)
    z0, z1, bound = velocity[0].copy(), np.zeros(3), 1.0
    for k, v in enumerate(velocity):
        error = z0 - v
        z0 = z0 + dt * (z1 - 3 * np.sqrt(np.abs(error)) * np.sign(error))
        z1 = z1 - dt * 3 * np.sign(error)
        if (k + 1) * dt >= 0.3 - 1e-9:
            bound = min(4.0, max(np.linalg.norm(z1), bound - 0.5 * dt))
        if k == 0:
            continue  # the error of the first velocity is 0 or rounding
        assert got[k, 3] == pytest.approx(bound, abs=0.1)
    assert np.abs(got[200:, 0] - 1.5).mean() < 0.4


def test_the_envelope_forgets_and_is_capped():
    still = _core.acceleration_envelope(np.zeros((400, 3)))[:, 3]
    assert still[0] == 1
    assert still[-1] == 0
    assert np.allclose(np.diff(still[40:150]), -0.005, atol=1e-6)
    mad = np.cumsum(np.full((300, 3), 1.0), axis=0)
    assert _core.acceleration_envelope(mad)[:, 3].max() == 4


def warning_of(position, velocity, row, acceleration, samples, own=(0.0,) * 6):
    """The printed CVaR: the mean of the worst twentieth of samples, at five times, plus eps L_Z."""
    covariance = np.zeros((6, 6))
    covariance[np.tril_indices(6)] = row[7:28]
    covariance = covariance + np.tril(covariance, -1).T
    xx, xy, xz, yy, yz, zz = own
    covariance[:3, :3] += [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]
    offsets = samples @ np.linalg.cholesky(covariance + 1e-14 * np.eye(6)).T
    p, v = row[1:4] - position + offsets[:, :3], row[4:7] - velocity + offsets[:, 3:]
    worst = math.ceil(0.05 * len(samples))
    most = -np.inf
    for t in np.linspace(0, 0.4, 5):
        at, moving = p + v * t + 0.5 * acceleration * t**2, v + acceleration * t
        distance = np.linalg.norm(at, axis=1)
        closing = np.maximum(0, -(at * moving).sum(axis=1) / distance)
        z = row[28] + 0.15 + closing * 0.02 + closing**2 / 24 - distance
        tail = np.argpartition(z, -worst)[-worst:]
        slope = 0.02 + closing[tail].mean() / 12
        most = max(most, z[tail].mean() + 0.05 * np.sqrt(1 + slope**2))
    return most


def near_the_limit(rng, sigma_p, sigma_v):
    """A track near the distance at which it starts to warn, with errors of about these sizes."""
    toward = rng.normal(size=3)
    toward /= np.linalg.norm(toward)
    speed = rng.uniform(4, 12)
    factor = np.diag([sigma_p] * 3 + [sigma_v] * 3) + 0.3 * sigma_p * rng.normal(size=(6, 6))
    distance = 0.3 + 0.42 * speed + speed**2 / 24 + 2 * sigma_p + 0.4 * rng.normal()
    velocity = -speed * toward + rng.normal(size=3)
    return track(1, distance * toward, velocity, covariance=factor @ factor.T)


OWN = (0.02, 0.005, 0.0, 0.03, 0.001, 0.01)


@pytest.mark.parametrize(
    ("sigma_p", "sigma_v", "excess"), [(0.05, 0.1, 0.08), (0.1, 0.3, 0.1), (0.3, 0.9, 0.7)]
)
def test_the_warning_is_never_below_the_cvar_of_many_samples(sigma_p, sigma_v, excess):
    rng = np.random.default_rng(4)
    half = rng.normal(size=(4000, 6))
    samples = np.vstack([half, -half])
    found, few = [], []
    for k in range(60):
        row = near_the_limit(rng, sigma_p, sigma_v)
        acceleration = rng.normal(scale=2, size=3)
        own = OWN if k % 2 else (0.0,) * 6
        expected = warning_of(np.zeros(3), np.zeros(3), row, acceleration, samples, own)
        if not -1 < expected < 1:
            continue
        found.append(_core.early_warning(ZERO, ZERO, row[None], acceleration.tolist(), own) - expected)
        some = rng.normal(size=(64, 6))
        few.append(warning_of(np.zeros(3), np.zeros(3), row, acceleration, some, own) - expected)
    assert len(found) > 15
    assert min(found) > -0.01  # 8,000 samples are themselves uncertain by about as much
    assert 0 < np.mean(found) < excess
    assert min(few) < -0.02  # 64 samples warn too late


@settings(deadline=None, max_examples=examples(200))
@given(st.integers(0, 10**6), st.floats(0, 1), st.floats(0, 2))
def test_more_uncertainty_never_delays_the_warning(seed, more_p, more_v):
    row = near_the_limit(np.random.default_rng(seed), 0.1, 0.3)
    wider = row.copy()
    diagonal = np.cumsum(np.arange(1, 7)) - 1
    wider[7 + diagonal] += [more_p**2] * 3 + [more_v**2] * 3
    before, after = (_core.early_warning(ZERO, ZERO, r[None], ZERO) for r in (row, wider))
    assert after >= before - 1e-4


@settings(deadline=None, max_examples=examples(300))
@given(st.integers(0, 10**6), st.floats(-6, 6), st.floats(-6, 6), st.floats(-12, 12), st.booleans())
def test_the_warning_is_a_number_for_every_input_in_range(seed, far, fast, wide, flat):
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(6, 6)) * 10 ** (wide / 2) / 10
    if flat:
        factor[:, 1:] = 0
    row = track(1, rng.uniform(-1, 1, 3) * 10**far, rng.uniform(-1, 1, 3) * 10**fast)
    row[7:28] = np.clip((factor @ factor.T)[np.tril_indices(6)], -1e12, 1e12)
    for options in ({}, {"wasserstein": 0.0, "latency_s": 0.0}, {"tail": 1e-6}):
        assert not np.isnan(_core.early_warning(ZERO, ZERO, row[None], ZERO, options=options))


@pytest.mark.parametrize("tail", [1e-6, 1e-3, 0.05, 0.3, 0.999, 1.0])
def test_the_tails_of_the_normal_are_rounded_up(tail):
    of_normal, of_square = _core.early_warning_tails(tail)
    q, both = norm.isf(tail), norm.isf(tail / 2)
    exact = 0.0 if tail == 1 else norm.pdf(q) / tail
    assert exact <= of_normal + 1e-4 <= 1.02 * exact + 2e-3
    square = 1 + (0.0 if tail == 1 else 2 * both * norm.pdf(both) / tail)
    assert square <= of_square + 1e-4 <= 1.02 * square + 2e-3


@pytest.mark.parametrize("speed", [2.0, 6.0, 11.0])
def test_without_noise_the_warning_starts_at_the_printed_distance(speed):
    expected = 0.3 + speed * 0.02 + speed**2 / 24 + speed * 0.4 + 0.05 * np.sqrt(1 + (0.02 + speed / 12) ** 2)
    for off, warns in ((-2e-3, True), (2e-3, False)):
        row = track(1, [expected + off, 0, 0], [-speed, 0, 0])
        assert (_core.early_warning(ZERO, ZERO, row[None], ZERO) >= 0) is warns
        assert tick(make(), ZERO, ZERO, tracks(row)).warned is warns


def test_the_simple_trigger_is_a_chance_constraint_at_one_time():
    for distance, warns in (
        (0.3 + 5 * 0.4 + 1.645 * 0.5 - 0.01, True),
        (0.3 + 5 * 0.4 + 1.645 * 0.5 + 0.01, False),
    ):
        row = track(1, [distance, 0, 0], [-5, 0, 0], sigma_p=0.3, sigma_v=1.0)
        assert tick(make(distributional=0), ZERO, ZERO, tracks(row)).warned is warns


# The whole filter


@settings(deadline=None, max_examples=examples(150))
@given(st.integers(0, 10**6), st.integers(0, 12), st.sampled_from([0, 1]), st.booleans())
def test_the_command_is_in_the_box_and_tells_whether_rows_hold(seed, count, solver, near):
    rng = np.random.default_rng(seed)
    filter_ = make(solver=solver)
    nominal = rng.uniform(-6, 6, 3).astype(np.float32).astype(float)
    rows = crowd(rng, count, near=0.2 if near else 3.0) if count else NO_TRACKS
    velocity = rng.uniform(-5, 5, 3)
    for _ in range(8):
        report = tick(filter_, ZERO, velocity, rows, nominal)
        a = np.array(report.acceleration)
        assert np.isfinite(a).all()
        assert np.abs(a).max() <= 6
        assert report.status in (OK, FILTERED, RECOVERING)
        assert (report.violation > 1e-3) == (report.status == RECOVERING)
        if report.status == OK:
            assert np.array_equal(a, nominal)
        if report.feasible and not solver:
            assert report.status != RECOVERING
            assert report.violation <= 0


def test_without_obstacles_the_nominal_comes_back_bit_by_bit():
    report = tick(make(), [1, 2, 3], [4, 0, 0], nominal=[0.1, -0.2, 0.3])
    assert (report.status, report.acceleration, report.rows) == (OK, [0.1, -0.2, 0.3], 0)
    assert report.urgent == -1
    assert report.risk_m == -np.inf


def test_rows_of_receding_obstacles_are_an_option():
    """As printed, (15) to (19) hold for all obstacles; here a receding one has no row and no risk."""
    rows = tracks(track(1, [9.0, 0, 0], [-4, 0, 0]), track(2, [-6.0, 0, 0], [-4, 0, 0]))
    assert tick(make(), ZERO, ZERO, rows).rows == 1
    assert tick(make(receding_rows=1), ZERO, ZERO, rows).rows == 2
    alpha = _core.allocate_risk(np.array([9.0, 6.0]), np.array([4.0, 0.0]), 0.1, receding=True)
    weight = np.array([2 / 9, 1 / 6])
    assert np.allclose(alpha, 0.1 * weight / weight.sum(), rtol=1e-4)


def test_the_printed_envelope_never_shrinks():
    """(24) without forgetting and cap; here it shrinks by 0.5 m/s^3 and ends at 4 m/s^2."""
    rng = np.random.default_rng(5)
    velocity = (
        np.cumsum(rng.normal(0, 0.05, (600, 3)), axis=0)
        + np.r_[np.zeros(300), np.arange(300) * 0.08][:, None]
    )
    printed = _core.acceleration_envelope(velocity, {"envelope_forget": 0.0, "envelope_cap": 1e5})[:, 3]
    ours = _core.acceleration_envelope(velocity)[:, 3]
    assert (np.diff(printed) >= 0).all()
    assert printed[-1] > 4
    assert ours.max() == 4


def test_rows_before_a_warning_are_an_option():
    rows = tracks(track(1, [9.0, 0, 0], [-4, 0, 0]))
    assert tick(make(), ZERO, ZERO, rows).rows == 1
    assert tick(make(rows_before_warning=0), ZERO, ZERO, rows).rows == 0


def test_the_tick_that_enters_takes_half_the_risk_and_the_longest_horizon():
    rows = tracks(track(1, [3.0, 0.2, 0], [-5, 0, 0]))
    filter_ = make()
    first = tick(filter_, ZERO, ZERO, rows)
    assert (first.mode, first.horizon_s) == (AVOID, pytest.approx(0.4))
    assert first.warned


BAD = [np.nan, np.inf, -np.inf, 2e6]


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("method", ["none", "dr_acbf", "dr_acbf_qp", "mpc", "cbf_qp", "rp_cbf"])
def test_bad_numbers_are_refused_and_change_nothing(method, bad):
    rng = np.random.default_rng(2)
    filter_ = _core.moving_filter(method)
    good = crowd(rng, 3)
    walls = np.array([[0.0, 0, 1.0, 5.0]])
    for _ in range(3):
        filter_.filter(ZERO, ZERO, good, walls, ZERO)
    calls = [([bad, 0, 0], ZERO, good, walls, ZERO), (ZERO, [0, bad, 0], good, walls, ZERO)]
    calls += [(ZERO, ZERO, good, walls, [0, 0, bad])]
    for column in (1, 3, 5, 28):
        broken = good.copy()
        broken[1, column] = bad
        calls.append((ZERO, ZERO, broken, walls, ZERO))
    if not np.isfinite(bad):
        broken = good.copy()
        broken[1, 8] = bad
        calls.append((ZERO, ZERO, broken, walls, ZERO))
    for column in (0, 3):
        broken = walls.copy()
        broken[0, column] = bad
        calls.append((ZERO, ZERO, good, broken, ZERO))
    for call in calls:
        twin = filter_.clone()
        report, _ = filter_.filter(*call)
        assert (report.status, report.acceleration) == (REFUSED, ZERO)
        same = [f.filter(ZERO, ZERO, good, walls, ZERO)[0] for f in (filter_, twin)]
        assert same[0].acceleration == same[1].acceleration
        assert same[0].risk_m == same[1].risk_m


def test_negative_variances_radii_equal_ids_and_too_many_are_refused():
    filter_ = make()
    row = track(1, [9, 0, 0], ZERO)
    for column, value in ((7, -1.0), (27, -1e-9), (28, -0.1)):
        broken = row.copy()
        broken[column] = value
        assert tick(filter_, ZERO, ZERO, broken[None]).status == REFUSED
    assert tick(filter_, ZERO, ZERO, tracks(row, row)).status == REFUSED
    many = np.array([track(i, [9, i, 0], ZERO) for i in range(129)])
    assert tick(filter_, ZERO, ZERO, many).status == REFUSED
    assert tick(filter_, ZERO, ZERO, many[:128]).status == OK
    walls = np.tile([0.0, 0, 1.0, 50.0], (33, 1))
    assert tick(filter_, ZERO, ZERO, walls=walls).status == REFUSED
    assert tick(filter_, ZERO, ZERO, walls=walls[:32]).status == OK
    assert filter_.filter(ZERO, ZERO, NO_TRACKS, NO_WALLS, ZERO, [-1, 0, 0, 0, 0, 0])[0].status == REFUSED


@pytest.mark.parametrize(
    "options",
    [
        {"dt_s": 0},
        {"risk": 1},
        {"h_min_s": 0.5},
        {"horizons": 17},
        {"a_max": np.nan},
        {"envelope_cap": np.nan},
        {"envelope_cap": np.inf},
        {"wall_deceleration": 7},
    ],
)
def test_options_that_mean_nothing_raise(options):
    for method in ("none", "dr_acbf", "mpc", "cbf_qp", "rp_cbf"):
        with pytest.raises(ValueError):
            _core.moving_filter(method, options)
    with pytest.raises(ValueError, match="no such option"):
        _core.moving_filter("dr_acbf", {"nothing": 1})


def test_the_bypass_point_follows_the_estimate_and_waits_for_no_brake():
    """Believed to pass by at first, then to hit; rows are missed for longer than the brake waits."""
    filters = _core.moving_filter("dr_acbf", {"failing_ticks": 5})
    p, v = np.array([0.0, 0.0, 10.0]), np.array([4.0, 0.0, 0.0])
    far, aside, missed = 7.0, [], 0
    for k in range(60):
        across = 1.2 if k < 5 else 0.0
        at = np.array([far - 9.0 * 0.01 * k, 0.0, 10.0])
        report, _ = filters.filter(
            p, v, tracks(track(1, at, (-9.0, across, 0.0), 0.1, 0.1)), NO_WALLS, (0, 0, 0)
        )
        assert report.mode == 1
        missed += report.status == 3
        a = np.array(report.acceleration)
        p, v = p + 0.01 * v + 0.00005 * a, v + 0.01 * a
        aside.append(np.hypot(p[1], p[2] - 10))
    assert missed > 5
    assert max(aside) > 0.6


@pytest.mark.parametrize("method", ["dr_acbf", "dr_acbf_qp", "mpc", "cbf_qp", "rp_cbf"])
def test_what_is_flown_while_input_is_refused_counts(method):
    """Away from the wall was commanded; then the input breaks, and towards it is flown."""
    walls = np.array([[-1.0, 0, 0, 50.0]])
    told = _core.moving_filter(method)
    for _ in range(20):
        told.filter(ZERO, ZERO, NO_TRACKS, walls, [-6.0, 0, 0])
    untold = told.clone()
    for _ in range(20):
        assert told.filter(ZERO, ZERO, NO_TRACKS, walls, [np.nan, 0, 0])[0].status == REFUSED
        told.flown([6.0, 0, 0])
        told.flown([np.nan, 0, 0])  # ignored
    near = np.array([[-1.0, 0, 0, 2.0]])
    braked, late = (
        f.filter(ZERO, [3.0, 0, 0], NO_TRACKS, near, [6.0, 0, 0])[0].acceleration for f in (told, untold)
    )
    assert braked[0] < late[0] - 1


@pytest.mark.parametrize("distance", [0.02, -0.1, -0.5])
def test_the_violation_between_walls_that_contradict_each_other_counts_every_row(distance):
    """No command meets the rows of both walls; the obstacle's row is missed by more than theirs."""
    walls = np.array([[1.0, 0.0, 0.0, distance], [-1.0, 0.0, 0.0, distance]])
    alone = tick(make(), ZERO, [0.0, 2.0, 0.0], walls=walls)
    rows = tracks(track(1, [1.5, 0.5, 0], [-3.0, 0, 0]))
    report = tick(make(), ZERO, [0.0, 2.0, 0.0], rows, walls=walls)
    assert alone.status == report.status == RECOVERING
    assert report.violation >= alone.violation > 1
