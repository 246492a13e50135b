"""Histogram of measured durations, in memory that does not grow with their number."""

from __future__ import annotations

import math

_MIN_S = 1e-7  # shorter durations count as this one
_PER_OCTAVE = 60  # bins per factor of 2: a quantile is exact to 1.2 %
_BINS = 30 * _PER_OCTAVE + 1  # up to 107 s; longer ones fall into the last bin


class Durations:
    """Counts of durations on a logarithmic scale, with their exact number and maximum.

    Attributes:
        max_s: the longest duration [s]; 0 without any.
    """

    def __init__(self) -> None:
        self.max_s = 0.0
        self._count = 0
        self._bins = [0] * _BINS

    def __len__(self) -> int:
        """Number of durations."""
        return self._count

    def append(self, seconds: float) -> None:
        """Count a duration.

        Args:
            seconds: the duration [s]; one below 0.1 us counts as 0.1 us.
        """
        octaves = math.log2(seconds / _MIN_S) if seconds > _MIN_S else 0.0
        self._bins[min(int(_PER_OCTAVE * octaves), _BINS - 1)] += 1
        self._count += 1
        self.max_s = max(self.max_s, seconds)

    def quantile(self, fraction: float) -> float:
        """Duration that this fraction of all durations does not exceed, rounded up by at most 1.2 % [s].

        Args:
            fraction: in (0, 1].

        Raises:
            ValueError: there is no duration.
        """
        if self._count == 0:
            raise ValueError("a quantile of no durations")
        left = fraction * self._count
        for index, count in enumerate(self._bins):
            left -= count
            if left <= 0:
                is_last = index == _BINS - 1  # it has no upper edge
                return self.max_s if is_last else min(_MIN_S * 2 ** ((index + 1) / _PER_OCTAVE), self.max_s)
        return self.max_s
