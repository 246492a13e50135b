"""Lag with which a vehicle follows velocity set-points: by axis and speed, and what a filter needs of it."""

from __future__ import annotations

from alula.schemas.scenarios.vehicle import VelocitiesTable

# A factor for what a first-order model leaves out, and the longest lag that a filter is given.
LAG_MARGIN, MAX_LAG_S = 1.25, 5.0


def stop_time_s(law: tuple[float, float], speed_m_s: float) -> float:
    """Time of 63 % of a stop, a + b v [s].

    Args:
        law: a [s] and b [s^2/m].
        speed_m_s: v [m/s].
    """
    return law[0] + law[1] * speed_m_s


def filter_lags_s(following: VelocitiesTable, speed_m_s: float) -> tuple[float, float, float]:
    """Lags along x, y, z that a filter of velocities assumes: 1.25 times that of a stop, at most 5 s [s].

    Args:
        speed_m_s: speed limit [m/s].
    """
    level = stop_time_s(following.horizontal_lag, speed_m_s)
    climb = stop_time_s(following.vertical_lag, min(speed_m_s, following.max_up_m_s))
    level, climb = (min(LAG_MARGIN * lag, MAX_LAG_S) for lag in (level, climb))
    return level, level, climb


def stop_m(law: tuple[float, float], speed_m_s: float) -> float:
    """Distance in which the vehicle stops, with the margin of the lag [m].

    Args:
        law: a [s] and b [s^2/m].
        speed_m_s: speed before the stop [m/s].
    """
    return LAG_MARGIN * stop_time_s(law, speed_m_s) * speed_m_s


def stop_slope_s(law: tuple[float, float], speed_m_s: float) -> float:
    """Derivative of `stop_m` [s]; it does not fall with the speed where b is not negative.

    Args:
        law: a [s] and b [s^2/m].
        speed_m_s: speed before the stop [m/s].
    """
    return LAG_MARGIN * (law[0] + 2 * law[1] * speed_m_s)


def needed_deceleration_m_s2(speed_m_s: float, lag_s: float, beta: float) -> float:
    """Deceleration towards a wall under the filter of `chord_filter.hpp`, speed / (1 / beta + lag) [m/s^2].

    Args:
        speed_m_s: speed limit [m/s].
        lag_s: lag that the filter assumes [s].
        beta: gain of the barrier [1/s].
    """
    return speed_m_s / (1 / beta + lag_s)


def max_speed_m_s(following: VelocitiesTable, beta: float) -> float:
    """Largest speed from which the vehicle decelerates as fast as `needed_deceleration_m_s2` [m/s].

    The solution of v = d (1 / beta + lag(v)), d the vehicle's deceleration.

    Args:
        beta: gain of the barrier [1/s].
    """
    a, b = following.horizontal_lag
    most = following.deceleration_m_s2
    capped, rise = most * (1 / beta + MAX_LAG_S), 1 - LAG_MARGIN * b * most
    return capped if rise <= 0 else min(most * (1 / beta + LAG_MARGIN * a) / rise, capped)
