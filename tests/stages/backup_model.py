"""The backup policies and their flow in NumPy, written so that complex states work: derivatives by complex step.

Made from quaternions and rotation matrices rather than from the formulas of the library, where there is a choice.
"""

from __future__ import annotations

import numpy as np

G = 9.81
MASS = 0.461
INERTIA = np.array([6.5e-4, 6.9e-4, 1.1e-3])
ARM = 0.078
TORQUE_RATIO = 0.0116
F_MAX = 4.25
ALLOCATION = np.array(
    [
        [1, 1, 1, 1],
        [ARM, -ARM, -ARM, ARM],
        [-ARM, ARM, -ARM, ARM],
        [-TORQUE_RATIO, -TORQUE_RATIO, TORQUE_RATIO, TORQUE_RATIO],
    ]
)
E3 = np.array([0.0, 0.0, 1.0])
STEP = 1e-40  # of a complex step


def hat(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def rotation(sigma):
    """Body from inertial, by the quaternion."""
    n = sigma @ sigma
    q0, q = (1 - n) / (1 + n), 2 * sigma / (1 + n)
    inertial_from_body = (q0 * q0 - q @ q) * np.eye(3) + 2 * np.outer(q, q) + 2 * q0 * hat(q)
    return inertial_from_body.T


def attitude_rate(sigma, omega):
    """From the quaternion's rate: sigma = q_v / (1 + q_0)."""
    n = sigma @ sigma
    q0, q = (1 - n) / (1 + n), 2 * sigma / (1 + n)
    dq0, dq = -0.5 * q @ omega, 0.5 * (q0 * omega + np.cross(q, omega))
    return dq / (1 + q0) - q * dq0 / (1 + q0) ** 2


class Hover:
    k_vz, k_sigma, k_omega, k_vh, kappa, eta_frac = 2.0, 0.30, 0.020, 0.006, 1.0, 0.95
    weight = np.array([2.0, 0.3, 0.3, 0.05])

    def __init__(self):
        hover = MASS * G / 4
        eta = min(F_MAX - hover, hover)
        share = np.abs(np.linalg.inv(ALLOCATION)) @ self.weight
        self.caps = self.eta_frac * eta / share.max() * self.weight

    def raw(self, x, hold):
        sigma, v, omega = x[3:6], x[6:9], x[9:12]
        u = rotation(sigma) @ v
        torque = -self.k_sigma * sigma - self.k_omega * omega + self.k_vh * np.array([u[1], -u[0], 0])
        return np.concatenate([[MASS * G - MASS * self.k_vz * v[2]], torque])

    def __call__(self, x, hold):
        offset = np.array([MASS * G, 0, 0, 0])
        return offset + self.caps * np.tanh(self.kappa * (self.raw(x, hold) - offset) / self.caps)


class HeadingInvariant(Hover):
    def raw(self, x, hold):
        sigma, v, omega = x[3:6], x[6:9], x[9:12]
        r = rotation(sigma)
        u = r @ v
        lean = np.cross(E3, r[:, 2])
        torque = self.k_sigma / 4 * lean - self.k_omega * omega + self.k_vh * np.array([u[1], -u[0], 0])
        return np.concatenate([[MASS * G - MASS * self.k_vz * v[2]], torque])


class Brake:
    tilt, full_speed, climb_rate, w, zeta, yaw, eta_frac, share = 0.61, 1.5, 4.0, 20.0, 0.9, 8.0, 0.95, 0.4
    torque_weight = np.array([0.3, 0.3, 0.03])

    def __init__(self):
        hover, inverse = MASS * G / 4, np.linalg.inv(ALLOCATION)
        per_unit = np.abs(inverse[:, 1:]) @ self.torque_weight
        margin = self.eta_frac * min(F_MAX - hover, hover)
        self.torque_cap = (self.share * margin / per_unit).min() * self.torque_weight
        taken = np.abs(inverse[:, 1:]) @ self.torque_cap
        self.up = ((self.eta_frac * (F_MAX - hover) - taken) / inverse[:, 0]).min()
        self.down = ((self.eta_frac * hover - taken) / inverse[:, 0]).min()

    def raw(self, x, hold):
        sigma, v, omega = x[3:6], x[6:9], x[9:12]
        r = rotation(sigma)
        u = v - hold
        target = np.array([0, 0, 1], dtype=u.dtype)
        target[:2] = -np.tan(self.tilt) * u[:2] / np.sqrt(self.full_speed**2 + u[0] ** 2 + u[1] ** 2)
        k_omega = INERTIA * np.array([2 * self.zeta * self.w, 2 * self.zeta * self.w, self.yaw])
        torque = INERTIA * self.w**2 * np.cross(E3, r @ target) - k_omega * omega
        lift = 1.02 * r[2, 2] / (r[2, 2] ** 2 + 0.02)
        return np.concatenate([[MASS * (G - self.climb_rate * u[2]) * lift], torque])

    def __call__(self, x, hold):
        raw = self.raw(x, hold)
        y = raw[0] - MASS * G
        cap = self.up if y.real > 0 else self.down
        return np.concatenate(
            [[MASS * G + cap * np.tanh(y / cap)], self.torque_cap * np.tanh(raw[1:] / self.torque_cap)]
        )


MODELS = {"hover": Hover, "heading-invariant": HeadingInvariant, "brake": Brake, "cone-escape": Brake}


def drift(x):
    omega = x[9:12]
    return np.concatenate(
        [x[6:9], attitude_rate(x[3:6], omega), -G * E3, -np.cross(omega, INERTIA * omega) / INERTIA]
    )


def control(x):
    g = np.zeros((12, 4), dtype=x.dtype)
    g[6:9, 0] = rotation(x[3:6])[2] / MASS
    g[9:12, 1:] = np.diag(1 / INERTIA)
    return g


def held_step(x, u, h):
    """RK4 with the wrench held."""

    def f(y):
        return drift(y) + control(y) @ u

    k1 = f(x)
    k2 = f(x + h / 2 * k1)
    k3 = f(x + h / 2 * k2)
    k4 = f(x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def closed_loop(policy, x, hold):
    return drift(x) + control(x) @ policy(x, hold)


def flow(policy, x, step, count, hold, hold_steps):
    states = [x]
    for tick in range(count):
        v = hold if tick < hold_steps else np.zeros(3)
        x = states[-1]
        k1 = closed_loop(policy, x, v)
        k2 = closed_loop(policy, x + step / 2 * k1, v)
        k3 = closed_loop(policy, x + step / 2 * k2, v)
        k4 = closed_loop(policy, x + step * k3, v)
        states.append(x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4))
    return np.array(states)


def derivative(function, x, direction):
    """Derivative of `function` at x along `direction`, to rounding."""
    return np.asarray(function(x + 1j * STEP * direction)).imag / STEP


def random_state(rng, reach=1.0):
    """Any attitude but the singular one; speeds and rates up to a few m/s and rad/s times `reach`."""
    axis = rng.normal(size=3)
    sigma = axis / np.linalg.norm(axis) * np.tan(rng.uniform(-0.95, 0.95) * np.pi / 2)
    return np.concatenate([rng.normal(size=3), sigma, 3 * reach * rng.normal(size=3), 4 * reach * rng.normal(size=3)])
