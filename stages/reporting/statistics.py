"""Intervals of figures that are compared over the same trials."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from alula.schemas.errors import InputError

FloatArray = NDArray[np.float64]

_RESAMPLES = 4000


@dataclass(frozen=True, slots=True)
class Estimate:
    """A figure with its 95 % interval, from `n` trials."""

    value: float
    low: float
    high: float
    n: int


def mean_estimate(values: ArrayLike, *, seed: int = 0) -> Estimate | None:
    """The mean of independent values, shape (n,), and its percentile bootstrap interval; None for none."""
    x = _finite(values)
    if len(x) == 0:
        return None
    means = x[_resampled(len(x), seed)].mean(axis=1)
    return _estimate(float(x.mean()), means, len(x))


def ratio_estimate(ours: ArrayLike, theirs: ArrayLike, *, seed: int = 0) -> Estimate | None:
    """Ratio of the means of paired values, shapes (n,), resampled by pairs; None for none.

    Source: Efron and Tibshirani 1993, chapter 13 (percentile intervals).

    Raises:
        InputError: the lengths differ, or a value is not finite.
    """
    a, b = _finite(ours), _finite(theirs)
    if len(a) != len(b):
        raise InputError(f"paired values need equal lengths, not {len(a)} and {len(b)}")
    if len(a) == 0 or not b.mean() > 0:
        return None
    index = _resampled(len(a), seed)
    below = b[index].mean(axis=1)
    ratios = a[index].mean(axis=1)[below > 0] / below[below > 0]
    return _estimate(float(a.mean() / b.mean()), ratios, len(a))


def difference_estimate(ours: ArrayLike, theirs: ArrayLike, *, seed: int = 0) -> Estimate | None:
    """Mean of the differences of paired values, shapes (n,), with its interval; None for none."""
    a, b = _finite(ours), _finite(theirs)
    if len(a) != len(b):
        raise InputError(f"paired values need equal lengths, not {len(a)} and {len(b)}")
    return mean_estimate(a - b, seed=seed)


def _estimate(value: float, resampled: FloatArray, n: int) -> Estimate:
    low, high = np.percentile(resampled, [2.5, 97.5]).tolist()
    return Estimate(value, low, high, n)


def _resampled(count: int, seed: int) -> NDArray[np.int64]:
    generator = np.random.Generator(np.random.Philox(key=np.array([seed, count], np.uint64)))
    return generator.integers(0, count, (_RESAMPLES, count))


def _finite(values: ArrayLike) -> FloatArray:
    x = np.asarray(values, np.float64)
    if x.ndim != 1 or not np.isfinite(x).all():
        raise InputError(f"values of trials are finite and in one row, not of shape {x.shape}")
    return x
