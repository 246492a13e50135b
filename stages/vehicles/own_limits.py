"""Limits of a vehicle by its own parameters, under the names of ArduPilot Copter before and since 4.7."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import msgspec

from alula.schemas.scenarios.vehicle import Vehicle

_DEGREE, _CENTI = math.pi / 180, 0.01

# Names of each limit and their factors to SI units; where several are set the first counts.
_SOURCES: dict[str, tuple[tuple[str, float], ...]] = {
    "climb": (("WPNAV_SPEED_UP", _CENTI), ("WP_SPD_UP", 1.0)),
    "descent": (("WPNAV_SPEED_DN", _CENTI), ("WP_SPD_DN", 1.0)),
    "acceleration": (("WPNAV_ACCEL", _CENTI), ("WP_ACC", 1.0)),
    "jerk": (("PSC_JERK_XY", 1.0), ("PSC_NE_JERK", 1.0)),
    "hover": (("MOT_THST_HOVER", 1.0),),
    "lean": (
        ("PSC_ANGLE_MAX", _DEGREE),
        ("ANGLE_MAX", _CENTI * _DEGREE),
        ("ATC_ANGLE_MAX", _DEGREE),
    ),
    **{f"{name} rate": ((f"ATC_RATE_{name[0].upper()}_MAX", _DEGREE),) for name in ("roll", "pitch", "yaw")},
    **{
        f"{name} acceleration": (
            (f"ATC_ACCEL_{name[0].upper()}_MAX", _CENTI * _DEGREE),
            (f"ATC_ACC_{name[0].upper()}_MAX", _DEGREE),
        )
        for name in ("roll", "pitch", "yaw")
    },
}
_FEEDS_FORWARD = "ATC_RATE_FF_ENAB"
PARAMETERS = (*(name for sources in _SOURCES.values() for name, _ in sources), _FEEDS_FORWARD)
# Those of them that stay as they are in flight; the hover throttle is learned there.
RESPONSES = tuple(name for name in PARAMETERS if name != "MOT_THST_HOVER")
AXES = ("roll", "pitch", "yaw")


class Limit(NamedTuple):
    """A limit and the parameter that sets it."""

    value: float
    parameter: str


def own_limits(parameters: Mapping[str, float]) -> dict[str, Limit]:
    """Limits in SI units and radians that the parameters set; 0 stands for none in all of them.

    Args:
        parameters: of the vehicle, by name; those of another autopilot set none.
    """
    found = dict[str, Limit]()
    for what, sources in _SOURCES.items():
        for name, factor in sources:
            if parameters.get(name, 0.0) > 0:
                found[what] = Limit(parameters[name] * factor, name)
                break
    return found


def rate_notes(parameters: Mapping[str, float]) -> list[str]:
    """What is wrong with the parameters for flights by body rates."""
    if parameters.get(_FEEDS_FORWARD, 1.0) != 0:
        return []
    return [
        f"{_FEEDS_FORWARD} is 0: the vehicle follows rates by its attitude only, seconds late; set it to 1"
    ]


def first_guess(vehicle: Vehicle, parameters: Mapping[str, float]) -> Vehicle:
    """The vehicle's file with the limits that its parameters set.

    The horizontal acceleration is also at most that of the largest lean angle, g tan(angle). Body rates stay
    those of the file where the vehicle allows more, because links send no faster ones.
    """
    limits, following, rates = own_limits(parameters), vehicle.following, vehicle.rates
    given = {
        key: limits[what].value
        for key, what in (
            ("max_up_m_s", "climb"),
            ("max_down_m_s", "descent"),
            ("deceleration_m_s2", "acceleration"),
        )
        if what in limits
    }
    if "lean" in limits:
        lean_m_s2 = vehicle.body.gravity_m_s2 * math.tan(min(limits["lean"].value, math.radians(80.0)))
        given["deceleration_m_s2"] = min(
            given.get("deceleration_m_s2", following.deceleration_m_s2), lean_m_s2
        )
    own_rates = [
        min(limits[f"{name} rate"].value, of_file) if f"{name} rate" in limits else of_file
        for name, of_file in zip(AXES, rates.max_rad_s, strict=True)
    ]
    return msgspec.structs.replace(
        vehicle,
        velocities=msgspec.structs.replace(following, **given),
        rates=msgspec.structs.replace(rates, max_rad_s=(own_rates[0], own_rates[1], own_rates[2])),
    )
