"""Offset between the vehicle's clock and the local clock; detects late, old and pre-reboot packets.

Let theta be the local time minus the vehicle's time. Packets bound it from above, because each arrives after
its time stamp: theta <= arrival - stamp. Answers to time requests bound it from below, because each is
stamped after the request was sent: theta >= requested - stamp. The difference of the two bounds is the
latency: on top of its measured delay no packet took longer. Packets alone cannot show a delay that all of
them share. An upper bound that falls below a lower one of the last seconds: the vehicle's clock runs fast.
"""

from __future__ import annotations

import math
from collections import deque

_DRIFT = 2e-4  # maximum relative drift of the two clocks
_EARLY_S = 0.05  # a packet that much faster than the fastest before means that a clock was set
_BACK_S = 0.5  # packets overtake each other by less
_FAST_S = 0.3  # a vehicle that gains more in the last 5 s runs fast; one that stalled catches up less
_AHEAD_S = 5.0  # a queue that empties looks like a clock set ahead, but by less
_WITNESSES = 3  # consecutive packets that must agree that a clock was set
_EVIDENCE_S = 5.0  # answers to time requests count for this long: the way to the vehicle may become slower


class VehicleClock:
    """Estimator of the minimum of (arrival - time stamp), the offset of the fastest packet, with drift.

    A clock that is set back a little, or that stops for a while, looks like packets that are late from then
    on. `synchronise` separates the two cases if the vehicle answers; otherwise only time does.

    Args:
        patience_s: packets that are late for this long without a break count as on time again [s].

    Attributes:
        jumps: how often the vehicle's clock was set back, or far ahead, which means that it restarted.
    """

    def __init__(self, patience_s: float = math.inf) -> None:
        self.jumps = 0
        self._patience_s = patience_s
        self._offset: float | None = None
        self._last_now = 0.0
        self._last_stamp = 0.0
        self._witnesses: list[tuple[float, float]] = []
        self._late: tuple[float, float] | None = None  # since when, and the minimum offset since
        self._answers: deque[tuple[float, float]] = deque(
            maxlen=64
        )  # time of the request, lower bound of theta

    def arrival(self, stamp_s: float, now_s: float) -> float | None:
        """Arrival time that a packet would have had with the smallest delay so far; None while in doubt.

        Args:
            stamp_s: time stamp in the packet, vehicle's clock [s].
            now_s: when it arrived, local clock [s].
        """
        offset = now_s - stamp_s
        if self._offset is None:
            self._offset = offset
        elif offset < self._offset - _EARLY_S or stamp_s < self._last_stamp - _BACK_S:
            if not self._is_confirmed(stamp_s, offset):
                return None
            if not -_AHEAD_S < offset - self._offset < _BACK_S:
                self.jumps += 1
            self._answers.clear()  # of the clock before it was set
            self._offset = offset
            self._last_stamp = stamp_s
        else:
            drifted = self._offset + _DRIFT * max(now_s - self._last_now, 0.0)
            self._offset = min(self._patient(drifted, offset, now_s), offset)
        self._witnesses.clear()
        self._last_now = now_s
        self._last_stamp = max(self._last_stamp, stamp_s)
        return min(now_s, stamp_s + self._offset)

    def synchronise(self, clock_s: float, requested_s: float) -> None:
        """Use an answer to a time request: the offset is not below sending time minus vehicle time.

        Args:
            clock_s: vehicle's clock in its answer [s].
            requested_s: when the request was sent, local clock [s].
        """
        minimum = requested_s - clock_s
        if self._offset is not None and 0 < minimum - self._offset < _AHEAD_S:
            self._offset = minimum
        self._answers.append((requested_s, minimum))

    @property
    def latency_s(self) -> float:
        """Upper bound of the age of the last packet at the time that `arrival` returned for it [s].

        It is the sum of the minimum delays of both directions, with the answers to the requests of the last
        5 s. A set-point that is computed from the packet takes effect that long after `arrival`, if it is as
        fast as the fastest of these requests. NaN without a packet, without such an answer, and while the
        clock runs fast.
        """
        room_s = self._room_s()
        return max(room_s, 0.0) if room_s >= -_FAST_S else math.nan

    @property
    def runs_fast(self) -> bool:
        """Whether the vehicle's clock gained 0.3 s in the last 5 s: a simulation that is not in real time."""
        return self._room_s() < -_FAST_S

    def _room_s(self) -> float:
        """Upper less lower bound of the offset; NaN if one of them is not known."""
        now_s = self._last_now
        while self._answers and now_s - self._answers[0][0] > _EVIDENCE_S:
            self._answers.popleft()
        if self._offset is None or not self._answers:
            return math.nan
        minimum = max(bound - _DRIFT * (now_s - requested_s) for requested_s, bound in self._answers)
        return self._offset - minimum

    def _patient(self, before: float, offset: float, now_s: float) -> float:
        if offset <= before + _EARLY_S:
            self._late = None
            return before
        since_s, minimum = self._late or (now_s, offset)
        self._late = since_s, min(minimum, offset)
        if now_s - since_s < self._patience_s:
            return before
        self._late = None
        return min(minimum, offset)

    def _is_confirmed(self, stamp_s: float, offset: float) -> bool:
        """Return whether several consecutive packets, in order, agree on the same new offset."""
        if self._witnesses:
            before_s, before_offset = self._witnesses[-1]
            if stamp_s < before_s or abs(offset - before_offset) > _BACK_S / 2:
                self._witnesses.clear()
        self._witnesses.append((stamp_s, offset))
        return len(self._witnesses) >= _WITNESSES and stamp_s > self._witnesses[0][0]
