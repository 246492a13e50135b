"""A vehicle's clock against ours: which of its packets are late, old, or from before it started anew."""

from __future__ import annotations

import math

_DRIFT = 2e-4  # that two clocks may have against each other
_EARLY_S = 0.05  # no packet is this much faster than the fastest before, unless a clock was set
_BACK_S = 0.5  # further back than packets overtake each other
_AHEAD_S = 5.0  # a queue on the way that empties looks like a clock set ahead, but by less
_WITNESSES = 3  # packets in a row that must agree that a clock was set


class VehicleClock:
    """Finds the least (arrival - time stamp), the way of the fastest packet, and lets it drift.

    A clock that is set back a little, or stands still for a while, looks like packets that are late from then
    on. `found` tells the two apart, where the vehicle answers; otherwise only time does.

    Args:
        patience_s: after being late for this long without a break packets count as in time again.

    Attributes:
        jumps: how often the vehicle's clock was set back, or far ahead: it started anew.
    """

    def __init__(self, patience_s: float = math.inf) -> None:
        self.jumps = 0
        self._patience_s = patience_s
        self._offset: float | None = None
        self._last_now = 0.0
        self._last_stamp = 0.0
        self._witnesses: list[tuple[float, float]] = []
        self._late: tuple[float, float] | None = None  # since when, and the least offset since

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
            self._offset = min(self._patient(drifted, offset, now_s), offset)
        self._witnesses.clear()
        self._last_now = now_s
        self._last_stamp = max(self._last_stamp, stamp_s)
        return min(now_s, stamp_s + self._offset)

    def found(self, clock_s: float, asked_s: float) -> None:
        """The vehicle read its clock after we asked: no packet comes faster than the question left."""
        least = asked_s - clock_s
        if self._offset is not None and 0 < least - self._offset < _AHEAD_S:
            self._offset = least

    def _patient(self, before: float, offset: float, now_s: float) -> float:
        if offset <= before + _EARLY_S:
            self._late = None
            return before
        since_s, least = self._late or (now_s, offset)
        self._late = since_s, min(least, offset)
        if now_s - since_s < self._patience_s:
            return before
        self._late = None
        return min(least, offset)

    def _is_confirmed(self, stamp_s: float, offset: float) -> bool:
        """Whether several in a row, none older than the one before, tell of the same new time."""
        if self._witnesses:
            before_s, before_offset = self._witnesses[-1]
            if stamp_s < before_s or abs(offset - before_offset) > _BACK_S / 2:
                self._witnesses.clear()
        self._witnesses.append((stamp_s, offset))
        return len(self._witnesses) >= _WITNESSES and stamp_s > self._witnesses[0][0]
