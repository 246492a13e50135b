"""FastBridge, Propositions 1 and 3 and eqs. 13 and 25, by finite differences."""

import numpy as np
import pytest

from alula import _core
from support.models import backup_model as model
from support.models import quadrotor_model as body
from support.models import splat_filter_model as filters


def ellipsoid(rng):
    root = rng.normal(size=(3, 3))
    return 2 * rng.normal(size=3), root @ root.T + np.eye(3)


def test_the_realisation_gap_of_the_barrier_rate_is_the_gradient_by_velocity_times_the_error():
    """Along two accelerations from one state: h'_real - h'_DI = w . (a_real - a_cmd)."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        mu, a = ellipsoid(rng)
        p, v, command, real = rng.normal(size=(4, 3))

        def rate(acceleration, mu=mu, a=a, p=p, v=v, step=1e-30):
            return filters.cone(mu, a, p + 1j * step * v, v + 1j * step * acceleration)[3].imag / step

        w = np.array(_core.collision_cone(mu, a, p, v, acceleration=command, jerk=np.zeros(3))["w"])
        gap = rate(real) - rate(command)
        assert gap == pytest.approx(w @ (real - command), rel=1e-9, abs=1e-9 * np.abs(w).max())


def test_under_the_backup_policy_the_backup_barrier_falls_no_faster_than_its_condition_allows():
    """d/dt h_b + alpha h_b >= 0 with u = pi_b, where h_b >= 0 and the terminal residual is not negative."""
    policy, alpha, step = _core.BackupPolicy(body.fastbridge(), "hover"), 5.0, 1e-4
    ahead = _core.BackupFlow(policy, horizon_s=3.0, nodes=150)
    tick = _core.BackupFlow(policy, horizon_s=step, nodes=1)
    rng = np.random.default_rng(1)
    compared = 0
    while compared < 50:
        x = np.concatenate([rng.normal(size=3), np.zeros(3), rng.normal(size=3), np.zeros(3)])
        mu, a = x[:3] + 3 * rng.normal(size=3), ellipsoid(rng)[1]

        def barrier(y, mu=mu, a=a):
            """h_b and the terminal residual."""
            ahead.run(y)
            cones = np.array([filters.cone(mu, a, z[:3], z[6:9]) for z in ahead.states()])
            _, gamma, delta, _ = cones[-1]
            return min(cones[:, 3].min(), gamma), alpha * gamma - 2 * delta

        now, residual = barrier(x)
        if not (now > 0 and residual >= 0):
            continue
        tick.run(x)
        assert (barrier(tick.states()[-1])[0] - now) / step + alpha * now >= -1e-6 * max(1, now)
        compared += 1


def roll_slope(speed):
    """Maximum |d pi_b / d sigma_1| over roll angles while flying sideways: below the Lipschitz constant."""
    hover, step = _core.BackupPolicy(body.fastbridge(), "hover"), 1e-6
    x, unit = np.zeros(12), np.eye(12)[3]
    x[7] = speed
    angles = np.linspace(-0.9, 0.9, 3001)
    slopes = [(hover(x + (k + step) * unit) - hover(x + (k - step) * unit)) / (2 * step) for k in angles]
    return np.abs(slopes).max()


def test_the_printed_lipschitz_bound_of_the_policy_holds_at_low_speed_and_not_at_every_speed():
    gains = model.Hover()
    bound = body.MASS * gains.k_vz + gains.k_sigma + gains.k_omega + gains.k_vh  # kappa = 1
    assert roll_slope(5.0) < bound
    assert roll_slope(200.0) > bound  # S R(sigma) v grows with v, so no constant bounds its slope
