"""Values of a scenario of version 2.0 that follow from its vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from alula.schemas.vehicle import FASTBRIDGE, Vehicle, read_vehicle
from alula.schemas.vehicles import VEHICLES
from alula.schemas.world import WorldScenario
from alula.schemas.world_tables import Interface

_NOISE = ("position_noise_m", "velocity_noise_m_s", "attitude_noise_rad", "rate_noise_rad_s", "delay_s")
_ATTITUDE_LAG_S = 0.15  # of the attitude loop within a velocity loop


def vehicle_of(scenario: WorldScenario, folder: Path) -> Vehicle:
    """Vehicle that a scenario names, without the scenario's deviations from it.

    Args:
        scenario: any.
        folder: of the scenario's file.

    Raises:
        InputError, VersionError, UsageError: the vehicle's file cannot be read or is wrong.
    """
    table = scenario.vehicle
    if table.file is not None:
        return read_vehicle(folder / table.file)
    return VEHICLES[table.type or FASTBRIDGE.name]


def interface_of(scenario: WorldScenario, vehicle: Vehicle) -> Interface:
    """What a vehicle is commanded by: as the scenario says, else by its model and the mission.

    Args:
        scenario: any.
        vehicle: of the scenario.
    """
    if scenario.vehicle.interface is not None:
        return scenario.vehicle.interface
    if vehicle.model == "quadrotor":
        return "sticks" if scenario.mission.kind == "pilot" else "wrench"
    return "velocity" if vehicle.model == "single-integrator" else "acceleration"


def completed(scenario: WorldScenario, vehicle: Vehicle) -> WorldScenario:
    """Replace None by the values of the vehicle, where they apply to it.

    Args:
        scenario: any.
        vehicle: of the scenario.
    """
    table, own = scenario.vehicle, vehicle.disturbance
    values: dict[str, Any] = {
        "type": None if table.file is not None else table.type or vehicle.name,
        "interface": interface_of(scenario, vehicle),
        "radius_m": vehicle.body.radius_m,
        "max_speed_m_s": vehicle.limits.max_speed_m_s,
        "max_acceleration_m_s2": vehicle.limits.max_acceleration_m_s2,
    }
    if vehicle.model != "single-integrator":
        values["velocity_gain_per_s"] = _velocity_gain_per_s(vehicle, table.max_speed_m_s or 1.0)
        gain = table.velocity_gain_per_s or values["velocity_gain_per_s"]
        values["velocity_lag_s"] = 1 / gain + _ATTITUDE_LAG_S
    if vehicle.model == "double-integrator":
        values["actuation_delay_s"] = 0.0
    if vehicle.model == "quadrotor":
        disturbed = {key: getattr(own, key, None) for key in table.disturbance.__struct_fields__}
        if vehicle.throttle is not None:
            disturbed |= {key: getattr(vehicle.throttle, key) for key in ("sag_share", "sag_time_s")}
        values["disturbance"] = _filled(table.disturbance, disturbed)
        values["assumed"] = _filled(table.assumed, msgspec.structs.asdict(vehicle.assumed))
    known = {key: getattr(own, key) for key in _NOISE}
    return msgspec.structs.replace(
        scenario,
        vehicle=_filled(table, values),
        estimation=_filled(scenario.estimation, known),
    )


def _velocity_gain_per_s(vehicle: Vehicle, speed_m_s: float) -> float:
    """Gain of the loop that follows velocities: of a stop as `identify` measured it, else the vehicle's."""
    measured = vehicle.velocities
    if measured is None:
        return vehicle.tracking.kv_per_s
    a, b = measured.horizontal_lag
    return 1 / max(a + b * speed_m_s, _ATTITUDE_LAG_S)  # the attitude loop adds little to a stop


def _filled(table: Any, values: dict[str, Any]) -> Any:
    """A table with values in place of None, and nested tables replaced."""
    new = {
        key: value
        for key, value in values.items()
        if getattr(table, key) is None or isinstance(value, msgspec.Struct)
    }
    return msgspec.structs.replace(table, **new)
