"""An independent model of the quadrotor: attitude through the unit quaternion, all in complex numbers too.

Nothing here uses the closed forms of the library. Functions take one state and work for complex dtype,
so derivatives follow from a complex step: f(x + i h)'s imaginary part over h, exact to rounding.
"""

import json

import numpy as np

from support.paths import SUPPORT

VECTORS = json.loads((SUPPORT / "vectors_fastbridge.json").read_text())
PARAMETERS = VECTORS["params"]
MASS, GRAVITY = PARAMETERS["m"], PARAMETERS["g"]
INERTIA = np.array(PARAMETERS["J"])
E3 = np.array([0.0, 0.0, 1.0])
ROTORS = {
    "rotor_x": (0.078, -0.078, 0.078, -0.078),
    "rotor_y": (0.078, -0.078, -0.078, 0.078),
    "spin": (-1, -1, 1, 1),
    "torque_ratio": 0.0116,
    "f_min": (0,) * 4,
    "f_max": (4.25,) * 4,
}


def fastbridge(**changed):
    """The native quadrotor of the test vectors."""
    from alula._core import Quadrotor

    return Quadrotor(**({"mass": MASS, "inertia": INERTIA.tolist(), **ROTORS} | changed))


def row(*parts):
    """One row of a batch."""
    return np.concatenate([np.atleast_1d(np.asarray(part, np.float64)) for part in parts])[None]


def cross(a, b):
    """a x b of two vectors, in numbers: `np.cross` takes ten times as long."""
    return np.array(_cross(np.asarray(a).tolist(), np.asarray(b).tolist()))


def _cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def quaternion(sigma):
    """(q0, q) = (1 - n, 2 sigma) / (1 + n)."""
    return np.array(_quaternion(sigma))


def _quaternion(sigma):
    x, y, z = np.asarray(sigma).tolist()
    n = x * x + y * y + z * z
    return [(1 - n) / (1 + n), 2 * x / (1 + n), 2 * y / (1 + n), 2 * z / (1 + n)]


def body_to_inertial(sigma):
    """Columns are the body's axes: each basis vector rotated by q v q*."""
    w, *q = _quaternion(sigma)
    columns = [_rotate(w, q, e) for e in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))]
    return np.array(list(zip(*columns, strict=True)))


def _rotate(w, q, v):
    t = [2 * each for each in _cross(q, v)]
    return [a + w * b + c for a, b, c in zip(v, t, _cross(q, t), strict=True)]


def sigma_rate(sigma, omega):
    """From q' = q (0, omega) / 2 and sigma = q_v / (1 + q0)."""
    (w, *q), omega = _quaternion(sigma), np.asarray(omega).tolist()
    scalar = -0.5 * (q[0] * omega[0] + q[1] * omega[1] + q[2] * omega[2])
    vector = [0.5 * (w * o + c) for o, c in zip(omega, _cross(q, omega), strict=True)]
    return np.array([v / (1 + w) - c * scalar / (1 + w) ** 2 for v, c in zip(vector, q, strict=True)])


def derivative(x, u, *, mass=MASS, inertia=INERTIA, gravity=GRAVITY, force=0.0):
    """x' of x = (p, sigma, v, omega) under (T, tau) and another force on the body [N]."""
    sigma, v, omega = x[3:6], x[6:9], x[9:]
    acceleration = (u[0] * body_to_inertial(sigma)[:, 2] + force) / mass - gravity * E3
    spin = (u[1:] - cross(omega, inertia * omega)) / inertia
    return np.concatenate([v, sigma_rate(sigma, omega), acceleration, spin])


def rk4(f, x, dt):
    """One step of x' = f(t, x)."""
    k1 = f(0, x)
    k2 = f(dt / 2, x + dt / 2 * k1)
    k3 = f(dt / 2, x + dt / 2 * k2)
    k4 = f(dt, x + dt * k3)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def jacobian(f, x, h=1e-30):
    """The derivative of f at a real x by complex steps; columns belong to components of x."""
    x = np.asarray(x, np.complex128)
    steps = 1j * h * np.eye(len(x))
    return np.stack([np.imag(f(x + step)) / h for step in steps], axis=-1)


def hat(a):
    """hat(a) b = a x b."""
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def vee(m):
    """The inverse of hat."""
    return np.array([m[2, 1], m[0, 2], m[1, 0]])


def random_states(count, seed, *, speed=3.0, rate=4.0):
    """States (N, 12) with |sigma| up to 1."""
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(count, 3))
    sigma = axis / np.linalg.norm(axis, axis=1, keepdims=True) * rng.uniform(0, 1, (count, 1))
    return np.concatenate(
        [
            rng.normal(size=(count, 3)),
            sigma,
            speed * rng.normal(size=(count, 3)),
            rate * rng.normal(size=(count, 3)),
        ],
        axis=1,
    )
