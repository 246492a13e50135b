"""Histograms of measured durations, in memory that does not grow with their number."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Self

import msgspec
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


class Times(msgspec.Struct, frozen=True, kw_only=True):
    """Histogram of the measured times of a run, which can be added up: counts by bin, int64, as bytes.

    Attributes:
        counts: by logarithm, see `counts_of`.
        total_s, max_s: exact sum and maximum [s].
        square_s2: exact sum of the squares [s^2].
        overruns: times longer than a tick.
    """

    counts: bytes
    calls: int
    total_s: float
    square_s2: float
    max_s: float
    overruns: int

    @classmethod
    def of(cls, seconds: NDArray[np.float32], tick_s: float) -> Self:
        """Count measured times.

        Args:
            seconds: shape (C,) [s].
            tick_s: duration of a tick [s]; longer times are `overruns`.
        """
        exact = seconds.astype(np.float64)
        return cls(
            counts=counts_of(seconds).tobytes(),
            calls=len(seconds),
            total_s=float(exact.sum()),
            square_s2=float(np.square(exact).sum()),
            max_s=float(seconds.max(initial=0.0)),
            overruns=int((seconds > tick_s).sum()),
        )

    @classmethod
    def joined(cls, parts: Sequence[Times]) -> Self:
        """Add up histograms, at least one."""
        counts = sum((np.frombuffer(part.counts, np.int64) for part in parts), np.zeros(BINS, np.int64))
        return cls(
            counts=counts.tobytes(),
            calls=sum(part.calls for part in parts),
            total_s=math.fsum(part.total_s for part in parts),
            square_s2=math.fsum(part.square_s2 for part in parts),
            max_s=max(part.max_s for part in parts),
            overruns=sum(part.overruns for part in parts),
        )

    def quantile(self, fraction: float) -> float:
        """Quantile of the times, to 1.2 % [s].

        Args:
            fraction: of the times that are at most this one, in (0, 1].

        Raises:
            ValueError: there is none.
        """
        return quantile(np.frombuffer(self.counts, np.int64), fraction, self.max_s)

    @property
    def mean_s(self) -> float:
        """Mean [s]; 0 without any."""
        return self.total_s / self.calls if self.calls else 0.0

    @property
    def std_s(self) -> float:
        """Standard deviation [s]; 0 without any."""
        return math.sqrt(max(0.0, self.square_s2 / self.calls - self.mean_s**2)) if self.calls else 0.0


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
