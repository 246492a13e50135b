"""The planner before version 1.1 of its artifact, to compare with.

It made curves of minimum snap with its own allocation of times, and knew limits of speed and acceleration
alone. A piece that was not proven clear was halved, up to four times, and then became a straight line from
rest to rest.
"""

from __future__ import annotations

import numpy as np
from measure import FloatArray

from alula.stages.planning.curve_certificate import certify_in
from alula.stages.planning.fastest import keeps
from alula.stages.planning.limits import Limits
from alula.stages.planning.path import Polyline
from alula.stages.planning.space import PlanSpace
from alula.stages.planning.trajectory import control_points, subdivided
from support.models.septic_splines import allocate_times, septic_spline

_SPLITS = 4
_PARTS = 32  # of a piece, whose control points bound its derivatives to about 0.1 %


def older_curve(
    path: Polyline, speed_m_s: float, acceleration_m_s2: float, space: PlanSpace
) -> tuple[FloatArray, FloatArray] | None:
    """Knots (K + 1,) and coefficients (K, 3, 8) along a path, proven clear; None if that failed."""
    waypoint = path.point
    rest = np.zeros(len(waypoint), np.bool_)
    rest[[0, -1]] = True
    splits = np.zeros(len(waypoint) - 1, np.int64)
    while True:
        duration = allocate_times(waypoint, speed_m_s, acceleration_m_s2, rest)
        time = np.concatenate([[0.0], np.cumsum(duration)])
        coefficient = septic_spline(waypoint, np.diff(time), rest)
        parts = subdivided(control_points(time, coefficient))
        low, high = parts.min(axis=(2, 3)), parts.max(axis=(2, 3))
        inside = (low >= path.lower - 1e-9) & (high <= path.upper + 1e-9)
        failed = ~(certify_in(time, coefficient, space, jobs=1).proven & inside.all(axis=1))
        if not failed.any():
            return time, coefficient
        if (rest[:-1] & rest[1:] & failed).any():
            return None
        halved = failed & (splits < _SPLITS)
        straight = failed & ~halved
        rest[:-1] |= straight
        rest[1:] |= straight
        at = np.flatnonzero(halved)
        waypoint = np.insert(waypoint, at + 1, 0.5 * (waypoint[at] + waypoint[at + 1]), axis=0)
        rest = np.insert(rest, at + 1, False)
        splits = np.insert(splits + halved, at + 1, splits[at] + 1)


def stretched_s(time: FloatArray, coefficient: FloatArray, limits: Limits) -> float:
    """Duration of the same path, all of it flown more slowly until limits hold [s]."""
    parts = subdivided(control_points(time, coefficient), _PARTS)  # (K, 3, parts, 8)
    points = parts.transpose(0, 2, 3, 1).reshape(-1, 8, 3)
    duration = np.repeat(np.diff(time) / _PARTS, _PARTS)
    low, high = 0.0, 1.0
    while not keeps(points, high * duration, limits).all():
        low, high = high, 2 * high
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if keeps(points, middle * duration, limits).all() else (middle, high)
    return high * float(time[-1])
