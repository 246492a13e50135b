"""What a scenario says of a real flight: its table `[fly]`, and keys of its other tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from alula.schemas.errors import UsageError
from alula.schemas.parameters.flight_defaults import IN_A_COVER, NO_FILTER
from alula.schemas.scenarios.scenario import Read, Scenario, value_at
from alula.schemas.scenarios.vehicle import Vehicle

_FILES = {
    "cover": "world.cover",
    "tiles": "world.tiles",
    "scene": "world.scene",
    "within": "world.seen",
    "plan": "mission.plan",
    "vehicle": "vehicle.file",
}
_FIELDS = {
    "name": "name",
    "world.sigma": "sigma",
    "world.inflation_m": "inflation_m",
    "world.fence.box_m": "fence",
    "mission.controller.gain_per_s": "gain",
    "mission.controller.catch_up_m_s": "catch_up_m_s",
    "mission.via_tolerance_m": "via_tolerance_m",
    "mission.allow_tight": "allow_tight",
    "mission.allow_other_map": "allow_other_map",
    "mission.beyond_map_m": "beyond_map_m",
    "rules.max_time_s": "max_time_s",
    "rules.log_rate_hz": "log_rate_hz",
}
_SIMULATED = ("world.moving", "world.walls", "world.fence.faces", "world.onboard", "mission.controller.guide")


def flown_files(scenario: Scenario, folder: Path) -> dict[str, Path]:
    """Files of a real flight by role.

    Args:
        folder: of the scenario's file.
    """
    named = {role: _value(scenario, key) for role, key in _FILES.items()}
    return {role: folder / name for role, name in named.items() if name is not None}


def flown_filter(read: Read) -> str | None:
    """Name of the filter of a real flight; None where the scenario does not say.

    Raises:
        UsageError: the scenario names several.
    """
    names = read.scenario.safety.filters
    if len(names) > 1:
        words = f"a real flight has one filter, and these are {len(names)}; choose one with --filter"
        raise UsageError(f"`$.safety.filters`: {words}")
    if value_at(read.given, "safety.filters") is None:
        return None
    return names[0] if names else NO_FILTER


def flown_settings(read: Read, name: str) -> dict[str, Any]:
    """Fields of `FlyConfig` that the file of a scenario sets, and the address of the link as `link`.

    What belongs to the simulated plant, to its measurements or to random trials has no meaning in a real
    flight. `world.confidence` is left to the caller.

    Args:
        name: of the filter that is flown, whose parameters are those of its table.

    Raises:
        UsageError: the scenario has what a real flight cannot have, such as walls.
    """
    scenario, default = read.scenario, Scenario()
    for key in _SIMULATED:
        if _value(scenario, key) not in (None, _value(default, key), ()):
            raise UsageError(f"`$.{key}`: is for simulate alone; leave it out for a real flight")
    fields = dict(_FIELDS)
    if name == IN_A_COVER:
        fields |= {f"safety.{name}.{key}": key for key in ("beta", "kappa_per_m")}
    given = {key for key in fields if value_at(read.given, key) is not None}
    found = {fields[key]: _value(scenario, key) for key in given}
    if name not in (IN_A_COVER, NO_FILTER):
        found["filter_parameters"] = value_at(read.given, f"safety.{name}")
    own = {} if scenario.fly is None else msgspec.structs.asdict(scenario.fly)
    own["fence"] = own.pop("fence_m", None)
    found |= {key: value for key, value in own.items() if value is not None}
    return {key: value for key, value in found.items() if value is not None}


def flown_vehicle(scenario: Scenario, vehicle: Vehicle) -> Vehicle:
    """Vehicle of a real flight: with the radius, the lag and the delay that the scenario gives it.

    Args:
        vehicle: that the scenario or the user names.

    Raises:
        UsageError: it is a point, not a quadrotor.
    """
    if vehicle.model != "quadrotor":
        words = f"a {vehicle.model} is simulated only; name a quadrotor there or with --vehicle"
        raise UsageError(f"`$.vehicle`: {words}")
    table = scenario.vehicle
    assumed = {
        key: value for key, value in msgspec.structs.asdict(table.assumed).items() if value is not None
    }
    body = {} if table.radius_m is None else {"radius_m": table.radius_m}
    return msgspec.structs.replace(
        vehicle,
        body=msgspec.structs.replace(vehicle.body, **body),
        assumed=msgspec.structs.replace(vehicle.assumed, **assumed),
    )


def _value(scenario: Scenario, key: str) -> Any:
    """Value of a key; None where a table above it is absent."""
    found: Any = scenario
    for part in key.split("."):
        found = getattr(found, part.replace("-", "_"), None)
    return found
