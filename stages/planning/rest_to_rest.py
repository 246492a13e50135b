"""References as knots and coefficients of (x, y, z, yaw), as in `alula/plan`, for `ReferenceCurve`."""

from __future__ import annotations

from functools import cache
from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.stages.planning.trajectory import DEGREE

PEAK_SPEED = 2.1875  # of a rest-to-rest septic, in units of its length over its duration


class ReferencePath(NamedTuple):
    """Piece k: component d of (x, y, z, yaw) is sum_j coefficient[k, d, j] (t - time[k])^j."""

    time: FloatArray  # (K + 1,) [s]
    coefficient: FloatArray  # (K, 4, 8) [m, rad]


def rest_to_rest(
    start: ArrayLike, goal: ArrayLike, peak_speed: float, *, yaw_rad: float = 0.0
) -> ReferencePath:
    """The straight septic from rest to rest, 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7 of the distance.

    Its speed peaks in the middle at 2.1875 L / T, which sets T; velocity, acceleration and jerk are zero
    at both ends.

    Args:
        start: shape (3,) [m].
        goal: shape (3,) [m], another point.
        peak_speed: [m/s].

    Raises:
        InputError: the points are the same or not finite, or the speed is not positive.
    """
    points = np.stack([np.asarray(start, np.float64), np.asarray(goal, np.float64)])
    if points.shape != (2, 3):
        raise InputError(f"start and goal have shape (3,), not {points.shape[1:]}")
    if not np.isfinite(points).all():
        raise InputError("start and goal must be finite")
    length = float(np.linalg.norm(points[1] - points[0]))
    if length == 0:
        raise InputError("start and goal must be distinct")
    if not (peak_speed > 0 and np.isfinite(peak_speed)):
        raise InputError(f"the peak speed must be positive, not {peak_speed}")
    duration = PEAK_SPEED * length / peak_speed
    at_ends = np.zeros((8, 3))  # value and three derivatives at the start, then at the goal
    at_ends[[0, 4]] = points
    coefficient = np.zeros((1, 4, DEGREE + 1))
    coefficient[0, :3] = np.einsum("ij,jd->di", _hermite(), at_ends) / duration ** np.arange(8.0)
    coefficient[0, 3, 0] = yaw_rad
    return ReferencePath(np.array([0.0, duration]), coefficient)


@cache
def _hermite() -> FloatArray:
    """Power coefficients on [0, 1] from value and three derivatives at 0, then at 1."""
    conditions = np.zeros((8, 8))
    for i in range(4):
        conditions[i, i] = factorial(i)
        for j in range(i, 8):
            conditions[4 + i, j] = factorial(j) / factorial(j - i)
    return np.asarray(np.linalg.inv(conditions), np.float64)
