"""High-level commander of the simulated Crazyflie: smooth trajectories to a height or a position."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import Enum

import numpy as np

from alula.schemas.arrays import FloatArray

_STOP, _GO_TO, _TAKE_OFF, _LAND, _LAND_BY_SPEED, _GO_TO_2 = 3, 4, 7, 8, 10, 12
_BUSY, _UNKNOWN = 1, 8
_FARTHEST = 1000.0  # maximum of positions [m] and durations [s]
_FORMATS = {_TAKE_OFF: "<Bff?f", _LAND: "<Bff?f", _GO_TO: "<BBfffff", _GO_TO_2: "<BBBfffff"}
_FORMATS[_LAND_BY_SPEED] = "<Bf?f?f"
_LANDING_M_S = 0.5  # of a landing by speed that states none


class Plan(Enum):
    """State of the commander."""

    IDLE = "idle"  # commands the motors off
    FLYING = "flying"
    LANDING = "landing"


@dataclass(frozen=True, slots=True)
class Goal:
    """A point of the trajectory.

    Attributes:
        position: shape (3,) [m].
        velocity: shape (3,) [m/s].
        acceleration: shape (3,) [m/s^2].
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    yaw_rad: float


def _ends(time: float) -> FloatArray:
    """Matrix from the coefficients of a polynomial of degree 7 to its value and three derivatives."""
    rows = np.zeros((4, 8))
    for order in range(4):
        for power in range(order, 8):
            rows[order, power] = math.perm(power, order) * time ** (power - order)
    return rows


_FROM_ENDS = np.linalg.inv(np.concatenate([_ends(0.0), _ends(1.0)]))


class Planner:
    """Plans polynomials of degree 7 from the present motion to rest at a goal, without jerk at the ends."""

    def __init__(self) -> None:
        self.plan = Plan.IDLE
        self._begin_s, self._duration_s = 0.0, 1.0
        self._coefficients = np.zeros((8, 4))  # of x, y, z, yaw over the fraction of the duration

    def receive(self, data: bytes, here: Goal, now_s: float) -> int:
        """Execute a command.

        Returns:
            0, or an error number.
        """
        command, rest = data[0], data[1:]
        if command in _FORMATS and len(rest) == struct.calcsize(_FORMATS[command]):
            values = struct.unpack(_FORMATS[command], rest)
            if not all(map(math.isfinite, values)) or max(map(abs, values)) > _FARTHEST:
                return _UNKNOWN
        elif command != _STOP:
            return _UNKNOWN
        if command == _STOP:
            self.plan = Plan.IDLE
        elif command in (_TAKE_OFF, _LAND, _LAND_BY_SPEED):
            if command == _LAND_BY_SPEED:
                _, height, is_relative, yaw, keeps, speed = values
                height = here.position[2] - height if is_relative else height
                duration = abs(height - here.position[2]) / (speed if speed > 0 else _LANDING_M_S)
            else:
                _, height, yaw, keeps, duration = values
            if command == _TAKE_OFF and self.plan is not Plan.IDLE:
                return _BUSY
            if command != _TAKE_OFF and self.plan is Plan.LANDING:
                return _BUSY
            still = Goal(here.position, np.zeros(3), np.zeros(3), here.yaw_rad)
            end = np.array([*here.position[:2], height])
            self._go(still, end, here.yaw_rad if keeps else yaw, duration, now_s)
            self.plan = Plan.FLYING if command == _TAKE_OFF else Plan.LANDING
        else:
            end, yaw, duration = np.array(values[-5:-2]), values[-2], values[-1]
            begin = here if self.plan is Plan.IDLE else self.goal(now_s)
            if values[1]:
                end, yaw = end + begin.position, yaw + begin.yaw_rad
            self._go(begin, end, yaw, duration, now_s)
            self.plan = Plan.FLYING
        return 0

    def is_finished(self, now_s: float) -> bool:
        """Return whether the duration of the plan is over."""
        return now_s - self._begin_s >= self._duration_s

    def goal(self, now_s: float) -> Goal:
        """Point of the trajectory at `now_s` [s]; a finished landing ends the plan."""
        fraction = min(max((now_s - self._begin_s) / self._duration_s, 0.0), 1.0)
        if self.plan is Plan.LANDING and self.is_finished(now_s):
            self.plan = Plan.IDLE
        value, slope, bend, _ = _ends(fraction) @ self._coefficients
        slope, bend = slope / self._duration_s, bend / self._duration_s**2
        return Goal(value[:3], slope[:3], bend[:3], float(value[3]))

    def _go(self, begin: Goal, end: FloatArray, yaw: float, duration_s: float, now_s: float) -> None:
        self._begin_s, self._duration_s = now_s, max(duration_s, 0.1)
        turn = math.remainder(yaw - begin.yaw_rad, 2 * math.pi)
        edges = np.zeros((8, 4))
        edges[0] = [*begin.position, begin.yaw_rad]
        edges[1, :3] = begin.velocity * self._duration_s
        edges[2, :3] = begin.acceleration * self._duration_s**2
        edges[4] = [*end, begin.yaw_rad + turn]
        self._coefficients = _FROM_ENDS @ edges
