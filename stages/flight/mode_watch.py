"""Whose the vehicle's mode is: changes that follow an order of ours are its effect, all others are not."""

from __future__ import annotations

from alula.stages.flight.links.protocol import Order, VehicleStatus

_SETTLE_S = 1.0
_FOLLOWING = (Order.ARM, Order.TAKE_OFF, Order.TAKE_CONTROL)  # change no mode that follows us already


class ModeWatch:
    """Keeps the mode that the last order led to.

    After an order the first change is taken for its effect, for at most a second; a vehicle that follows
    set-points already changes no mode to arm, to take off or to be taken control of. A pilot who changes the
    mode in the very moment between an order and its effect is seen when the effect, too late, takes it back.
    """

    def __init__(self) -> None:
        self._kept: str | None = None
        self._before = ""
        self._until_s = -1.0
        self._lost = False

    def ordered(self, order: Order, status: VehicleStatus, now_s: float) -> None:
        """An order is on its way."""
        if order in _FOLLOWING and status.obeys:
            self._kept = status.mode
            return
        self._kept, self._before, self._until_s = None, status.mode, now_s + _SETTLE_S

    def is_ours(self, status: VehicleStatus, now_s: float) -> bool:
        """Whether nobody else has changed the mode; once somebody has, it stays so."""
        if self._until_s < 0 and self._kept is None:
            return True  # nothing was ordered yet
        if self._kept is None:
            if status.mode != self._before or now_s > self._until_s:
                self._kept = status.mode
            return not self._lost
        self._lost = self._lost or status.mode != self._kept
        return not self._lost
