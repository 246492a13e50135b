"""The safety filters of a scenario, in their order, as native filters of one protocol."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import msgspec
import numpy as np

from alula import _core
from alula.schemas.encounter_filter import native_options
from alula.schemas.errors import UsageError
from alula.schemas.filter_options import GeofenceParameters, MovingFilterParameters
from alula.schemas.vehicle import FASTBRIDGE, Vehicle
from alula.schemas.world import WorldScenario
from alula.schemas.world_check import FILTER_COMMANDS
from alula.stages.filtering.bridge import native_filter, native_velocity_filter
from alula.stages.filtering.polytope_cbf import NativeFilter
from alula.stages.filtering.protocol import World
from alula.stages.filtering.registry import make_splat_filter
from alula.stages.filtering.splat_filters import BOTH, ELLIPSOIDS, HULLS, SHIELD_MAP
from alula.stages.filtering.splat_protocol import SplatWorld
from alula.stages.simulation.encounters.world import WALL_FRACTION
from alula.stages.simulation.world.vehicle import box_of_accelerations
from alula.stages.simulation.world.world import StaticWorld
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
from alula.stages.vehicles.racer import racer_model

_JERK_M_S3 = 60.0  # assumed limit of a vehicle without one, of the filters among moving obstacles
_SPEEDS = 3.0  # assumed limit of a vehicle without one, over the mission's speed
_PARTS = {
    ELLIPSOIDS: ("ellipsoids", "fence"),
    HULLS: ("hulls", "fence"),
    BOTH: ("ellipsoids", "hulls", "fence"),
}


def safety_filters(
    scenario: WorldScenario,
    vehicle: Vehicle,
    world: StaticWorld,
    *,
    speed_m_s: float,
    max_speed_m_s: float,
    extent_m: float,
) -> list[_core.SafetyFilter]:
    """Make the filters of a scenario.

    Args:
        scenario: completed.
        vehicle: that it names.
        world: static obstacles.
        speed_m_s: of the mission [m/s].
        max_speed_m_s: limit of velocity commands [m/s].
        extent_m: bound of the coordinates of all positions [m].

    Raises:
        UsageError: a parameter is wrong, or a filter is unknown.
    """
    made: list[_core.SafetyFilter] = []
    names = list(scenario.safety.filters)
    if scenario.mission.controller.guide != "none":
        names.insert(0, scenario.mission.controller.guide)
    for i, name in enumerate(names):
        is_guide = i == 0 and len(names) > len(scenario.safety.filters)
        given = scenario.mission.controller.guide_parameters if is_guide else scenario.safety.parameters(name)
        command = FILTER_COMMANDS.get(name)
        try:
            if name == "polytope-cbf":
                made.append(_of_velocities(scenario, world, given, max_speed_m_s, extent_m))
            elif isinstance(given, MovingFilterParameters):
                made.append(_among_moving(name, scenario, vehicle, world, given, speed_m_s))
            elif command == "sticks":
                assert isinstance(given, GeofenceParameters)
                made.append(_in_fence(name, scenario, vehicle, world, given))
            else:
                made.append(_among_obstacles(name, scenario, vehicle, world, _plain(given)))
        except (ValueError, TypeError, OverflowError, UsageError) as error:
            if "`$." in str(error):
                raise
            raise UsageError(f"`$.safety.{name}`: {str(error).removeprefix(f'{name}: ')}") from error
    return made


def _plain(given: Any) -> dict[str, Any]:
    return msgspec.structs.asdict(given) if isinstance(given, msgspec.Struct) else dict(given)


def velocity_world(
    scenario: WorldScenario, world: StaticWorld, max_speed_m_s: float, extent_m: float
) -> World:
    """What a filter of velocities is built for.

    Args:
        scenario: completed.
        world: with hulls.
        max_speed_m_s: limit of velocity commands [m/s].
        extent_m: bound of the coordinates of all positions [m].

    Raises:
        UsageError: there are no hulls.
    """
    if world.hulls is None:
        raise UsageError("`$.safety.filters`: polytope-cbf needs hulls; set world.cover or world.walls")
    is_read = scenario.world.onboard and not scenario.world.walls
    return World(
        hulls=world.hulls,
        radius_m=world.hull_keep_m,
        speed_m_s=max_speed_m_s,
        dt_s=scenario.rules.dt_s * scenario.rules.filter_ticks,
        extent_m=extent_m,
        image=world.image if is_read else b"",
    )


def _of_velocities(
    scenario: WorldScenario, world: StaticWorld, given: Any, max_speed_m_s: float, extent_m: float
) -> _core.SafetyFilter:
    values = _plain(given)
    values.pop("onboard", None)
    built = NativeFilter(velocity_world(scenario, world, max_speed_m_s, extent_m), values)
    lag = scenario.vehicle.velocity_lag_s or 0.0
    return native_velocity_filter(built, lag_s=lag, max_speed_m_s=max_speed_m_s)


def _among_moving(
    name: str,
    scenario: WorldScenario,
    vehicle: Vehicle,
    world: StaticWorld,
    given: MovingFilterParameters,
    speed_m_s: float,
) -> _core.SafetyFilter:
    """A filter among moving obstacles; static obstacles are walls to it."""
    table = scenario.vehicle
    largest = box_of_accelerations(vehicle, table.max_acceleration_m_s2)
    limits = {
        "a_max": largest,
        "v_max": table.max_speed_m_s or _SPEEDS * max(speed_m_s, 1.0),
        "j_max": table.max_jerk_m_s3 or _JERK_M_S3,
        "radius_m": world.most_keep_m,
        "dt_s": scenario.rules.dt_s * scenario.rules.filter_ticks,
    }
    options = {"wall_deceleration": WALL_FRACTION * largest} | native_options(given) | limits
    native = _core.moving_filter(
        name.replace("-", "_"), {key: float(value) for key, value in options.items()}
    )
    return _core.MovingSafety(
        native,
        world.map,
        max_speed_m_s=limits["v_max"],
        max_acceleration_m_s2=largest,
        radius_m=world.most_keep_m,
    )


def _in_fence(
    name: str, scenario: WorldScenario, vehicle: Vehicle, world: StaticWorld, given: GeofenceParameters
) -> _core.SafetyFilter:
    """A filter of sticks: the geofence, which also keeps out of a cover, or backup-qp."""
    if scenario.world.walls:
        raise UsageError(
            f"`$.safety.filters`: {name} keeps inside a fence and out of a cover, not of walls; leave out "
            "world.walls, or voxelize and merge them into the cover"
        )
    values = _plain(given)
    alpha = values.pop("alpha")
    table = scenario.world.fence
    box = None if table is None or table.box_m is None else (table.box_m[:3], table.box_m[3:])
    has_faces = table is not None and bool(table.faces)
    keeps_out = name == "geofence" and world.image
    where = _core.Fence(
        box=box,
        faces=np.ascontiguousarray(world.faces[6 if box is not None else 0 :]) if has_faces else None,
        image=world.image if keeps_out else None,
        keep_out=world.polytopes if keeps_out else None,
    )
    model = racer_model(vehicle)
    if name == "backup-qp":  # it has no regulation function
        values["beta"] = min(values["beta"], _core.Geofence.conditions(model, values)["most_beta"])
    native = _core.Geofence(where, model, values | {"radius_m": world.radius_m})
    return _core.FenceFilter(native, alpha if name == "backup-qp" else None)


def _among_obstacles(
    name: str, scenario: WorldScenario, vehicle: Vehicle, world: StaticWorld, given: Mapping[str, Any]
) -> _core.SafetyFilter:
    """A filter of accelerations or wrenches among ellipsoids and hulls, or one of another package."""
    rules, assumed = scenario.rules, scenario.vehicle.assumed
    against = given.get(SHIELD_MAP, ELLIPSOIDS)
    by_rates = scenario.vehicle.interface == "body-rates"
    of_what = SplatWorld(
        index=world.index,
        body=quadrotor(vehicle if vehicle.model == "quadrotor" else FASTBRIDGE),
        gains=_core.TrackingGains() if vehicle.model == "single-integrator" else tracking_gains(vehicle),
        radius_m=world.keep_m,
        dt_s=rules.dt_s * rules.filter_ticks,
        motor_time_constant_s=assumed.motor_time_constant_s or 0.0,
        rate_time_constant_s=vehicle.rates.time_constant_s if by_rates else 0.0,
        max_rate_rad_s=vehicle.rates.max_rad_s,
        hulls=world.polytopes,
        hull_radius_m=world.hull_keep_m,
        static=world.of(*_PARTS[against]),
        static_radius_m=world.most_keep_m,
    )
    built = make_splat_filter(name, of_what, given)
    assert built is not None
    return native_filter(built)
