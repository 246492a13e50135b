"""Where the vehicle should be while it flies by itself: on its way up, and where it holds."""

from __future__ import annotations

import math

from alula.schemas.arrays import FloatArray
from alula.stages.flight.links.protocol import VehicleState

_BRAKE_M_S2, _NOTICE_S = 2.0, 0.5  # what autopilots brake with at least, and how soon


class PlaceWatch:
    """How far a vehicle is from the way up that was proven clear, and from where it was told to hold.

    Args:
        top_m: height of the end of the way up, in the world.
    """

    def __init__(self, top_m: float) -> None:
        self.top_m = top_m
        self._foot: FloatArray | None = None
        self._room_m = 0.0
        self._held: VehicleState | None = None

    def proven(self, foot: FloatArray, room_m: float) -> None:
        """The way straight up from `foot`, shape (3,), is clear for a vehicle that is off it by `room_m`."""
        self._foot, self._room_m = foot.copy(), room_m

    def astray_m(self, state: VehicleState) -> float:
        """How far beyond that room it is, beside the way or above its end; 0 within.

        How low it is does not count: heights above the ground are where estimates are at their worst.
        """
        if self._foot is None:
            return math.inf
        x, y, z = (state.position - self._foot).tolist()
        above = z + float(self._foot[2]) - self.top_m
        off = math.sqrt(x * x + y * y + (0.0 if above < 0 else above) ** 2) - self._room_m
        return 0.0 if off <= 0 else off  # what is not a number stays none

    def moved(self) -> None:
        """It was told to fly: the next hold is another."""
        self._held = None

    def drift_m(self, state: VehicleState) -> float:
        """How far a hold has let it go, beyond what it takes to notice and to brake; 0 within.

        A hold begins with the first state that is asked about after `moved`.
        """
        if self._held is None:
            self._held = state
        begin = self._held
        speed = math.sqrt(float(begin.velocity @ begin.velocity))
        away = state.position - begin.position
        off = math.sqrt(float(away @ away)) - speed * (_NOTICE_S + 0.5 * speed / _BRAKE_M_S2)
        return 0.0 if off <= 0 else off
