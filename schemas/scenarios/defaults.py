"""Values of a scenario that follow from its vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.tables import Interface
from alula.schemas.scenarios.vehicle import Vehicle, read_vehicle
from alula.schemas.scenarios.vehicles import DEFAULT_VEHICLE, VEHICLES

_NOISE = ("position_noise_m", "velocity_noise_m_s", "attitude_noise_rad", "rate_noise_rad_s", "delay_s")
_ATTITUDE_LAG_S = 0.15  # of the attitude loop within a velocity loop


def vehicle_of(scenario: Scenario, folder: Path) -> Vehicle:
    """Vehicle that a scenario names, without the scenario's deviations from it.

    Args:
        folder: of the scenario's file.

    Raises:
        InputError, VersionError, UsageError: the vehicle's file cannot be read or is wrong.
    """
    table = scenario.vehicle
    if table.file is not None:
        return read_vehicle(folder / table.file)
    return VEHICLES[table.type or DEFAULT_VEHICLE.name]


def interface_of(scenario: Scenario, vehicle: Vehicle) -> Interface:
    """What a vehicle is commanded by: as the scenario says, else by its model and the mission."""
    if scenario.vehicle.interface is not None:
        return scenario.vehicle.interface
    if vehicle.model == "quadrotor":
        return "sticks" if scenario.mission.kind == "pilot" else "wrench"
    return "velocity" if vehicle.model == "single-integrator" else "acceleration"


def has_autopilot(scenario: Scenario, vehicle: Vehicle) -> bool:
    """Whether a vehicle follows velocities or accelerations as its own autopilot does."""
    table = scenario.vehicle
    if table.autopilot is not None:
        return table.autopilot
    by_autopilot = interface_of(scenario, vehicle) in ("velocity", "acceleration")
    return by_autopilot and vehicle.velocities is not None and table.velocity_gain_per_s is None


def completed(scenario: Scenario, vehicle: Vehicle) -> Scenario:
    """Replace None by the values of the vehicle, where they apply to it."""
    table, own = scenario.vehicle, vehicle.disturbance
    measured, mission_kind = vehicle.velocities is not None, scenario.mission.kind
    values: dict[str, Any] = {
        "type": None if table.file is not None else table.type or vehicle.name,
        "interface": interface_of(scenario, vehicle),
        "radius_m": vehicle.body.radius_m,
        "max_speed_m_s": vehicle.limits.max_speed_m_s,
        "max_acceleration_m_s2": vehicle.limits.max_acceleration_m_s2,
    }
    if has_autopilot(scenario, vehicle):
        values["autopilot"] = True
    elif vehicle.model != "single-integrator":
        values["velocity_gain_per_s"] = vehicle.tracking.kv_per_s
        gain = table.velocity_gain_per_s or vehicle.tracking.kv_per_s
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
        mission=_filled(scenario.mission, {"waits": True} if measured and mission_kind == "plan" else {}),
    )


def _filled(table: Any, values: dict[str, Any]) -> Any:
    """A table with values in place of None, and nested tables replaced."""
    new = {
        key: value
        for key, value in values.items()
        if getattr(table, key) is None or isinstance(value, msgspec.Struct)
    }
    return msgspec.structs.replace(table, **new)
