"""Watch over satellite receivers while the position depends on them: new fixes, positions and velocities."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

_FIX_3D = 3
_STILL_S = 1.0  # receivers send at least five fixes in this time
_FIXLESS_S = 0.5  # a receiver that reports that it has no fix may be wrong for this long
_SILENT_S = 3.0  # reports may be lost on the line for this long
_UNKNOWN = 0xFFFF  # a speed or a course that is not reported
_DISAGREES_M_S = 1.0  # between the velocity of a receiver and the estimated one
_ERRORS = 2.0  # of the receiver's own accuracy, on top
_DISAGREES_S = 0.6  # longer than the delay of a receiver lets them differ
_JUMPS_M = 1.0  # in 2 s, between the position of a receiver and the estimated one
_JUMP_S = 2.0
_JUMP_FIXES = 2  # in a row that must agree
_STRAYS_M = 1.0  # between the way by a receiver's velocities and the estimated one
_DRIFT_M_S = 0.01  # of the integral of a receiver's velocities
_LONGEST_S = 1.0  # between fixes; velocities are not integrated over more
_DELAY_S = 0.4  # a fix is older than the estimate by at most that
_EARTH_M = 6378100.0
KINDS = ("GPS_RAW_INT", "GPS2_RAW")


class _Way:
    """Way by the velocities of one receiver beside the estimated one, from a rest on.

    Attributes:
        strayed_m: distance between both, less what the delay of a fix makes of the velocity, and less 1 cm/s
            that those velocities may be wrong by [m].
    """

    def __init__(self, now_s: float, velocity: tuple[float, float], position: tuple[float, float]) -> None:
        self.strayed_m = 0.0
        self._begun_s = self._at_s = now_s
        self._velocity, self._position = velocity, position
        self._north = self._east = 0.0  # estimated way less that by the velocities [m]

    def go(self, now_s: float, velocity: tuple[float, float], position: tuple[float, float]) -> None:
        """Go on to a fix, with the estimated position then."""
        dt_s = now_s - self._at_s
        if dt_s <= _LONGEST_S:
            self._north += position[0] - self._position[0] - 0.5 * dt_s * (velocity[0] + self._velocity[0])
            self._east += position[1] - self._position[1] - 0.5 * dt_s * (velocity[1] + self._velocity[1])
        self._at_s, self._velocity, self._position = now_s, velocity, position
        allowed_m = _DELAY_S * math.hypot(*velocity) + _DRIFT_M_S * (now_s - self._begun_s)
        self.strayed_m = max(0.0, math.hypot(self._north, self._east) - allowed_m)


class Satellites:
    """Newest fixes of the vehicle's receivers.

    An autopilot extrapolates its position for seconds after the last fix, and reports the loss only then.
    The fixes in GPS_RAW_INT and GPS2_RAW have times; when none of them advances the loss is known at once.
    Receivers that never had a fix are not counted.

    They also measure the horizontal velocity, by the Doppler shift, which no accelerometer has a part in. An
    estimate that differs from it by more than 1 m/s and twice the receiver's own accuracy for 0.6 s is wrong:
    after the fault of an accelerometer an autopilot's own checks may pass for many seconds.

    A receiver whose fixes jump pulls the estimate after it, and the vehicle the other way. In 2 s the
    distance between a fix and the estimated position may change by 1 m and twice the receiver's own accuracy,
    besides what the delay of a fix makes of a change of the velocity. Two fixes in a row must agree.

    From the take-off on the velocities of the fixes are integrated: by more than 1 m, and 1 cm/s, the
    estimated position must not have moved otherwise. This sees what comes slowly, and what the positions of
    fixes follow.

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
        self._position: tuple[float, float] | None = None  # estimated, north and east [m]
        self._zero: tuple[float, float] | None = None  # latitude and longitude that positions are from [rad]
        self._apart: dict[str, deque[tuple[float, ...]]] = {}  # [s], fix less estimate [m], velocity [m/s]
        self._ways: dict[str, _Way] = {}
        self._is_flown = False
        self._velocity: tuple[float, float] | None = None  # of the newest fix
        self._jumped: dict[str, tuple[int, float]] = {}  # number of fixes in a row, and by how much [m]

    def estimated(self, velocity: tuple[float, float], position: tuple[float, float] | None = None) -> None:
        """Store the vehicle's own newest estimates: north and east, [m/s] and [m]."""
        self._estimated, self._position = velocity, position

    def take_off(self) -> None:
        """Compare the way from here on."""
        self._ways, self._is_flown = {}, True

    @property
    def strayed_m(self) -> float:
        """Distance of the estimate from the way by the velocities of the receiver that agrees best [m]."""
        ways = self._ways.values() if self.is_watched else ()
        return min((way.strayed_m for way in ways), default=0.0)

    def take(self, message: Any, now_s: float) -> None:
        """Process a message of `KINDS` that arrived at `now_s` [s]."""
        kind, self._heard_s = message.get_type(), now_s
        is_new = message.time_usec != self._stamps.get(kind)
        self._stamps[kind], self._fixes[kind] = message.time_usec, message.fix_type
        if is_new and message.fix_type >= _FIX_3D:
            self._fixed_s[kind] = now_s
            self._compare(kind, message, now_s)
            self._measure(kind, message, now_s)

    def _measure(self, kind: str, message: Any, now_s: float) -> None:
        if self._estimated is None or self._position is None:
            return
        latitude, longitude = math.radians(1e-7 * message.lat), math.radians(1e-7 * message.lon)
        self._zero = self._zero or (latitude, longitude)
        north = _EARTH_M * (latitude - self._zero[0]) - self._position[0]
        turn = math.remainder(longitude - self._zero[1], 2 * math.pi)
        east = _EARTH_M * math.cos(self._zero[0]) * turn - self._position[1]
        past = self._apart.setdefault(kind, deque())
        while past and past[0][0] < now_s - _JUMP_S:
            past.popleft()
        past.append((now_s, north, east, *self._estimated))
        _, *before = past[0]
        jump = math.dist((north, east), before[:2]) - _DELAY_S * math.dist(self._estimated, before[2:])
        fixes, _ = self._jumped.get(kind, (0, 0.0))
        is_jump = jump > _JUMPS_M + _ERRORS * 1e-3 * message.h_acc
        self._jumped[kind] = (fixes + 1 if is_jump else 0), jump

    def _compare(self, kind: str, message: Any, now_s: float) -> None:
        if self._estimated is None or _UNKNOWN in (message.vel, message.cog):
            self._differs.pop(kind, None)
            self._velocity = None
            return
        speed, course = 0.01 * message.vel, math.radians(0.01 * message.cog)
        self._velocity = measured = speed * math.cos(course), speed * math.sin(course)
        if self._is_flown and self._position is not None:
            way = self._ways.setdefault(kind, _Way(now_s, measured, self._position))
            way.go(now_s, measured, self._position)
        away = math.dist(measured, self._estimated)
        if away <= _DISAGREES_M_S + _ERRORS * 1e-3 * message.vel_acc:
            self._differs.pop(kind, None)
        else:
            self._differs[kind] = self._differs.get(kind, (now_s, 0.0))[0], away

    @property
    def velocity(self) -> tuple[float, float] | None:
        """Newest measured velocity, north and east [m/s]; None if it is unknown or a second old."""
        is_old = self._heard_s - max(self._fixed_s.values(), default=-math.inf) > _STILL_S
        return None if is_old else self._velocity

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
        if words := self._misplaced():
            return words
        silent_s = now_s - self._heard_s
        return f"no report of satellites for {silent_s:.1f} s" if silent_s > _SILENT_S else ""

    @property
    def are_misplaced(self) -> bool:
        """Return whether positions are wrong, but not velocities: what holds a position would move."""
        return self.is_watched and bool(self._fixed_s) and bool(self._misplaced())

    def _misplaced(self) -> str:
        jumps = [self._jumped.get(kind, (0, 0.0)) for kind in self._fixed_s]
        if all(fixes >= _JUMP_FIXES for fixes, _ in jumps):
            return f"the position of the satellites jumped by {max(jump for _, jump in jumps):.1f} m"
        if (strayed_m := self.strayed_m) > _STRAYS_M:
            return f"its position strayed by {strayed_m:.1f} m from the way by the velocities of satellites"
        return ""
