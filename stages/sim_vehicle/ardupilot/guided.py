"""The mode GUIDED: accepted set-points, their interpretation with its pitfalls, and their control."""

from __future__ import annotations

import math
from enum import Enum

from alula.stages.sim_vehicle.ardupilot.attitude import AttitudeControl
from alula.stages.sim_vehicle.ardupilot.position import PositionControl
from alula.stages.sim_vehicle.common.airframe import TICK_S, Motion
from alula.stages.sim_vehicle.common.packets import Message, mavlink
from alula.stages.sim_vehicle.common.parameters import Parameters
from alula.stages.sim_vehicle.common.quaternions import (
    Quat,
    Vector,
    added,
    from_euler,
    rotate,
    to_euler,
    unit,
)

THRUST_AS_THRUST = 8  # bit of GUID_OPTIONS
_RATE_BITS, _THRUST_BIT, _ATTITUDE_BIT = 0b111, 64, 128
_POSITION_BITS, _VELOCITY_BITS, _ACCELERATION_BITS = 0b111, 0b111 << 3, 0b111 << 6
_FORCE_BIT, _YAW_BIT, _YAW_RATE_BIT = 1 << 9, 1 << 10, 1 << 11


class Sub(Enum):
    """Sub-mode of GUIDED."""

    VELOCITY = "velocity"  # also with acceleration and position
    POINT = "point"
    ANGLE = "angle"
    TAKE_OFF = "take off"


class Guided:
    """Controller of the mode that follows set-points.

    An unsupported message re-initialises the mode: the vehicle brakes and holds. GUID_TIMEOUT after the last
    set-point the command becomes a level attitude without climb, or zero velocity. Until then the last
    set-point stays in force.

    Args:
        parameters: parameters, read at every tick.

    Attributes:
        needs_position: True for GUIDED, False for GUIDED_NOGPS, which follows attitudes only.
        rejected: number of set-points that re-initialised the mode.
        speed_m_s: speed from MAV_CMD_DO_CHANGE_SPEED [m/s]; None for the default.
    """

    def __init__(self, attitude: AttitudeControl, position: PositionControl, parameters: Parameters) -> None:
        self._attitude = attitude
        self._position = position
        self._parameters = parameters
        self.sub = Sub.VELOCITY
        self.needs_position = True
        self.rejected = 0
        self._silent_s = 0.0
        self._target: Quat | None = None
        self._omega: Vector = (0.0, 0.0, 0.0)
        self._thrust = 0.0  # throttle 0 to 1, or a climb rate [m/s]
        self._is_thrust = False
        self._point: Vector | None = None
        self._velocity: Vector = (0.0, 0.0, 0.0)
        self._acceleration: Vector = (0.0, 0.0, 0.0)
        self._is_streamed = self._accelerates = False
        self._climbing_s = 0.0  # since the take-off began
        self.speed_m_s: float | None = None

    def enter(self, motion: Motion) -> None:
        """Enter or re-initialise the mode: brake."""
        self.sub, self._is_streamed, self._point = Sub.VELOCITY, False, None
        self._velocity = self._acceleration = (0.0, 0.0, 0.0)
        self._silent_s = 0.0
        self._position.reset(motion)
        if not self.needs_position:
            self.sub, self._is_thrust, self._thrust = Sub.ANGLE, False, 0.0
            self._target, self._omega = from_euler(0, 0, to_euler(motion.attitude)[2]), (0.0, 0.0, 0.0)

    def take_off(self, motion: Motion, height_m: float) -> None:
        """Climb straight up.

        Args:
            height_m: height above the local origin [m].
        """
        self._position.reset(motion)
        self.sub, self._point = Sub.TAKE_OFF, (*motion.position[:2], -height_m)
        self._climbing_s = 0.0

    def go_to(self, motion: Motion, point: Vector) -> None:
        """Fly to a point with shaped speeds, and stay there.

        Args:
            point: NED [m].
        """
        if self.sub is not Sub.POINT:
            self._position.reset(motion)
        self.sub, self._point = Sub.POINT, point

    def is_taking_off(self, motion: Motion) -> bool:
        """Return whether it is still below the height of its take-off."""
        return (
            self.sub is Sub.TAKE_OFF and self._point is not None and motion.position[2] > self._point[2] + 0.5
        )

    @property
    def target(self) -> tuple[int, Vector, Vector, Vector] | None:
        """Mask, position, velocity and acceleration that are followed, NED; None for attitude set-points."""
        zero = (0.0, 0.0, 0.0)
        if self.sub is Sub.ANGLE:
            return None
        ignored = _FORCE_BIT | _YAW_BIT | _YAW_RATE_BIT
        if self.sub is not Sub.VELOCITY:
            ignored |= _VELOCITY_BITS | _ACCELERATION_BITS
            return ignored, self._point or zero, zero, zero
        ignored |= _POSITION_BITS if self._point is None else 0
        return ignored, self._point or zero, self._velocity, self._acceleration

    @property
    def flies_rates(self) -> bool:
        """Return whether the newest set-point is one of body rates."""
        return self.sub is Sub.ANGLE and self._target is None

    def should_leave_ground(self) -> bool:
        """Return whether the set-point commands a vehicle on the ground to leave it."""
        match self.sub:
            case Sub.TAKE_OFF:
                return True
            case Sub.ANGLE:
                return self._thrust > 0
            case Sub.POINT:
                return self._point is not None and self._point[2] < -0.3
            case Sub.VELOCITY:
                return self._velocity[2] < 0 or self._acceleration[2] < 0

    def attitude_target(self, message: Message, motion: Motion) -> None:
        """Process a SET_ATTITUDE_TARGET."""
        mask = message.type_mask
        rates = mask & _RATE_BITS
        quat: Quat | None = None
        if not mask & _ATTITUDE_BIT:
            length = sum(c * c for c in message.q)
            if not math.isfinite(length) or abs(length - 1) > 1e-2:
                return self._reject(motion)
            quat = unit(tuple(message.q))
        if mask & _THRUST_BIT or rates not in (0, _RATE_BITS) or (quat is None and rates):
            return self._reject(motion)
        omega = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
        if not all(map(math.isfinite, omega)):
            return self._reject(motion)
        is_thrust = bool(self._parameters.whole("GUID_OPTIONS") & THRUST_AS_THRUST)
        if self.sub is not Sub.ANGLE or (self._is_thrust and not is_thrust):
            self._position.reset(motion)
        self.sub, self._silent_s = Sub.ANGLE, 0.0
        self._target, self._omega, self._is_thrust = quat, omega if not rates else (0.0, 0.0, 0.0), is_thrust
        if is_thrust:
            self._thrust = _constrained(message.thrust, -1.0, 1.0)
            return None
        climb = 2 * (_constrained(message.thrust, 0.0, 1.0) - 0.5)
        direction = "UP" if climb > 0 else "DN"
        self._thrust = climb * self._parameters[f"WPNAV_SPEED_{direction}"] / 100
        return None

    def position_target(self, message: Message, motion: Motion) -> None:
        """Process a SET_POSITION_TARGET_LOCAL_NED; GUIDED_NOGPS ignores it."""
        if not self.needs_position:
            return None
        mask, frame = message.type_mask, message.coordinate_frame
        body = frame in (mavlink.MAV_FRAME_BODY_NED, mavlink.MAV_FRAME_BODY_OFFSET_NED)
        offset = frame in (
            mavlink.MAV_FRAME_LOCAL_OFFSET_NED,
            mavlink.MAV_FRAME_BODY_NED,
            mavlink.MAV_FRAME_BODY_OFFSET_NED,
        )
        position = None if mask & _POSITION_BITS else (message.x, message.y, message.z)
        velocity = None if mask & _VELOCITY_BITS else (message.vx, message.vy, message.vz)
        acceleration = None if mask & _ACCELERATION_BITS else (message.afx, message.afy, message.afz)
        given = [v for v in (position, velocity, acceleration) if v is not None]
        known = frame == mavlink.MAV_FRAME_LOCAL_NED or offset
        finite = all(math.isfinite(c) for v in given for c in v)
        is_force = bool(mask & _FORCE_BIT) and acceleration is not None
        if not known or is_force or not given or not finite:
            return self._reject(motion)
        if position is not None and velocity is None and acceleration is not None:
            return self._reject(motion)
        turn = from_euler(0, 0, to_euler(motion.attitude)[2]) if body else (1.0, 0.0, 0.0, 0.0)
        if position is not None:
            position = rotate(turn, position)
            if offset:
                position = added(position, motion.position)
        if position is not None and velocity is None:
            self.go_to(motion, position)
            return self._set_yaw(message, mask, motion, body)
        if self.sub is not Sub.VELOCITY:
            self._position.reset(motion)
        self._set_yaw(message, mask, motion, body)
        zero = (0.0, 0.0, 0.0)
        self.sub, self._silent_s, self._is_streamed, self._point = Sub.VELOCITY, 0.0, True, position
        self._velocity = zero if velocity is None else rotate(turn, velocity)
        self._acceleration = zero if acceleration is None else rotate(turn, acceleration)
        self._accelerates = velocity is None
        return None

    def run(self, motion: Motion) -> None:
        """Run one tick: command attitude and throttle."""
        self._silent_s += TICK_S
        silent = self._silent_s > self._parameters["GUID_TIMEOUT"]
        match self.sub:
            case Sub.ANGLE:
                self._run_angle(motion, silent)
            case Sub.VELOCITY:
                self._run_velocity(motion, silent)
            case Sub.POINT | Sub.TAKE_OFF:
                assert self._point is not None
                max_speed = self.speed_m_s or self._parameters["WPNAV_SPEED"] / 100
                self._position.point(motion, self._point[:2], max_speed)
                self._climbing_s += TICK_S
                throttle = self._climbing_s / max(self._parameters["TKOFF_SLEW_TIME"], 0.25)
                if self.sub is Sub.TAKE_OFF and throttle < self._parameters["MOT_THST_HOVER"]:
                    self._position.reset_vertical(motion)
                    self._attitude.set_throttle(throttle)
                else:
                    self._position.height(motion, self._point[2])

    def _run_angle(self, motion: Motion, silent: bool) -> None:
        if silent:
            if self._is_thrust:
                self._position.reset_vertical(motion)
            yaw = to_euler(self._attitude.target)[2]
            self._target, self._omega = from_euler(0, 0, yaw), (0.0, 0.0, 0.0)
            self._thrust, self._is_thrust = 0.0, False
        if self._target is None:
            self._attitude.input_rates(self._omega)
        else:
            self._attitude.input_attitude(self._target, self._omega)
        if self._is_thrust:
            self._attitude.set_throttle(self._thrust)
        else:
            self._position.climb(motion, self._thrust)

    def _run_velocity(self, motion: Motion, silent: bool) -> None:
        if silent and self._is_streamed:
            self._is_streamed, self._point = False, None
            self._velocity = self._acceleration = (0.0, 0.0, 0.0)
            self._position.yaw_rate = 0.0
        if self._is_streamed:
            if self._accelerates:
                self._position.accelerate(motion, self._acceleration)
                return
            point, velocity, ahead = self._point, self._velocity, self._acceleration
            self._point, self._velocity = self._position.track(motion, point, velocity, ahead)
            return
        self._position.stay(motion)
        self._position.climb(motion, 0.0)

    def _set_yaw(self, message: Message, mask: int, motion: Motion, body: bool) -> None:
        heading = to_euler(motion.attitude)[2]
        if not mask & _YAW_BIT and math.isfinite(message.yaw):
            self._position.yaw = message.yaw + (heading if body else 0.0)
        self._position.yaw_rate = 0.0
        if not mask & _YAW_RATE_BIT and math.isfinite(message.yaw_rate):
            self._position.yaw_rate = message.yaw_rate

    def _reject(self, motion: Motion) -> None:
        self.rejected += 1
        self.enter(motion)


def _constrained(value: float, low: float, high: float) -> float:
    """Clip as ArduPilot does: NaN becomes the middle of the range, which for a thrust is zero."""
    return (low + high) / 2 if math.isnan(value) else max(low, min(high, value))
