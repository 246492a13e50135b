"""From an identification to a vehicle file, and to warnings where the first guess was wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import msgspec

from alula.schemas.scenarios.vehicle import (
    DisturbanceTable,
    IdentifiedTable,
    RatesTable,
    Vehicle,
    VelocitiesTable,
)
from alula.stages.identification.estimates import Measured
from alula.stages.identification.fit import Identification
from alula.stages.vehicles.own_limits import AXES, Limit, own_limits
from alula.stages.vehicles.velocity_lag import stop_time_s

_DISAGREES = 1.25  # factor between a measurement and the first guess that is worth a warning
# ArduPilot decelerates by PSC_JERK_XY / WPNAV_ACCEL times the speed, at most by WPNAV_ACCEL. The mean of a
# stop between 80 % and 20 % is 0.6 / log(4) of the former.
_SHAPED = 0.6 / math.log(4)
_DIGITS = 4


def identified_vehicle(
    vehicle: Vehicle,
    found: Identification,
    speeds_m_s: Sequence[float],
    *,
    name: str,
    autopilot: str,
    date: str,
) -> Vehicle:
    """The first guess with all that was measured in its place.

    A vertical speed is a limit only if a step did not reach its own; otherwise the first guess stays, or the
    speed that was reached if that is higher.

    Args:
        name: of the vehicle; empty for that of the first guess.
        autopilot: description of the vehicle, as its link gives it.
        date: of the flight; may be empty.
    """
    guess = vehicle.following
    vertical = (
        guess.vertical_lag
        if found.vertical_lag is None
        else tuple(_short(e.value) for e in found.vertical_lag)
    )
    velocities = VelocitiesTable(
        horizontal_lag=(_short(found.horizontal_lag.a.value), _short(found.horizontal_lag.b.value)),
        vertical_lag=(vertical[0], vertical[1]),
        max_up_m_s=_short(found.max_up_m_s or max(guess.max_up_m_s, _fastest(found, 1.0))),
        max_down_m_s=_short(found.max_down_m_s or max(guess.max_down_m_s, _fastest(found, -1.0))),
        deceleration_m_s2=_short(found.deceleration_m_s2.value),
    )
    drag, rates = found.drag_per_s, found.rate_s
    drags = None if None in drag else tuple(_short(each.value) for each in drag if each is not None)
    turn = found.rate_limits[2]
    turns = None if turn is None else turn.acceleration_rad_s2
    identified = IdentifiedTable(
        autopilot=autopilot,
        date=date,
        speeds_m_s=tuple(sorted(speeds_m_s)),
        horizontal_lag_interval=_two(found.horizontal_lag),
        vertical_lag_interval=None if found.vertical_lag is None else _two(found.vertical_lag),
        delay_s=_short(found.delay_s.value),
        delay_interval_s=_interval(found.delay_s),
        deceleration_interval_m_s2=_interval(found.deceleration_m_s2),
        hover_throttle=None if found.hover_throttle is None else _short(found.hover_throttle.value),
        hover_throttle_interval=_interval(found.hover_throttle),
        drag_per_s=None if drags is None else (drags[0], drags[1], drags[2]),
        drag_interval_per_s=_three(drag),
        residual_m_s2=None if math.isnan(found.residual_m_s2) else _short(found.residual_m_s2),
        time_constant_interval_s=None if rates is None else _three(rates),
        reached_rad_s=_reached(found),
        reached_interval_rad_s=_three(
            tuple(None if each is None else each.reached_rad_s for each in found.rate_limits)
        ),
        yaw_acceleration_rad_s2=None if turns is None else _short(turns.value),
        yaw_acceleration_interval_rad_s2=_interval(turns),
        thrust_time_constant_s=None if found.thrust_s is None else _short(found.thrust_s.value),
        thrust_time_constant_interval_s=_interval(found.thrust_s),
    )
    return msgspec.structs.replace(
        vehicle,
        name=name or vehicle.name,
        velocities=velocities,
        rates=_with_rates(vehicle, found),
        disturbance=_with_drag(vehicle, drags),
        identified=identified,
    )


def _with_rates(vehicle: Vehicle, found: Identification) -> RatesTable:
    """Lags of the rate loop, and for each axis the rate that was reached where it was less than asked."""
    table = vehicle.rates
    if found.rate_s is not None:
        roll, pitch, yaw = (_short(max(each.value, 1e-3)) for each in found.rate_s)
        table = msgspec.structs.replace(table, axis_time_constant_s=(roll, pitch, yaw))
    roll, pitch, yaw = (
        of_guess if limit is None or not limit.is_limited else max(_short(limit.reached_rad_s.value), 1e-3)
        for limit, of_guess in zip(found.rate_limits, table.max_rad_s, strict=True)
    )
    return msgspec.structs.replace(table, max_rad_s=(roll, pitch, yaw))


def _with_drag(vehicle: Vehicle, drag_per_s: Sequence[float] | None) -> DisturbanceTable:
    """Disturbances of the simulated plant with the measured drag, if it is one."""
    mass = vehicle.body.mass_kg
    if drag_per_s is None or mass is None or min(drag_per_s) <= 0:
        return vehicle.disturbance
    x, y, z = (_short(mass * each) for each in drag_per_s)
    none = (0.0, 0.0, 0.0)
    return msgspec.structs.replace(
        vehicle.disturbance, linear_drag_n_s_m=(x, y, z), quadratic_drag_n_s2_m2=none
    )


def _reached(found: Identification) -> tuple[float, float, float] | None:
    """Rates reached in fast steps; 0 about an axis without any."""
    if found.rate_limits == (None, None, None):
        return None
    x, y, z = (
        0.0 if each is None else max(_short(each.reached_rad_s.value), 0.0) for each in found.rate_limits
    )
    return x, y, z


def _fastest(found: Identification, sign: float) -> float:
    speeds = [each.speed_m_s for each in found.responses if (each.axis, each.sign) == (2, sign)]
    return max(speeds, default=0.0)


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _interval(estimate: Measured | None) -> tuple[float, float] | None:
    if estimate is None or estimate.interval is None:
        return None
    low, high = estimate.interval
    return _short(low), _short(high)


def _two(law: tuple[Measured, Measured]) -> tuple[tuple[float, float], tuple[float, float]] | None:
    a, b = map(_interval, law)
    return None if a is None or b is None else (a, b)


def _three(
    each: tuple[Measured | None, ...],
) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]] | None:
    x, y, z = map(_interval, each)
    return None if x is None or y is None or z is None else (x, y, z)


def disagreements(found: Identification, guess: Vehicle, parameters: Mapping[str, float]) -> list[str]:
    """A line for each value of the first guess that differs from the measured one by more than a quarter.

    Args:
        guess: vehicle's file before the flight.
    """
    lines = list[str]()
    for what, measured, expected, unit in _compared(found, guess, parameters):
        if not 1 / _DISAGREES <= measured / expected <= _DISAGREES:
            lines.append(f"{what}: measured {measured:.3g} {unit}, expected {expected:.3g}")
    return lines


def _compared(
    found: Identification, guess: Vehicle, parameters: Mapping[str, float]
) -> Iterator[tuple[str, float, float, str]]:
    following, fastest = guess.following, max(each.speed_m_s for each in found.responses)
    laws = [("horizontal", found.horizontal_lag, following.horizontal_lag)]
    if found.vertical_lag is not None:
        laws.append(("vertical", found.vertical_lag, following.vertical_lag))
    for name, law, expected in laws:
        values = (law.a.value, law.b.value)
        yield (
            f"63 % of a {name} stop from {fastest:.2g} m/s, by the first guess",
            *(stop_time_s(values, fastest), stop_time_s(expected, fastest)),
            "s",
        )
    limits = own_limits(parameters)
    for name, sign, measured in (("climb", 1.0, found.max_up_m_s), ("descent", -1.0, found.max_down_m_s)):
        limit = limits.get(name)
        reached = measured or _fastest(found, sign)
        if limit is not None and (measured is not None or reached > limit.value):
            yield f"fastest {name}, by {limit.parameter}", reached, limit.value, "m/s"
    level = max(each.speed_m_s for each in found.responses if each.axis != 2)
    measured_m_s2 = found.deceleration_m_s2.value
    if (limit := limits.get("acceleration")) is not None and (jerk := limits.get("jerk")) is not None:
        most = following.deceleration_m_s2  # with the lean angle
        if measured_m_s2 > most or _SHAPED * level * jerk.value / limit.value >= most:
            what = f"deceleration of a stop from {level:.2g} m/s, by {limit.parameter}"
            yield what, measured_m_s2, limit.value, "m/s^2"
    if found.hover_throttle is not None and (limit := limits.get("hover")) is not None:
        yield f"hover throttle, by {limit.parameter}", found.hover_throttle.value, limit.value, ""
    if found.rate_s is not None:
        for name, rate, expected_s in zip(AXES, found.rate_s, guess.rates.axes_s, strict=True):
            yield f"63 % of a step of the {name} rate, by the first guess", rate.value, expected_s, "s"
    yield from _compared_rates(found, guess, limits)


def _compared_rates(
    found: Identification, guess: Vehicle, limits: Mapping[str, Limit]
) -> Iterator[tuple[str, float, float, str]]:
    """The same for the limits of body rates.

    A rate is compared where it was not reached, and an angular acceleration where a step is long enough to
    show it: where the limit needs more time than the rate loop does.
    """
    for axis, (name, seen) in enumerate(zip(AXES, found.rate_limits, strict=True)):
        if seen is None:
            continue
        if seen.is_limited:
            limit = limits.get(f"{name} rate")
            is_own = limit is not None and limit.value <= guess.rates.max_rad_s[axis]
            by = limit.parameter if limit is not None and is_own else "the first guess"
            yield f"fastest {name} rate, by {by}", seen.reached_rad_s.value, seen.asked_rad_s, "rad/s"
        limit, gained = limits.get(f"{name} acceleration"), seen.acceleration_rad_s2
        lag_s = guess.rates.axes_s[axis] if found.rate_s is None else found.rate_s[axis].value
        if limit is not None and gained is not None and seen.asked_rad_s / limit.value > 2 * lag_s:
            yield f"{name} acceleration, by {limit.parameter}", gained.value, limit.value, "rad/s^2"
