"""Random hulls with a small filter of velocities in double precision, for the chord of a lagging vehicle."""

import numpy as np

from alula.stages.filtering.protocol import FilterResult, FilterStatus

SPEED_M_S, BETA, RADIUS_M = 2.0, 4.0, 0.25


class Hulls:
    """Filter among convex hulls {x : n . x <= d}: one row, of the nearest hull; refuses beyond 12 m."""

    def __init__(self, rng):
        self.normals, self.offsets = [], []
        for _ in range(4):
            normals = rng.normal(size=(8, 3))
            normals /= np.linalg.norm(normals, axis=1)[:, None]
            centre = rng.uniform(-3, 3, 3)
            self.normals.append(normals)
            self.offsets.append(normals @ centre + rng.uniform(0.1, 0.8, 8))

    kind = "velocity"

    def reset(self):
        pass

    def __call__(self, state, nominal):
        x, u = state.position, nominal.velocity
        if np.abs(x).max() > 12:
            return FilterResult(np.zeros(3), FilterStatus.REFUSED, float("nan"))
        values = [n @ x - d for n, d in zip(self.normals, self.offsets, strict=True)]
        k = int(np.argmin([v.max() for v in values]))
        n, h = self.normals[k][int(np.argmax(values[k]))], float(values[k].max()) - RADIUS_M
        if h < 0:
            return FilterResult(min(-BETA * h, SPEED_M_S) * n, FilterStatus.RECOVERING, h, k)
        lacking = -BETA * h - float(n @ u)
        speed = float(np.linalg.norm(u))
        if lacking <= 0 and speed <= SPEED_M_S:
            return FilterResult(u, FilterStatus.OK, h, k)
        safe = u + max(0.0, lacking) * n
        size = float(np.linalg.norm(safe))
        return FilterResult(safe * min(1.0, SPEED_M_S / size), FilterStatus.FILTERED, h, k)


def scenes(count, seed):
    """Filter, position, velocity, nominal velocity and lag [s] of each scene."""
    rng = np.random.RandomState(seed)  # its numbers never change
    for i in range(count):
        hulls = Hulls(rng)
        span = 13.0 if i % 20 == 0 else 4.0
        p, v, u = rng.uniform(-span, span, 3), rng.normal(size=3), 1.5 * rng.normal(size=3)
        yield hulls, p, v * rng.choice([0.01, 0.5, 2.0]), u, float(rng.choice([0.0, 0.25, 0.6, 2.0]))
