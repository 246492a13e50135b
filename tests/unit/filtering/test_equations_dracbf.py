"""DR-ACBF, eqs. 2 to 6, 14 to 17 and 20 to 22: whole rows of the filter from tracks; poles of the gains."""

import numpy as np
import pytest

from alula import _core
from support.scenes.moving_scenes import NO_WALLS, crowd

ENVELOPE = 1.0  # ahat of a track in its first tick


def bounds_of(rows, position, velocity, own, horizon, total):
    """Unit vectors n_i and bounds b_i of the obstacles that close in, from the printed equations."""
    P, V = rows[:, 1:4] - position, rows[:, 4:7] - velocity
    d = np.linalg.norm(P, axis=1)
    n = P / d[:, None]
    closing = np.maximum(0, -(n * V).sum(axis=1))
    active = (closing > 0) & (d < 40)
    d, n, closing, rows = d[active], n[active], closing[active], rows[active]
    triangle = np.zeros((len(rows), 6, 6))
    triangle[:, *np.tril_indices(6)] = rows[:, 7:28]
    covariance = triangle + np.tril(triangle, -1).swapaxes(1, 2)
    sigma2 = np.einsum("ni,nij,nj->n", n, covariance[:, :3, :3] + own, n)
    speed2 = np.einsum("ni,nij,nj->n", n, covariance[:, 3:, 3:], n)
    sigma = np.sqrt(sigma2 + horizon**2 * speed2)
    weight = (1 + closing / (closing.max() + 1e-6)) / np.maximum(d, 1e-3)
    alpha = total * weight / weight.sum()
    tightening = np.sqrt((1 - alpha) / alpha)
    clearance = 0.15 + rows[:, 28] + 12 * 0.02 + 3 * 0.02**2 + 60 / 6 * horizon**3 + ENVELOPE / 2 * horizon**2
    return n, 2 / horizon**2 * (d - clearance - closing * horizon - tightening * sigma)


def test_rows_of_a_tick_are_those_of_the_printed_equations():
    rng = np.random.default_rng(0)
    compared = 0
    for _ in range(200):
        rows = crowd(rng, 4, near=2.0, far=20.0).astype(np.float32).astype(float)
        position, velocity = rng.uniform(-1, 1, (2, 3)).astype(np.float32).astype(float)
        nominal = rng.uniform(-6, 6, 3).astype(np.float32).astype(float)
        own = np.diag([0.02, 0.03, 0.01])
        own_row = [0.02, 0, 0, 0.03, 0, 0.01]
        report, _ = _core.moving_filter("dr_acbf").filter(
            position.tolist(), velocity.tolist(), rows, NO_WALLS, nominal.tolist(), own_row
        )
        total = 0.05 if report.mode == 1 else 0.1  # half of it in the tick that enters a manoeuvre
        n, b = bounds_of(rows, position, velocity, own, report.horizon_s, total)
        assert report.rows == len(b)
        missed = (n @ np.array(report.acceleration) - b).max()
        assert report.violation == pytest.approx(missed, rel=1e-3, abs=2e-2)
        compared += report.feasible
    assert compared > 50


@pytest.mark.parametrize("alpha", [0.5, 0.1, 0.025])
def test_the_tightening_factor_is_the_smallest_that_holds_for_every_distribution(alpha):
    """Cantelli: Pr(x <= mean - lambda sigma) <= alpha, with equality for one distribution on two points."""
    factor = _core.cantelli(alpha)
    values, weights = np.array([-factor, 1 / factor]), np.array([alpha, 1 - alpha])
    assert weights @ values == pytest.approx(0, abs=1e-6)
    assert weights @ values**2 == pytest.approx(1, rel=1e-6)  # so it reaches -lambda sigma with alpha
    rng = np.random.default_rng(2)
    for x in (rng.normal(size=10**5), -rng.exponential(size=10**5), rng.standard_t(5, 10**5)):
        assert np.mean(x <= x.mean() - factor * x.std()) <= alpha


@pytest.mark.parametrize("horizon", [0.15, 0.4])
def test_the_printed_gains_have_complex_poles_so_that_the_barrier_undershoots(horizon):
    """h'' + k_1 h' + k_2 h = 0 with k_1 = 2 / H, k_2 = 2 / H^2, from rest at h = 1: h falls to -exp(-pi)."""
    poles = np.roots([1, 2 / horizon, 2 / horizon**2])
    np.testing.assert_allclose(sorted(poles.imag * horizon), [-1, 1])
    t = np.linspace(0, 10 * horizon, 20001)
    h = np.exp(-t / horizon) * (np.cos(t / horizon) + np.sin(t / horizon))
    assert h.min() == pytest.approx(-np.exp(-np.pi), rel=1e-6)
    # the row of the filter is the range form: it has the same gains and no centripetal term
    distance, closing = 3.0, 2.0
    bare = {"latency_s": 0.0, "j_max": 0.0}
    row = _core.row_bound(distance, closing, horizon, 0.0, radius_m=0.3, envelope=0.0, options=bare)
    assert row == pytest.approx(2 / horizon**2 * (distance - 0.3) - 2 / horizon * closing, rel=1e-5)
