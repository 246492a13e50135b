"""Commands to a Crazyflie: arming through its supervisor, paths through its high-level commander."""

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
    IS_LOCKED: "it is locked and must be restarted",
    IS_CRASHED: "it has crashed",
}
_GO_TO, _TAKE_OFF, _LAND, _GO_TO_2 = 4, 7, 8, 12
_BUSY = 1
_REPEAT_S, _PATIENCE_S = 0.5, 5.0
_CLIMB_M_S, _SINK_M_S, _BRAKE_M_S2 = 0.4, 0.3, 3.0  # means over a path
_SHORTEST_S, _SHORTEST_STOP_S = 1.5, 0.8


@dataclass(slots=True)
class Motion:
    """Motion of the vehicle in its own local frame, z up.

    Attributes:
        position: shape (3,) [m].
        velocity: shape (3,) [m/s].
        floor_m: height at which it stood last, or 0 [m].
    """

    position: FloatArray
    velocity: FloatArray
    yaw_rad: float
    floor_m: float


@dataclass(slots=True)
class _Pending:
    order: Order
    send: Callable[[], None]
    is_done: Callable[[], bool] | None  # None: done when the high-level commander has answered
    commands: tuple[int, ...] = ()
    since_s: float = 0.0
    next_s: float = 0.0
    sent: int = 0
    is_reported: bool = False


class Orders:
    """The one pending command; a new one replaces it.

    Args:
        status: the status to update; `armed`, `landed`, `mode`, `obeys` and `is_failsafe` follow from the
            supervisor's bits.

    Attributes:
        info: the last reported bits of `supervisor.info`; None before the first.
    """

    def __init__(self, session: Session, status: VehicleStatus) -> None:
        self._session, self._status = session, status
        self._pending: _Pending | None = None
        self._has_armed = False  # this program armed it; a vehicle that arms itself always reports armed
        self.info: int | None = None
        status.mode = "standby"

    def update(self, info: int) -> None:
        """Update the status from the bits of `supervisor.info`."""
        status, was_flying = self._status, bool((self.info or 0) & IS_FLYING)
        self.info = info
        is_flying = bool(info & IS_FLYING)
        if was_flying and not is_flying:
            self._has_armed = False
        is_armed = bool(info & IS_ARMED)
        status.armed = is_flying or (is_armed and (self._has_armed or not info & AUTO_ARMS))
        status.landed = not is_flying
        status.is_failsafe = bool(info & (IS_TUMBLED | IS_LOCKED | IS_CRASHED))
        status.obeys = status.mode == "commanded" and not status.is_failsafe

    def start(self, order: Order, now_s: float, height_m: float, motion: Motion | None) -> None:
        """Start a command.

        Args:
            height_m: take-off height above the present position [m].
            motion: the vehicle's motion; None if unknown.

        Raises:
            LinkError: the command is not possible now.
        """
        status = self._status
        if order is Order.TAKE_OFF:
            check_height(height_m)
        if order in (Order.TAKE_OFF, Order.HOLD) and motion is None:
            raise LinkError(f"{order.value} is refused: the vehicle has not reported its position")
        if order is Order.DISARM and status.landed is not True:
            return self._refuse(order, "the vehicle does not report that it is on the ground")
        # If `armed` is unknown the command is sent: without set-points a flying vehicle falls after 2 s.
        is_maybe_flying = status.armed is None and order is not Order.TAKE_OFF
        if order in (Order.TAKE_OFF, Order.HOLD, Order.LAND) and not (status.armed or is_maybe_flying):
            return self._refuse(order, "it is not armed")
        if order in (Order.ARM, Order.TAKE_OFF) and status.is_failsafe:
            return self._refuse(order, "; ".join(self._reasons()))
        self._pending = self._made(order, height_m, motion)
        if order in (Order.ARM, Order.TAKE_CONTROL, Order.TAKE_OFF):
            status.mode = "commanded"
        elif order is Order.LAND:
            status.mode = "landing"
        status.obeys = status.mode == "commanded" and not status.is_failsafe
        if self._pending is not None:
            self._pending.since_s = self._pending.next_s = now_s
        self.poll(now_s)

    def poll(self, now_s: float) -> None:
        """Process answers, and send the command if it is due."""
        answers = self._session.answers()
        pending = self._pending
        if pending is None:
            return
        for command, error in answers:
            if command in pending.commands and pending.sent:
                # A repeated command is answered with "busy" while the first one is executed.
                if error == 0 or (error == _BUSY and pending.sent > 1):
                    self._pending = None
                    return
                self._give_up(pending, f"its high-level commander reports error {error}")
        if pending.is_done is not None and pending.is_done():
            self._pending = None
            return
        if now_s - pending.since_s > _PATIENCE_S:
            self._give_up(pending, "; ".join([f"{UNDONE} for {_PATIENCE_S:g} s", *self._reasons()]))
        if self._pending is not None and now_s >= pending.next_s:
            pending.next_s = now_s + _REPEAT_S
            pending.sent += 1
            pending.send()

    def _made(self, order: Order, height_m: float, motion: Motion | None) -> _Pending | None:
        session, status = self._session, self._status
        if order is Order.ARM:
            self._has_armed = True
            return _Pending(order, lambda: session.arm(True), lambda: bool((self.info or 0) & IS_ARMED))
        # Its supervisor also stops the motors of a Crazyflie that lies on its side.
        if order in (Order.DISARM, Order.STOP):
            self._has_armed = False
            return _Pending(order, lambda: session.arm(False), lambda: status.armed is False)
        if order is Order.TAKE_OFF:
            assert motion is not None
            goal = float(motion.position[2]) + height_m
            time_s = max(_SHORTEST_S, height_m / _CLIMB_M_S)
            return self._path(
                order, (_TAKE_OFF,), lambda plan: plan.takeoff(goal, time_s, yaw=None), takes_over=False
            )
        if order is Order.HOLD:
            assert motion is not None
            speed = math.sqrt(float(motion.velocity @ motion.velocity))
            time_s = max(_SHORTEST_STOP_S, speed / _BRAKE_M_S2)
            x, y, z = (motion.position + 0.5 * time_s * motion.velocity).tolist()
            yaw = motion.yaw_rad
            return self._path(order, (_GO_TO, _GO_TO_2), lambda plan: plan.go_to(x, y, z, yaw, time_s))
        if order is Order.LAND:
            floor = 0.0 if motion is None else motion.floor_m
            height = 1.0 if motion is None else max(float(motion.position[2]) - floor, 0.0)
            time_s = max(_SHORTEST_S, height / _SINK_M_S)
            return self._path(order, (_LAND,), lambda plan: plan.land(floor, time_s, yaw=None))
        return None

    def _path(
        self, order: Order, commands: tuple[int, ...], plan: Callable[[Any], None], takes_over: bool = True
    ) -> _Pending:
        """Send the plan before the end of set-points: without a plan the commander stops the motors."""

        def send() -> None:
            self._session.post(lambda vehicle: plan(vehicle.high_level_commander))
            if takes_over:
                self._session.post(lambda vehicle: vehicle.commander.send_notify_setpoint_stop())

        return _Pending(order, send, None, commands)

    def _reasons(self) -> list[str]:
        found = [words for bit, words in _REASONS.items() if (self.info or 0) & bit]
        return found or (["its supervisor reports nothing"] if self.info is None else [])

    def _give_up(self, pending: _Pending, why: str) -> None:
        if not pending.is_reported:
            self._refuse(pending.order, why)
            pending.is_reported = True
        if pending.order is not Order.LAND:
            self._pending = None

    def _refuse(self, order: Order, why: str) -> None:
        self._status.refusals.append((order, why))
