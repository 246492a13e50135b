"""Outer loops of the simulated PX4: velocities and positions to lean angles and throttle; in NED."""

from __future__ import annotations

import math

from alula.stages.sim_vehicle.ardupilot.attitude import AttitudeControl
from alula.stages.sim_vehicle.ardupilot.position import PositionControl
from alula.stages.sim_vehicle.ardupilot.shaping import square_root
from alula.stages.sim_vehicle.common.airframe import TICK_S, Motion
from alula.stages.sim_vehicle.common.parameters import Parameters
from alula.stages.sim_vehicle.common.quaternions import Vector, added, from_euler, scaled, to_euler

_SPEED_GAIN = 2.5  # [1/s]
_SPEED_INTEGRAL = 0.6  # [1/s^2]
_HEIGHT_PER_S = 0.38  # climb rate by the distance from a height, as observed in take-offs [1/s]
_MAX_INTEGRAL = 3.0  # [m/s^2]
_JERK_PER_S = 5.0  # jerk of shaped vertical speeds, divided by their largest acceleration


class Px4PositionControl(PositionControl):
    """Cascades of position (P), velocity (PI) and acceleration, which gives lean angles and throttle.

    Args:
        parameters: gains and limits, read at every tick.
    """

    def __init__(self, attitude: AttitudeControl, parameters: Parameters, gravity: float) -> None:
        super().__init__(attitude, parameters, gravity)
        self._integral = [0.0, 0.0, 0.0]
        self._climb_m_s = 0.0  # shaped, upward
        self._climb_m_s2 = 0.0
        self._ramp_m_s = math.inf  # largest climb rate while it takes off
        self._course = [0.0, 0.0]  # shaped velocity, north and east
        self._hold: Vector | None = None
        self._gained: Vector | None = None  # velocity that accelerations were integrated to

    def rest(self, motion: Motion) -> None:
        """Start all loops from rest on the ground: the take-off begins at no thrust."""
        self.reset(motion)
        self._ramp_m_s = -self._gravity / self._parameters["MPC_Z_VEL_P_ACC"]

    def reset(self, motion: Motion) -> None:
        """Start all loops from the present motion."""
        self._integral = [0.0, 0.0, 0.0]
        self.reset_vertical(motion)
        self._course = list(motion.velocity[:2])
        self.yaw, self.yaw_rate = to_euler(motion.attitude)[2], 0.0
        self._hold = self._gained = None

    def reset_vertical(self, motion: Motion) -> None:
        """Start the vertical loop from the present climb rate."""
        self._integral[2] = 0.0
        self._climb_m_s, self._climb_m_s2 = -motion.velocity[2], 0.0

    def speed_to(self, error: float, limit: float, acceleration: float) -> float:
        """Speed towards a point from which the vehicle can still brake: ArduPilot's square-root law.

        Args:
            error: signed distance to the point [m].
            limit: maximum speed [m/s].
            acceleration: deceleration [m/s^2].
        """
        speed = square_root(error, max(self._parameters["PSC_POSXY_P"], 0.01), acceleration)
        return max(-limit, min(limit, speed))

    def climb(self, motion: Motion, climb_m_s: float) -> None:
        """See `PositionControl`; the climb rate is reached with WPNAV_ACCEL_Z."""
        limit = max(self._parameters["WPNAV_ACCEL_Z"], 1.0) / 100
        command = max(-limit, min(limit, (climb_m_s - self._climb_m_s) / 0.3))
        jerk = _JERK_PER_S * limit * TICK_S
        change = max(-jerk, min(jerk, command - self._climb_m_s2))
        self._climb_m_s2 += change
        self._climb_m_s += self._climb_m_s2 * TICK_S
        self._throttle_for(motion, self._climb_m_s, self._climb_m_s2)

    def follow_vertical(self, motion: Motion, down_m_s: float, down_m_s2: float) -> None:
        """See `PositionControl`; without shaping."""
        self._climb_m_s, self._climb_m_s2 = -down_m_s, 0.0
        self._throttle_for(motion, -down_m_s, -down_m_s2)

    def height(self, motion: Motion, down_m: float) -> None:
        """See `PositionControl`."""
        p = self._parameters
        up, down = (p[f"WPNAV_SPEED_{direction}"] / 100 for direction in ("UP", "DN"))
        self.climb(motion, max(-down, min(up, _HEIGHT_PER_S * (motion.position[2] - down_m))))

    def velocity(
        self, motion: Motion, velocity: tuple[float, float], ahead: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """See `PositionControl`; reached with WPNAV_ACCEL."""
        self._hold = None
        self._fly(motion, velocity, ahead)

    def stay(self, motion: Motion) -> None:
        """Brake horizontally, then hold the position."""
        if self._hold is None and math.hypot(*motion.velocity[:2]) < 0.2:
            self._hold = motion.position
        hold = self._hold
        if hold is None:
            self._fly(motion, (0.0, 0.0), (0.0, 0.0))
        else:
            self.point(motion, hold[:2], 1.0)
            self._hold = hold

    def _fly(self, motion: Motion, velocity: tuple[float, float], ahead: tuple[float, float]) -> None:
        step = max(self._parameters["WPNAV_ACCEL"], 10.0) / 100 * TICK_S
        dx, dy = velocity[0] - self._course[0], velocity[1] - self._course[1]
        size = math.hypot(dx, dy)
        scale = 1.0 if size <= step else step / size
        self._course = [self._course[0] + scale * dx, self._course[1] + scale * dy]
        feed = (ahead[0] + scale * dx / TICK_S, ahead[1] + scale * dy / TICK_S) if size > step else ahead
        self._lean_along(motion, self._course, feed)

    def point(self, motion: Motion, position: tuple[float, float], max_m_s: float) -> None:
        """See `PositionControl`."""
        dx, dy = position[0] - motion.position[0], position[1] - motion.position[1]
        distance = math.hypot(dx, dy)
        acceleration = max(self._parameters["WPNAV_ACCEL"], 10.0) / 100 / 2
        speed = self.speed_to(distance, max_m_s, acceleration)
        scale = 0.0 if distance < 1e-6 else speed / distance
        self.velocity(motion, (scale * dx, scale * dy))

    def track(
        self, motion: Motion, position: Vector | None, velocity: Vector, ahead: Vector
    ) -> tuple[Vector | None, Vector]:
        """See `PositionControl`; without shaping, and the same position and velocity remain."""
        gain = self._parameters["PSC_POSXY_P"]
        command = list(velocity)
        if position is not None:
            command = [
                v + gain * (p - q) for v, p, q in zip(velocity, position, motion.position, strict=True)
            ]
        self._course = command[:2]
        self._lean_along(motion, self._course, ahead[:2])
        self.follow_vertical(motion, command[2], ahead[2])
        self._hold = self._gained = None
        return position, velocity

    def accelerate(self, motion: Motion, acceleration: Vector) -> None:
        """Follow a stream of accelerations, NED [m/s^2]."""
        gained = added(self._gained or motion.velocity, scaled(acceleration, TICK_S))
        self.track(motion, None, gained, acceleration)
        self._gained = gained

    def lean_for(self, motion: Motion, north_m_s2: float, east_m_s2: float) -> None:
        """Command lean angles for a horizontal acceleration, at most ANGLE_MAX, and turn with the yaw rate.

        Args:
            north_m_s2: acceleration to the north [m/s^2].
            east_m_s2: acceleration to the east [m/s^2].
        """
        limit = self._gravity * math.tan(math.radians(self._parameters["ANGLE_MAX"] / 100))
        size = math.hypot(north_m_s2, east_m_s2)
        scale = 1.0 if size <= limit else limit / size
        self.yaw += self.yaw_rate * TICK_S
        heading = to_euler(motion.attitude)[2]
        cos, sin = math.cos(heading), math.sin(heading)
        forward = scale * (cos * north_m_s2 + sin * east_m_s2)
        right = scale * (cos * east_m_s2 - sin * north_m_s2)
        pitch = math.atan2(-forward, self._gravity)
        roll = math.atan2(right * math.cos(pitch), self._gravity)
        self._attitude.input_attitude(from_euler(roll, pitch, self.yaw))

    def _lean_along(self, motion: Motion, course: list[float], ahead: tuple[float, ...]) -> None:
        command = []
        for axis in range(2):
            error = course[axis] - motion.velocity[axis]
            self._integrate(axis, error)
            command.append(ahead[axis] + _SPEED_GAIN * error + self._integral[axis])
        self.lean_for(motion, *command)

    def _throttle_for(self, motion: Motion, climb_m_s: float, climb_m_s2: float) -> None:
        climb_m_s, climb_m_s2 = self._ramped(climb_m_s, climb_m_s2)
        error = climb_m_s + motion.velocity[2]
        self._integrate(2, error)
        up = climb_m_s2 + 2 * _SPEED_GAIN * error + self._integral[2]
        hover = self._parameters["MOT_THST_HOVER"]
        self._attitude.set_throttle(hover * (1 + up / self._gravity))

    def _ramped(self, climb_m_s: float, climb_m_s2: float) -> tuple[float, float]:
        """Climb rate and acceleration within the ramp of a take-off, MPC_TKO_RAMP_T to MPC_TKO_SPEED."""
        top_m_s = self._parameters["WPNAV_SPEED_UP"] / 100
        if self._ramp_m_s >= top_m_s:
            return climb_m_s, climb_m_s2
        rise_m_s = top_m_s + self._gravity / self._parameters["MPC_Z_VEL_P_ACC"]
        self._ramp_m_s += rise_m_s * TICK_S / max(self._parameters["TKOFF_SLEW_TIME"], TICK_S)
        if self._ramp_m_s < 0:
            self._integral[2] = 0.0  # still on the ground
        return (self._ramp_m_s, 0.0) if climb_m_s > self._ramp_m_s else (climb_m_s, climb_m_s2)

    def _integrate(self, axis: int, error: float) -> None:
        grown = self._integral[axis] + _SPEED_INTEGRAL * error * TICK_S
        self._integral[axis] = max(-_MAX_INTEGRAL, min(_MAX_INTEGRAL, grown))
