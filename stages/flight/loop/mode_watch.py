"""What must not change unseen: whose the vehicle's mode is, and that it tells of its health."""

from __future__ import annotations

import math

from alula.stages.flight.links.protocol import Order, VehicleStatus

_MOMENT_S = 1.0
_HEALTH = ("armed", "is_estimator_ready", "battery_share")


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


class HealthWatch:
    """Whether a vehicle still tells what it told of its health when it was armed.

    A link makes unknown what was not heard for some seconds. Who flies on then flies on the last good news.
    """

    def __init__(self) -> None:
        self._told: tuple[str, ...] = ()
        self._since_s = math.inf

    def armed(self, status: VehicleStatus) -> None:
        """It is about to be armed."""
        self._told = tuple(name for name in _HEALTH if getattr(status, name) is not None)

    def is_untold(self, status: VehicleStatus, now_s: float) -> bool:
        """Whether one of them is unknown, and has been for longer than a moment."""
        is_unknown = any(getattr(status, name) is None for name in self._told)
        self._since_s = min(self._since_s, now_s) if is_unknown else math.inf
        return now_s - self._since_s > _MOMENT_S
