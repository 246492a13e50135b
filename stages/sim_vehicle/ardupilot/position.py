"""Outer loops: from climb rates, velocities and positions to lean angles and throttle; in NED."""

from __future__ import annotations

import math

from alula.stages.sim_vehicle.ardupilot.attitude import AttitudeControl
from alula.stages.sim_vehicle.ardupilot.parameters import Parameters
from alula.stages.sim_vehicle.ardupilot.pid import Pid
from alula.stages.sim_vehicle.ardupilot.shaping import Profile, largest_error, square_root
from alula.stages.sim_vehicle.common.airframe import TICK_S, Motion
from alula.stages.sim_vehicle.common.quaternions import (
    Quat,
    Vector,
    added,
    from_euler,
    multiply,
    rotate,
    scaled,
    to_euler,
)

_THROTTLE_HZ = 2.0  # low-pass of the throttle that these loops command
_OVERSPEED_GAIN = 2.0  # of acceleration and jerk at the largest vertical speed
_CM = 100.0  # the gains of the vertical acceleration are for cm/s^2 and thousandths of the throttle


class PositionControl:
    """Shaped set-points, and cascades of position, velocity and acceleration that follow them.

    Every command first shapes a motion with at most WPNAV_ACCEL and PSC_JERK_XY, or WPNAV_ACCEL_Z and
    PSC_JERK_Z. Horizontally, the position error gives a velocity (PSC_POSXY_P), the velocity error a
    acceleration (PSC_VELXY_*), and the shaped acceleration is added: lean angles. Vertically, one more loop
    (PSC_ACCZ_*) follows the acceleration by the throttle, which passes a low-pass of 2 Hz.

    Args:
        attitude: the inner loop.
        parameters: gains and limits, read at every tick.
        gravity: g [m/s^2].

    Attributes:
        yaw: commanded heading [rad].
        yaw_rate: commanded yaw rate [rad/s].
    """

    def __init__(self, attitude: AttitudeControl, parameters: Parameters, gravity: float) -> None:
        self._attitude = attitude
        self._parameters = parameters
        self._gravity = gravity
        self._level, self._vertical = Profile(2), Profile(1)  # north and east; down
        self._speed = (Pid(parameters, "PSC_VELXY", 1 / _CM), Pid(parameters, "PSC_VELXY", 1 / _CM))
        self._climb = Pid(parameters, "PSC_VELZ", 1 / _CM)
        self._lift = Pid(parameters, "PSC_ACCZ")
        self._leans_most = False
        self.yaw = 0.0
        self.yaw_rate = 0.0

    def rest(self, motion: Motion) -> None:
        """Start all loops from rest on the ground."""
        self.reset(motion)
        for loop in (*self._speed, self._lift):
            loop.reset()

    def reset(self, motion: Motion) -> None:
        """Start all loops from the present motion and lean."""
        self._level.start(motion.position[:2], motion.velocity[:2])
        up = rotate(self._attitude.target, (0.0, 0.0, -1.0))
        for axis, loop in enumerate(self._speed):
            loop.reset(self._gravity * up[axis] / max(-up[2], 0.1))
        self.reset_vertical(motion)
        self.yaw, self.yaw_rate = to_euler(self._attitude.target)[2], 0.0

    def reset_vertical(self, motion: Motion) -> None:
        """Start the vertical loop from the present climb rate and throttle."""
        limit = self._vertical_limit()
        self._vertical.start(motion.position[2:], motion.velocity[2:])
        self._vertical.acceleration = [max(-limit, min(limit, motion.acceleration[2]))]
        self._climb.reset()
        extra = self._attitude.throttle_command - self._parameters["MOT_THST_HOVER"]
        self._lift.reset(1000 * extra)

    def climb(self, motion: Motion, climb_m_s: float) -> None:
        """Command the throttle for a climb rate, upward [m/s]."""
        self.follow_vertical(motion, -climb_m_s, 0.0)

    def follow_vertical(self, motion: Motion, down_m_s: float, down_m_s2: float) -> None:
        """Command the throttle for a vertical velocity and acceleration.

        Args:
            motion: estimated motion.
            down_m_s: velocity, downward [m/s].
            down_m_s2: acceleration, downward [m/s^2].
        """
        self._vertical.advance()
        limit, jerk = self._vertical_limits()
        self._vertical.to_velocity([down_m_s], (down_m_s2,), limit, jerk)
        self._throttle(motion)

    def height(self, motion: Motion, down_m: float) -> None:
        """Command the throttle for a height, given as the NED coordinate [m]."""
        way = "UP" if down_m < self._vertical.position[0] else "DN"
        speed = self._parameters[f"WPNAV_SPEED_{way}"] / _CM
        self._vertical.advance()
        limit, jerk = self._vertical_limits()
        self._vertical.to_position((down_m,), (0.0,), (0.0,), speed, limit, jerk)
        self._throttle(motion)

    def stay(self, motion: Motion) -> None:
        """Brake horizontally, then hold the position."""
        self.velocity(motion, (0.0, 0.0))

    def velocity(
        self, motion: Motion, velocity: tuple[float, float], ahead: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Command lean angles for a horizontal velocity.

        Args:
            motion: estimated motion.
            velocity: north and east [m/s].
            ahead: acceleration added to it, north and east [m/s^2].
        """
        self._level.advance()
        self._level.to_velocity(list(velocity), ahead, self._level_limit(), self._level_jerk())
        self._lean(motion)

    def point(self, motion: Motion, position: tuple[float, float], max_m_s: float) -> None:
        """Command lean angles for a horizontal position.

        Args:
            motion: estimated motion.
            position: north and east [m].
            max_m_s: maximum speed [m/s].
        """
        zero = (0.0, 0.0)
        self._level.advance()
        self._level.to_position(position, zero, zero, max_m_s, self._level_limit(), self._level_jerk())
        self._lean(motion)

    def track(
        self, motion: Motion, position: Vector | None, velocity: Vector, ahead: Vector
    ) -> tuple[Vector | None, Vector]:
        """Follow a stream of set-points.

        Args:
            motion: estimated motion.
            position: NED [m]; None if the set-point has none.
            velocity: NED [m/s].
            ahead: acceleration, NED [m/s^2].

        Returns:
            Position and velocity of the next tick if no set-point arrives.
        """
        gained = added(velocity, scaled(ahead, TICK_S))
        if position is None:
            self.velocity(motion, velocity[:2], ahead[:2])
            self.follow_vertical(motion, velocity[2], ahead[2])
            return None, gained
        self._level.advance()
        self._vertical.advance()
        top = self._parameters["WPNAV_SPEED"] / _CM
        limit, jerk = self._level_limit(), self._level_jerk()
        self._level.to_position(position[:2], velocity[:2], ahead[:2], top, limit, jerk)
        way = "UP" if position[2] < self._vertical.position[0] else "DN"
        speed = self._parameters[f"WPNAV_SPEED_{way}"] / _CM
        limit, jerk = self._vertical_limits()
        self._vertical.to_position(position[2:], velocity[2:], ahead[2:], speed, limit, jerk)
        self._lean(motion)
        self._throttle(motion)
        return added(position, scaled(velocity, TICK_S)), gained

    def accelerate(self, motion: Motion, acceleration: Vector) -> None:
        """Follow a stream of accelerations, NED [m/s^2]."""
        self._level.advance()
        self._vertical.advance()
        self._level.to_acceleration(list(acceleration[:2]), self._level_jerk())
        self._vertical.to_acceleration(list(acceleration[2:]), self._vertical_limits()[1])
        self._lean(motion)
        self._throttle(motion)

    def _lean(self, motion: Motion) -> None:
        """Follow the shaped horizontal motion by lean angles of at most ANGLE_MAX."""
        gain, limit = self._parameters["PSC_POSXY_P"], self._level_limit()
        most = largest_error(self._parameters["WPNAV_SPEED"] / _CM, gain, limit)
        error = self._level.keep_near(motion.position[:2], most)
        size = math.hypot(*error)
        scale = square_root(size, gain, limit) / size if size > 0 else 0.0
        command = []
        for axis, loop in enumerate(self._speed):
            target = self._level.velocity[axis] + scale * error[axis]
            accelerates = loop.run(target, motion.velocity[axis], held=self._leans_most)
            command.append(self._level.acceleration[axis] + accelerates)
        most = self._gravity * math.tan(math.radians(self._parameters["ANGLE_MAX"] / 100))
        size = math.hypot(*command)
        self._leans_most = size > most
        share = most / size if self._leans_most else 1.0
        self.yaw += self.yaw_rate * TICK_S
        attitude = _leaning(share * command[0], share * command[1], self._gravity, self.yaw)
        self._attitude.input_attitude(attitude, (0.0, 0.0, self.yaw_rate), slews=True)

    def _throttle(self, motion: Motion) -> None:
        """Follow the shaped vertical motion by the throttle."""
        gain, limit = self._parameters["PSC_POSZ_P"], self._vertical_limit()
        speed = self._parameters["WPNAV_SPEED_UP"] / _CM
        error = self._vertical.keep_near(motion.position[2:], largest_error(speed, gain, limit))[0]
        target = self._vertical.velocity[0] + square_root(error, gain, limit)
        held = not 0 < self._attitude.throttle_command < 1
        down = self._vertical.acceleration[0] + self._climb.run(target, motion.velocity[2], held=held)
        lift = self._lift.run(-_CM * down, -_CM * motion.acceleration[2], held=held)
        hover = self._parameters["MOT_THST_HOVER"]
        self._attitude.set_throttle(hover + lift / 1000, cutoff_hz=_THROTTLE_HZ)

    def _level_limit(self) -> float:
        return max(self._parameters["WPNAV_ACCEL"], 10.0) / _CM

    def _level_jerk(self) -> float:
        return max(self._parameters["PSC_JERK_XY"], 0.1)

    def _vertical_limit(self) -> float:
        return max(self._parameters["WPNAV_ACCEL_Z"], 1.0) / _CM

    def _vertical_limits(self) -> tuple[float, float]:
        """Acceleration and jerk; both are higher while the shaped speed is beyond WPNAV_SPEED_UP or _DN."""
        down = self._vertical.velocity[0]
        top = self._parameters["WPNAV_SPEED_DN" if down > 0 else "WPNAV_SPEED_UP"] / _CM
        gain = _OVERSPEED_GAIN * abs(down) / top if abs(down) > top > 0 else 1.0
        return min(gain * self._vertical_limit(), 7.5), gain * max(self._parameters["PSC_JERK_Z"], 0.1)


def _leaning(north_m_s2: float, east_m_s2: float, gravity: float, yaw: float) -> Quat:
    """Attitude with a heading whose thrust gives a horizontal acceleration at constant height."""
    size = math.hypot(north_m_s2, east_m_s2)
    if size < 1e-9:
        return from_euler(0.0, 0.0, yaw)
    half = math.atan2(size, gravity) / 2
    sine = math.sin(half) / size
    return multiply((math.cos(half), sine * east_m_s2, -sine * north_m_s2, 0.0), from_euler(0.0, 0.0, yaw))
