"""Time along the plan, and the reference at that time."""

from __future__ import annotations

import math
from typing import Protocol

from alula import _core
from alula.schemas.arrays import FloatArray


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

    It is the clock of `simulate`: `native/core/include/alula/flight/plan_clock.hpp`.

    Args:
        options: errors that slow the time down, and the via points at which it waits.
    """

    def __init__(self, curve: _core.ReferenceCurve, options: _core.PlanClockOptions) -> None:
        self.curve = curve
        self._clock = _core.PlanClock(curve, options)

    @property
    def time_s(self) -> float:
        """Time along the plan [s]."""
        return self._clock.time_s

    @property
    def rate(self) -> float:
        """Rate of this time, from 0 to 1."""
        return self._clock.rate

    @property
    def is_over(self) -> bool:
        """True at the end of the plan."""
        return self._clock.is_over

    def pause(self, heading_rad: float) -> None:
        """Stop the time; the flight continues from here, and turns from this heading to the plan's."""
        self._clock.pause(heading_rad)

    def enter(self, time_s: float, rate: float, heading_rad: float) -> None:
        """Begin at a time along the plan; via points at or before it are left out.

        Args:
            time_s: from 0 on [s].
            rate: of this time, from 0 to 1.

        Raises:
            ValueError: a value is not a number or out of range.
        """
        self._clock.enter(time_s, rate, heading_rad)

    def advance(self, dt_s: float, error_m: float) -> None:
        """Advance by a time step."""
        self._clock.advance(dt_s, error_m)

    def target(self) -> FloatArray:
        """Reference now, a row of `ReferenceCurve.at`, shape (1, 18), world frame."""
        return self._clock.target()
