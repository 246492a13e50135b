"""Rates, means and ratios of trials with their intervals, also of paired trials.

A percentile bootstrap resamples only the values that it is given. When all of them are equal, or there is
only one, its interval has no width, although the next value may differ. Two remedies:

- Values with known bounds, such as the fraction of goals reached: n draws all miss a part u of the
  distribution with probability (1 - u)^n. At 2.5 % that is u = 1 - 0.025^(1/n), 0.07 for n = 50: the
  Clopper-Pearson bound for 0 of n. If that part lay at a bound, the mean would change by u times the distance
  to the bound, so the interval extends at least that far. This matters where failures are few or n is small.
- Values without bounds: the interval is unknown and its ends are None.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.stages.reporting.table import text
from alula.stages.verdict import wilson_interval

_RESAMPLES = 4000
_TAIL = 0.025  # on each side of an interval
_ROUNDING = 1e-12  # relative; rounding error between means of equal values


@dataclass(frozen=True, slots=True)
class Estimate:
    """A value with its 95 % interval, from `n` trials; the ends are None where the interval is unknown."""

    value: float
    low: float | None
    high: float | None
    n: int


@dataclass(frozen=True, slots=True)
class Rate:
    """A percentage of trials with its 95 % Wilson interval.

    The value is None without trials; the ends are None where all trials are the same flight.
    """

    value: float | None
    low: float | None
    high: float | None
    n: int

    @property
    def cells(self) -> tuple[float | None, float | None, float | None]:
        """Value, low and high end, as cells of a table."""
        return self.value, self.low, self.high

    @property
    def ends(self) -> tuple[float, float]:
        """Ends of the interval; 0 and 100, which exclude nothing, where there is none."""
        return 0.0 if self.low is None else self.low, 100.0 if self.high is None else self.high

    def __str__(self) -> str:
        if self.low is None:
            return f"{text(self.value)} %"
        return f"{text(self.value)} % ({text(self.low)} to {text(self.high)})"


def rate(values: Iterable[bool]) -> Rate:
    """Percentage of true values."""
    each = list(values)
    good, n = sum(each), len(each)
    low, high = wilson_interval(good, n)
    return Rate(100 * good / n if n else None, 100 * low, 100 * high, n)


def mean_of(values: Iterable[float | None]) -> float | None:
    """Mean of the known, finite values; None when there are none."""
    known = [value for value in values if value is not None and math.isfinite(value)]
    return math.fsum(known) / len(known) if known else None


def mean_estimate(
    values: ArrayLike, *, bounds: tuple[float, float] | None = None, seed: int = 0
) -> Estimate | None:
    """Mean of independent values with its percentile bootstrap interval; None without values.

    Args:
        values: shape (n,).
        bounds: limits of all possible values; with them the interval also covers what n values cannot
            exclude.

    Raises:
        InputError: a value is not finite.
    """
    x = _finite(values)
    if len(x) == 0:
        return None
    means = x[_resampled(len(x), seed)].mean(axis=1)
    return _estimate(float(x.mean()), means, len(x), bounds)


def ratio_estimate(ours: ArrayLike, theirs: ArrayLike, *, seed: int = 0) -> Estimate | None:
    """Ratio of the means of paired values, resampled by pairs; None without values.

    Args:
        ours: numerator, shape (n,).
        theirs: denominator, shape (n,).

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


def difference_estimate(
    ours: ArrayLike, theirs: ArrayLike, *, bounds: tuple[float, float] | None = None, seed: int = 0
) -> Estimate | None:
    """Mean of the differences of paired values with its interval; None without values.

    Args:
        ours: shape (n,).
        theirs: subtracted from `ours`, shape (n,).
        bounds: limits of the differences, as in `mean_estimate`.

    Raises:
        InputError: the lengths differ, or a value is not finite.
    """
    a, b = _finite(ours), _finite(theirs)
    if len(a) != len(b):
        raise InputError(f"paired values need equal lengths, not {len(a)} and {len(b)}")
    return mean_estimate(a - b, bounds=bounds, seed=seed)


def two_sample_estimate(ours: ArrayLike, theirs: ArrayLike, *, seed: int = 0) -> Estimate | None:
    """Difference of the means of two samples that are not paired, each resampled on its own.

    Args:
        ours: shape (n,).
        theirs: its mean is subtracted, shape (m,).

    Returns:
        The difference; `n` counts both samples. None where one of them is empty.

    Source: Efron and Tibshirani 1993, chapter 8 (two-sample problem) and 13 (percentile intervals).

    Raises:
        InputError: a value is not finite.
    """
    a, b = _finite(ours), _finite(theirs)
    if len(a) == 0 or len(b) == 0:
        return None
    means = a[_resampled(len(a), seed)].mean(axis=1) - b[_resampled(len(b), seed + 1)].mean(axis=1)
    return _estimate(float(a.mean() - b.mean()), means, len(a) + len(b))


def rate_difference(ours: Sequence[bool], theirs: Sequence[bool]) -> Estimate | None:
    """Difference of two rates of samples that are not paired, with its 95 % interval.

    Args:
        ours: shape (n,).
        theirs: its rate is subtracted, shape (m,).

    Returns:
        The difference of the fractions; None where a sample is empty.

    Source: Newcombe 1998, method 10, from the Wilson intervals of both rates.
    """
    n, m = len(ours), len(theirs)
    if n == 0 or m == 0:
        return None
    p, q = sum(ours) / n, sum(theirs) / m
    (p_low, p_high), (q_low, q_high) = wilson_interval(sum(ours), n), wilson_interval(sum(theirs), m)
    low = p - q - math.hypot(p - p_low, q_high - q)
    high = p - q + math.hypot(p_high - p, q - q_low)
    return Estimate(p - q, low, high, n + m)


def sign_test(higher: int, lower: int) -> float:
    """Probability that fair coins split at least as unevenly: the exact two-sided sign test.

    Of two outcomes of pairs it is McNemar's exact test. Equal pairs do not count.

    Args:
        higher: pairs in which the one is higher.
        lower: pairs in which it is lower.

    Source: Dixon and Mood 1946; Lehmann and Romano 2005, section 3.8.
    """
    n, few = higher + lower, min(higher, lower)
    term = tail = 1
    for k in range(few):
        term = term * (n - k) // (k + 1)
        tail += term
    return min(1.0, tail / (1 << max(n - 1, 0)))  # a quotient of integers, so that no power overflows


def _estimate(
    value: float, resampled: FloatArray, n: int, bounds: tuple[float, float] | None = None
) -> Estimate:
    low, high = np.percentile(resampled, [2.5, 97.5]).tolist()
    if bounds is not None:
        unseen = 1 - _TAIL ** (1 / n)
        low = min(low, value - unseen * (value - bounds[0]))
        high = max(high, value + unseen * (bounds[1] - value))
    elif np.ptp(resampled) <= _ROUNDING * abs(value):
        return Estimate(value, None, None, n)
    return Estimate(value, low, high, n)


def _resampled(count: int, seed: int) -> NDArray[np.int64]:
    generator = np.random.Generator(np.random.Philox(key=np.array([seed, count], np.uint64)))
    return generator.integers(0, count, (_RESAMPLES, count))


def _finite(values: ArrayLike) -> FloatArray:
    x = np.asarray(values, np.float64)
    if x.ndim != 1 or not np.isfinite(x).all():
        raise InputError(f"values of trials must be finite and one-dimensional; their shape is {x.shape}")
    return x
