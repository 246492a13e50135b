"""The collision cone, its derivatives and rows against test vectors, power series and rays."""

import numpy as np
import pytest

from alula import _core
from support.models.quadrotor_model import INERTIA, MASS, VECTORS, body_to_inertial, fastbridge, sigma_rate
from support.models.splat_filter_model import cone, outer_matrix

STEP = 1e-30


def native(mu, A, p, v, a=(0, 0, 0), j=(0, 0, 0)):
    A = np.ascontiguousarray(A, float)
    return _core.collision_cone(tuple(mu), A, tuple(p), tuple(v), acceleration=tuple(a), jerk=tuple(j))


def draw(rng):
    """An ellipsoid with semi-axes of 1 cm to 1 m and a flight near it."""
    scale, quat = 10 ** rng.uniform(-2, 0, 3), rng.normal(size=4)
    A = outer_matrix(scale, quat, 1.0, 0.05)
    mu, p, v = rng.uniform(-2, 2, (3, 3))
    return mu, A, p, v, rng.normal(size=3) * 5, rng.normal(size=3) * 20, rng.normal(size=3) * 100


def series(mu, A, p, v, a, j, s):
    """Coefficients in t of h and gamma along the path p + v t + a t^2/2 + j t^3/6 + s t^4/24."""
    path = [p, v, a / 2, j / 6, s / 24]
    r = [mu - p] + [-c for c in path[1:]]
    speed = [(k + 1) * path[k + 1] for k in range(4)]

    def product(x, y):
        out = np.zeros(len(x) + len(y) - 1)
        for i, left in enumerate(x):
            for k, right in enumerate(y):
                out[i + k] += left @ A @ right
        return out

    gamma = product(r, r)
    gamma[0] -= 1
    beta, delta = product(speed, speed), product(r, speed)
    h = np.convolve(beta, gamma)[:4] - np.convolve(delta, delta)[:4]
    return h * [1, 1, 2, 6], gamma[:5] * [1, 1, 2, 6, 24]


def close(actual, expected, scale):
    np.testing.assert_allclose(actual, expected, rtol=1e-10, atol=1e-12 * scale)


@pytest.mark.parametrize("case", VECTORS["cases"], ids=["1", "2", "3"])
def test_the_vectors(case):
    given = case["inp"]
    state = (*given["p"], *given["sigma"], *given["v"], *given["omega"])
    thrust, rate = MASS * given["uT"], MASS * given["duT"]
    mu, A = tuple(given["mu"]), np.array(case["A"])
    c = native(mu, A, given["p"], given["v"], case["a"], case["j"])
    names = {
        "beta": "beta", "gamma": "gamma", "delta": "delta", "h": "h", "w": "w", "grad_p": "grad_p_h",
        "h1": "hdot", "h2": "hddot", "phi": "Phi", "w1": "wdot", "w2": "wddot",
    }  # fmt: skip
    for mine, theirs in names.items():
        expected = np.array(case[theirs])
        np.testing.assert_allclose(c[mine], expected, rtol=1e-9, atol=1e-9 * max(1, np.abs(expected).max()))
    snap = _core.snap_rows(
        fastbridge(), state, thrust=thrust, thrust_rate=rate, centre=mu, a=A, rate=VECTORS["params"]["lam"]
    )
    names = {
        "acceleration": "a", "jerk": "j", "drift": "Fp", "per_thrust": "GT", "per_torque": "Gtau",
        "ecbf_row": "ecbf_row", "ecbf_bound": "ecbf_rhs",
    }  # fmt: skip
    for mine, theirs in names.items():
        expected = np.array(case[theirs])
        np.testing.assert_allclose(
            snap[mine], expected, rtol=1e-9, atol=1e-9 * max(1, np.abs(expected).max())
        )


def test_gradients_are_those_of_a_complex_step():
    rng = np.random.default_rng(1)
    for _ in range(1000):
        mu, A, p, v, *_ = draw(rng)
        c = native(mu, A, p, v)
        beta, gamma, delta, h = cone(mu, A, p, v)
        size = np.abs(beta * (gamma + 1))
        close([c["beta"], c["gamma"], c["delta"]], [beta, gamma, delta], beta + gamma + 1)
        close(c["h"], h, size)
        for i in range(3):
            step = 1j * STEP * np.eye(3)[i]
            close(c["w"][i], cone(mu, A, p, v + step)[3].imag / STEP, size / np.linalg.norm(v))
            close(c["grad_p"][i], cone(mu, A, p + step, v)[3].imag / STEP, size / np.linalg.norm(mu - p))
            close(c["gamma_grad_p"][i], cone(mu, A, p + step, v)[1].imag / STEP, np.abs(A).max())
        assert abs(np.dot(c["grad_p"], v)) <= 1e-10 * size


def test_derivatives_along_a_flight_are_those_of_its_power_series():
    rng = np.random.default_rng(2)
    for _ in range(1000):
        mu, A, p, v, a, j, s = draw(rng)
        c = native(mu, A, p, v, a, j)
        h, gamma = series(mu, A, p, v, a, j, s)
        largest = np.abs(A).max()
        size = largest**2 * np.array([1, 10, 200, 4000]) * 100
        third = np.dot(c["w"], s) + c["phi"]
        np.testing.assert_array_less(np.abs([c["h"], c["h1"], c["h2"], third] - h), 1e-13 * size)
        fourth = np.dot(c["gamma_grad_p"], s) + c["gamma_phi"]
        size = largest * np.array([1, 10, 100, 1000, 10000]) * 10
        values = [c["gamma"], c["gamma1"], c["gamma2"], c["gamma3"], fourth]
        np.testing.assert_array_less(np.abs(values - gamma), 1e-13 * size)


def test_rows_over_thrust_and_torque_are_the_derivatives_of_the_flight_they_cause():
    rng = np.random.default_rng(3)
    body, rate = fastbridge(), 3.0
    for _ in range(300):
        mu, A, p, v, *_ = draw(rng)
        sigma, omega = rng.uniform(-0.5, 0.5, 3), rng.uniform(-3, 3, 3)
        u, u1, u2, tau = rng.uniform(2, 20), rng.normal() * 10, rng.normal() * 50, rng.normal(size=3) * 0.05
        turn = (tau - np.cross(omega, INERTIA * omega)) / INERTIA

        def jerk(sigma, omega, u, u1):
            C = body_to_inertial(sigma)
            return u1 * C[:, 2] + u * C @ np.cross(omega, [0, 0, 1])

        a, j = u * body_to_inertial(sigma)[:, 2] - [0, 0, 9.81], jerk(sigma, omega, u, u1)
        i = 1j * STEP
        s = jerk(sigma + i * sigma_rate(sigma, omega), omega + i * turn, u + i * u1, u1 + i * u2).imag / STEP
        snap = _core.snap_rows(
            body,
            (*p, *sigma, *v, *omega),
            thrust=MASS * u,
            thrust_rate=MASS * u1,
            centre=tuple(mu),
            a=A,
            rate=rate,
        )
        np.testing.assert_allclose(snap["acceleration"], a, atol=1e-12)
        np.testing.assert_allclose(snap["jerk"], j, atol=1e-11)
        mapped = (
            np.array(snap["drift"]) + u2 * np.array(snap["per_thrust"]) + np.array(snap["per_torque"]) @ tau
        )
        np.testing.assert_allclose(mapped, s, atol=1e-10 * np.abs(s).max())
        h, gamma = series(mu, A, p, v, a, j, s)
        powers = rate ** np.arange(5)[::-1]
        terms = h * [1, 3, 3, 1] * powers[1:]
        value = np.dot(snap["ecbf_row"], [u2, *tau]) - snap["ecbf_bound"]
        assert abs(value - terms.sum()) <= 1e-9 * np.abs(A).max() ** 2 * 1e5
        terms = gamma * [1, 4, 6, 4, 1] * powers
        value = np.dot(snap["escape_row"], [u2, *tau]) - snap["escape_bound"]
        assert abs(value - terms.sum()) <= 1e-9 * np.abs(A).max() * 1e5
        psi = [h[0], h[1] + rate * h[0], h[2] + 2 * rate * h[1] + rate**2 * h[0]]
        np.testing.assert_allclose(snap["psi"], psi, atol=1e-9 * np.abs(A).max() ** 2 * 1e4)
        assert snap["ecbf_row"][3] == 0  # yaw moves nothing


def test_the_ray_meets_the_ellipsoid_exactly_when_the_cone_says_so():
    rng = np.random.default_rng(4)
    met = 0
    for _ in range(2000):
        mu, A, p, _, *_ = draw(rng)
        v = (mu - p) * rng.uniform(0.2, 1.5) + rng.normal(size=3) * rng.choice([0.05, 0.5])
        if rng.random() < 0.2:
            v = -v
        c = native(mu, A, p, v)
        if c["gamma"] <= 0:
            assert c["is_inside"]
            assert c["h"] <= 1e-12 * abs(c["delta"]) ** 2
            continue
        # (p + t v - mu)^T A (p + t v - mu) = 1 has a root t >= 0.
        roots = np.roots([c["beta"], -2 * c["delta"], c["gamma"]])
        if abs(c["h"]) < 1e-9 * c["delta"] ** 2:
            continue
        hits = bool(np.all(np.isreal(roots)) and roots.real.max() >= 0)
        assert c["is_met"] == hits
        t = np.linspace(0, 2 * max(np.abs(roots)), 4001)
        y = p + t[:, None] * v - mu
        inside = np.einsum("ti,ij,tj->t", y, A, y).min() <= 1
        assert hits or not inside
        met += hits
    assert 300 < met < 1700
