"""Set-points of the simulated Crazyflie, from CRTP, and what each controller makes of them."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.flight.links.crazyflie.setpoints import expand_quat_wxyz
from alula.stages.sim_vehicle.crazyflie.planner import Goal

PID, MELLINGER, LEE, OUT_OF_TREE = 1, 2, 5, 6

_FULL_STATE = struct.Struct("<9hI3h")
_FOUR = struct.Struct("<4f")
_STOP, _LEGACY_VELOCITY, _FULL, _POSITION, _VELOCITY = 0, 1, 6, 7, 8

# Mellinger's default gains over the mass, 0.4 and 0.2 N/m over 0.029 kg; of z 1.25 and 0.5 N/m.
_KP, _KV = np.array([13.8, 13.8, 43.0]), np.array([6.9, 6.9, 17.2])
_TO_SPEED_PER_S, _TO_ACCELERATION_PER_S = 2.0, 4.3  # PID: m to m/s, and 25 degrees of tilt per m/s
_MOST_M_S2 = 12.0


def _zeros() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True, slots=True)
class Setpoint:
    """A set-point; without a kind the motors are off.

    Attributes:
        kind: "off", "full-state", "position" or "velocity".
        yaw_rad: heading to hold; None turns by `yaw_rate_rad_s`.
        omega: body rates, forward-left-up [rad/s]: what the firmware damps towards.
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
    """A packet of the generic commander; None if it is none that this vehicle knows."""
    kind, rest = data[0], data[1:]
    if kind == _STOP:
        return OFF
    if kind == _FULL and len(rest) == _FULL_STATE.size:
        values = _FULL_STATE.unpack(rest)
        quat = expand_quat_wxyz(values[9])
        w, x, y, z = quat
        thousandths = np.array([*values[:9], *values[10:]]) * 1e-3
        position, velocity, push, omega = thousandths.reshape(4, 3)
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        return Setpoint("full-state", position, velocity, push, quat, omega, yaw)
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
    """A point of a plan."""
    return Setpoint("position", goal.position, goal.velocity, goal.acceleration, yaw_rad=goal.yaw_rad)


def acceleration(
    setpoint: Setpoint, controller: int, position: FloatArray, velocity: FloatArray, *, levels_out: bool
) -> FloatArray | None:
    """What a controller asks of the translation [m/s^2]; None lets the motors stop.

    PID flies positions and velocities and knows no acceleration. Mellinger and Lee fly full states; for a
    velocity, which they do not know, Mellinger goes to the height in the set-point, which is zero, and Lee
    gives the thrust in it, which is none. Without set-points only the height is kept.
    """
    if setpoint.kind == "off":
        return None
    is_geometric = controller in (MELLINGER, LEE)
    away, slow = setpoint.position - position, setpoint.velocity - velocity
    if setpoint.kind == "velocity" and controller == LEE:
        return None
    if is_geometric:
        wish = _KP * away + _KV * slow
        if setpoint.kind == "velocity":
            wish[:2] = 0.0
        else:
            wish += setpoint.acceleration
    else:
        speed = setpoint.velocity if setpoint.kind == "velocity" else _TO_SPEED_PER_S * away
        wish = _TO_ACCELERATION_PER_S * (speed - velocity)
    if levels_out:
        wish[:2] = 0.0
    return np.clip(wish, -_MOST_M_S2, _MOST_M_S2)
