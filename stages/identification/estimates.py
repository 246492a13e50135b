"""Values with 95 % intervals: of a mean by Student's t, of a line's coefficients by least squares and t."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.quantiles import student_quantile

_CONFIDENCE = 0.95


class Measured(NamedTuple):
    """A value and its 95 % interval; None where there are too few measurements for one."""

    value: float
    interval: tuple[float, float] | None


def mean_of(values: Sequence[float]) -> Measured:
    """Mean with its interval by Student's t.

    Args:
        values: independent measurements, at least one.
    """
    mean, n = float(np.mean(values)), len(values)
    if n < 2:
        return Measured(mean, None)
    half = student_quantile(n - 1, 0.5 + _CONFIDENCE / 2) * float(np.std(values, ddof=1)) / math.sqrt(n)
    return Measured(mean, (mean - half, mean + half))


def line_of(x: Sequence[float] | FloatArray, y: Sequence[float] | FloatArray) -> tuple[Measured, Measured]:
    """Least-squares line y = a + b x, with the intervals of a and b.

    Args:
        x: at least two different values.
    """
    A = np.column_stack([np.ones(len(x)), np.asarray(x, np.float64)])
    y = np.asarray(y, np.float64)
    (a, b), *_ = np.linalg.lstsq(A, y, rcond=None)
    degrees = len(y) - 2
    if degrees < 1:
        return Measured(float(a), None), Measured(float(b), None)
    variance = float(((y - A @ (a, b)) ** 2).sum()) / degrees
    half = student_quantile(degrees, 0.5 + _CONFIDENCE / 2) * np.sqrt(
        variance * np.diag(np.linalg.inv(A.T @ A))
    )
    first, second = (
        Measured(float(value), (float(value - wide), float(value + wide)))
        for value, wide in zip((a, b), half, strict=True)
    )
    return first, second
