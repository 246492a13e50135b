"""Coordinates far from the origin: the spacing of their numbers, and an origin that is nearer."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray

_ROUND_M = 100.0  # a chosen origin is a multiple of it


def spacing(numbers: NDArray[Any]) -> FloatArray:
    """Distance from the size of each number to the next larger one of its precision.

    That of the largest finite numbers is the spacing of their exponent, where `np.spacing` overflows.

    Args:
        numbers: of half or single precision, any shape.

    Returns:
        Same shape; NaN for those that are not finite.
    """
    largest = np.finfo(numbers.dtype).max
    with np.errstate(over="ignore", invalid="ignore"):
        step = np.spacing(np.abs(numbers)).astype(np.float64)
    bound: FloatArray = np.minimum(step, float(largest - np.nextafter(largest, largest.dtype.type(0))))
    return bound


def single_rounding(points: NDArray[Any]) -> FloatArray:
    """Bound of the shift of each point by rounding to single precision; 0 where a file has finer numbers.

    Numbers in a file that are all single-precision numbers were rounded to them, as far as one can know.

    Args:
        points: shape (n, 3), any units.

    Returns:
        Shape (n,), same units.
    """
    with np.errstate(over="ignore"):  # infinite where it is beyond single precision
        single = points.astype(np.float32)
    half = spacing(single) / 2
    if not (single == points).all():
        return np.zeros(len(points))
    bound: FloatArray = np.linalg.norm(half, axis=1)
    return bound


def nearer_origin(lower: FloatArray, upper: FloatArray, far_m: float) -> tuple[float, float, float]:
    """Origin for a map: 0 along each axis on which nothing is far, else the middle, rounded to 100 m.

    Args:
        lower: lowest coordinates, shape (3,) [m].
        upper: highest coordinates, shape (3,) [m].
        far_m: largest coordinate that is not far [m].
    """
    middle = np.round((lower + upper) / 2 / _ROUND_M) * _ROUND_M
    is_far = np.maximum(np.abs(lower), np.abs(upper)) > far_m
    x, y, z = np.where(is_far, middle, 0.0).tolist()
    return x, y, z
