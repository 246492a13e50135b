"""Time along the plan, and the reference at that time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray

_TURN_RAD_S = 0.7  # from the heading at the start of a flight to the plan's


def heading_of(quat_wxyz: FloatArray) -> float:
    """Heading: direction of the body's x axis seen from above, counter-clockwise from the map's x axis [rad].

    Args:
        quat_wxyz: attitude, a unit quaternion that turns body vectors into the world frame, shape (4,).
    """
    w, x, y, z = quat_wxyz.tolist()
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


class PlanClock:
    """Time along the plan; it runs with the clock and slows down for a vehicle that falls behind.

    The rate falls linearly from 1 at an error of `near_m` to 0 at `far_m`. It changes by at most
    `slew_per_s`. Derivatives of the reference are those of the slowed time, with its rate taken as constant.

    Args:
        curve: the plan.
        near_m: error up to which the time runs at full rate [m].
        far_m: error from which on the time stands still [m].
        slew_per_s: maximum change of the rate [1/s].

    Attributes:
        time_s: time along the plan [s].
        rate: its rate, from 0 to 1.
    """

    def __init__(
        self, curve: _core.ReferenceCurve, *, near_m: float, far_m: float, slew_per_s: float = 2.0
    ) -> None:
        self.curve = curve
        self.near_m, self.far_m, self.slew_per_s = near_m, far_m, slew_per_s
        self.time_s, self.rate, self._turn = 0.0, 0.0, 0.0
        self._query = np.zeros(1)

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
        max_change = self.slew_per_s * dt_s
        self.rate += min(max_change, max(-max_change, target_rate - self.rate))
        self.time_s = min(self.time_s + self.rate * dt_s, self.curve.duration_s)
        self._turn -= min(_TURN_RAD_S * dt_s, max(-_TURN_RAD_S * dt_s, self._turn))

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
