"""Piecewise degree-7 polynomials: evaluation, control points and exact bounds.

A trajectory is `time`, shape (K + 1,), strictly increasing [s], and `coefficient`, shape (K, D, 8):
on piece k, component d is sum_j coefficient[k, d, j] (t - time[k])^j, as in `alula/plan`.
"""

from __future__ import annotations

from functools import cache
from math import comb, factorial

import numpy as np
from numpy.typing import ArrayLike

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError

DEGREE = 7
_SUBDIVISIONS = 32  # the bound on a peak is then within about 0.1 % of the peak


def evaluate(time: ArrayLike, coefficient: ArrayLike, t: ArrayLike, derivative: int = 0) -> FloatArray:
    """Evaluate a derivative of a trajectory; times before its start or after its end give the value there.

    Args:
        time: knots, shape (K + 1,) [s].
        coefficient: shape (K, D, 8).
        t: times, any shape S [s].
        derivative: 0 for the position, up to 7.

    Returns:
        Shape S + (D,). At a knot, of the piece that begins there.

    Raises:
        InputError: the shapes do not fit or the derivative is not in 0..7.
    """
    knots, c = np.asarray(time, np.float64), np.asarray(coefficient, np.float64)
    if c.ndim != 3 or c.shape[2] != DEGREE + 1 or knots.shape != (len(c) + 1,) or len(c) == 0:
        raise InputError(f"a trajectory has K + 1 knots and (K, D, 8), not {knots.shape} and {c.shape}")
    if not (0 <= derivative <= DEGREE):
        raise InputError(f"the derivative must be in 0..{DEGREE}, not {derivative}")
    at = np.clip(np.asarray(t, np.float64), knots[0], knots[-1])
    piece = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(c) - 1)
    local = (at - knots[piece])[..., None]
    value = np.zeros((*at.shape, c.shape[1]))
    for j in range(DEGREE, derivative - 1, -1):
        value = value * local + factorial(j) // factorial(j - derivative) * c[piece, :, j]
    return value


def control_points(time: ArrayLike, coefficient: ArrayLike) -> FloatArray:
    """Bernstein coefficients of each piece on its interval.

    b_i = sum_j C(i, j) / C(7, j) c_j T^j; the curve lies in the hull of its control points.

    Args:
        time: knots, shape (K + 1,) [s].
        coefficient: shape (K, D, 8).

    Returns:
        Shape (K, D, 8).
    """
    duration = np.diff(np.asarray(time, np.float64))
    powers = duration[:, None] ** np.arange(DEGREE + 1)
    scaled = np.asarray(coefficient, np.float64) * powers[:, None, :]
    return np.asarray(scaled @ _bernstein_from_power().T)


@cache
def _bernstein_from_power() -> FloatArray:
    return np.array([[comb(i, j) / comb(DEGREE, j) for j in range(DEGREE + 1)] for i in range(DEGREE + 1)])


@cache
def _subdivision(degree: int, parts: int) -> FloatArray:
    """Matrices, shape (parts, degree + 1, degree + 1), to the control points on equal sub-intervals.

    Entry (s, i, j) is the Bernstein polynomial of degree `degree` polarised at i times the upper and
    degree - i times the lower end of part s; all entries are >= 0 and rows sum to one.
    """
    matrices = np.zeros((parts, degree + 1, degree + 1))
    for part in range(parts):
        low, high = part / parts, (part + 1) / parts
        for i in range(degree + 1):
            row = np.ones(1)
            for argument in [high] * i + [low] * (degree - i):
                row = np.append(row * (1 - argument), 0.0) + np.append(0.0, row * argument)
            matrices[part, i] = row
    return matrices


def subdivided(points: FloatArray, parts: int = _SUBDIVISIONS) -> FloatArray:
    """Control points on equal sub-intervals.

    Args:
        points: shape (..., n + 1).

    Returns:
        Shape (..., parts, n + 1).
    """
    return np.asarray(np.einsum("sij,...j->...si", _subdivision(points.shape[-1] - 1, parts), points))


def peak_bounds(time: ArrayLike, coefficient: ArrayLike, derivative: int) -> FloatArray:
    """Upper bound on the norm of a derivative over each piece.

    The squared norm is a polynomial of degree 2 (7 - derivative) whose Bernstein coefficients on
    32 sub-intervals bound it from above: a bound over the continuous time, at most about 0.1 %
    above the true peak.

    Args:
        time: knots, shape (K + 1,) [s].
        coefficient: shape (K, D, 8).
        derivative: 0 for the position, up to 7.

    Returns:
        Shape (K,).
    """
    duration = np.diff(np.asarray(time, np.float64))
    points = control_points(time, coefficient)
    for order in range(derivative):
        points = (DEGREE - order) * np.diff(points, axis=-1) / duration[:, None, None]
    parts = subdivided(points)
    n = parts.shape[-1] - 1
    squared = np.zeros((*parts.shape[:1], parts.shape[2], 2 * n + 1))
    for i in range(n + 1):
        for j in range(n + 1):
            weight = comb(n, i) * comb(n, j) / comb(2 * n, i + j)
            squared[..., i + j] += weight * (parts[..., i] * parts[..., j]).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(squared.max(axis=(1, 2)), 0.0)))
