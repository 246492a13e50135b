"""From an identification to a vehicle file, and to warnings where the first guess was wrong."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import msgspec

from alula.schemas.vehicle import DisturbanceTable, IdentifiedTable, Vehicle, VelocitiesTable
from alula.stages.identification.estimates import Estimate
from alula.stages.identification.fit import Identification
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
        vehicle: first guess.
        found: fit of the steps.
        speeds_m_s: speeds of the steps [m/s].
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
        thrust_time_constant_s=None if found.thrust_s is None else _short(found.thrust_s.value),
        thrust_time_constant_interval_s=_interval(found.thrust_s),
    )
    table = vehicle.rates
    if rates is not None:
        roll, pitch, yaw = (_short(max(each.value, 1e-3)) for each in rates)
        table = msgspec.structs.replace(table, axis_time_constant_s=(roll, pitch, yaw))
    return msgspec.structs.replace(
        vehicle,
        name=name or vehicle.name,
        velocities=velocities,
        rates=table,
        disturbance=_with_drag(vehicle, drags),
        identified=identified,
    )


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


def _fastest(found: Identification, sign: float) -> float:
    speeds = [each.speed_m_s for each in found.responses if (each.axis, each.sign) == (2, sign)]
    return max(speeds, default=0.0)


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")


def _interval(estimate: Estimate | None) -> tuple[float, float] | None:
    if estimate is None or estimate.interval is None:
        return None
    low, high = estimate.interval
    return _short(low), _short(high)


def _two(law: tuple[Estimate, Estimate]) -> tuple[tuple[float, float], tuple[float, float]] | None:
    a, b = map(_interval, law)
    return None if a is None or b is None else (a, b)


def _three(
    each: tuple[Estimate | None, Estimate | None, Estimate | None],
) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]] | None:
    x, y, z = map(_interval, each)
    return None if x is None or y is None or z is None else (x, y, z)


def disagreements(found: Identification, guess: Vehicle, parameters: Mapping[str, float]) -> list[str]:
    """A line for each value of the first guess that differs from the measured one by more than a quarter.

    Args:
        found: fit of the steps.
        guess: vehicle's file before the flight.
        parameters: of the vehicle, by name.
    """
    lines = list[str]()
    for what, measured, expected, unit in _compared(found, guess, parameters):
        if not 1 / _DISAGREES <= measured / expected <= _DISAGREES:
            lines.append(f"{what}: measured {measured:.3g} {unit}, expected {expected:.3g}")
    return lines


def _compared(
    found: Identification, guess: Vehicle, parameters: Mapping[str, float]
) -> Iterator[tuple[str, float, float, str]]:
    """What, measured and expected value, and unit."""
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
    for name, sign, measured, parameter in (
        ("climb", 1.0, found.max_up_m_s, "WPNAV_SPEED_UP"),
        ("descent", -1.0, found.max_down_m_s, "WPNAV_SPEED_DN"),
    ):
        expected_m_s = parameters.get(parameter, 0.0) / 100
        reached = measured or _fastest(found, sign)
        if expected_m_s > 0 and (measured is not None or reached > expected_m_s):
            yield f"fastest {name}, by {parameter}", reached, expected_m_s, "m/s"
    limit, jerk = parameters.get("WPNAV_ACCEL", 0.0) / 100, parameters.get("PSC_JERK_XY", 0.0)
    level = max(each.speed_m_s for each in found.responses if each.axis != 2)
    measured_m_s2 = found.deceleration_m_s2.value
    if limit > 0 and jerk > 0 and (measured_m_s2 > limit or _SHAPED * level * jerk / limit >= limit):
        yield f"deceleration of a stop from {level:.2g} m/s, by WPNAV_ACCEL", measured_m_s2, limit, "m/s^2"
    if found.hover_throttle is not None and parameters.get("MOT_THST_HOVER", 0.0) > 0:
        yield (
            "hover throttle, by MOT_THST_HOVER",
            found.hover_throttle.value,
            parameters["MOT_THST_HOVER"],
            "",
        )
    if found.rate_s is not None:
        for name, rate, expected_s in zip(
            ("roll", "pitch", "yaw"), found.rate_s, guess.rates.axes_s, strict=True
        ):
            yield f"63 % of a step of the {name} rate, by the first guess", rate.value, expected_s, "s"
