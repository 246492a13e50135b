"""Outer loops: from climb rates, velocities and positions to lean angles and throttle; in NED."""

from __future__ import annotations

import math

from alula.stages.sim_vehicle.ardupilot.attitude import AttitudeControl
from alula.stages.sim_vehicle.ardupilot.pid import Pid
from alula.stages.sim_vehicle.ardupilot.shaping import (
    LevelProfile,
    VerticalProfile,
    largest_error,
    square_root,
)
from alula.stages.sim_vehicle.common.airframe import TICK_S, Motion
from alula.stages.sim_vehicle.common.parameters import Parameters
from alula.stages.sim_vehicle.common.quaternions import (
    Quat,
    Vector,
    added,
    from_heading,
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
        parameters: gains and limits, read at every tick.
    """

    def __init__(self, attitude: AttitudeControl, parameters: Parameters, gravity: float) -> None:
        self._attitude = attitude
        self._parameters = parameters
        self._gravity = gravity
        self._level, self._vertical = LevelProfile(), VerticalProfile()
        self._speed = (Pid(parameters, "PSC_VELXY", 1 / _CM), Pid(parameters, "PSC_VELXY", 1 / _CM))
        self._climb = Pid(parameters, "PSC_VELZ", 1 / _CM)
        self._lift = Pid(parameters, "PSC_ACCZ")
        self._leans_most = False
        self.yaw = 0.0
        self.yaw_rate = 0.0
        parameters.follow(self._tune)

    def _tune(self) -> None:
        p = self._parameters
        self._hover = p["MOT_THST_HOVER"]
        self._top_level, self._top_up, self._top_down = (
            p[f"WPNAV_SPEED{way}"] / _CM for way in ("", "_UP", "_DN")
        )
        self._level_gain, self._vertical_gain = p["PSC_POSXY_P"], p["PSC_POSZ_P"]
        self._level_limit = max(p["WPNAV_ACCEL"], 10.0) / _CM
        self._level_jerk = max(p["PSC_JERK_XY"], 0.1)
        self._vertical_limit = max(p["WPNAV_ACCEL_Z"], 1.0) / _CM
        self._vertical_jerk = max(p["PSC_JERK_Z"], 0.1)
        self._level_error = largest_error(self._top_level, self._level_gain, self._level_limit)
        self._vertical_error = largest_error(self._top_up, self._vertical_gain, self._vertical_limit)
        self._most_level = self._gravity * math.tan(math.radians(p["PSC_ANGLE_MAX"] or p["ANGLE_MAX"] / 100))

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
        limit = self._vertical_limit
        self._vertical.start(motion.position[2], motion.velocity[2])
        self._vertical.acceleration = max(-limit, min(limit, motion.acceleration[2]))
        self._climb.reset()
        extra = self._attitude.throttle_command - self._hover
        self._lift.reset(1000 * extra)

    def climb(self, motion: Motion, climb_m_s: float) -> None:
        """Command the throttle for a climb rate, upward [m/s]."""
        self.follow_vertical(motion, -climb_m_s, 0.0)

    def follow_vertical(self, motion: Motion, down_m_s: float, down_m_s2: float) -> None:
        """Command the throttle for a vertical velocity and acceleration.

        Args:
            down_m_s: velocity, downward [m/s].
            down_m_s2: acceleration, downward [m/s^2].
        """
        self._vertical.advance()
        limit, jerk = self._vertical_limits()
        self._vertical.to_velocity(down_m_s, down_m_s2, limit, jerk)
        self._throttle(motion)

    def height(self, motion: Motion, down_m: float) -> None:
        """Command the throttle for a height, given as the NED coordinate [m]."""
        goes_up = down_m < self._vertical.position
        self._vertical.advance()
        limit, jerk = self._vertical_limits()
        speed = self._top_up if goes_up else self._top_down
        self._vertical.to_position(down_m, 0.0, 0.0, speed, limit, jerk)
        self._throttle(motion)

    def stay(self, motion: Motion) -> None:
        """Brake horizontally, then hold the position."""
        self.velocity(motion, (0.0, 0.0))

    def velocity(
        self, motion: Motion, velocity: tuple[float, float], ahead: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Command lean angles for a horizontal velocity.

        Args:
            velocity: north and east [m/s].
            ahead: acceleration added to it, north and east [m/s^2].
        """
        self._level.advance()
        self._level.to_velocity(velocity, ahead, self._level_limit, self._level_jerk)
        self._lean(motion)

    def point(self, motion: Motion, position: tuple[float, float], max_m_s: float) -> None:
        """Command lean angles for a horizontal position.

        Args:
            position: north and east [m].
        """
        zero = (0.0, 0.0)
        self._level.advance()
        self._level.to_position(position, zero, zero, max_m_s, self._level_limit, self._level_jerk)
        self._lean(motion)

    def track(
        self, motion: Motion, position: Vector | None, velocity: Vector, ahead: Vector
    ) -> tuple[Vector | None, Vector]:
        """Follow a stream of set-points.

        Args:
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
        top, limit, jerk = self._top_level, self._level_limit, self._level_jerk
        self._level.to_position(position[:2], velocity[:2], ahead[:2], top, limit, jerk)
        speed = self._top_up if position[2] < self._vertical.position else self._top_down
        limit, jerk = self._vertical_limits()
        self._vertical.to_position(position[2], velocity[2], ahead[2], speed, limit, jerk)
        self._lean(motion)
        self._throttle(motion)
        return added(position, scaled(velocity, TICK_S)), gained

    def accelerate(self, motion: Motion, acceleration: Vector) -> None:
        """Follow a stream of accelerations, NED [m/s^2]."""
        self._level.advance()
        self._vertical.advance()
        self._level.to_acceleration(acceleration[:2], self._level_jerk)
        self._vertical.to_acceleration(acceleration[2], self._vertical_limits()[1])
        self._lean(motion)
        self._throttle(motion)

    def _lean(self, motion: Motion) -> None:
        """Follow the shaped horizontal motion by lean angles of at most ANGLE_MAX."""
        level, (north, east, _) = self._level, motion.velocity
        x, y = level.keep_near(motion.position[:2], self._level_error)
        size = math.hypot(x, y)
        scale = square_root(size, self._level_gain, self._level_limit) / size if size > 0 else 0.0
        (u, v), (a, b), (along_north, along_east) = level.velocity, level.acceleration, self._speed
        a += along_north.run(u + scale * x, north, held=self._leans_most)
        b += along_east.run(v + scale * y, east, held=self._leans_most)
        size, most = math.hypot(a, b), self._most_level
        self._leans_most = size > most
        share = most / size if self._leans_most else 1.0
        self.yaw += self.yaw_rate * TICK_S
        attitude = _leaning(share * a, share * b, self._gravity, self.yaw)
        self._attitude.input_attitude(attitude, (0.0, 0.0, self.yaw_rate), slews=True)

    def _throttle(self, motion: Motion) -> None:
        vertical = self._vertical
        error = vertical.keep_near(motion.position[2], self._vertical_error)
        target = vertical.velocity + square_root(error, self._vertical_gain, self._vertical_limit)
        held = not 0 < self._attitude.throttle_command < 1
        down = vertical.acceleration + self._climb.run(target, motion.velocity[2], held=held)
        lift = self._lift.run(-_CM * down, -_CM * motion.acceleration[2], held=held)
        self._attitude.set_throttle(self._hover + lift / 1000, cutoff_hz=_THROTTLE_HZ)

    def _vertical_limits(self) -> tuple[float, float]:
        """Acceleration and jerk; both are higher while the shaped speed is beyond WPNAV_SPEED_UP or _DN."""
        down = self._vertical.velocity
        top = self._top_down if down > 0 else self._top_up
        gain = _OVERSPEED_GAIN * abs(down) / top if abs(down) > top > 0 else 1.0
        return min(gain * self._vertical_limit, 7.5), gain * self._vertical_jerk


def _leaning(north_m_s2: float, east_m_s2: float, gravity: float, yaw: float) -> Quat:
    """Attitude with a heading whose thrust gives a horizontal acceleration at constant height."""
    size = math.hypot(north_m_s2, east_m_s2)
    if size < 1e-9:
        return from_heading(yaw)
    half = math.atan2(size, gravity) / 2
    sine = math.sin(half) / size
    w, x, y = math.cos(half), sine * east_m_s2, -sine * north_m_s2
    turn, _, _, about_z = from_heading(yaw)
    return w * turn, x * turn + y * about_z, y * turn - x * about_z, w * about_z
