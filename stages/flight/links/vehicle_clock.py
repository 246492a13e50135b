"""A vehicle's clock against ours: which of its packets are late, old, or from before it started anew."""

from __future__ import annotations

_DRIFT = 2e-4  # that two clocks may have against each other
_EARLY_S = 0.05  # no packet is this much faster than the fastest before, unless a clock was set
_BACK_S = 0.5  # further back than packets overtake each other
_AHEAD_S = 5.0  # a queue on the way that empties looks like a clock set ahead, but by less
_WITNESSES = 3  # packets in a row that must agree that a clock was set


class VehicleClock:
    """Finds the least (arrival - time stamp), the way of the fastest packet, and lets it drift.

    Attributes:
        jumps: how often the vehicle's clock was set back, or far ahead: it started anew.
    """

    def __init__(self) -> None:
        self.jumps = 0
        self._offset: float | None = None
        self._last_now = 0.0
        self._last_stamp = 0.0
        self._witnesses: list[tuple[float, float]] = []

    def arrival(self, stamp_s: float, now_s: float) -> float | None:
        """When a packet that came now would have come by the fastest way; None while in doubt."""
        offset = now_s - stamp_s
        if self._offset is None:
            self._offset = offset
        elif offset < self._offset - _EARLY_S or stamp_s < self._last_stamp - _BACK_S:
            if not self._is_confirmed(stamp_s, offset):
                return None
            if not -_AHEAD_S < offset - self._offset < _BACK_S:
                self.jumps += 1
            self._offset = offset
            self._last_stamp = stamp_s
        else:
            drifted = self._offset + _DRIFT * max(now_s - self._last_now, 0.0)
            self._offset = min(drifted, offset)
        self._witnesses.clear()
        self._last_now = now_s
        self._last_stamp = max(self._last_stamp, stamp_s)
        return min(now_s, stamp_s + self._offset)

    def _is_confirmed(self, stamp_s: float, offset: float) -> bool:
        """Whether several in a row, none older than the one before, tell of the same new time."""
        if self._witnesses:
            before_s, before_offset = self._witnesses[-1]
            if stamp_s < before_s or abs(offset - before_offset) > _BACK_S / 2:
                self._witnesses.clear()
        self._witnesses.append((stamp_s, offset))
        return len(self._witnesses) >= _WITNESSES and stamp_s > self._witnesses[0][0]
