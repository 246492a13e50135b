"""A model of the racing drone and its backup controller by rotation matrices and adaptive integration.

Nothing here uses the closed forms of the library. States are p, v, q wxyz, omega (13).
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

GRAVITY, RATE_GAIN = 9.81, 50.0
MAX_RATE = np.array([12.0, 12.0, 6.0])
BOX = ((-40.0, -40.0, 0.0), (40.0, 40.0, 60.0))


def thrust(throttle):
    """The published map, through P."""
    p = 1639 * throttle + 172
    return 2.7508051e-5 * p**2 - 4.7313846e-3 * p


HOVER = brentq(lambda throttle: thrust(throttle) - GRAVITY, 0, 1)


def hat(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def about_z(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def rotation(q):
    """The matrix of a quaternion."""
    k = hat(q[1:])
    return np.eye(3) + 2 * q[0] * k + 2 * k @ k


def exponential(vector):
    """The matrix of a rotation vector, after Rodrigues."""
    size, k = np.linalg.norm(vector), hat(vector)
    return np.eye(3) + np.sinc(size / np.pi) * k + 0.5 * np.sinc(size / (2 * np.pi)) ** 2 * k @ k


def quaternion_rate(q, w):
    vector = 0.5 * (q[0] * w + np.cross(q[1:], w))
    return np.concatenate([[-0.5 * q[1:] @ w], vector])


def push(p, box=BOX, kept=0.0, distance=1.0):
    """(17), with the same rule for the height."""
    lower, upper = np.array(box[0]) + kept, np.array(box[1]) - kept
    inward = np.clip((lower + distance) - p, 0, 1)
    return inward + np.clip((upper - distance) - p, -1, 0)


def hold(x, box=BOX, kept=0.0):
    """z_0 and yaw_0."""
    return x[2] + push(x[:3], box, kept)[2], 2 * np.arctan2(x[9], x[6])


def backup(x, held, box=BOX, kept=0.0):
    """u_B: throttle, rates."""
    height, yaw = held
    p, v, turn = x[:3], x[3:6], rotation(x[6:10])
    zeta, wanted = turn[2, 2], push(p, box, kept)
    tilt = 0.15 * (about_z(yaw).T @ (wanted - v))[:2]
    size, most = np.linalg.norm(tilt), np.pi / 2.1
    tilt *= np.clip(1 + 4 * zeta, 0, 1) * min(1.0, most / max(size, 1e-9))
    target = about_z(yaw) @ exponential([-tilt[1], tilt[0], 0])
    error = target.T @ turn
    skew, cosine = 0.5 * (error - error.T), (np.trace(error) - 1) / 2
    if cosine < 0:  # beyond 90 degrees
        skew *= np.sqrt(0.5) / np.sqrt((1 + cosine) / 2)
    rates = -10 * np.array([skew[2, 1], skew[0, 2], skew[1, 0]])
    steep = np.interp(zeta, [-0.25, 0.0], [1 / 3, 2]) if zeta < 0.5 else 1 / zeta
    throttle = HOVER * steep
    throttle += np.clip(0.1 * (height - p[2]), -0.3, 0.3) + np.clip(0.05 * (wanted[2] - v[2]), -0.3, 0.3)
    return np.concatenate([[np.clip(throttle, 0, 1)], np.clip(rates, -MAX_RATE, MAX_RATE)])


def derivative(x, u, *, force=0.0):
    """x' under throttle and rates, with another acceleration."""
    acceleration = thrust(u[0]) * rotation(x[6:10])[:, 2] - GRAVITY * np.array([0, 0, 1]) + force
    return np.concatenate(
        [x[3:6], acceleration, quaternion_rate(x[6:10], x[10:]), RATE_GAIN * (u[1:] - x[10:])]
    )


def flow(x, horizon, box=BOX, kept=0.0):
    """The states at 601 times of the flow under u_B."""
    held = hold(x, box, kept)
    solved = solve_ivp(
        lambda _, y: derivative(y, backup(y, held, box, kept)),
        (0, horizon),
        x,
        t_eval=np.linspace(0, horizon, 601),
        rtol=1e-6,
        atol=1e-7,
        max_step=0.02,
    )
    return solved.y.T


def box_distance(p, box=BOX):
    return np.minimum(p - np.array(box[0]), np.array(box[1]) - p).min(axis=-1)


def random_states(count, seed, *, speed=20.0, tilt=1.2, low=(-35, -35, 3), high=(35, 35, 57)):
    """States (N, 13) tilted by at most so much, at any yaw."""
    rng = np.random.default_rng(seed)
    yaw, towards = rng.uniform(-np.pi, np.pi, (2, count))
    half = 0.5 * rng.uniform(0, tilt, count)
    y, t = (
        np.stack([np.cos(yaw / 2), np.sin(yaw / 2)]),
        np.stack([np.cos(towards), np.sin(towards)]) * np.sin(half),
    )
    q = np.stack(
        [y[0] * np.cos(half), y[0] * t[0] - y[1] * t[1], y[0] * t[1] + y[1] * t[0], y[1] * np.cos(half)]
    )
    v = rng.normal(size=(count, 3))
    v *= speed * rng.uniform(0, 1, (count, 1)) / np.linalg.norm(v, axis=1, keepdims=True)
    return np.concatenate([rng.uniform(low, high, (count, 3)), v, q.T, rng.normal(size=(count, 3))], axis=1)
