"""Set-points for a Crazyflie: full states in 16 bits each, and velocities with a yaw rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import LinkError
from alula.stages.flight.links.options import Limits
from alula.stages.flight.links.protocol import AccelerationSetpoint, VelocitySetpoint
from alula.stages.vehicles.frames import LocalFrame

Triple = tuple[float, float, float]
Quat = tuple[float, float, float, float]

LARGEST = 32.767  # of m, m/s, m/s^2 and rad/s in 16 bits of thousandths

_QUAT_BITS = 9
_QUAT_MAX = (1 << _QUAT_BITS) - 1

LEAD_S = 0.02
_GAP_S = 0.3  # after which the last set-point says nothing about the next
_FIRST_S = 0.01
_JERK_S = 0.05
_LEAST_M_S2 = 1.0  # of thrust: below it the attitude says nothing
_FLAT = 1e-3
_FAR_OUT = 2.0
_TURN_PER_S = 2.0


@dataclass(frozen=True, slots=True)
class FullState:
    """What is sent: in the vehicle's own frame, z up; rates forward-left-up [rad/s]."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    attitude_wxyz: Quat
    omega: Triple


class SetpointEncoder:
    """Checks, clips and slows down set-points, and moves them into the vehicle's frame.

    A full state is flown with the firmware's gains around its position and velocity. Those of an
    `AccelerationSetpoint` are of the moment it was made: here they are taken on by 20 ms (sending, and half
    of the time that it is flown), p + v t + a t^2 / 2 and v + a t; otherwise they would pull back. The
    attitude is that of the thrust a + g with the yaw; the rates are those that turn it as the acceleration
    changes, smoothed over 50 ms.

    Attributes:
        clipped: set-points that did not go out as they came in.
    """

    def __init__(self, frame: LocalFrame, limits: Limits, gravity_m_s2: float) -> None:
        self.frame, self.limits, self._gravity = frame, limits, gravity_m_s2
        self.clipped = 0
        self._last: tuple[float, FloatArray] | None = None
        self._jerk = np.zeros(3)

    def full_state(self, setpoint: AccelerationSetpoint, now_s: float) -> FullState:
        """A full state.

        Raises:
            LinkError: a field is not finite, far out of range, or beyond 16 bits of thousandths.
        """
        limits = self.limits
        _check("position", setpoint.position, math.inf)
        _check("velocity", setpoint.velocity, limits.speed_m_s)
        wish = _check("acceleration", setpoint.acceleration, limits.acceleration_m_s2)
        yaw = _angle(setpoint.yaw_rad) + self.frame.yaw_rad
        most, step = limits.acceleration_m_s2, limits.acceleration_slew_m_s3
        given, dt_s = self._limited(wish, most, step, now_s)
        speed, lead = np.asarray(setpoint.velocity, np.float64), LEAD_S * given
        ahead = setpoint.position + LEAD_S * (speed + 0.5 * lead)
        flown = np.clip(speed + lead, -limits.speed_m_s, limits.speed_m_s)
        moves = self.frame.vector_to_local(np.array([flown, given, self._jerk]))
        push, jerk = moves[1:].tolist()
        quat, omega = self._attitude(push, jerk, yaw, math.isfinite(dt_s))
        sent = FullState(self.frame.position_to_local(ahead), moves[0], moves[1], quat, omega)
        for name, unit in (("position", "m"), ("velocity", "m/s"), ("acceleration", "m/s^2")):
            for axis, value in zip("xyz", getattr(sent, name).tolist(), strict=True):
                if abs(value) > LARGEST:
                    where = f"{name}.{axis} is {value:g} {unit}"
                    raise LinkError(f"set-point refused: {where}; a Crazyflie takes up to {LARGEST}")
        return sent

    def velocity(
        self, setpoint: VelocitySetpoint, yaw_now_rad: float, now_s: float
    ) -> tuple[FloatArray, float]:
        """A velocity in the vehicle's frame [m/s], and the yaw rate towards the heading [degrees/s].

        Raises:
            LinkError: a field is not finite or far out of range.
        """
        limits = self.limits
        wish = _check("velocity", setpoint.velocity, limits.speed_m_s)
        given, _ = self._limited(wish, limits.speed_m_s, limits.speed_slew_m_s2, now_s)
        turn = math.remainder(_angle(setpoint.yaw_rad) - yaw_now_rad, 2 * math.pi)
        most = limits.rates_rad_s[2]
        rate = min(max(_TURN_PER_S * turn, -most), most)
        return self.frame.vector_to_local(given), math.degrees(rate)

    def reset(self) -> None:
        """The last set-point says nothing about the next."""
        self._last = None

    def _limited(self, wish: FloatArray, most: float, slew: float, now_s: float) -> tuple[FloatArray, float]:
        """Within limits and within reach of the last one; and the time since it."""
        values: FloatArray = np.clip(wish, -most, most)
        dt_s = math.inf
        if self._last is not None and now_s - self._last[0] < _GAP_S:
            dt_s = max(now_s - self._last[0], 0.0)
            values = np.clip(values, self._last[1] - slew * dt_s, self._last[1] + slew * dt_s)
            if dt_s > 0:
                share = dt_s / (dt_s + _JERK_S)
                self._jerk += share * ((values - self._last[1]) / dt_s - self._jerk)
        else:
            self._jerk = np.zeros(3)
        self._last = (now_s, values)
        self.clipped += bool((values != wish).any())
        return values, dt_s

    def _attitude(
        self, push: list[float], jerk: list[float], yaw: float, has_jerk: bool
    ) -> tuple[Quat, Triple]:
        """The attitude whose z axis is along a + g, and the rates that turn it with the jerk."""
        zx, zy, zz = push[0], push[1], push[2] + self._gravity
        size = math.sqrt(zx * zx + zy * zy + zz * zz)
        cos, sin = math.cos(yaw), math.sin(yaw)
        if size > _LEAST_M_S2:
            zx, zy, zz = zx / size, zy / size, zz / size
        else:
            zx, zy, zz = 0.0, 0.0, 1.0
        yx, yy, yz = -zz * sin, zz * cos, zx * sin - zy * cos
        norm = math.sqrt(yx * yx + yy * yy + yz * yz)
        if norm < _FLAT:  # it lies along the heading
            zx, zy, zz, yx, yy, yz, norm = 0.0, 0.0, 1.0, -sin, cos, 0.0, 1.0
        yx, yy, yz = yx / norm, yy / norm, yz / norm
        xx, xy, xz = yy * zz - yz * zy, yz * zx - yx * zz, yx * zy - yy * zx
        quat = _quat_wxyz((xx, xy, xz), (yx, yy, yz), (zx, zy, zz))
        if not has_jerk or size <= _LEAST_M_S2:
            return quat, (0.0, 0.0, 0.0)
        roll = -(jerk[0] * yx + jerk[1] * yy + jerk[2] * yz) / size
        pitch = (jerk[0] * xx + jerk[1] * xy + jerk[2] * xz) / size
        most = self.limits.rates_rad_s
        return quat, (min(max(roll, -most[0]), most[0]), min(max(pitch, -most[1]), most[1]), 0.0)


def _quat_wxyz(x: Triple, y: Triple, z: Triple) -> Quat:
    """Of three axes, with w >= 0; numbers, since arrays of four cost ten times as much."""
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


def _check(name: str, values: Any, most: float) -> FloatArray:
    """Finite and not far out, component by component."""
    array = np.asarray(values, np.float64)
    if array.shape != (3,):
        raise LinkError(f"set-point refused: {name} has the shape {array.shape}, not (3,)")
    for axis, value in zip("xyz", array.tolist(), strict=True):
        if not math.isfinite(value):
            raise LinkError(f"set-point refused: {name}.{axis} is {value}")
        if abs(value) > _FAR_OUT * most:
            raise LinkError(f"set-point refused: {name}.{axis} is {value:g}, the limit {most:g}")
    return array


def _angle(value: float) -> float:
    if not math.isfinite(value):
        raise LinkError(f"set-point refused: yaw_rad is {value}")
    return float(value)


def compress_quat_wxyz(quat_wxyz: Sequence[float]) -> int:
    """A unit quaternion in 32 bits.

    The two highest say which of x, y, z, w has the largest magnitude; it is made positive and left out. Of
    the three others, in this order, follow the sign and nine bits of |q| sqrt(2).
    """
    w, x, y, z = map(float, quat_wxyz)
    parts = (x, y, z, w)
    largest = max(range(4), key=lambda i: abs(parts[i]))
    packed = largest
    for i, part in enumerate(parts):
        if i != largest:
            is_negative = (part < 0) != (parts[largest] < 0)
            share = min(abs(part) * math.sqrt(2.0), 1.0)
            packed = packed << (_QUAT_BITS + 1) | is_negative << _QUAT_BITS | int(share * _QUAT_MAX + 0.5)
    return packed


def expand_quat_wxyz(packed: int) -> tuple[float, float, float, float]:
    """The inverse of `compress_quat_wxyz`, exact to 1.4e-3 in each component that was sent."""
    largest = packed >> 30 & 3
    parts = [0.0] * 4
    for i in (3, 2, 1, 0):
        if i != largest:
            share = (packed & _QUAT_MAX) / _QUAT_MAX / math.sqrt(2.0)
            parts[i] = -share if packed >> _QUAT_BITS & 1 else share
            packed >>= _QUAT_BITS + 1
    parts[largest] = math.sqrt(max(0.0, 1.0 - sum(part * part for part in parts)))
    x, y, z, w = parts
    return w, x, y, z
