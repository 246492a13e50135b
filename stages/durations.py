"""Histogram of measured durations, in memory that does not grow with their number."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

BINS = 2400
_MIN_S = 1e-8  # shorter durations count as this one
_PER_OCTAVE = 60  # bins per factor of 2: a quantile is exact to 1.2 %, from 10 ns to 3 hours


class Durations:
    """Counts of durations on a logarithmic scale, with their exact number and maximum.

    Attributes:
        max_s: the longest duration [s]; 0 without any.
    """

    def __init__(self) -> None:
        self.max_s = 0.0
        self._count = 0
        self._counts = [0] * BINS

    def __len__(self) -> int:
        """Number of durations."""
        return self._count

    def append(self, seconds: float) -> None:
        """Count a duration.

        Args:
            seconds: the duration [s]; one below 10 ns counts as 10 ns.
        """
        octaves = math.log2(seconds / _MIN_S) if seconds > _MIN_S else 0.0
        self._counts[min(int(_PER_OCTAVE * octaves), BINS - 1)] += 1
        self._count += 1
        self.max_s = max(self.max_s, seconds)

    def quantile(self, fraction: float) -> float:
        """See `quantile`.

        Args:
            fraction: in (0, 1].
        """
        return quantile(self._counts, fraction, self.max_s)


def counts_of(seconds: NDArray[np.float32]) -> NDArray[np.int64]:
    """Count durations by bin.

    Args:
        seconds: shape (C,) [s].

    Returns:
        Counts, shape (BINS,).
    """
    octaves = np.log2(np.maximum(seconds, _MIN_S) / _MIN_S)
    index = np.minimum(np.floor(_PER_OCTAVE * octaves).astype(np.int64), BINS - 1)
    return np.bincount(index, minlength=BINS).astype(np.int64)


def quantile(counts: Sequence[int] | NDArray[np.int64], fraction: float, max_s: float) -> float:
    """Duration that this fraction of all durations does not exceed, rounded up by at most 1.2 % [s].

    Args:
        counts: counts by bin, shape (BINS,).
        fraction: in (0, 1].
        max_s: the longest duration [s].

    Raises:
        ValueError: there is no duration.
    """
    running = np.cumsum(np.asarray(counts, np.int64))
    if running[-1] == 0:
        raise ValueError("a quantile of no durations")
    index = int(np.searchsorted(running, fraction * running[-1]))
    if index == BINS - 1:  # it has no upper edge
        return max_s
    return float(min(_MIN_S * 2 ** ((index + 1) / _PER_OCTAVE), max_s))
