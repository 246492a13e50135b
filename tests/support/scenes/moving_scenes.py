"""Tracks and walls as the filters among moving obstacles take them."""

import numpy as np

NO_WALLS = np.empty((0, 4))
NO_TRACKS = np.empty((0, 29))


def track(number, position, velocity, sigma_p=0.0, sigma_v=0.0, radius=0.15, covariance=None):
    """One row of tracks: (29,)."""
    matrix = np.diag([sigma_p**2] * 3 + [sigma_v**2] * 3) if covariance is None else covariance
    return np.r_[number, position, velocity, matrix[np.tril_indices(6)], radius]


def tracks(*rows):
    return np.array(rows) if rows else NO_TRACKS


def crowd(rng, count, near=4.0, far=30.0):
    """Obstacles all around that mostly come closer, with full covariances."""
    rows = []
    for number in range(count):
        direction = rng.normal(size=3)
        direction /= np.linalg.norm(direction)
        position = rng.uniform(near, far) * direction
        velocity = -rng.uniform(0, 9) * direction + rng.normal(size=3)
        factor = np.diag([0.1] * 3 + [0.3] * 3) + 0.05 * rng.normal(size=(6, 6))
        rows.append(track(number, position, velocity, covariance=factor @ factor.T))
    return np.array(rows)
