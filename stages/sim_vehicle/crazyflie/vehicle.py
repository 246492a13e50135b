"""The simulated Crazyflie: bytes in and out, on the caller's clock.

A datagram is a packet of CRTP: a byte with port (high half) and channel (lowest two bits), and up to 30 more
bytes. The vehicle behaves like the firmware with protocol 12 in the parts that flights need: tables of
parameters and logs, set-points with priorities and watchdogs, high-level commander, supervisor, external
poses, console.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import msgspec
import numpy as np

from alula.schemas.errors import UsageError
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.sim_vehicle.crazyflie.estimator import Estimator
from alula.stages.sim_vehicle.crazyflie.planner import Goal, Plan, Planner
from alula.stages.sim_vehicle.crazyflie.setpoints import (
    MELLINGER,
    OFF,
    OUT_OF_TREE,
    PID,
    Setpoint,
    acceleration,
    decode,
    of_goal,
)
from alula.stages.sim_vehicle.crazyflie.supervisor import Stage, Supervisor
from alula.stages.sim_vehicle.crazyflie.tables import LogTable, ParameterTable
from alula.stages.vehicles.packed_attitude import compress_quat_wxyz
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint
from alula.stages.vehicles.simulated_body import STEP_S, Body

PROTOCOL = 12

_CONSOLE, _PARAMETERS, _RPYT, _MEMORY, _LOGS, _LOCALIZATION = 0, 2, 3, 4, 5, 6
_SETPOINTS, _HIGH_LEVEL, _SUPERVISOR, _PLATFORM, _LINK = 7, 8, 9, 13, 15
_MAX_BYTES = 30
_PRIORITY_NONE, _PRIORITY_PLANNER, _PRIORITY_RADIO = 0, 1, 2
_PLAN_S = _MOCAP_S = 0.01
_TUMBLES_M_S = 2.5  # a faster touch-down makes it tumble
_FULL_V, _EMPTY_V, _SAG_V = 4.15, 3.0, 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class CrazyflieOptions:
    """Equipment and initial state of the simulated Crazyflie.

    Attributes:
        start: initial position in its own frame [m]; its height is that of the floor.
        arms_itself: whether it arms by itself, as a Crazyflie 2.1 does; a Bolt or a brushless one waits for a
            request.
        needs_poses: whether its estimate drifts without external poses.
        has_app: whether it has the parameters and logs of the out-of-tree app, whose filter is not simulated.
        flight_s: flight time until the battery is empty [s].
    """

    start: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0
    arms_itself: bool = False
    needs_poses: bool = False
    has_app: bool = False
    flight_s: float = 420.0
    seed: int = 0


class SimulatedCrazyflie:
    """A simulated Crazyflie; `receive` takes packets, `advance` simulates and returns those to send.

    Args:
        vehicle: a quadrotor; its disturbances act.

    Attributes:
        setpoint: the set-point that is followed, or was last.
        setpoints: number of set-points received by radio.
    """

    def __init__(self, vehicle: Vehicle, options: CrazyflieOptions | None = None) -> None:
        self.options = options = options or CrazyflieOptions()
        self.body = Body(vehicle, np.array(options.start), options.yaw_rad, options.seed)
        self.supervisor = Supervisor(arms_itself=options.arms_itself)
        self.planner = Planner()
        self.estimator = Estimator(self.body, needs_poses=options.needs_poses, seed=options.seed)
        self.parameters = ParameterTable(self._parameters())
        self.logs = LogTable(self._variables())
        self.setpoint: Setpoint = OFF
        self.time_s = 0.0
        self.setpoints = 0
        self._setpoint_s, self._priority = 0.0, _PRIORITY_NONE
        self._plan_due_s = self._mocap_due_s = 0.0
        self._yaw = options.yaw_rad
        self._used_s = 0.0
        self._refused = 0
        self._outbox: list[bytes] = []
        self._text = bytearray(b"SYS: Crazyflie simulated by alula is up and running!\n")

    def set_parameters(self, values: Mapping[str, float]) -> None:
        """Set parameters at boot.

        Raises:
            UsageError: there is no such parameter, or its type cannot hold the value.
        """
        for name, value in values.items():
            try:
                self.parameters.set(name, value)
            except KeyError:
                raise UsageError(f"the simulated Crazyflie has no parameter {name}") from None
            except (struct.error, ValueError, OverflowError):
                raise UsageError(f"{name} cannot be {value:g}") from None
        self._apply_parameters()

    def receive(self, data: bytes) -> None:
        """Process a packet; the next `advance` returns the answers."""
        if not 1 <= len(data) <= 1 + _MAX_BYTES:
            return
        port, channel, rest = data[0] >> 4, data[0] & 3, data[1:]
        if port == _PARAMETERS:
            for number, answer in self.parameters.receive(channel, rest):
                self._send(port, number, answer)
            self._apply_parameters()
        elif port == _LOGS:
            for number, answer in self.logs.receive(channel, rest, 1e3 * self.time_s):
                self._send(port, number, answer)
        elif port == _LINK:
            self._answer_link(channel, rest)
        elif rest:
            self._answer(port, channel, rest)

    def advance(self, to_s: float) -> list[bytes]:
        """Simulate up to a time since boot.

        Returns:
            The packets to send, each in a datagram of its own.
        """
        while self.time_s + STEP_S <= to_s + 1e-9:
            self.time_s += STEP_S
            self._step()
        for channel, data in self.logs.due(1e3 * self.time_s):
            self._send(_LOGS, channel, data)
        for text in self.supervisor.texts:
            self._text += text.encode()
        self.supervisor.texts.clear()
        while self._text:
            self._send(_CONSOLE, 0, bytes(self._text[:_MAX_BYTES]))
            del self._text[:_MAX_BYTES]
        packets, self._outbox = self._outbox, []
        return packets

    def mocap(self) -> bytes | None:
        """Datagram of motion capture with the true pose, 100 times a second; None between them."""
        if self.time_s < self._mocap_due_s:
            return None
        self._mocap_due_s = max(self._mocap_due_s + _MOCAP_S, self.time_s)
        position, attitude = self.body.position.tolist(), self.estimator.true_attitude_wxyz.tolist()
        sample = {"time_s": self.time_s, "position_m": position, "attitude_wxyz": attitude}
        return msgspec.json.encode(sample)

    @property
    def battery_v(self) -> float:
        """Voltage of the battery [V]; it sags while the motors run."""
        left = max(0.0, 1.0 - self._used_s / self.options.flight_s)
        sag = _SAG_V if self._is_pushing else 0.0
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * left - sag

    @property
    def _is_pushing(self) -> bool:
        return self.setpoint.kind != "off" and self.supervisor.motors_may_run

    def _step(self) -> None:
        if self.time_s >= self._plan_due_s:
            self._plan_due_s += _PLAN_S
            self._plan()
        self.estimator.step(STEP_S)
        self.supervisor.update(self.time_s, self._setpoint_s, self._is_pushing)
        command = None
        if self.supervisor.motors_may_run:
            command = acceleration(
                self.setpoint,
                int(self.parameters.values["stabilizer.controller"]),
                self.estimator.position,
                self.estimator.velocity,
                levels_out=self.supervisor.stage is Stage.LEVEL_OUT,
            )
        was_resting = self.body.is_resting
        if command is None:
            self.body.step(RatesSetpoint(0.0, np.zeros(3)))
        else:
            self._used_s += STEP_S
            # The attitude loop uses the true body; a wrong estimate affects only the commanded acceleration.
            turned = self.estimator.to_truth(command)
            if self.setpoint.yaw_rad is None:
                self._yaw += STEP_S * self.setpoint.yaw_rate_rad_s
            else:
                self._yaw = self.setpoint.yaw_rad
            yaw = self._yaw - self.estimator.yaw_offset_rad
            self.body.step(AccelerationSetpoint(turned, self.body.velocity, self.body.position, yaw))
        if self.body.is_resting and not was_resting and self.body.impact_m_s > _TUMBLES_M_S:
            self.supervisor.tumbled = True

    def _plan(self) -> None:
        """Follow the high-level commander's set-point; any other set-point has priority."""
        if self._priority > _PRIORITY_PLANNER:
            return
        if self.planner.plan is Plan.IDLE:
            self._set(OFF, _PRIORITY_PLANNER)
        else:
            self._set(of_goal(self.planner.goal(self.time_s)), _PRIORITY_PLANNER)

    def _set(self, setpoint: Setpoint, priority: int) -> None:
        if priority >= self._priority:
            if priority > _PRIORITY_PLANNER:
                self.planner.plan = Plan.IDLE
                self.setpoints += 1
            self.setpoint, self._setpoint_s, self._priority = setpoint, self.time_s, priority

    def _answer(self, port: int, channel: int, data: bytes) -> None:
        if port == _SETPOINTS and channel == 0:
            setpoint = decode(data)
            if setpoint is not None:
                self._set(setpoint, _PRIORITY_RADIO)
        elif port == _SETPOINTS and channel == 1 and data[0] == 0:
            self._priority = _PRIORITY_NONE
        elif port == _RPYT and data[-2:] == b"\0\0":
            self._set(OFF, _PRIORITY_RADIO)
        elif port == _HIGH_LEVEL:
            estimator = self.estimator
            here = Goal(estimator.position, estimator.velocity, np.zeros(3), estimator.yaw_rad)
            status = self.planner.receive(data, here, self.time_s)
            self._send(port, channel, data[:3].ljust(3, b"\0") + bytes([status]))
        elif port == _SUPERVISOR:
            self._answer_supervisor(channel, data)
        elif port == _LOCALIZATION:
            self._answer_localization(channel, data)
        elif port == _MEMORY and channel == 0 and data[0] == 1:
            self._send(port, 0, b"\1\0")
        elif port == _PLATFORM and channel == 1 and data[0] == 0:
            self._send(port, 1, bytes([0, PROTOCOL]))
        elif port == _PLATFORM and channel == 0 and data[0] == 1 and len(data) > 1:
            self.supervisor.arm(bool(data[1]))

    def _answer_link(self, channel: int, data: bytes) -> None:
        if channel == 1:
            self._send(_LINK, 1, b"Bitcraze Crazyflie".ljust(_MAX_BYTES, b"\0"))
        elif channel in (0, 3):
            self._send(_LINK, channel, data)

    def _answer_supervisor(self, channel: int, data: bytes) -> None:
        command = data[0]
        if channel == 0 and command == 0x0C:
            self._send(_SUPERVISOR, 0, bytes([0x80 | command]) + struct.pack("<H", int(self._bits())))
        elif channel == 1 and command == 1 and len(data) > 1:
            done = self.supervisor.arm(bool(data[1]))
            self._send(_SUPERVISOR, 1, bytes([0x80 | command, done, self.supervisor.is_armed]))
        elif channel == 1 and command == 3:
            self.supervisor.stop()
        elif channel == 1 and command == 4:
            self.supervisor.notice(self.time_s)

    def _answer_localization(self, channel: int, data: bytes) -> None:
        if channel == 1 and data[0] == 8 and len(data) == 29:
            x, y, z, *xyzw = struct.unpack("<7f", data[1:])
            self.estimator.take_pose(np.array([x, y, z]), np.array([xyzw[3], *xyzw[:3]]))
        elif channel == 1 and data[0] == 3:
            self.supervisor.stop()
        elif channel == 1 and data[0] == 4:
            self.supervisor.notice(self.time_s)

    def _apply_parameters(self) -> None:
        values = self.parameters.values
        for name in self.parameters.written:
            if name == "kalman.resetEstimation" and values[name]:
                initial = [float(values[f"kalman.initial{axis}"]) for axis in ("X", "Y", "Z", "Yaw")]
                self.estimator.reset(np.array(initial[:3]), initial[3])
                values[name] = 0
            elif name == "stabilizer.controller":
                known = (PID, MELLINGER, 3, 4, 5) + ((OUT_OF_TREE,) if self.options.has_app else ())
                if values[name] not in known:
                    values[name] = PID
            elif name.startswith("alula.") and not values["alula.radius"] > 0:
                self._refused += 1
        self.parameters.written.clear()

    def _bits(self) -> float:
        plans = self.planner.plan is not Plan.IDLE
        return self.supervisor.bits(plans, self.planner.is_finished(self.time_s))

    def _send(self, port: int, channel: int, data: bytes) -> None:
        self._outbox.append(bytes([port << 4 | 0x0C | channel]) + data[:_MAX_BYTES])

    def _parameters(self) -> dict[str, tuple[str, float]]:
        found: dict[str, tuple[str, float]] = {
            "stabilizer.controller": ("B", PID),
            "stabilizer.estimator": ("B", 1),
            "commander.enHighLevel": ("B", 0),
            "kalman.resetEstimation": ("B", 0),
            **{f"kalman.initial{axis}": ("f", 0.0) for axis in ("X", "Y", "Z", "Yaw")},
        }
        if self.options.has_app:
            found |= {f"alula.{name}": ("B", value) for name, value in _APP_BYTES.items()}
            found |= {f"alula.{name}": ("f", value) for name, value in _APP_NUMBERS.items()}
        return found

    def _variables(self) -> dict[str, tuple[str, Callable[[], float]]]:
        estimator = self.estimator
        found: dict[str, tuple[str, Callable[[], float]]] = {
            **{
                f"stateEstimateZ.{name}": ("h", _thousandths(read))
                for name, read in estimator.readers().items()
            },
            "stateEstimateZ.quat": ("I", lambda: compress_quat_wxyz(estimator.attitude_wxyz.tolist())),
            **{f"kalman.var{axis}": ("f", lambda: estimator.variance) for axis in "XYZ"},
            "pm.vbat": ("f", lambda: self.battery_v),
            "supervisor.info": ("H", self._bits),
        }
        if self.options.has_app:
            found["alula.status"] = ("B", lambda: 4)
            found["alula.refused"] = ("I", lambda: self._refused)
            found["alula.h"] = ("f", lambda: math.nan)
        return found


def _thousandths(read: Callable[[], float]) -> Callable[[], float]:
    return lambda: 1e3 * read()


_APP_BYTES = {"enable": 1, "attitude": 0, "divider": 5}
_APP_NUMBERS = {"radius": 0.15, "beta": 2.0, "kappa": 100.0, "vmax": 1.0, "gain": 2.0, "variance": 0.0025}
