"""Set-points for a Crazyflie, full states and velocities with a yaw rate, and its number formats.

A full state has 16 bits for each number, in thousandths of m, m/s, m/s^2 and rad/s, and 32 for the attitude.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import LinkError
from alula.stages.flight.links.options import Limits
from alula.stages.vehicles.frames import LocalFrame
from alula.stages.vehicles.setpoints import AccelerationSetpoint, VelocitySetpoint

Triple = tuple[float, float, float]
Quat = tuple[float, float, float, float]

LARGEST = 32.767  # largest m, m/s, m/s^2 or rad/s in 16 bits of thousandths


LEAD_S = 0.02
_GAP_S = 0.3  # after a longer gap the last set-point does not limit the next
_JERK_S = 0.05
_MIN_THRUST_M_S2 = 1.0  # below it the attitude is undefined
_FLAT = 1e-3
_FAR_OUT = 2.0
_TURN_PER_S = 2.0


@dataclass(frozen=True, slots=True)
class FullState:
    """A full state as it is sent, in the vehicle's own frame, z up.

    Attributes:
        position: shape (3,) [m].
        velocity: shape (3,) [m/s].
        acceleration: shape (3,) [m/s^2].
        attitude_wxyz: unit quaternion.
        omega: body rates, forward-left-up [rad/s].
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    attitude_wxyz: Quat
    omega: Triple


class SetpointEncoder:
    """Encoder of set-points: checks, clips and slew-limits them, and turns them into the vehicle's frame.

    The firmware tracks the position and velocity of a full state with its own gains. The position and
    velocity of an `AccelerationSetpoint` belong to the time when it was computed. The encoder extrapolates
    them by 20 ms (the delay of sending, and half of the time that the set-point is flown),
    p + v t + a t^2 / 2 and v + a t; otherwise the gains would pull the vehicle back. The attitude is that of
    the thrust a + g with the yaw. The body rates turn it as the acceleration changes, smoothed over 50 ms.

    Attributes:
        clipped: number of set-points that were changed by a limit.
    """

    def __init__(self, frame: LocalFrame, limits: Limits, gravity_m_s2: float) -> None:
        self.frame, self.limits, self._gravity = frame, limits, gravity_m_s2
        self.clipped = 0
        self._last: tuple[float, FloatArray] | None = None
        self._jerk = np.zeros(3)

    def full_state(self, setpoint: AccelerationSetpoint, now_s: float) -> FullState:
        """Full state of an acceleration set-point.

        Raises:
            LinkError: a field is not finite, far out of range, or beyond 16 bits of thousandths.
        """
        limits = self.limits
        _check("position", setpoint.position, math.inf)
        _check("velocity", setpoint.velocity, limits.speed_m_s)
        nominal = _check("acceleration", setpoint.acceleration, limits.acceleration_m_s2)
        yaw = _angle(setpoint.yaw_rad) + self.frame.yaw_rad
        limit, slew = limits.acceleration_m_s2, limits.acceleration_slew_m_s3
        limited, dt_s = self._limited(nominal, limit, slew, now_s)
        speed, lead = np.asarray(setpoint.velocity, np.float64), LEAD_S * limited
        ahead = setpoint.position + LEAD_S * (speed + 0.5 * lead)
        flown = np.clip(speed + lead, -limits.speed_m_s, limits.speed_m_s)
        local = self.frame.vector_to_local(np.array([flown, limited, self._jerk]))
        acceleration, jerk = local[1:].tolist()
        quat, omega = self._attitude(acceleration, jerk, yaw, math.isfinite(dt_s))
        sent = FullState(self.frame.position_to_local(ahead), local[0], local[1], quat, omega)
        for name, unit in (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s^2")):
            for axis, value in zip("xyz", getattr(sent, name).tolist(), strict=True):
                if abs(value) > LARGEST:
                    where = f"{name}.{axis} is {value:g} {unit}"
                    raise LinkError(f"set-point refused: {where}; a Crazyflie takes up to {LARGEST}")
        return sent

    def velocity(
        self, setpoint: VelocitySetpoint, yaw_now_rad: float, now_s: float
    ) -> tuple[FloatArray, float]:
        """Velocity in the vehicle's frame [m/s], and the yaw rate towards the heading [degrees/s].

        Args:
            yaw_now_rad: present heading, world frame [rad].

        Raises:
            LinkError: a field is not finite or far out of range.
        """
        limits = self.limits
        nominal = _check("velocity", setpoint.velocity, limits.speed_m_s)
        limited, _ = self._limited(nominal, limits.speed_m_s, limits.speed_slew_m_s2, now_s)
        turn = math.remainder(_angle(setpoint.yaw_rad) - yaw_now_rad, 2 * math.pi)
        limit = limits.rates_rad_s[2]
        rate = min(max(_TURN_PER_S * turn, -limit), limit)
        return self.frame.vector_to_local(limited), math.degrees(rate)

    def reset(self) -> None:
        """Forget the last set-point: it does not limit the next."""
        self._last = None

    def _limited(
        self, nominal: FloatArray, limit: float, slew: float, now_s: float
    ) -> tuple[FloatArray, float]:
        """Values within the limit and the slew limit, and the time since the last ones [s]."""
        values: FloatArray = np.clip(nominal, -limit, limit)
        dt_s = math.inf
        if self._last is not None and now_s - self._last[0] < _GAP_S:
            dt_s = max(now_s - self._last[0], 0.0)
            values = np.clip(values, self._last[1] - slew * dt_s, self._last[1] + slew * dt_s)
            if dt_s > 0:
                weight = dt_s / (dt_s + _JERK_S)
                self._jerk += weight * ((values - self._last[1]) / dt_s - self._jerk)
        else:
            self._jerk = np.zeros(3)
        self._last = (now_s, values)
        self.clipped += bool((values != nominal).any())
        return values, dt_s

    def _attitude(
        self, acceleration: list[float], jerk: list[float], yaw: float, has_jerk: bool
    ) -> tuple[Quat, Triple]:
        """Attitude with its z axis along a + g, and the body rates that follow from the jerk."""
        zx, zy, zz = acceleration[0], acceleration[1], acceleration[2] + self._gravity
        size = math.sqrt(zx * zx + zy * zy + zz * zz)
        cos, sin = math.cos(yaw), math.sin(yaw)
        if size > _MIN_THRUST_M_S2:
            zx, zy, zz = zx / size, zy / size, zz / size
        else:
            zx, zy, zz = 0.0, 0.0, 1.0
        yx, yy, yz = -zz * sin, zz * cos, zx * sin - zy * cos
        norm = math.sqrt(yx * yx + yy * yy + yz * yz)
        if norm < _FLAT:  # the z axis lies along the heading
            zx, zy, zz, yx, yy, yz, norm = 0.0, 0.0, 1.0, -sin, cos, 0.0, 1.0
        yx, yy, yz = yx / norm, yy / norm, yz / norm
        xx, xy, xz = yy * zz - yz * zy, yz * zx - yx * zz, yx * zy - yy * zx
        quat = _quat_wxyz((xx, xy, xz), (yx, yy, yz), (zx, zy, zz))
        if not has_jerk or size <= _MIN_THRUST_M_S2:
            return quat, (0.0, 0.0, 0.0)
        roll = -(jerk[0] * yx + jerk[1] * yy + jerk[2] * yz) / size
        pitch = (jerk[0] * xx + jerk[1] * xy + jerk[2] * xz) / size
        limit = self.limits.rates_rad_s
        return quat, (min(max(roll, -limit[0]), limit[0]), min(max(pitch, -limit[1]), limit[1]), 0.0)


def _quat_wxyz(x: Triple, y: Triple, z: Triple) -> Quat:
    """Quaternion of three body axes, with w >= 0; plain floats, since small arrays cost ten times as much."""
    squares = (
        1 + x[0] + y[1] + z[2],
        1 + x[0] - y[1] - z[2],
        1 - x[0] + y[1] - z[2],
        1 - x[0] - y[1] + z[2],
    )
    wx, wy, wz = y[2] - z[1], z[0] - x[2], x[1] - y[0]
    xy, xz, yz = x[1] + y[0], x[2] + z[0], y[2] + z[1]
    best = max(range(4), key=squares.__getitem__)
    row = (
        (squares[0], wx, wy, wz),
        (wx, squares[1], xy, xz),
        (wy, xy, squares[2], yz),
        (wz, xz, yz, squares[3]),
    )[best]
    scale = math.copysign(1 / math.sqrt(sum(each * each for each in row)), row[0])
    return row[0] * scale, row[1] * scale, row[2] * scale, row[3] * scale


def _check(name: str, values: Any, limit: float) -> FloatArray:
    """Check that each component is finite and within twice the limit; raises LinkError."""
    array = np.asarray(values, np.float64)
    if array.shape != (3,):
        raise LinkError(f"set-point refused: {name} has the shape {array.shape}, not (3,)")
    for axis, value in zip("xyz", array.tolist(), strict=True):
        if not math.isfinite(value):
            raise LinkError(f"set-point refused: {name}.{axis} is {value}")
        if abs(value) > _FAR_OUT * limit:
            raise LinkError(f"set-point refused: {name}.{axis} is {value:g}, the limit {limit:g}")
    return array


def _angle(value: float) -> float:
    if not math.isfinite(value):
        raise LinkError(f"set-point refused: yaw_rad is {value}")
    return float(value)
