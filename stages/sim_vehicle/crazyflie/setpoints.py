"""Set-points of the simulated Crazyflie, decoded from CRTP, and the controllers that follow them."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.sim_vehicle.crazyflie.planner import Goal
from alula.stages.vehicles.packed_attitude import expand_quat_wxyz

PID, MELLINGER, LEE, OUT_OF_TREE = 1, 2, 5, 6

_FULL_STATE = struct.Struct("<9hI3h")
_FOUR = struct.Struct("<4f")
_STOP, _LEGACY_VELOCITY, _FULL, _POSITION, _VELOCITY = 0, 1, 6, 7, 8

# Mellinger's default gains divided by the mass: 0.4 and 0.2 N/m over 0.029 kg, in z 1.25 and 0.5 N/m.
_KP, _KV = np.array([13.8, 13.8, 43.0]), np.array([6.9, 6.9, 17.2])
_TO_SPEED_PER_S, _TO_ACCELERATION_PER_S = 2.0, 3.7  # PID: m to m/s; 25 degrees of tilt per m/s, late
_MAX_M_S2 = 12.0


def _zeros() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True, slots=True)
class Setpoint:
    """A set-point in the vehicle's own frame, z up; of kind "off" the motors are off.

    Attributes:
        kind: "off", "full-state", "position" or "velocity".
        position: shape (3,) [m].
        velocity: shape (3,) [m/s].
        acceleration: shape (3,) [m/s^2].
        attitude_wxyz: unit quaternion.
        omega: body rates, forward-left-up, towards which the firmware damps [rad/s].
        yaw_rad: heading to hold [rad]; None to turn by `yaw_rate_rad_s`.
    """

    kind: str = "off"
    position: FloatArray = field(default_factory=_zeros)
    velocity: FloatArray = field(default_factory=_zeros)
    acceleration: FloatArray = field(default_factory=_zeros)
    attitude_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    omega: FloatArray = field(default_factory=_zeros)
    yaw_rad: float | None = None
    yaw_rate_rad_s: float = 0.0


OFF = Setpoint()


def decode(data: bytes) -> Setpoint | None:
    """Decode a packet of the generic commander; None if its kind is not simulated."""
    kind, rest = data[0], data[1:]
    if kind == _STOP:
        return OFF
    if kind == _FULL and len(rest) == _FULL_STATE.size:
        values = _FULL_STATE.unpack(rest)
        quat = expand_quat_wxyz(values[9])
        w, x, y, z = quat
        thousandths = np.array([*values[:9], *values[10:]]) * 1e-3
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        p, v, a, omega = thousandths.reshape(4, 3)
        return Setpoint("full-state", p, v, a, quat, omega, yaw)
    if kind in (_LEGACY_VELOCITY, _VELOCITY, _POSITION) and len(rest) == _FOUR.size:
        x, y, z, angle = _FOUR.unpack(rest)
        if not all(map(math.isfinite, (x, y, z, angle))):
            return None
        angle = math.radians(angle)
        if kind == _POSITION:
            return Setpoint("position", position=np.array([x, y, z]), yaw_rad=angle)
        sign = -1.0 if kind == _LEGACY_VELOCITY else 1.0
        return Setpoint("velocity", velocity=np.array([x, y, z]), yaw_rate_rad_s=sign * angle)
    return None


def of_goal(goal: Goal) -> Setpoint:
    """Set-point of a point of a plan."""
    return Setpoint("position", goal.position, goal.velocity, goal.acceleration, yaw_rad=goal.yaw_rad)


def acceleration(
    setpoint: Setpoint, controller: int, position: FloatArray, velocity: FloatArray, *, levels_out: bool
) -> FloatArray | None:
    """Commanded translational acceleration of a controller, shape (3,) [m/s^2]; None stops the motors.

    PID follows positions and velocities and ignores accelerations. Mellinger and Lee follow full states. They
    do not support a velocity set-point: Mellinger flies to the height in it, which is zero, and Lee applies
    the thrust in it, which is zero. While the vehicle levels out only the height is controlled.

    Args:
        position: estimated position, shape (3,) [m].
        velocity: estimated velocity, shape (3,) [m/s].
        levels_out: whether the vehicle levels out because set-points are missing.
    """
    if setpoint.kind == "off":
        return None
    is_geometric = controller in (MELLINGER, LEE)
    position_error, velocity_error = setpoint.position - position, setpoint.velocity - velocity
    if setpoint.kind == "velocity" and controller == LEE:
        return None
    if is_geometric:
        command = _KP * position_error + _KV * velocity_error
        if setpoint.kind == "velocity":
            command[:2] = 0.0
        else:
            command += setpoint.acceleration
    else:
        speed = setpoint.velocity if setpoint.kind == "velocity" else _TO_SPEED_PER_S * position_error
        command = _TO_ACCELERATION_PER_S * (speed - velocity)
    if levels_out:
        command[:2] = 0.0
    return np.clip(command, -_MAX_M_S2, _MAX_M_S2)
