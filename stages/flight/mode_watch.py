"""Whose the vehicle's mode is: ours as long as it follows us, or lands because we said so."""

from __future__ import annotations

from alula.stages.flight.links.protocol import Order, VehicleStatus


class ModeWatch:
    """Tells a pilot's change of the mode from the effect of an order.

    All orders but LAND are carried out in a mode that follows set-points, and that of landing has "land" in
    its name (`Order`). So after the first order the mode may only stay as it was until the vehicle follows;
    follow; and, once landing was ordered, land. Every other change is somebody else's, and stays so.
    """

    def __init__(self) -> None:
        self._before: str | None = None
        self._follows = self._may_land = self._lands = self._lost = False

    def ordered(self, order: Order, status: VehicleStatus) -> None:
        """An order is on its way."""
        if self._before is None:
            self._before = status.mode
        self._may_land = self._may_land or order is Order.LAND

    def is_ours(self, status: VehicleStatus) -> bool:
        """Whether nobody else has changed the mode; a mode that is not told, "", is no change."""
        if self._before is None or self._lost or not status.mode:
            return not self._lost
        if self._may_land and "land" in status.mode.lower():
            self._lands = True
        elif self._may_land and status.armed is False:
            pass  # nobody flies it any more
        elif self._lands:
            self._lost = True
        elif status.obeys:
            self._follows = True
        elif self._follows or status.mode != self._before:
            self._lost = True
        return not self._lost
