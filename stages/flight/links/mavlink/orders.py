"""Commands to a vehicle, repeated until it executes or refuses them or a timeout passes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from alula.stages.flight.links.mavlink.autopilots import Autopilot, mode_command
from alula.stages.flight.links.mavlink.session import Session
from alula.stages.flight.links.mavlink.telemetry import Telemetry
from alula.stages.flight.links.protocol import UNANSWERED, UNDONE, Order, check_height

_REPEAT_S = 0.5
_PATIENCE_S = 5.0
_SETTLED_S = 0.3  # a heartbeat that arrives this long after a command shows its effect
_REASONS_S = 2.0  # texts up to this long before a refusal may be its reason
_AFTER_S = 0.1  # and texts up to this long after it: PX4 sends the refusal first
_FORCED = 21196.0  # parameter of COMPONENT_ARM_DISARM
_PREFIXES = ("PreArm:", "Arm:", "Arming", "Preflight", "Takeoff", "Mode change", "Switching")


class Addressee:
    """Filter of COMMAND_ACKs: those for this program and not for another ground station.

    An answer to another system or component is rejected. Older autopilots, and MAVLink 1, leave the target 0.
    Such an answer counts if it has the number of the pending command, since nothing else identifies it. A
    vehicle that has named this program once always does; from then on answers with target 0 are rejected.
    """

    def __init__(self, system: int, component: int) -> None:
        self._ours = system, component
        self._names_us = False

    def is_ours(self, message: Any) -> bool:
        """Return whether a COMMAND_ACK answers this program."""
        named = message.target_system, message.target_component
        self._names_us = self._names_us or named == self._ours
        if self._names_us:
            return named == self._ours
        return all(name in (0, ours) for name, ours in zip(named, self._ours, strict=True))


@dataclass(slots=True)
class _Step:
    """One COMMAND_LONG; done when the vehicle's state shows it, or without `is_done` when acknowledged."""

    number: int
    values: tuple[float, ...]
    is_done: Callable[[], bool] | None = None
    first_s: float = 0.0  # delay before it is sent
    since_s: float = math.inf
    next_s: float = math.inf
    sent: int = 0
    first_sent_s: float = math.inf
    is_accepted: bool = False


class Orders:
    """The one pending command; a new one replaces it.

    A step is done when the vehicle's reported state shows it: a mode, or armed or not. Disarmed counts only
    in a heartbeat that arrives after the command was sent, because a command to arm may still be in transit.
    A take-off is done when it is acknowledged. A command that is refused, or unanswered for 5 s, is
    appended to `VehicleStatus.refusals` and ends; only LAND is repeated without limit. Repetition stops as
    soon as the mode differs from that at the first transmission, even within one poll, because a pilot has
    chosen the new mode. After the vehicle has followed set-points once, control is not taken again without
    a new command, because the pilot may have taken it back.
    """

    def __init__(self, session: Session, autopilot: Autopilot, telemetry: Telemetry) -> None:
        self._session, self._autopilot, self._telemetry = session, autopilot, telemetry
        self._order: Order | None = None
        self._steps: list[_Step] = []
        self._is_reported = False
        self._mode: tuple[int, int] | None = None  # at the first transmission of the pending step
        self._texts: list[tuple[float, str]] = []
        self._refusal: tuple[float, str] | None = None  # kept until its reason may have arrived

    def start(self, order: Order, now_s: float, height_m: float, first_s: float = 0.0) -> None:
        """Start a command.

        Args:
            first_s: delay before control is requested [s].

        Raises:
            LinkError: the height is out of range.
        """
        if order is Order.TAKE_OFF:
            check_height(height_m)
        self._order, self._is_reported, self._refusal = order, False, None
        self._steps = self._steps_of(order, height_m, first_s)
        if order is Order.DISARM and self._telemetry.status.landed is not True:
            self._refuse("the vehicle does not report that it is on the ground")
        self._advance(now_s)

    def drop(self) -> None:
        """Cancel the pending command."""
        self._steps, self._refusal = [], None

    def poll(self, now_s: float) -> None:
        """Send the pending command if it is due."""
        self._advance(now_s)
        if not self._steps:
            return
        step = self._steps[0]
        if self._refusal is not None:
            self._take_reasons(*self._refusal, now_s)
        elif now_s - step.since_s > _PATIENCE_S:
            what = UNDONE if step.is_accepted else UNANSWERED
            self._refuse(f"{what} for {_PATIENCE_S:g} s")
        if not self._steps or self._refusal is not None:
            return
        if now_s >= step.next_s:
            if step.sent == 0:
                self._mode, step.first_sent_s = self._telemetry.mode, now_s
            elif self._is_taken():
                self._steps = []
                return
            step.next_s = now_s + _REPEAT_S
            self._session.send(self._session.command(step.number, step.values, step.sent))
            step.sent += 1

    def _is_taken(self) -> bool:
        """Return whether the mode changed since the step was sent, although the step is not done."""
        mode = self._telemetry.mode
        return mode is not None and self._mode is not None and mode != self._mode

    def take_answer(self, message: Any, now_s: float) -> None:
        """Process a COMMAND_ACK that arrived at `now_s` [s]."""
        step = self._steps[0] if self._steps else None
        if step is None or message.command != step.number or step.sent == 0:
            return
        if message.result == dialect.MAV_RESULT_ACCEPTED:
            step.is_accepted, self._refusal = True, None
            step.next_s = now_s + 2 * _REPEAT_S
            self._advance(now_s)
        elif message.result == dialect.MAV_RESULT_IN_PROGRESS:
            step.next_s = now_s + _PATIENCE_S / 2
        elif self._refusal is None:
            entry = dialect.enums["MAV_RESULT"].get(message.result)
            result = str(message.result) if entry is None else entry.name.removeprefix("MAV_RESULT_").lower()
            self._refusal = now_s, result.replace("_", " ")

    def _take_reasons(self, since_s: float, result: str, now_s: float) -> None:
        """Report a refusal with its reasons, once no more of them are expected."""
        if now_s - since_s < _AFTER_S:
            return
        self._refusal = None
        texts = [text for at, text in self._texts if since_s - at <= _REASONS_S]
        self._refuse("; ".join([result, *dict.fromkeys(texts)]))

    def take_text(self, text: str, now_s: float) -> None:
        """Keep a text that arrived at `now_s` [s] if it may be the reason of a refusal."""
        if text.startswith(_PREFIXES):
            self._texts = [*self._texts[-7:], (now_s, text)]

    def _advance(self, now_s: float) -> None:
        while self._steps:
            step = self._steps[0]
            if step.since_s == math.inf:
                step.since_s = step.next_s = now_s + step.first_s
            if not (step.is_accepted if step.is_done is None else step.is_done()):
                return
            del self._steps[0]
            self._refusal = None

    def _refuse(self, why: str) -> None:
        assert self._order is not None
        if not self._is_reported:
            self._telemetry.status.refusals.append((self._order, why))
            self._is_reported = True
        if self._order is not Order.LAND:
            self._steps = []

    def _steps_of(self, order: Order, height_m: float, first_s: float) -> list[_Step]:
        telemetry, autopilot = self._telemetry, self._autopilot
        status = telemetry.status
        control = _Step(*mode_command(autopilot.control), lambda: status.obeys, first_s)
        arm = dialect.MAV_CMD_COMPONENT_ARM_DISARM  # to arm, it is never forced
        match order:
            case Order.TAKE_CONTROL:
                return [control]
            case Order.ARM:
                return [control, _Step(arm, (1.0,), lambda: status.armed is True)]
            case Order.DISARM | Order.STOP:
                step = _Step(arm, (0.0, _FORCED) if order is Order.STOP else (0.0,))
                step.is_done = lambda: (
                    status.armed is False and telemetry.beat_s > step.first_sent_s + _SETTLED_S
                )
                return [step]
            case Order.TAKE_OFF:
                return [_Step(dialect.MAV_CMD_NAV_TAKEOFF, (0.0,) * 6 + (height_m,))]
            case Order.LAND:
                landing = autopilot.landing
                return [_Step(*mode_command(landing), lambda: telemetry.mode == landing)]
            case _:
                return []
