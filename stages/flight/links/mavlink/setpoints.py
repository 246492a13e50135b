"""Set-points as MAVLink messages: axes, masks, limits and slew limits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import LinkError
from alula.stages.flight.links.mavlink.hover import HoverThrottle
from alula.stages.flight.links.options import Limits
from alula.stages.vehicles.frames import LocalFrame, flipped_body
from alula.stages.vehicles.setpoints import RatesSetpoint, Setpoint, VelocitySetpoint

# Bits of type_mask: fields that the vehicle ignores.
RATES_MASK = 128  # SET_ATTITUDE_TARGET: ignores the attitude, uses all three rates and the thrust
_NO_POSITION, _NO_VELOCITY, _NO_ACCELERATION = 0b111, 0b111 << 3, 0b111 << 6
_NO_YAW, _NO_YAW_RATE = 1 << 10, 1 << 11
VELOCITY_MASK = _NO_POSITION | _NO_ACCELERATION | _NO_YAW_RATE
STOP_MASK = VELOCITY_MASK | _NO_YAW
# The position at which an acceleration was computed is in the past when it is flown, and would pull back.
ACCELERATION_MASK = _NO_POSITION | _NO_YAW_RATE
POSITION_MASK = _NO_VELOCITY | _NO_ACCELERATION | _NO_YAW_RATE | _NO_YAW

ATTITUDE_MASK = 0b111  # SET_ATTITUDE_TARGET: ignores the rates
SINK_M_S = 0.5
_SINK_PER_S = 2.0
_BRAKE_PER_S, _BRAKE_M_S2 = 1.2, 2.0  # slow enough for velocities of satellites, which are 0.4 s late
_LOCAL_NED = 1  # MAV_FRAME
_GAP_S = 0.5  # after a longer gap the last set-point does not limit the next
_FIRST_S = 0.02
_FAR_OUT = 2.0  # set-points beyond this multiple of a limit are refused


class SetpointEncoder:
    """Encoder of set-points for one vehicle: checks, clips and slew-limits them and makes messages.

    A set-point that is not finite or beyond twice a limit is refused, with the field's name. One beyond a
    limit or the slew limit is clipped and counted.

    Attributes:
        clipped: number of set-points that were changed by a limit.
    """

    def __init__(
        self, target: tuple[int, int], frame: LocalFrame, limits: Limits, hover: HoverThrottle
    ) -> None:
        self.target, self.frame, self.limits, self.hover = target, frame, limits, hover
        self.clipped = 0
        self._last: tuple[type[Setpoint], float, FloatArray] | None = None

    def encode(self, setpoint: Setpoint, now_s: float, time_ms: int) -> Any:
        """Message of a set-point.

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
        limit = self.limits.speed_m_s
        _check("position", setpoint.position, math.inf)
        velocity = _check("velocity", setpoint.velocity, limit)
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
            velocity=np.clip(velocity, -limit, limit),
            acceleration=acceleration,
            yaw=yaw,
        )

    def stop(self, time_ms: int) -> Any:
        """Message of zero velocity with any heading; it needs no state."""
        self._last = None
        return self._point(time_ms, STOP_MASK)

    def sink(self, velocity_ned: FloatArray, yaw_ned: float, time_ms: int) -> Any:
        """Message of an attitude and a thrust that end a horizontal velocity and descend by 0.5 m/s.

        It needs no position, and of the vehicle's estimate only its attitude and its vertical velocity.

        Args:
            velocity_ned: horizontal as measured by satellites, vertical as estimated, shape (3,) [m/s].
            yaw_ned: heading to keep [rad].
        """
        self._last = None
        gravity = self.hover.gravity_m_s2
        along = -_BRAKE_PER_S * velocity_ned[:2]
        along *= min(1.0, _BRAKE_M_S2 / max(float(np.linalg.norm(along)), 1e-9))
        up = gravity + _SINK_PER_S * (float(velocity_ned[2]) - SINK_M_S)
        up = min(max(up, 0.5 * gravity), 1.5 * gravity)
        cosine, sine = math.cos(yaw_ned), math.sin(yaw_ned)
        ahead = float(cosine * along[0] + sine * along[1])
        right = float(cosine * along[1] - sine * along[0])
        quat = _from_euler(math.atan2(right, up), math.atan2(-ahead, up), yaw_ned)
        low, high = self.limits.throttle
        throttle = min(max(self.hover.throttle(math.hypot(up, ahead, right)), low), high)
        return dialect.MAVLink_set_attitude_target_message(
            time_ms, *self.target, ATTITUDE_MASK, quat, 0.0, 0.0, 0.0, throttle
        )

    def position(self, position_ned: FloatArray, time_ms: int) -> Any:
        """Message of a position with any heading.

        Args:
            position_ned: shape (3,), vehicle's local frame, north-east-down [m].
        """
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
        upper = np.array([high, *limits.rates_rad_s])
        nominal = np.array([throttle, *_check("omega", setpoint.omega, upper[1:])])
        lower = np.array([low, *(-upper[1:])])
        slew = np.array([limits.throttle_slew_per_s, *(3 * [limits.rates_slew_rad_s2])])
        neutral = np.array([self.hover.value, 0.0, 0.0, 0.0])
        values = self._bounded(setpoint, nominal, lower, upper, slew, neutral, now_s)
        roll, pitch, yaw = flipped_body(values[1:])
        return dialect.MAVLink_set_attitude_target_message(
            time_ms, *self.target, RATES_MASK, [1.0, 0.0, 0.0, 0.0], roll, pitch, yaw, float(values[0])
        )

    def _limited(
        self, setpoint: Setpoint, name: str, values: FloatArray, limit: float, slew: float, now_s: float
    ) -> FloatArray:
        nominal = _check(name, values, limit)
        upper = np.full(3, limit)
        return self._bounded(setpoint, nominal, -upper, upper, np.full(3, slew), None, now_s)

    def _bounded(
        self,
        setpoint: Setpoint,
        nominal: FloatArray,
        lower: FloatArray,
        upper: FloatArray,
        slew: FloatArray,
        neutral: FloatArray | None,
        now_s: float,
    ) -> FloatArray:
        """Clip to the limits and slew-limit from the last values; the first start from `neutral`."""
        values: FloatArray = np.clip(nominal, lower, upper)
        last, dt_s = neutral, _FIRST_S
        if self._last is not None and self._last[0] is type(setpoint) and now_s - self._last[1] < _GAP_S:
            last, dt_s = self._last[2], max(now_s - self._last[1], 0.0)
        if last is not None:
            values = np.clip(values, last - slew * dt_s, last + slew * dt_s)
            values = np.clip(values, lower, upper)
        self._last = (type(setpoint), now_s, values)
        self.clipped += bool((values != nominal).any())
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


def _check(name: str, values: Any, limit: Any) -> FloatArray:
    """Check that each component is finite and within twice the limit; raises LinkError."""
    array = np.atleast_1d(np.asarray(values, np.float64))
    if name != "thrust_m_s2" and array.shape != (3,):
        raise LinkError(f"set-point refused: {name} has the shape {array.shape}, not (3,)")
    limits = np.broadcast_to(limit, array.shape)
    for axis, value, bound in zip("xyz", array.tolist(), limits.tolist(), strict=False):
        field = name if len(array) == 1 else f"{name}.{axis}"
        if not math.isfinite(value):
            raise LinkError(f"set-point refused: {field} is {value}")
        if abs(value) > _FAR_OUT * bound:
            raise LinkError(f"set-point refused: {field} is {value:g}, the limit {bound:g}")
    return array


def _from_euler(roll: float, pitch: float, yaw: float) -> list[float]:
    """Quaternion of a vehicle's axes in NED, w first."""
    (a, b, c), (d, e, f) = ([g(each / 2) for each in (roll, pitch, yaw)] for g in (math.cos, math.sin))
    return [
        a * b * c + d * e * f,
        d * b * c - a * e * f,
        a * e * c + d * b * f,
        a * b * f - d * e * c,
    ]
