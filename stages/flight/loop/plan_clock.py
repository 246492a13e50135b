"""Time along the plan, and the reference at that time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray

_TURN_RAD_S = 0.7  # from the heading at the start of a flight to the plan's
_SLOW_S = 0.5  # time before a via point in which the time slows down for a vehicle that is too far away
_CREEP = 0.1  # minimum rate there, so that the time arrives
_PASSED = 0.9  # a via point is passed at this fraction of its tolerance
_WAIT_S = 4.0  # maximum time for which a via point is waited for; a filter may keep the vehicle away


def heading_of(quat_wxyz: FloatArray) -> float:
    """Heading: direction of the body's x axis seen from above, counter-clockwise from the map's x axis [rad].

    Args:
        quat_wxyz: attitude, a unit quaternion that turns body vectors into the world frame, shape (4,).
    """
    w, x, y, z = quat_wxyz.tolist()
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


class Reference(Protocol):
    """Reference over time that the control loop follows, as `PlanClock` is one."""

    @property
    def time_s(self) -> float:
        """Time along it [s]."""
        ...

    @property
    def rate(self) -> float:
        """Rate of this time, from 0 to 1."""
        ...

    @property
    def is_over(self) -> bool:
        """True at its end."""
        ...

    def pause(self, heading_rad: float) -> None:
        """Stop the time; see `PlanClock.pause`."""
        ...

    def advance(self, dt_s: float, error_m: float) -> None:
        """Advance by a time step; see `PlanClock.advance`."""
        ...

    def target(self) -> FloatArray:
        """Reference now, a row of `ReferenceCurve.at`, shape (1, 18), world frame."""
        ...


class PlanClock:
    """Time along the plan; it runs with the clock and slows down for a vehicle that falls behind.

    The rate falls linearly from 1 at an error of `near_m` to 0 at `far_m`. It changes by at most
    `slew_per_s`. Derivatives of the reference are those of the slowed time, with its rate taken as constant.
    The time stops at a via point until the vehicle is within 0.9 of its tolerance, for 4 s at most.

    Args:
        curve: the plan.
        near_m: error up to which the time runs at full rate [m].
        far_m: error from which on the time stands still [m].
        slew_per_s: maximum change of the rate [1/s].
        via_s: times of the via points along the plan, ascending [s].
        via_m: distance within which a via point counts as passed [m].

    Attributes:
        time_s: time along the plan [s].
        rate: its rate, from 0 to 1.
    """

    def __init__(
        self,
        curve: _core.ReferenceCurve,
        *,
        near_m: float,
        far_m: float,
        slew_per_s: float = 2.0,
        via_s: Sequence[float] = (),
        via_m: float = math.inf,
    ) -> None:
        self.curve = curve
        self.near_m, self.far_m, self.slew_per_s = near_m, far_m, slew_per_s
        self.time_s, self.rate, self._turn = 0.0, 0.0, 0.0
        self._query = np.zeros(1)
        self._via_s, self._passed_m, self._waited_s = list(via_s), _PASSED * via_m, 0.0

    @property
    def is_over(self) -> bool:
        """True at the end of the plan."""
        return self.time_s >= self.curve.duration_s

    def pause(self, heading_rad: float) -> None:
        """Stop the time; the flight continues from here, and turns from this heading to the plan's.

        Args:
            heading_rad: heading of the vehicle now, see `heading_of` [rad].
        """
        self.rate = 0.0
        self._query[0] = self.time_s
        turn = heading_rad - float(self.curve.at(self._query)[0, 15])
        self._turn = (turn + math.pi) % (2 * math.pi) - math.pi

    def advance(self, dt_s: float, error_m: float) -> None:
        """Advance by a time step.

        Args:
            dt_s: step of the clock [s].
            error_m: distance of the vehicle from the reference [m].
        """
        target_rate = min(1.0, max(0.0, (self.far_m - error_m) / (self.far_m - self.near_m)))
        end_s = self.curve.duration_s
        if self._via_s and error_m > self._passed_m:
            end_s = self._via_s[0]
            target_rate = min(target_rate, max(_CREEP, (end_s - self.time_s) / _SLOW_S))
        max_change = self.slew_per_s * dt_s
        self.rate += min(max_change, max(-max_change, target_rate - self.rate))
        self.time_s = min(self.time_s + self.rate * dt_s, end_s)
        self._pass_vias(dt_s, error_m)
        self._turn -= min(_TURN_RAD_S * dt_s, max(-_TURN_RAD_S * dt_s, self._turn))

    def _pass_vias(self, dt_s: float, error_m: float) -> None:
        """Go on to the next via point if the vehicle is at this one, or if it was waited for long enough."""
        while self._via_s and self.time_s >= self._via_s[0]:
            self._waited_s += dt_s
            if error_m > self._passed_m and self._waited_s < _WAIT_S:
                self.rate = 0.0  # else the velocity of the reference would lead the vehicle past the point
                return
            self._via_s.pop(0)
            self._waited_s = 0.0

    def target(self) -> FloatArray:
        """Reference now, a row of `ReferenceCurve.at`, shape (1, 18), world frame."""
        self._query[0] = self.time_s
        row: Any = self.curve.at(self._query)
        s = self.rate
        for begin, factor in ((3, s), (6, s * s), (9, s**3), (12, s**4)):
            row[0, begin : begin + 3] *= factor
        row[0, 15] += self._turn
        row[0, 16] = s * row[0, 16] - (math.copysign(_TURN_RAD_S, self._turn) if self._turn else 0.0)
        row[0, 17] *= s * s
        result: FloatArray = row
        return result
