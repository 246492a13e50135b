"""How a vehicle's own autopilot shapes velocities: limits for which stops take as long as measured."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from alula import _core
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.vehicles.velocity_lag import stop_time_s

_SPEEDS_M_S = (1.0, 2.0)  # of a law whose speeds are not known
_LAG_S = 0.08  # of the acceleration, within the loop of the vehicle's attitude
_INNER_S = 0.08  # this lag, that loop and the link lengthen a stop's 63 % by this; feedback makes up the rest
_LEAST_S = 0.05  # shortest time of a shaped stop
_FALLEN = math.exp(-1)
_BOUNDS = ((0.2, 0.5), (30.0, 300.0))  # of acceleration and jerk


def following_options(vehicle: Vehicle) -> _core.FollowingOptions:
    """Acceleration and jerk of a vehicle that follows velocities as its table says, or else its defaults.

    Args:
        vehicle: a quadrotor.
    """
    following, measured = vehicle.following, vehicle.identified
    speeds = (measured.speeds_m_s if measured is not None else ()) or _SPEEDS_M_S
    climbs = [min(speed, following.max_up_m_s) for speed in speeds]
    level = shaping_limits(following.horizontal_lag, speeds)
    climb = shaping_limits(following.vertical_lag, climbs)
    return _core.FollowingOptions(
        horizontal_acceleration_m_s2=level[0],
        horizontal_jerk_m_s3=level[1],
        vertical_acceleration_m_s2=climb[0],
        vertical_jerk_m_s3=climb[1],
        lag_s=_LAG_S,
    )


def shaping_limits(law: tuple[float, float], speeds_m_s: Sequence[float]) -> tuple[float, float]:
    """Acceleration [m/s^2] and jerk [m/s^3] whose stops take as long as a law says; least squares.

    Args:
        law: a [s] and b [s^2/m], see `stop_time_s`.
        speeds_m_s: at which the law was measured; its ends count [m/s].
    """
    from scipy.optimize import least_squares

    ends = (min(speeds_m_s), max(speeds_m_s))
    wanted = [max(stop_time_s(law, speed) - _INNER_S, _LEAST_S) for speed in ends]

    def error(logarithms: np.ndarray) -> list[float]:
        acceleration, jerk = np.exp(logarithms).tolist()
        return [
            shaped_stop_s(acceleration, jerk, speed) / time - 1
            for speed, time in zip(ends, wanted, strict=True)
        ]

    found = least_squares(error, np.log((2.5, 5.0)), bounds=np.log(_BOUNDS))
    acceleration, jerk = np.exp(found.x).tolist()
    return acceleration, jerk


def shaped_stop_s(acceleration_m_s2: float, jerk_m_s3: float, speed_m_s: float) -> float:
    """Time of 63 % of a stop that is shaped by limits of acceleration A and jerk J [s].

    The deceleration rises by J until it is A, or J / A times the speed that is left; then it stays A while
    that is less, and at last the speed falls exponentially, at the rate J / A.

    Args:
        acceleration_m_s2: A.
        jerk_m_s3: J.
        speed_m_s: before the stop.
    """
    most, jerk, rate = acceleration_m_s2, jerk_m_s3, jerk_m_s3 / acceleration_m_s2
    goal = _FALLEN * speed_m_s
    rise_s = min(most / jerk, (math.sqrt(most**2 + 2 * jerk * speed_m_s) - most) / jerk)
    speed = speed_m_s - jerk * rise_s**2 / 2
    if speed <= goal:
        return math.sqrt(2 * (speed_m_s - goal) / jerk)
    linear = max(goal, most / rate)  # below this speed it falls exponentially
    steady_s = max(0.0, speed - linear) / most
    speed = min(speed, linear)
    return rise_s + steady_s + math.log(speed / goal) / rate
