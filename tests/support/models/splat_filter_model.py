"""The filters among ellipsoids in NumPy, written from their equations alone; complex inputs work."""

import numpy as np


def rotation(quat_wxyz):
    quat = np.asarray(quat_wxyz, float)
    w, x, y, z = quat / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def outer_matrix(scale, quat_wxyz, sigma, radius):
    """A of the ellipsoid around the sum with a ball, from the covariance and its inverse."""
    R = rotation(quat_wxyz)
    Sigma = R @ np.diag((sigma * np.asarray(scale, float)) ** 2) @ R.T
    p = np.sqrt(np.trace(Sigma) / (3 * radius**2))
    return np.linalg.inv((1 + 1 / p) * Sigma + (1 + p) * radius**2 * np.eye(3))


def cone(mu, A, p, v):
    """beta, gamma, delta, h; without conjugation, so that steps may be complex."""
    r = mu - p
    beta, gamma, delta = v @ A @ v, r @ A @ r - 1, r @ A @ v
    return beta, gamma, delta, beta * gamma - delta**2


def closest_point(semi, z):
    """The point of an axis-aligned ellipsoid closest to z > 0, semi-axes descending, by bisection."""
    scaled, ratio = z / semi, (semi / semi[-1]) ** 2
    low, high = scaled[-1] - 1, np.linalg.norm(ratio * scaled) - 1
    if scaled @ scaled < 1:
        high = 0.0
    else:
        low = max(low, 0.0)
    for _ in range(200):
        middle = 0.5 * (low + high)
        value = np.sum((ratio * scaled / (middle + ratio)) ** 2) - 1
        low, high = (middle, high) if value >= 0 else (low, middle)
    multiplier = 0.5 * (low + high)
    return ratio * z / (multiplier + ratio), multiplier * semi[-1] ** 2


def distance_barrier(mean, scale, quat_wxyz, sigma, radius, p, v, *, alpha=5.0, beta=1.0, published=False):
    """h, row and bound (row . a >= bound) of phi d^2 - r^2 in the ellipsoid's sorted and mirrored frame."""
    order = np.argsort(-np.asarray(scale, float), kind="stable")
    semi, axes = sigma * np.asarray(scale, float)[order], rotation(quat_wxyz)[:, order]
    local = axes.T @ (p - mean)
    sign = np.where(local < 0, -1.0, 1.0)
    z = sign * local
    y, lam = closest_point(semi, z)
    phi = 1.0 if np.sum((z / semi) ** 2) > 1 else -1.0
    h = phi * np.sum((z - y) ** 2) - radius**2
    # y(z) solves y (lam + e^2) = e^2 z on the surface: differentiate both.
    e2 = semi**2
    dlam = 2 * e2 * z / (lam + e2) ** 2 / (2 * np.sum(e2 * z**2 / (lam + e2) ** 3))
    jacobian = np.diag(e2 / (lam + e2)) - np.outer(e2 * z / (lam + e2) ** 2, dlam)
    hessian = 2 * phi * (np.eye(3) - jacobian)
    gradient = axes @ (sign * 2 * phi * (z - y))
    if not published:
        frame = axes * sign
        hessian = frame @ hessian @ frame.T
    bound = -(v @ hessian @ v + (alpha + beta) * gradient @ v + alpha * beta * h)
    return h, gradient, bound


def gate(speed, radius, *, reaction_time_s=0.3, max_deceleration=6.0, floor_m=0.5):
    return max(floor_m, speed**2 / (2 * max_deceleration) + speed * reaction_time_s + radius)


def scene(rng, count, *, size=2.0, low=-2.0, high=-0.7):
    """Gaussians of mixed shapes in a cube, as 32-bit rows."""
    mean = rng.uniform(-size, size, (count, 3)).astype(np.float32)
    scale = (10 ** rng.uniform(low, high, (count, 3))).astype(np.float32)
    return mean, scale, rng.normal(size=(count, 4)).astype(np.float32)
