"""The backup policies and their flow in NumPy, for complex states too: derivatives by complex step."""

import numpy as np

from support.models import quadrotor_model as body
from support.models.quadrotor_model import E3, GRAVITY, INERTIA, MASS

ALLOCATION = np.array(body.PARAMETERS["G"])
INVERSE = np.linalg.inv(ALLOCATION)
F_MAX = body.PARAMETERS["fmax"]
HOVER = MASS * GRAVITY / 4  # of a rotor
REST = np.zeros(3)
WEIGHT = np.array([MASS * GRAVITY, 0, 0, 0])


class Hover:
    k_vz, k_sigma, k_omega, k_vh, eta_frac = 2.0, 0.30, 0.020, 0.006, 0.95
    weight = np.array([2.0, 0.3, 0.3, 0.05])

    def __init__(self):
        eta = min(F_MAX - HOVER, HOVER)
        self.caps = self.eta_frac * (eta / (np.abs(INVERSE) @ self.weight)).min() * self.weight

    def attitude_torque(self, sigma):
        return -self.k_sigma * sigma

    def raw(self, x, hold):
        sigma, v, omega = x[3:6], x[6:9], x[9:]
        u = body.body_to_inertial(sigma).T @ v
        torque = self.attitude_torque(sigma) - self.k_omega * omega + self.k_vh * np.array([u[1], -u[0], 0])
        return np.concatenate([[MASS * GRAVITY - MASS * self.k_vz * v[2]], torque])

    def __call__(self, x, hold):
        return WEIGHT + self.caps * np.tanh((self.raw(x, hold) - WEIGHT) / self.caps)


class HeadingInvariant(Hover):
    def attitude_torque(self, sigma):
        return self.k_sigma / 4 * body.cross(E3, body.body_to_inertial(sigma).T @ E3)


class Brake:
    tilt, full_speed, climb_rate, w, zeta, yaw, eta_frac, share = 0.61, 1.5, 4.0, 20.0, 0.9, 8.0, 0.95, 0.4
    torque_weight = np.array([0.3, 0.3, 0.03])

    def __init__(self):
        per_unit = np.abs(INVERSE[:, 1:]) @ self.torque_weight
        margin = self.eta_frac * min(F_MAX - HOVER, HOVER)
        self.torque_cap = (self.share * margin / per_unit).min() * self.torque_weight
        taken = np.abs(INVERSE[:, 1:]) @ self.torque_cap
        self.up = ((self.eta_frac * (F_MAX - HOVER) - taken) / INVERSE[:, 0]).min()
        self.down = ((self.eta_frac * HOVER - taken) / INVERSE[:, 0]).min()

    def raw(self, x, hold):
        sigma, omega, u = x[3:6], x[9:], x[6:9] - hold
        inertial = body.body_to_inertial(sigma)
        flat = u[:2] / np.sqrt(self.full_speed**2 + u[0] ** 2 + u[1] ** 2)
        target = np.concatenate([-np.tan(self.tilt) * flat, [1]])
        k_omega = INERTIA * np.array([2 * self.zeta * self.w, 2 * self.zeta * self.w, self.yaw])
        torque = INERTIA * self.w**2 * body.cross(E3, inertial.T @ target) - k_omega * omega
        cosine = inertial[2, 2]
        lift = 1.02 * cosine / (cosine**2 + 0.02)
        return np.concatenate([[MASS * (GRAVITY - self.climb_rate * u[2]) * lift], torque])

    def __call__(self, x, hold):
        raw = self.raw(x, hold)
        y = raw[0] - MASS * GRAVITY
        cap = self.up if y.real > 0 else self.down
        torque = self.torque_cap * np.tanh(raw[1:] / self.torque_cap)
        return np.concatenate([[MASS * GRAVITY + cap * np.tanh(y / cap)], torque])


MODELS = {"hover": Hover, "heading-invariant": HeadingInvariant, "brake": Brake, "cone-escape": Brake}


def closed_loop(policy, x, hold=REST):
    return body.derivative(x, policy(x, hold))


def drift_and_control(x):
    """f and g of x' = f + g u, from the model at five inputs."""
    f = body.derivative(x, np.zeros(4))
    return f, np.stack([body.derivative(x, u) - f for u in np.eye(4)], axis=-1)


def flow(policy, x, step, count, hold=REST, hold_steps=0):
    """Phi at 0, step, ..., shape (count + 1, 12)."""
    states = [x]
    for tick in range(count):
        v = hold if tick < hold_steps else REST
        states.append(body.rk4(lambda _, y, v=v: closed_loop(policy, y, v), states[-1], step))
    return np.array(states)


def along(function, x, direction):
    """The derivative of `function` at x along `direction`, to rounding."""
    return np.imag(function(x + 1e-40j * direction)) / 1e-40


def manoeuvre(vehicle, policy, x, tick, ticks, *, first=None, hold=REST, hold_ticks=0):
    """Positions, ten per tick, and states at ticks, of the policy sampled and held on the native vehicle."""
    states, positions = [x], [x[:3]]
    offset = 0 if first is None else 1
    for k in range(ticks):
        u = first if k < offset else policy(states[-1], hold if k - offset < hold_ticks else REST)
        row = states[-1][None]
        for _ in range(10):
            row = vehicle.step(row, u[None], dt_s=tick / 10)
            positions.append(row[0, :3])
        y = row[0].copy()
        n = y[3:6] @ y[3:6]
        if n > 1:
            y[3:6] /= -n
        states.append(y)
    return np.array(positions), np.array(states)
