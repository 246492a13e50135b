"""Set-points for a Crazyflie: full states in 16 bits each, and velocities with a yaw rate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import LinkError
from alula.stages.flight.frames import LocalFrame
from alula.stages.flight.links.crazyflie_numbers import LARGEST
from alula.stages.flight.links.options import Limits
from alula.stages.flight.links.protocol import AccelerationSetpoint, VelocitySetpoint
from alula.stages.rotation import quat_wxyz_from_matrix

FloatArray = NDArray[np.float64]

LEAD_S = 0.02
_GAP_S = 0.3  # after which the last set-point says nothing about the next
_FIRST_S = 0.01
_JERK_S = 0.05
_LEAST_M_S2 = 1.0  # of thrust: below it the attitude says nothing
_FAR_OUT = 2.0
_TURN_PER_S = 2.0


@dataclass(frozen=True, slots=True)
class FullState:
    """What is sent: in the vehicle's own frame, z up; rates forward-left-up [rad/s]."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    attitude_wxyz: FloatArray
    omega: FloatArray


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
        lead = np.asarray(setpoint.velocity, np.float64) + LEAD_S * given
        speed = np.clip(lead, -limits.speed_m_s, limits.speed_m_s)
        ahead = setpoint.position + LEAD_S * (np.asarray(setpoint.velocity) + 0.5 * LEAD_S * given)
        acceleration = self.frame.vector_to_local(given)
        axes, omega = self._attitude(acceleration, yaw, dt_s)
        sent = FullState(
            self.frame.position_to_local(ahead),
            self.frame.vector_to_local(speed),
            acceleration,
            quat_wxyz_from_matrix(axes),
            omega,
        )
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

    def _attitude(self, acceleration: FloatArray, yaw: float, dt_s: float) -> tuple[FloatArray, FloatArray]:
        """Axes of the body as columns, and its rates."""
        thrust = acceleration + np.array([0.0, 0.0, self._gravity])
        size = math.sqrt(float(thrust @ thrust))
        heading = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        z = thrust / size if size > _LEAST_M_S2 else np.array([0.0, 0.0, 1.0])
        y = np.cross(z, heading)
        norm = math.sqrt(float(y @ y))
        if norm < 1e-3:  # it lies along the heading
            z, y, norm = np.array([0.0, 0.0, 1.0]), np.array([-heading[1], heading[0], 0.0]), 1.0
        y = y / norm
        x = np.cross(y, z)
        omega = np.zeros(3)
        if math.isfinite(dt_s) and size > _LEAST_M_S2:
            jerk = self.frame.vector_to_local(self._jerk)
            most = np.array(self.limits.rates_rad_s)
            omega = np.clip(np.array([-(jerk @ y), jerk @ x, 0.0]) / size, -most, most)
        return np.stack([x, y, z], axis=1), omega


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
