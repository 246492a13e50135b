"""Set-points as messages of MAVLink: axes, masks, limits and how fast they may change."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import LinkError
from alula.stages.flight.links.hover import HoverThrottle
from alula.stages.flight.links.options import Limits
from alula.stages.flight.links.protocol import (
    RatesSetpoint,
    Setpoint,
    VelocitySetpoint,
)
from alula.stages.vehicles.frames import LocalFrame, flipped_body

# What a message says to ignore.
RATES_MASK = 128  # SET_ATTITUDE_TARGET: the attitude alone: all three rates and the thrust count
_NO_POSITION, _NO_VELOCITY, _NO_ACCELERATION = 0b111, 0b111 << 3, 0b111 << 6
_NO_YAW, _NO_YAW_RATE = 1 << 10, 1 << 11
VELOCITY_MASK = _NO_POSITION | _NO_ACCELERATION | _NO_YAW_RATE
STOP_MASK = VELOCITY_MASK | _NO_YAW
# The position that an acceleration was computed at is past when it is flown: sent along, it would pull back.
ACCELERATION_MASK = _NO_POSITION | _NO_YAW_RATE
POSITION_MASK = _NO_VELOCITY | _NO_ACCELERATION | _NO_YAW_RATE | _NO_YAW

_LOCAL_NED = 1  # MAV_FRAME
_GAP_S = 0.5  # after which the last set-point says nothing about the next
_FIRST_S = 0.02
_FAR_OUT = 2.0  # times a limit


class SetpointEncoder:
    """Checks, clips, slows down and turns set-points into messages for one vehicle.

    Not finite, or beyond twice a limit: refused with the field's name. Beyond the limit: clipped, and
    counted. Faster than the slew limit: brought as far as it goes since the last one.

    Attributes:
        clipped: set-points that did not go out as they came in.
    """

    def __init__(
        self, target: tuple[int, int], frame: LocalFrame, limits: Limits, hover: HoverThrottle
    ) -> None:
        self.target, self.frame, self.limits, self.hover = target, frame, limits, hover
        self.clipped = 0
        self._last: tuple[type[Setpoint], float, FloatArray] | None = None

    def encode(self, setpoint: Setpoint, now_s: float, time_ms: int) -> Any:
        """The message of a set-point.

        Raises:
            LinkError: a field is not finite or far out of range.
        """
        if isinstance(setpoint, RatesSetpoint):
            return self._rates(setpoint, now_s, time_ms)
        yaw = float(setpoint.yaw_rad)
        if not math.isfinite(yaw):
            raise LinkError(f"set-point refused: yaw_rad is {yaw}")
        if isinstance(setpoint, VelocitySetpoint):
            velocity = self._limited(
                setpoint,
                "velocity",
                setpoint.velocity,
                self.limits.speed_m_s,
                self.limits.speed_slew_m_s2,
                now_s,
            )
            return self._point(time_ms, VELOCITY_MASK, velocity=velocity, yaw=yaw)
        most = self.limits.speed_m_s
        _check("position", setpoint.position, math.inf)
        velocity = _check("velocity", setpoint.velocity, most)
        acceleration = self._limited(
            setpoint,
            "acceleration",
            setpoint.acceleration,
            self.limits.acceleration_m_s2,
            self.limits.acceleration_slew_m_s3,
            now_s,
        )
        return self._point(
            time_ms,
            ACCELERATION_MASK,
            velocity=np.clip(velocity, -most, most),
            acceleration=acceleration,
            yaw=yaw,
        )

    def stop(self, time_ms: int) -> Any:
        """Zero velocity, whatever the heading; needs no state."""
        self._last = None
        return self._point(time_ms, STOP_MASK)

    def place(self, position_ned: FloatArray, time_ms: int) -> Any:
        """A position of the vehicle's own local frame, whatever the heading."""
        self._last = None
        _check("position", position_ned, math.inf)
        return self._point(time_ms, POSITION_MASK, position_ned=position_ned)

    def _rates(self, setpoint: RatesSetpoint, now_s: float, time_ms: int) -> Any:
        limits = self.limits
        _check("thrust_m_s2", setpoint.thrust_m_s2, math.inf)
        throttle = self.hover.throttle(float(setpoint.thrust_m_s2))
        low, high = limits.throttle
        if not -high < throttle <= _FAR_OUT * high:
            raise LinkError(
                f"set-point refused: thrust_m_s2 {setpoint.thrust_m_s2:g} is {throttle:.3g} of full"
            )
        most = np.array([high, *limits.rates_rad_s])
        wish = np.array([throttle, *_check("omega", setpoint.omega, most[1:])])
        least = np.array([low, *(-most[1:])])
        slew = np.array([limits.throttle_slew_per_s, *(3 * [limits.rates_slew_rad_s2])])
        neutral = np.array([self.hover.value, 0.0, 0.0, 0.0])
        values = self._bounded(setpoint, wish, least, most, slew, neutral, now_s)
        self.hover.sent(float(values[0]), now_s)
        roll, pitch, yaw = flipped_body(values[1:])
        return dialect.MAVLink_set_attitude_target_message(
            time_ms, *self.target, RATES_MASK, [1.0, 0.0, 0.0, 0.0], roll, pitch, yaw, float(values[0])
        )

    def _limited(
        self, setpoint: Setpoint, name: str, values: FloatArray, most: float, slew: float, now_s: float
    ) -> FloatArray:
        wish = _check(name, values, most)
        edge = np.full(3, most)
        return self._bounded(setpoint, wish, -edge, edge, np.full(3, slew), None, now_s)

    def _bounded(
        self,
        setpoint: Setpoint,
        wish: FloatArray,
        least: FloatArray,
        most: FloatArray,
        slew: FloatArray,
        neutral: FloatArray | None,
        now_s: float,
    ) -> FloatArray:
        """Within limits and within reach of what was sent last; the first is held against `neutral`."""
        values: FloatArray = np.clip(wish, least, most)
        last, dt_s = neutral, _FIRST_S
        if self._last is not None and self._last[0] is type(setpoint) and now_s - self._last[1] < _GAP_S:
            last, dt_s = self._last[2], max(now_s - self._last[1], 0.0)
        if last is not None:
            values = np.clip(values, last - slew * dt_s, last + slew * dt_s)
            values = np.clip(values, least, most)
        self._last = (type(setpoint), now_s, values)
        self.clipped += bool((values != wish).any())
        return values

    def _point(
        self,
        time_ms: int,
        mask: int,
        *,
        position_ned: Any = (0.0, 0.0, 0.0),
        velocity: FloatArray | None = None,
        acceleration: FloatArray | None = None,
        yaw: float | None = None,
    ) -> Any:
        zero = np.zeros(3)
        return dialect.MAVLink_set_position_target_local_ned_message(
            time_ms,
            *self.target,
            _LOCAL_NED,
            mask,
            *map(float, position_ned),
            *(self.frame.vector_to_ned(zero if velocity is None else velocity).tolist()),
            *(self.frame.vector_to_ned(zero if acceleration is None else acceleration).tolist()),
            0.0 if yaw is None else self.frame.yaw_to_ned(yaw),
            0.0,
        )


def _check(name: str, values: Any, most: Any) -> FloatArray:
    """Finite and not far out, component by component."""
    array = np.atleast_1d(np.asarray(values, np.float64))
    if name != "thrust_m_s2" and array.shape != (3,):
        raise LinkError(f"set-point refused: {name} has the shape {array.shape}, not (3,)")
    limits = np.broadcast_to(most, array.shape)
    for axis, value, limit in zip("xyz", array.tolist(), limits.tolist(), strict=False):
        place = name if len(array) == 1 else f"{name}.{axis}"
        if not math.isfinite(value):
            raise LinkError(f"set-point refused: {place} is {value}")
        if abs(value) > _FAR_OUT * limit:
            raise LinkError(f"set-point refused: {place} is {value:g}, the limit {limit:g}")
    return array
