"""Orders to a vehicle: repeated until it does them, refuses them or takes too long."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from alula.schemas.errors import LinkError
from alula.stages.flight.links.mavlink_autopilots import Autopilot, mode_command
from alula.stages.flight.links.mavlink_session import Session
from alula.stages.flight.links.protocol import Order, VehicleStatus

_REPEAT_S = 0.5
_PATIENCE_S = 5.0
_STREAM_FIRST_S = 1.1  # of set-points, before PX4 is asked to follow them
_REASONS_S = 2.0  # how long before a refusal its reason may have been said
_PREFIXES = ("PreArm:", "Arm:", "Arming", "Preflight", "Takeoff")


@dataclass(slots=True)
class _Standing:
    order: Order
    number: int
    values: tuple[float, ...]
    since_s: float
    next_s: float
    sent: int = 0
    is_accepted: bool = False
    is_reported: bool = False


class Orders:
    """The one order that stands; a new one replaces it.

    It is done when the vehicle's own state shows it (a mode, armed or not), a take-off when it is
    acknowledged. Refused or unanswered for 5 s, it goes to `VehicleStatus.refusals`; only LAND is repeated
    for ever. Taking control is never repeated once the vehicle obeyed: the pilot may have taken it back.
    """

    def __init__(self, session: Session, autopilot: Autopilot, status: VehicleStatus) -> None:
        self._session, self._autopilot, self._status = session, autopilot, status
        self._standing: _Standing | None = None
        self._said: list[tuple[float, str]] = []
        self.mode: tuple[int, int] | None = None

    def start(self, order: Order, now_s: float, height_m: float) -> None:
        """Give an order.

        Raises:
            LinkError: it makes no sense now.
        """
        if not math.isfinite(height_m) or (order is Order.TAKE_OFF and not 0 < height_m <= 100):
            raise LinkError(f"take-off to {height_m:g} m is refused: heights are above 0 and up to 100 m")
        if order is Order.DISARM and self._status.landed is not True:
            raise LinkError("disarming is refused: the vehicle does not say that it is on the ground")
        number, values = self._command(order, height_m)
        wait = _STREAM_FIRST_S if order is Order.TAKE_CONTROL and self._autopilot.streams_first else 0.0
        self._standing = _Standing(order, number, values, now_s + wait, now_s + wait)
        if self._is_done():
            self._standing = None

    def drop(self) -> None:
        """Nothing stands any more."""
        self._standing = None

    def poll(self, now_s: float) -> None:
        """Send what is due."""
        standing = self._standing
        if standing is None:
            return
        if self._is_done():
            self._standing = None
            return
        if now_s - standing.since_s > _PATIENCE_S:
            what = "accepted, but not done" if standing.is_accepted else "no answer"
            self._refuse(standing, f"{what} for {_PATIENCE_S:g} s")
            if self._standing is None:
                return
        if now_s >= standing.next_s:
            standing.next_s = now_s + _REPEAT_S
            self._session.send(self._session.command(standing.number, standing.values, standing.sent))
            standing.sent += 1

    def take_answer(self, message: Any, now_s: float) -> None:
        """A COMMAND_ACK."""
        standing = self._standing
        if standing is None or message.command != standing.number or standing.sent == 0:
            return
        if message.result == dialect.MAV_RESULT_ACCEPTED:
            standing.is_accepted = True
            standing.next_s = now_s + 2 * _REPEAT_S
            if standing.order is Order.TAKE_OFF:
                self._standing = None
        elif message.result == dialect.MAV_RESULT_IN_PROGRESS:
            standing.next_s = now_s + _PATIENCE_S / 2
        else:
            entry = dialect.enums["MAV_RESULT"].get(message.result)
            result = str(message.result) if entry is None else entry.name.removeprefix("MAV_RESULT_").lower()
            said = [text for at, text in self._said if now_s - at <= _REASONS_S]
            self._refuse(standing, "; ".join([result.replace("_", " "), *dict.fromkeys(said)]))

    def take_text(self, text: str, now_s: float) -> None:
        """What may be the reason of a refusal."""
        if text.startswith(_PREFIXES):
            self._said = [*self._said[-7:], (now_s, text)]

    def _refuse(self, standing: _Standing, why: str) -> None:
        if not standing.is_reported:
            self._status.refusals.append((standing.order, why))
            standing.is_reported = True
        if standing.order is not Order.LAND:
            self._standing = None

    def _is_done(self) -> bool:
        assert self._standing is not None
        order, status = self._standing.order, self._status
        if order is Order.TAKE_CONTROL:
            return status.obeys
        if order is Order.LAND:
            return self.mode == self._autopilot.landing
        if order is Order.ARM:
            return status.armed is True
        return order is Order.DISARM and status.armed is False

    def _command(self, order: Order, height_m: float) -> tuple[int, tuple[float, ...]]:
        if order is Order.TAKE_CONTROL:
            return mode_command(self._autopilot.control)
        if order is Order.LAND:
            return mode_command(self._autopilot.landing)
        if order is Order.TAKE_OFF:
            return dialect.MAV_CMD_NAV_TAKEOFF, (0.0,) * 6 + (height_m,)
        return dialect.MAV_CMD_COMPONENT_ARM_DISARM, (float(order is Order.ARM),)  # never by force
