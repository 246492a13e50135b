"""Vehicles that are built in by name; `examples/vehicles` has them as files, with sources of all numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from alula.schemas.artifacts.artifact import read_manifest
from alula.schemas.errors import InputError
from alula.schemas.scenarios.vehicle import (
    FASTBRIDGE,
    BodyTable,
    LimitsTable,
    RatesTable,
    RotorsTable,
    ThrottleTable,
    TrackingTable,
    Vehicle,
    read_vehicle,
)

DEFAULT_RADIUS_M = 0.1
"""Radius of a point that is moved by velocities, without a vehicle or a plan [m]."""
DEFAULT_SPEED_M_S = 1.0
PLAN_SPEED_FACTOR = 1.5
"""Speed limit of a point along a plan, over the plan's speed: leaves room to catch up."""
CATCH_UP_FACTOR = 0.5
"""Speed above the reference's at which a delayed vehicle catches up, over the peak speed."""

_CRAZYFLIE21 = Vehicle(
    name="crazyflie21",
    model="quadrotor",
    body=BodyTable(radius_m=0.075, mass_kg=0.029, inertia_kg_m2=(16.6e-6, 16.6e-6, 29.3e-6)),
    rotors=RotorsTable(
        positions_m=((0.0325, -0.0325), (-0.0325, -0.0325), (-0.0325, 0.0325), (0.0325, 0.0325)),
        spins=(-1, 1, -1, 1),
        torque_ratio_m=0.005964552,
        min_thrust_n=(0.02,) * 4,
        max_thrust_n=(0.1125,) * 4,
    ),
    tracking=TrackingTable(max_tilt_rad=0.7, max_thrust_share=0.95),
)

_RACER7 = Vehicle(
    name="racer7",
    model="quadrotor",
    body=BodyTable(radius_m=0.25, mass_kg=0.9, inertia_kg_m2=(3.1e-3, 4.4e-3, 7.0e-3)),
    rotors=RotorsTable(
        positions_m=((0.11, -0.11), (-0.11, -0.11), (-0.11, 0.11), (0.11, 0.11)),
        spins=(-1, 1, -1, 1),
        torque_ratio_m=0.0142,
        max_thrust_n=(18.37,) * 4,
    ),
    rates=RatesTable(max_rad_s=(12.0, 12.0, 6.0)),
    throttle=ThrottleTable(acceleration_m_s2=(0.0, 7.75474, 73.895455)),
    tracking=TrackingTable(max_tilt_rad=1.4, max_thrust_share=0.9),
)

_SINGLE_INTEGRATOR = Vehicle(
    name="single-integrator",
    model="single-integrator",
    body=BodyTable(radius_m=0.15),
    limits=LimitsTable(max_speed_m_s=1.0),
)

_DOUBLE_INTEGRATOR = Vehicle(
    name="double-integrator",
    model="double-integrator",
    body=BodyTable(radius_m=0.15),
    limits=LimitsTable(max_acceleration_m_s2=12.0),
)

VEHICLES: dict[str, Vehicle] = {
    vehicle.name: vehicle
    for vehicle in (_CRAZYFLIE21, FASTBRIDGE, _RACER7, _SINGLE_INTEGRATOR, _DOUBLE_INTEGRATOR)
}
"""By name."""

DEFAULT_VEHICLE = FASTBRIDGE
"""Vehicle of `plan`, `simulate`, `fly` and others where none is chosen, and no filter brings its own."""


def vehicle_named(given: str | Path | None) -> tuple[Vehicle, dict[str, Path]]:
    """A vehicle, and its file as an input with the role `vehicle`; no input if it is built in.

    Args:
        given: name of a built-in vehicle, or a file; None for `DEFAULT_VEHICLE`.

    Raises:
        InputError, VersionError, UsageError: the file cannot be read or is wrong.
    """
    if given is None:
        return DEFAULT_VEHICLE, {}
    if str(given) in VEHICLES:
        return VEHICLES[str(given)], {}
    path = Path(given)
    if not path.suffix and not path.exists():
        raise InputError(f"{given}: no such file, and no built-in vehicle; these are {', '.join(VEHICLES)}")
    return read_vehicle(path), {"vehicle": path}


def point_limits(
    plan: Path | None, *, radius_m: float | None = None, speed_m_s: float | None = None
) -> dict[str, float]:
    """Radius and speed limit of a point that is moved by velocities, as keys of the table `vehicle`.

    Args:
        plan: that it flies; its values are the default.
        radius_m: replaces the default [m].
        speed_m_s: replaces the default [m/s].

    Raises:
        InputError, ArtifactError: the plan cannot be read.
    """
    radius, speed = DEFAULT_RADIUS_M, DEFAULT_SPEED_M_S
    if plan is not None and None in (radius_m, speed_m_s):
        manifest: Any = read_manifest(plan)
        radius = float(manifest.radius_m - manifest.margin_m)
        speed = PLAN_SPEED_FACTOR * float(manifest.speed_m_s)
    return {
        "radius_m": radius if radius_m is None else radius_m,
        "max_speed_m_s": speed if speed_m_s is None else speed_m_s,
    }
