"""Orders to a Crazyflie: arming by its supervisor, ways by its high-level commander."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import LinkError
from alula.stages.flight.links.crazyflie.session import Session
from alula.stages.flight.links.protocol import UNDONE, Order, VehicleStatus, check_height

CAN_BE_ARMED, IS_ARMED, AUTO_ARMS, CAN_FLY, IS_FLYING = 1, 2, 4, 8, 16
IS_TUMBLED, IS_LOCKED, IS_CRASHED = 32, 64, 128  # bits of supervisor.info

_REASONS = {
    IS_TUMBLED: "it lies on its side",
    IS_LOCKED: "it is locked and must be started anew",
    IS_CRASHED: "it has crashed",
}
_GO_TO, _TAKE_OFF, _LAND, _GO_TO_2 = 4, 7, 8, 12
_BUSY = 1
_REPEAT_S, _PATIENCE_S = 0.5, 5.0
_CLIMB_M_S, _SINK_M_S, _BRAKE_M_S2 = 0.4, 0.3, 3.0  # means over a way
_SHORTEST_S, _SHORTEST_STOP_S = 1.5, 0.8


@dataclass(slots=True)
class Motion:
    """Of the vehicle in its own frame; the floor is the height where it stood last, or 0."""

    position: FloatArray
    velocity: FloatArray
    yaw_rad: float
    floor_m: float


@dataclass(slots=True)
class _Standing:
    """An order that is repeated until it is done."""

    order: Order
    send: Callable[[], None]
    is_done: Callable[[], bool] | None  # None: when the commander answered
    commands: tuple[int, ...] = ()
    since_s: float = 0.0
    next_s: float = 0.0
    sent: int = 0
    is_reported: bool = False


class Orders:
    """The one order that stands; a new one replaces it.

    Args:
        session: with the vehicle.
        status: whose `armed`, `landed`, `mode` and `obeys` are kept here, from the supervisor's bits.
    """

    def __init__(self, session: Session, status: VehicleStatus) -> None:
        self._session, self._status = session, status
        self._standing: _Standing | None = None
        self._is_wanted = False  # armed, by us: a vehicle that arms itself always is
        self.info: int | None = None
        status.mode = "standby"

    def see(self, info: int) -> None:
        """Bits of `supervisor.info`."""
        status, was_flying = self._status, bool((self.info or 0) & IS_FLYING)
        self.info = info
        is_flying = bool(info & IS_FLYING)
        if was_flying and not is_flying:
            self._is_wanted = False
        is_armed = bool(info & IS_ARMED)
        status.armed = is_flying or (is_armed and (self._is_wanted or not info & AUTO_ARMS))
        status.landed = not is_flying
        status.is_failsafe = bool(info & (IS_TUMBLED | IS_LOCKED | IS_CRASHED))
        status.obeys = status.mode == "commanded" and not status.is_failsafe

    def start(self, order: Order, now_s: float, height_m: float, motion: Motion | None) -> None:
        """Give an order.

        Raises:
            LinkError: it makes no sense now.
        """
        status = self._status
        if order is Order.TAKE_OFF:
            check_height(height_m)
        if order in (Order.TAKE_OFF, Order.HOLD) and motion is None:
            raise LinkError(f"{order.value} is refused: the vehicle has not said where it is")
        if order is Order.DISARM and status.landed is not True:
            return self._refuse(order, "the vehicle does not say that it is on the ground")
        # Not known to be armed is no reason to let it fall: without set-points it does so after 2 s.
        is_maybe_flying = status.armed is None and order is not Order.TAKE_OFF
        if order in (Order.TAKE_OFF, Order.HOLD, Order.LAND) and not (status.armed or is_maybe_flying):
            return self._refuse(order, "it is not armed")
        if order in (Order.ARM, Order.TAKE_OFF) and status.is_failsafe:
            return self._refuse(order, "; ".join(self._reasons()))
        self._standing = self._made(order, height_m, motion)
        if order in (Order.ARM, Order.TAKE_CONTROL, Order.TAKE_OFF):
            status.mode = "commanded"
        elif order is Order.LAND:
            status.mode = "landing"
        status.obeys = status.mode == "commanded" and not status.is_failsafe
        if self._standing is not None:
            self._standing.since_s = self._standing.next_s = now_s
        self.poll(now_s)

    def poll(self, now_s: float) -> None:
        """Send what is due, and look at answers."""
        answers = self._session.answers()
        standing = self._standing
        if standing is None:
            return
        for command, error in answers:
            if command in standing.commands and standing.sent:
                # The second of two equal commands finds the first at work.
                if error == 0 or (error == _BUSY and standing.sent > 1):
                    self._standing = None
                    return
                self._give_up(standing, f"its high-level commander says error {error}")
        if standing.is_done is not None and standing.is_done():
            self._standing = None
            return
        if now_s - standing.since_s > _PATIENCE_S:
            self._give_up(standing, "; ".join([f"{UNDONE} for {_PATIENCE_S:g} s", *self._reasons()]))
        if self._standing is not None and now_s >= standing.next_s:
            standing.next_s = now_s + _REPEAT_S
            standing.sent += 1
            standing.send()

    def _made(self, order: Order, height_m: float, motion: Motion | None) -> _Standing | None:
        session, status = self._session, self._status
        if order is Order.ARM:
            self._is_wanted = True
            return _Standing(order, lambda: session.arm(True), lambda: bool((self.info or 0) & IS_ARMED))
        if order is Order.DISARM:
            self._is_wanted = False
            return _Standing(order, lambda: session.arm(False), lambda: status.armed is False)
        if order is Order.TAKE_OFF:
            assert motion is not None
            goal = float(motion.position[2]) + height_m
            time_s = max(_SHORTEST_S, height_m / _CLIMB_M_S)
            return self._way(
                order, (_TAKE_OFF,), lambda plan: plan.takeoff(goal, time_s, yaw=None), takes_over=False
            )
        if order is Order.HOLD:
            assert motion is not None
            speed = math.sqrt(float(motion.velocity @ motion.velocity))
            time_s = max(_SHORTEST_STOP_S, speed / _BRAKE_M_S2)
            x, y, z = (motion.position + 0.5 * time_s * motion.velocity).tolist()
            yaw = motion.yaw_rad
            return self._way(order, (_GO_TO, _GO_TO_2), lambda plan: plan.go_to(x, y, z, yaw, time_s))
        if order is Order.LAND:
            floor = 0.0 if motion is None else motion.floor_m
            height = 1.0 if motion is None else max(float(motion.position[2]) - floor, 0.0)
            time_s = max(_SHORTEST_S, height / _SINK_M_S)
            return self._way(order, (_LAND,), lambda plan: plan.land(floor, time_s, yaw=None))
        return None

    def _way(
        self, order: Order, commands: tuple[int, ...], plan: Callable[[Any], None], takes_over: bool = True
    ) -> _Standing:
        """A plan first, and only then its turn: without a plan the commander stops the motors."""

        def send() -> None:
            self._session.post(lambda vehicle: plan(vehicle.high_level_commander))
            if takes_over:
                self._session.post(lambda vehicle: vehicle.commander.send_notify_setpoint_stop())

        return _Standing(order, send, None, commands)

    def _reasons(self) -> list[str]:
        found = [words for bit, words in _REASONS.items() if (self.info or 0) & bit]
        return found or (["its supervisor says nothing"] if self.info is None else [])

    def _give_up(self, standing: _Standing, why: str) -> None:
        if not standing.is_reported:
            self._refuse(standing.order, why)
            standing.is_reported = True
        if standing.order is not Order.LAND:
            self._standing = None

    def _refuse(self, order: Order, why: str) -> None:
        self._status.refusals.append((order, why))
