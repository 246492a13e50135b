"""The safety filters of a scenario, in their order, as native filters of one protocol."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import msgspec

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.parameters.filter_options import TABLES
from alula.schemas.parameters.filters.values import Options
from alula.schemas.scenarios.check import FILTER_COMMANDS
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.filtering.bridge import native_filter
from alula.stages.filtering.protocol import FilterWorld, SafetyFilter
from alula.stages.filtering.registry import make_filter
from alula.stages.vehicles.racer import racer_model
from alula.stages.world.obstacles import StaticWorld
from alula.stages.world.vehicle import body_of, box_of_accelerations, controller_gains

_JERK_M_S3 = 60.0  # assumed limit of a vehicle without one, of the filters among moving obstacles
_SPEEDS = 3.0  # assumed limit of a vehicle without one, over the mission's speed


def filter_world(
    scenario: Scenario,
    vehicle: Vehicle,
    world: StaticWorld,
    *,
    speed_m_s: float,
    max_speed_m_s: float,
    extent_m: float,
) -> FilterWorld:
    """What the filters of a scenario are built for.

    Args:
        speed_m_s: of the mission [m/s].
        max_speed_m_s: limit of velocity commands [m/s].
        extent_m: bound of the coordinates of all positions [m].
    """
    rules, table, fence = scenario.rules, scenario.vehicle, scenario.world.fence
    box = None if fence is None or fence.box_m is None else (fence.box_m[:3], fence.box_m[3:])
    is_read = scenario.world.onboard and not scenario.world.has_boxes
    return FilterWorld(
        radius_m=world.radius_m,
        inflation_m=world.inflation_m,
        dt_s=rules.dt_s * rules.filter_ticks,
        hulls=world.hulls,
        polytopes=world.polytopes,
        tiles=world.tiles,
        tile_load_ticks=math.ceil(round(scenario.world.tile_load_s / (rules.dt_s * rules.filter_ticks), 6)),
        image=world.image if is_read or needs_image(scenario) else b"",
        index=world.index,
        parts=world.parts,
        fence_box=box,
        fence_faces=world.faces[6 if box is not None else 0 :],
        extent_m=extent_m,
        speed_m_s=max_speed_m_s,
        max_speed_m_s=table.max_speed_m_s or _SPEEDS * max(speed_m_s, 1.0),
        max_acceleration_m_s2=box_of_accelerations(vehicle, table),
        max_jerk_m_s3=table.max_jerk_m_s3 or _JERK_M_S3,
        body=body_of(vehicle),
        gains=controller_gains(scenario, vehicle, speed_m_s),
        racer=racer_model(vehicle) if vehicle.throttle is not None else None,
        motor_time_constant_s=table.assumed.motor_time_constant_s or 0.0,
        rate_time_constant_s=vehicle.rates.axes_s if table.interface == "body-rates" else (0.0, 0.0, 0.0),
        max_rate_rad_s=vehicle.rates.max_rad_s,
    )


def needs_image(scenario: Scenario) -> bool:
    """Whether a geofence reads the cover as an onboard map: one that filters, or the judge of a pilot."""
    return "geofence" in scenario.safety.filters or scenario.mission.kind == "pilot"


def needs_index(scenario: Scenario, names: Sequence[str]) -> bool:
    """Whether filters or the choice of starts read the ellipsoids of the scene; the judge always does.

    Behind `polytope-cbf`, or without a filter, flights in a cover steer by its hulls alone.

    Args:
        names: filters, with the guide of the controller.
    """
    is_among_hulls = scenario.world.cover is not None and set(names) <= {"polytope-cbf"}
    return not is_among_hulls or scenario.mission.kind == "pilot"


def safety_filters(
    scenario: Scenario, world: FilterWorld, lag_s: tuple[float, float, float]
) -> list[_core.SafetyFilter]:
    """Make the filters of a scenario, the guide of its controller first.

    Args:
        lag_s: with which velocities are followed along x, y, z [s].

    Raises:
        UsageError: a parameter is wrong, or a filter is unknown.
    """
    controller, safety = scenario.mission.controller, scenario.safety
    wanted = [(name, safety.parameters(name), f"safety.{TABLES.get(name, name)}") for name in safety.filters]
    if controller.guide != "none":
        wanted.insert(
            0, (controller.guide, controller.guide_parameters, "mission.controller.guide_parameters")
        )
    made: list[_core.SafetyFilter] = []
    for name, given, table in wanted:
        if FILTER_COMMANDS.get(name) == "sticks" and scenario.world.seen is not None:
            raise UsageError(
                f"`$.safety.filters`: {name} keeps inside a fence and out of a cover, not in seen space; "
                "leave out world.seen"
            )
        if FILTER_COMMANDS.get(name) == "sticks" and scenario.world.walls:
            raise UsageError(
                f"`$.safety.filters`: {name} keeps inside a fence and out of a cover, not of walls; leave "
                "out world.walls, or voxelize and merge them into the cover"
            )
        try:
            built = make_filter(name, world, plain(name, given))
            assert built is not None
            native = flown_filter(built, lag_s, world.speed_m_s)
        except (ValueError, TypeError, OverflowError, UsageError) as error:
            if "`$." in str(error):
                raise
            raise UsageError(f"`$.{table}`: {str(error).removeprefix(f'{name}: ')}") from error
        made.append(native)
    return made


def flown_filter(
    made: SafetyFilter, lag_s: tuple[float, float, float], max_speed_m_s: float
) -> _core.SafetyFilter:
    """A filter as flights take it: native, and one of velocities with the way to a stop.

    Args:
        lag_s: with which velocities are followed along x, y, z [s].
        max_speed_m_s: limit of velocity commands [m/s].
    """
    native = native_filter(made)
    if native.kind != "velocity":
        return native
    return _core.ChordFilter(native, lag_s=lag_s, max_speed_m_s=max_speed_m_s)


def plain(name: str, given: Options | dict[str, Any]) -> dict[str, Any]:
    """Parameters of a filter as its maker takes them."""
    values = msgspec.structs.asdict(given) if isinstance(given, Options) else dict(given)
    if name == "polytope-cbf":
        values.pop("onboard", None)  # the image of the world stands for it
    return values
