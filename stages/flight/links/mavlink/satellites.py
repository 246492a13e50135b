"""Watch over satellite receivers while the position depends on them: new fixes, and their velocity."""

from __future__ import annotations

import math
from typing import Any

_FIX_3D = 3
_STILL_S = 1.0  # receivers send at least five fixes in this time
_FIXLESS_S = 0.5  # a receiver that reports that it has no fix may be wrong for this long
_SILENT_S = 3.0  # reports may be lost on the line for this long
_UNKNOWN = 0xFFFF  # a speed or a course that is not reported
_DISAGREES_M_S = 1.0  # between the velocity of a receiver and the estimated one
_ERRORS = 2.0  # of the receiver's own accuracy, on top
_DISAGREES_S = 0.6  # longer than the delay of a receiver lets them differ
KINDS = ("GPS_RAW_INT", "GPS2_RAW")


class Satellites:
    """Newest fixes of the vehicle's receivers.

    An autopilot extrapolates its position for seconds after the last fix, and reports the loss only then.
    The fixes in GPS_RAW_INT and GPS2_RAW have times; when none of them advances the loss is known at once.
    Receivers that never had a fix are not counted.

    They also measure the horizontal velocity, by the Doppler shift, which no accelerometer has a part in. An
    estimate that differs from it by more than 1 m/s and twice the receiver's own accuracy for 0.6 s is wrong:
    after the fault of an accelerometer an autopilot's own checks may pass for many seconds.

    Attributes:
        is_watched: the vehicle's position depends on satellites.
    """

    def __init__(self) -> None:
        self.is_watched = False
        self._stamps: dict[str, int] = {}
        self._fixed_s: dict[str, float] = {}  # when the newest good fix of each receiver arrived
        self._heard_s = -math.inf  # when the newest report of any of them arrived
        self._fixes: dict[str, int] = {}  # type of the newest fix of each
        self._estimated: tuple[float, float] | None = None  # velocity, north and east [m/s]
        self._differs: dict[str, tuple[float, float]] = {}  # since when [s], and by how much now [m/s]

    def estimated(self, north: float, east: float) -> None:
        """Store the vehicle's own newest estimate of its velocity [m/s]."""
        self._estimated = north, east

    def take(self, message: Any, now_s: float) -> None:
        """Process a message of `KINDS` that arrived at `now_s` [s]."""
        kind, self._heard_s = message.get_type(), now_s
        is_new = message.time_usec != self._stamps.get(kind)
        self._stamps[kind], self._fixes[kind] = message.time_usec, message.fix_type
        if is_new and message.fix_type >= _FIX_3D:
            self._fixed_s[kind] = now_s
            self._compare(kind, message, now_s)

    def _compare(self, kind: str, message: Any, now_s: float) -> None:
        if self._estimated is None or _UNKNOWN in (message.vel, message.cog):
            self._differs.pop(kind, None)
            return
        speed, course = 0.01 * message.vel, math.radians(0.01 * message.cog)
        north, east = self._estimated
        away = math.hypot(speed * math.cos(course) - north, speed * math.sin(course) - east)
        if away <= _DISAGREES_M_S + _ERRORS * 1e-3 * message.vel_acc:
            self._differs.pop(kind, None)
        else:
            self._differs[kind] = self._differs.get(kind, (now_s, 0.0))[0], away

    @property
    def has_fix(self) -> bool:
        """Whether a receiver reports a fix in three dimensions now."""
        return any(fix >= _FIX_3D for fix in self._fixes.values())

    def trouble(self, now_s: float) -> str:
        """Say what is wrong; empty while fixes arrive, before the first one, and if they are not watched."""
        if not self.is_watched or not self._fixed_s:
            return ""
        age_s = self._heard_s - max(self._fixed_s.values())
        has_fix = any(self._fixes[kind] >= _FIX_3D for kind in self._fixed_s)
        if age_s > (_STILL_S if has_fix else _FIXLESS_S):
            return f"no new satellite fix for {age_s:.1f} s"
        if self._differs.keys() >= self._fixed_s.keys():  # all receivers agree that it is wrong
            since_s, away = max(self._differs.values())
            if self._heard_s - since_s >= _DISAGREES_S:
                return f"its velocity differs from that of the satellites by {away:.1f} m/s"
        silent_s = now_s - self._heard_s
        return f"no report of satellites for {silent_s:.1f} s" if silent_s > _SILENT_S else ""
