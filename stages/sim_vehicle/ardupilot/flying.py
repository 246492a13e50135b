"""Controllers of the flight modes: from estimate, sticks and set-points to attitude and throttle."""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import Enum

from alula.stages.sim_vehicle.ardupilot.attitude import AttitudeControl
from alula.stages.sim_vehicle.ardupilot.guided import Guided
from alula.stages.sim_vehicle.ardupilot.modes import Mode
from alula.stages.sim_vehicle.ardupilot.position import PositionControl
from alula.stages.sim_vehicle.common.airframe import TICK_S, Motion
from alula.stages.sim_vehicle.common.parameters import Parameters
from alula.stages.sim_vehicle.common.pilot import Pilot
from alula.stages.sim_vehicle.common.quaternions import Vector, from_euler, to_euler

_AT_M = 0.3  # a point is reached within this distance
_LOWEST_RETURN_M = 0.3  # height of a return above home
_SHALLOWEST_CONE = 0.5  # smaller values of RTL_CONE_SLOPE have no effect


class Return(Enum):
    """Phases of RTL, in their order."""

    CLIMB = "climb"
    FLY = "fly"
    WAIT = "wait"
    LAND = "land"


class Flying:
    """Controllers of all modes.

    Args:
        parameters: parameters, read at every tick.

    Attributes:
        home: home position, NED [m].
    """

    def __init__(
        self,
        attitude: AttitudeControl,
        position: PositionControl,
        parameters: Parameters,
        pilot: Pilot,
    ) -> None:
        self.attitude = attitude
        self._parameters = parameters
        self._pilot = pilot
        self.position = position
        self.guided = Guided(attitude, self.position, parameters)
        self.has_position = False
        self.home: Vector = (0.0, 0.0, 0.0)
        self._phase = Return.CLIMB
        self._waited_s = 0.0
        self._height_m = 0.0
        self._rows: dict[Mode, Callable[[Motion, float], None]] = {
            Mode.STABILIZE: self._stabilize,
            Mode.ALT_HOLD: self._alt_hold,
            Mode.GUIDED: lambda motion, _: self.guided.run(motion),
            Mode.LOITER: self._loiter,
            Mode.RTL: self._return,
            Mode.LAND: self._land,
            Mode.BRAKE: self._brake,
            Mode.GUIDED_NOGPS: lambda motion, _: self.guided.run(motion),
        }

    def enter(self, mode: Mode, motion: Motion) -> None:
        """Enter a mode from a motion."""
        self.position.reset(motion)
        self._phase, self._waited_s = Return.CLIMB, 0.0
        self._height_m = self._return_height_m(motion.position)
        self.guided.needs_position = mode is not Mode.GUIDED_NOGPS
        self.guided.enter(motion)

    def _return_height_m(self, position: Vector) -> float:
        """Height above the local origin in which RTL flies level, by its RTL_ parameters."""
        p, above_m = self._parameters, self.home[2] - position[2]
        least_m = max(above_m + max(p["RTL_CLIMB_MIN"], 0.0) / 100, _LOWEST_RETURN_M)
        level_m = max(p["RTL_ALT"] / 100, least_m)
        if p["RTL_CONE_SLOPE"] >= _SHALLOWEST_CONE:
            away_m = math.dist(position[:2], self.home[:2])
            level_m = min(level_m, max(p["RTL_CONE_SLOPE"] * away_m, least_m))
        return level_m - self.home[2]

    def rest(self, motion: Motion) -> None:
        """Rest on the ground: no thrust, integrators reset."""
        self.attitude.reset(motion.attitude)
        self.position.rest(motion)
        self.attitude.set_throttle(0.0)

    def should_leave_ground(self, mode: Mode, now_s: float) -> bool:
        """Return whether a mode commands a vehicle on the ground to leave it."""
        if mode in (Mode.GUIDED, Mode.GUIDED_NOGPS):
            return self.guided.should_leave_ground()
        return mode in (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER) and (
            self._pilot.stick("THROTTLE", now_s) > 0
        )

    def run(self, mode: Mode, motion: Motion, now_s: float) -> None:
        """Run one tick in flight."""
        self._rows[mode](motion, now_s)

    def _stabilize(self, motion: Motion, now_s: float) -> None:
        self._lean_by_sticks(now_s)
        hover = self._parameters["MOT_THST_HOVER"]
        stick = self._pilot.stick("THROTTLE", now_s)
        self.attitude.set_throttle(hover + stick * (1 - hover if stick > 0 else hover))

    def _alt_hold(self, motion: Motion, now_s: float) -> None:
        self._lean_by_sticks(now_s)
        self.position.climb(motion, self._stick_climb(now_s))

    def _loiter(self, motion: Motion, now_s: float) -> None:
        pitch, roll = (self._pilot.stick(name, now_s) for name in ("PITCH", "ROLL"))
        self.position.yaw_rate = self._stick_turn(now_s)
        speed = self._parameters["LOIT_SPEED"] / 100
        if pitch or roll:
            heading = to_euler(motion.attitude)[2]
            cos, sin = math.cos(heading), math.sin(heading)
            self.position.velocity(
                motion, (speed * (-cos * pitch - sin * roll), speed * (-sin * pitch + cos * roll))
            )
        else:
            self.position.stay(motion)
        self.position.climb(motion, self._stick_climb(now_s))

    def _brake(self, motion: Motion, _now_s: float) -> None:
        self.position.stay(motion)
        self.position.climb(motion, 0.0)

    def _land(self, motion: Motion, _now_s: float) -> None:
        if self.has_position:
            self.position.stay(motion)
        else:
            self.attitude.input_attitude(from_euler(0, 0, self.position.yaw))
        self._descend(motion)

    def _return(self, motion: Motion, _now_s: float) -> None:
        north, east, down = motion.position
        away = math.dist((north, east), self.home[:2])
        speed = self._parameters["WPNAV_SPEED"] / 100
        match self._phase:
            case Return.CLIMB:
                self.position.stay(motion)
                self.position.height(motion, -self._height_m)
                if abs(down + self._height_m) < _AT_M:
                    self._phase = Return.FLY
            case Return.FLY:
                self.position.point(motion, self.home[:2], speed)
                self.position.height(motion, -self._height_m)
                if away < _AT_M:
                    self._phase = Return.WAIT
            case Return.WAIT:
                self._waited_s += TICK_S
                self.position.point(motion, self.home[:2], speed)
                self.position.height(motion, -self._height_m)
                if self._waited_s >= self._parameters["RTL_LOIT_TIME"] / 1000:
                    self._phase = Return.LAND
            case Return.LAND:
                self.position.point(motion, self.home[:2], speed)
                self._descend(motion)

    def _descend(self, motion: Motion) -> None:
        slow = self._parameters["LAND_SPEED"] / 100
        fast = max(self._parameters["LAND_SPEED_HIGH"] or self._parameters["WPNAV_SPEED_DN"], 10) / 100
        above = -motion.position[2] - self._parameters["LAND_ALT_LOW"] / 100
        self.position.climb(motion, -(slow if above <= 0 else min(fast, slow + above)))

    def _lean_by_sticks(self, now_s: float) -> None:
        max_lean = math.radians(self._parameters["ANGLE_MAX"] / 100)
        roll, pitch = (self._pilot.stick(name, now_s) * max_lean for name in ("ROLL", "PITCH"))
        self.position.yaw += self._stick_turn(now_s) * TICK_S
        self.attitude.input_attitude(from_euler(roll, pitch, self.position.yaw))

    def _stick_turn(self, now_s: float) -> float:
        return self._pilot.stick("YAW", now_s) * math.radians(self._parameters["ACRO_YAW_RATE"])

    def _stick_climb(self, now_s: float) -> float:
        stick = self._pilot.stick("THROTTLE", now_s)
        up = self._parameters["PILOT_SPEED_UP"]
        return stick * (up if stick > 0 else self._parameters["PILOT_SPEED_DN"] or up) / 100
