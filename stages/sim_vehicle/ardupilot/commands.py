"""Table of the MAV_CMD_* commands: execution and answer of each."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from alula.stages.sim_vehicle.ardupilot.modes import Mode
from alula.stages.sim_vehicle.ardupilot.telemetry import Telemetry
from alula.stages.sim_vehicle.common.copter import INFO, Copter
from alula.stages.sim_vehicle.common.estimator import is_location
from alula.stages.sim_vehicle.common.packets import Message, mavlink
from alula.stages.sim_vehicle.common.quaternions import to_euler

_FORCE = 21196.0  # param2 of COMPONENT_ARM_DISARM
_ACCEPTED, _DENIED = mavlink.MAV_RESULT_ACCEPTED, mavlink.MAV_RESULT_DENIED
_FAILED, _UNSUPPORTED = mavlink.MAV_RESULT_FAILED, mavlink.MAV_RESULT_UNSUPPORTED


@dataclass(frozen=True, slots=True)
class Command:
    """A COMMAND_LONG or COMMAND_INT.

    Attributes:
        params: the seven parameters; 5 and 6 may be degrees.
        frame: MAV_FRAME of a COMMAND_INT, else None.
    """

    number: int
    params: tuple[float, ...]
    frame: int | None = None


def command_of(message: Message) -> Command:
    """Command in a COMMAND_LONG or COMMAND_INT."""
    if message.get_type() == "COMMAND_INT":
        location = (message.x / 1e7, message.y / 1e7, message.z)
        rest = (message.param1, message.param2, message.param3, message.param4)
        return Command(message.command, (*rest, *location), message.frame)
    return Command(message.command, tuple(getattr(message, f"param{i}") for i in range(1, 8)))


class Commands:
    """Executes commands; each returns a MAV_RESULT and may add messages to send."""

    REFUSED: ClassVar[int] = _FAILED  # result of a command that is possible in another state
    UNKNOWN: ClassVar[int] = _DENIED  # result of asking for the interval of an unknown message

    def __init__(self, copter: Copter, telemetry: Telemetry) -> None:
        self._copter = copter
        self._telemetry = telemetry
        m = mavlink
        self._table: dict[int, Callable[[Command, list[Message]], int]] = {
            m.MAV_CMD_COMPONENT_ARM_DISARM: self._arm,
            m.MAV_CMD_NAV_TAKEOFF: self._take_off,
            m.MAV_CMD_NAV_LAND: lambda command, out: self._enter(Mode.LAND),
            m.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda command, out: self._enter(Mode.RTL),
            m.MAV_CMD_NAV_LOITER_UNLIM: lambda command, out: self._enter(Mode.LOITER),
            m.MAV_CMD_DO_SET_MODE: self._set_mode,
            m.MAV_CMD_DO_REPOSITION: self._reposition,
            m.MAV_CMD_DO_CHANGE_SPEED: self._change_speed,
            m.MAV_CMD_CONDITION_YAW: self._turn,
            m.MAV_CMD_DO_SET_HOME: self._set_home,
            m.MAV_CMD_DO_FLIGHTTERMINATION: self._terminate,
            m.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            m.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            m.MAV_CMD_REQUEST_MESSAGE: self._request,
            m.MAV_CMD_GET_HOME_POSITION: lambda command, out: self._build("HOME_POSITION", out),
            m.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: lambda command, out: self._build(
                "AUTOPILOT_VERSION", out
            ),
            m.MAV_CMD_RUN_PREARM_CHECKS: self._check,
        }

    def execute(self, command: Command) -> tuple[int, list[Message]]:
        """Execute a command; returns its MAV_RESULT and the messages to send in addition."""
        out: list[Message] = []
        if command.number not in self._table:
            return _UNSUPPORTED, out
        return self._table[command.number](command, out), out

    def _arm(self, command: Command, _out: list[Message]) -> int:
        forced = command.params[1] == _FORCE
        if command.params[0] not in (0.0, 1.0):
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        turn = self._copter.arm if command.params[0] == 1.0 else self._copter.disarm
        return int(_ACCEPTED if turn(forced=forced) else self.REFUSED)

    def _take_off(self, command: Command, _out: list[Message]) -> int:
        height = command.params[6]
        return int(_ACCEPTED if math.isfinite(height) and self._copter.take_off(height) else _FAILED)

    def _enter(self, mode: Mode) -> int:
        return int(_ACCEPTED if self._copter.set_mode(mode) else _FAILED)

    def _set_mode(self, command: Command, _out: list[Message]) -> int:
        base, custom = command.params[:2]
        if not (math.isfinite(base) and math.isfinite(custom)):
            return int(_DENIED)
        if not int(base) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return int(_DENIED)
        return int(_ACCEPTED if self._copter.set_mode(int(custom)) else _FAILED)

    def _reposition(self, command: Command, _out: list[Message]) -> int:
        copter = self._copter
        lat, lon, alt = command.params[4:]
        changes = math.isfinite(command.params[1]) and int(command.params[1]) & 1  # CHANGE_MODE
        if copter.mode is not Mode.GUIDED and not (changes and copter.set_mode(Mode.GUIDED)):
            return int(_DENIED)
        if not (is_location((lat, lon, alt)) and copter.is_armed and not copter.is_landed):
            return int(_DENIED)
        above_home = command.frame in (
            mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
            mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
        )
        north, east, down = copter.estimator.local_position((lat, lon, alt))
        down = copter.flying.home[2] - alt if above_home else down
        copter.flying.guided.go_to(copter.estimator.motion, (north, east, down))
        return int(_ACCEPTED)

    def _change_speed(self, command: Command, _out: list[Message]) -> int:
        speed = command.params[1]
        if not (math.isfinite(speed) and speed > 0):
            return int(_DENIED)
        self._copter.flying.guided.speed_m_s = speed
        return int(_ACCEPTED)

    def _turn(self, command: Command, _out: list[Message]) -> int:
        angle, _, direction, relative = command.params[:4]
        if self._copter.mode is not Mode.GUIDED or not math.isfinite(angle):
            return int(_FAILED)
        turn = math.radians(angle)
        if relative == 1.0:
            turn = to_euler(self._copter.estimator.motion.attitude)[2] + math.copysign(turn, direction or 1)
        self._copter.flying.position.yaw = turn
        return int(_ACCEPTED)

    def _set_home(self, command: Command, _out: list[Message]) -> int:
        estimator = self._copter.estimator
        if estimator.origin is None:
            return int(_FAILED)
        if command.params[0] == 1.0:
            self._copter.flying.home = estimator.motion.position
        elif is_location(location := (command.params[4], command.params[5], command.params[6])):
            self._copter.flying.home = estimator.local_position(location)
        else:
            return int(_DENIED)
        return int(_ACCEPTED)

    def _terminate(self, command: Command, _out: list[Message]) -> int:
        if command.params[0] != 1.0:
            return int(_UNSUPPORTED)
        self._copter.disarm(forced=True)
        return int(_ACCEPTED)

    def _set_interval(self, command: Command, _out: list[Message]) -> int:
        name, interval = self._name(command.params[0]), command.params[1]
        if name is None:
            self._copter.say(INFO, f"No ap_message for mavlink id ({command.params[0]:.0f})")
            return int(self.UNKNOWN)
        if not math.isfinite(interval) or (interval < 0 and interval != -1):
            return int(self.UNKNOWN)
        if interval == 0:
            self._telemetry.set_interval(name, self._telemetry.usual_interval_s(name))
        else:
            self._telemetry.set_interval(name, None if interval == -1 else interval * 1e-6)
        return int(_ACCEPTED)

    def _get_interval(self, command: Command, out: list[Message]) -> int:
        name = self._name(command.params[0])
        if name is None:
            return int(_FAILED)
        interval = self._telemetry.interval_s(name)
        number = -1 if interval is None else round(interval * 1e6)
        out.append(mavlink.MAVLink_message_interval_message(int(command.params[0]), number))
        return int(_ACCEPTED)

    def _request(self, command: Command, out: list[Message]) -> int:
        name = self._name(command.params[0])
        return int(_FAILED) if name is None else self._build(name, out)

    def _build(self, name: str, out: list[Message]) -> int:
        message = self._telemetry.build(name)
        if message is None:
            return int(_FAILED)
        out.append(message)
        return int(_ACCEPTED)

    def _check(self, _command: Command, _out: list[Message]) -> int:
        reason = self._copter.check_refusal()
        if reason is not None:
            self._copter.say(2, f"PreArm: {reason}")
        return int(_ACCEPTED)

    def _name(self, number: float) -> str | None:
        return self._telemetry.ids.get(int(number)) if math.isfinite(number) else None
