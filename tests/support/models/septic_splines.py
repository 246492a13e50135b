"""Minimum-snap splines through waypoints and their times, an independent planner to compare with."""

from __future__ import annotations

from functools import cache
from math import factorial

import numpy as np
from numpy.typing import ArrayLike

from alula.schemas.arrays import FloatArray
from alula.stages.planning.trajectory import peak_bounds

_ALLOCATION_STEPS = 6  # per cruising speed
_CRUISE_FRACTIONS = (1.0, 0.7, 0.5, 0.35)  # of the speed limit, to start from; slow ones win in tight turns


@cache
def _hermite() -> FloatArray:
    """Power coefficients on [0, 1] from value and three derivatives at 0, then at 1."""
    conditions = np.zeros((8, 8))
    for i in range(4):
        conditions[i, i] = factorial(i)
        for j in range(i, 8):
            conditions[4 + i, j] = factorial(j) / factorial(j - i)
    return np.asarray(np.linalg.inv(conditions), np.float64)


@cache
def _end_derivatives() -> FloatArray:
    """Derivatives 4, 5, 6 at 0 and at 1 of the Hermite piece, shape (2, 3, 8)."""
    power = np.zeros((2, 3, 8))
    for row, i in enumerate((4, 5, 6)):
        power[0, row, i] = factorial(i)
        for j in range(i, 8):
            power[1, row, j] = factorial(j) / factorial(j - i)
    return np.asarray(power @ _hermite())


def septic_spline(waypoint: ArrayLike, duration: ArrayLike, rest: ArrayLike | None = None) -> FloatArray:
    """The minimum-snap trajectory through waypoints at given times, at rest at its ends.

    Among all functions through the waypoints that have zero velocity, acceleration and jerk at waypoints of
    rest, it minimises the integral of |d^4 p / dt^4|^2. The minimiser is of degree 7 on
    each piece and has continuous derivatives up to the sixth at all other waypoints, which is a
    linear system, banded with five diagonals on each side, for velocity, acceleration and jerk
    there. At waypoints of rest derivatives up to the third are continuous. Between two adjacent
    waypoints of rest it is the straight rest-to-rest piece 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7.

    Args:
        waypoint: shape (W, D), W >= 2.
        duration: time between consecutive waypoints, shape (W - 1,), positive [s].
        rest: waypoints to stop at, shape (W,); always true at both ends.

    Returns:
        Coefficients, shape (W - 1, D, 8).

    Source: Mellinger and Kumar 2011, without inequality constraints.
    """
    from scipy.linalg import solve_banded

    p, length = np.asarray(waypoint, np.float64), np.asarray(duration, np.float64)
    count = len(p)
    stop = np.zeros(count, np.bool_) if rest is None else np.array(rest, np.bool_)
    stop[[0, -1]] = True
    moving = np.flatnonzero(~stop)
    slot = np.full(count, -1)
    slot[moving] = np.arange(len(moving))
    derivatives = np.zeros((count, 3, p.shape[1]))  # velocity, acceleration, jerk at each waypoint
    if len(moving):
        ends = _end_derivatives()
        band = np.zeros((11, 3 * len(moving)))
        right = np.zeros((3 * len(moving), p.shape[1]))
        # Unknown (v, a, j) of a waypoint in units of its shorter neighbour's duration; row i in
        # units of that duration to the power of -i: all numbers stay of order one.
        unit = np.minimum(length[:-1], length[1:])
        unit = np.concatenate([[length[0]], unit, [length[-1]]])
        for knot in moving:
            for piece, side in ((knot - 1, 1), (knot, 0)):
                sign = 1.0 if side == 1 else -1.0
                ratio = unit[knot] / length[piece]
                row_scale = sign * ratio ** np.array([4.0, 5.0, 6.0])
                block = ends[side] * row_scale[:, None]  # on [p0, v0 T, a0 T^2, j0 T^3, p1, ...]
                row = 3 * slot[knot]
                for end, other in ((0, piece), (1, piece + 1)):
                    right[row : row + 3] -= block[:, 4 * end, None] * p[other]
                    if slot[other] < 0:
                        continue
                    column_scale = (length[piece] / unit[other]) ** np.array([1.0, 2.0, 3.0])
                    part = block[:, 4 * end + 1 : 4 * end + 4] * column_scale
                    column = 3 * slot[other]
                    for i in range(3):
                        for j in range(3):
                            band[5 + row + i - column - j, column + j] += part[i, j]
        solution = solve_banded((5, 5), band, right).reshape(len(moving), 3, -1)
        derivatives[moving] = solution / unit[moving, None, None] ** np.array([1.0, 2.0, 3.0])[:, None]
    state = np.concatenate([p[:, None, :], derivatives], axis=1)  # (W, 4, D)
    scale = length[:, None] ** np.arange(8.0)
    unit_state = np.concatenate([state[:-1], state[1:]], axis=1) * scale[:, [0, 1, 2, 3, 0, 1, 2, 3], None]
    unit_coefficient = np.einsum("ij,kjd->kdi", _hermite(), unit_state)
    return np.asarray(unit_coefficient / scale[:, None, :])


def allocate_times(
    waypoint: ArrayLike, speed: float, acceleration: float, rest: ArrayLike | None = None
) -> FloatArray:
    """Durations between waypoints, shape (W - 1,) [s], that keep the septic spline within limits.

    Candidates start from the times of a point that slows down for the turns of the polyline, at several
    cruising speeds. Then, a fixed number of times, pieces far below the limits are shortened and pieces above
    them stretched. The fastest candidate is stretched as a whole until its bounds on speed and acceleration
    (`peak_bounds`, so over the continuous time) are within the limits. Scaling all times by f scales speed by
    1/f and acceleration by 1/f^2 and does not change the path.

    Args:
        waypoint: shape (W, D), consecutive ones distinct; the norm of all D columns is limited [m].
        speed: limit [m/s].
        acceleration: limit [m/s^2].
        rest: as for `septic_spline`.
    """
    p = np.asarray(waypoint, np.float64)
    best, best_total = np.empty(0), np.inf
    for fraction in _CRUISE_FRACTIONS:
        duration = _profile(p, fraction * speed, acceleration, rest)
        for _ in range(_ALLOCATION_STEPS):
            ratio = _limit_ratio(p, duration, speed, acceleration, rest)
            needed = duration * (ratio.max() * (1 + 1e-9))
            if needed.sum() < best_total:
                best, best_total = needed, float(needed.sum())
            duration = duration * np.clip(ratio, 0.5, 2.0) ** 0.5
    return best


def _profile(p: FloatArray, speed: float, acceleration: float, rest: ArrayLike | None) -> FloatArray:
    """Durations of a point on the polyline with v^2 curvature <= a and |dv/dt| <= a / 2."""
    step = np.diff(p, axis=0)
    length = np.linalg.norm(step, axis=1)
    direction = step / length[:, None]
    turn = 2 * np.arcsin(np.clip(np.linalg.norm(np.diff(direction, axis=0), axis=1) / 2, 0, 1))
    curvature = turn / (0.5 * (length[:-1] + length[1:]))
    fastest = np.zeros(len(p))
    fastest[1:-1] = np.minimum(speed, np.sqrt(acceleration / np.maximum(curvature, 1e-12)))
    if rest is not None:
        fastest[np.asarray(rest, np.bool_)] = 0
    for i in range(len(length)):
        fastest[i + 1] = min(fastest[i + 1], np.sqrt(fastest[i] ** 2 + acceleration * length[i]))
    for i in range(len(length) - 1, -1, -1):
        fastest[i] = min(fastest[i], np.sqrt(fastest[i + 1] ** 2 + acceleration * length[i]))
    mean = 0.5 * (fastest[:-1] + fastest[1:])
    return np.asarray(length / np.maximum(mean, 0.5 * np.sqrt(acceleration * length)))


def _limit_ratio(
    p: FloatArray, duration: FloatArray, speed: float, acceleration: float, rest: ArrayLike | None
) -> FloatArray:
    """Factor by which each piece would have to be slower, shape (K,)."""
    time = np.concatenate([[0.0], np.cumsum(duration)])
    coefficient = septic_spline(p, np.diff(time), rest)
    slower = np.sqrt(peak_bounds(time, coefficient, 2) / acceleration)
    return np.asarray(np.maximum(peak_bounds(time, coefficient, 1) / speed, slower))
