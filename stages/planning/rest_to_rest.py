"""References as knots and coefficients of (x, y, z, yaw), as in `alula/plan`, for `ReferenceCurve`."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.stages.planning.trajectory import DEGREE, allocate_times, septic_spline

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
    points = _checked(np.stack([np.asarray(start, np.float64), np.asarray(goal, np.float64)]))
    if not (peak_speed > 0 and np.isfinite(peak_speed)):
        raise InputError(f"the peak speed must be positive, not {peak_speed}")
    duration = np.array([PEAK_SPEED * np.linalg.norm(points[1] - points[0]) / peak_speed])
    return _with_yaw(duration, septic_spline(points, duration), yaw_rad)


def minimum_snap(
    waypoint: ArrayLike,
    *,
    speed: float,
    acceleration: float,
    rest: ArrayLike | None = None,
    yaw_rad: float = 0.0,
) -> ReferencePath:
    """The minimum-snap trajectory through waypoints, at rest at its ends, within limits at every instant.

    Args:
        waypoint: shape (W, 3), W >= 2, consecutive ones distinct [m].
        speed: limit [m/s].
        acceleration: limit [m/s^2].
        rest: intermediate waypoints to stop at, shape (W,).
        yaw_rad: constant heading [rad].

    Raises:
        InputError: waypoints coincide or are not finite, or a limit is not positive.
    """
    points = _checked(np.asarray(waypoint, np.float64))
    for name, limit in (("speed", speed), ("acceleration", acceleration)):
        if not (limit > 0 and np.isfinite(limit)):
            raise InputError(f"the limit of {name} must be positive, not {limit}")
    stops = None if rest is None else np.asarray(rest, np.bool_)
    if stops is not None and stops.shape != (len(points),):
        raise InputError(f"rest has shape {stops.shape}, not {(len(points),)}")
    duration = allocate_times(points, speed, acceleration, stops)
    return _with_yaw(duration, septic_spline(points, duration, stops), yaw_rad)


def _checked(points: FloatArray) -> FloatArray:
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2:
        raise InputError(f"waypoints have shape (W, 3) with W >= 2, not {points.shape}")
    if not np.isfinite(points).all():
        raise InputError("waypoints must be finite")
    if (np.linalg.norm(np.diff(points, axis=0), axis=1) == 0).any():
        raise InputError("consecutive waypoints must be distinct")
    return points


def _with_yaw(duration: FloatArray, position: FloatArray, yaw_rad: float) -> ReferencePath:
    yaw = np.zeros((len(position), 1, DEGREE + 1))
    yaw[:, 0, 0] = yaw_rad
    time = np.concatenate([[0.0], np.cumsum(duration)])
    return ReferencePath(time, np.ascontiguousarray(np.concatenate([position, yaw], axis=1)))
