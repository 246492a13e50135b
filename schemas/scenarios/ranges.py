"""Ranges of a scenario that depend on several of its keys.

Each check raises a UsageError whose message has the path of the key.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise
from typing import Any

import msgspec

from alula.schemas.errors import UsageError
from alula.schemas.parameters.filter_options import TABLES
from alula.schemas.parameters.flight_defaults import NO_FILTER
from alula.schemas.scenarios.moving import interval
from alula.schemas.scenarios.tables import (
    EstimationTable,
    MissionTable,
    RulesTable,
    SafetyTable,
    VehicleTable,
    WorldTable,
)
from alula.schemas.scenarios.types import LARGEST
from alula.schemas.toml_file import first_beyond

MOST_LATENCY = 32
"""Ticks of the geofence's latency: ALULA_GEOFENCE_LATENCY of native/onboard."""
FARTHEST_M = 1e4
"""Bound of a fence [m]: ALULA_FENCE_FAR of native/onboard."""

# Keys that may be infinite; parameters of filters may be so where their default is.
_UNLIMITED = (
    *("vehicle.max_speed_m_s", "vehicle.max_acceleration_m_s2", "vehicle.max_jerk_m_s3"),
    "estimation.stale_s",
)

_STARTS = ("goal", "waypoints", "hover", "pilot")
_WAYS = ("pairs", "goal", "waypoints")
# The missions that use a key; all use the others.
USED: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(("start_m", "start_velocity_m_s"), (*_STARTS, "plan")),
    "start_speed_m_s": ("goal", "waypoints", "pilot"),
    "start_yaw_deg": ("hover", "pilot"),
    "goal_m": ("goal",),
    "waypoints_m": ("waypoints",),
    **dict.fromkeys(("start_box_m", "start_tilt_deg", "pilot"), ("pilot",)),
    **dict.fromkeys(("plan", "allow_tight", "allow_other_map", "waits"), ("plan",)),
    **dict.fromkeys(("pairs_from", "bounds_m", "margin_m", "separation", "which"), ("pairs",)),
    "planned": _WAYS,
    **dict.fromkeys(("via_tolerance_m", "stop_fraction"), (*_WAYS, "plan")),
}
"""The missions that use a key; all missions use the others."""
_SAMPLING = ("bounds_m", "margin_m", "separation", "which")


def require(good: bool, where: str, words: str) -> None:
    """Refuse a value unless it is good.

    Args:
        where: path of its key.
        words: the rest of the sentence after the path.
    """
    if not good:
        raise UsageError(f"`$.{where}` {words}")


_PLAIN = (str, int)


@cache
def _fields(table: type[msgspec.Struct]) -> tuple[Any, ...]:
    """Fields of a table; msgspec evaluates all annotations for each call."""
    return msgspec.structs.fields(table)


def check_finite(table: msgspec.Struct, path: str = "") -> None:
    """Refuse numbers that are not finite, but infinity where it stands for no limit.

    Args:
        path: of the table, with a dot at its end.
    """
    for item in _fields(type(table)):
        value, where = getattr(table, item.name), path + item.encode_name
        if isinstance(value, msgspec.Struct):
            check_finite(value, f"{where}.")
        elif isinstance(value, tuple) and value and isinstance(value[0], msgspec.Struct):
            for i, row in enumerate(value):
                check_finite(row, f"{where}[{i}].")
        elif (
            value is None or isinstance(value, _PLAIN) or (isinstance(value, float) and math.isfinite(value))
        ):
            continue
        elif value != math.inf or not (where in _UNLIMITED or item.default == math.inf):
            wrong = first_beyond(msgspec.to_builtins(value), f"$.{where}", math.inf)
            if wrong:
                raise UsageError(f"{wrong} must be a finite number")


def check_vehicle_table(table: VehicleTable) -> None:
    """Refuse a name and a file at once."""
    require(
        table.type is None or table.file is None, "vehicle.file", "and `$.vehicle.type`: give one of the two"
    )


def check_world_table(table: WorldTable) -> None:
    """Check levels, fence, walls and moving obstacles."""
    require(
        table.confidence is None or table.sigma == WorldTable().sigma,
        "world.confidence",
        "sets sigma; give one of the two, not both",
    )
    if table.fence is not None:
        fence = table.fence
        require(fence.box_m is not None or bool(fence.faces), "world.fence", "needs box_m or faces")
        _check_box("world.fence.box_m", fence.box_m, FARTHEST_M * (1 + 1e-12))
        for i, face in enumerate(fence.faces):
            length, where = math.hypot(*face[:3]), f"world.fence.faces[{i}]"
            require(1e-3 <= length <= 1e3, where, f"needs a normal, and n has the length {length:.4g}")
            require(abs(face[3]) <= FARTHEST_M * length, where, f"is farther than {FARTHEST_M:g} m")
    for name in ("moving", "walls"):
        if wrong := first_beyond(msgspec.to_builtins(getattr(table, name)), f"$.world.{name}", LARGEST):
            raise UsageError(f"{wrong} must be below {LARGEST:g}")
    for i, wall in enumerate(table.walls):
        below = all(low < high for low, high in zip(wall.lower_m, wall.upper_m, strict=True))
        require(below, f"world.walls[{i}].upper_m", "must be above lower_m on each axis")
    for i, obstacle in enumerate(table.moving):
        for key in ("azimuth_rad", "elevation_rad", "speed_m_s", "heading_rad", "acceleration_m_s2"):
            low, high = interval(getattr(obstacle, key))
            require(low <= high, f"world.moving[{i}].{key}", "must be a number, or two that increase")
        require(interval(obstacle.speed_m_s)[0] >= 0, f"world.moving[{i}].speed_m_s", "must be >= 0")


def _check_box(where: str, box: tuple[float, ...] | None, limit: float) -> None:
    if box is None:
        return
    if wrong := first_beyond(list(box), f"$.{where}", limit):
        raise UsageError(f"{wrong} must be at most {limit:g} m")
    proper = all(low < high for low, high in zip(box[:3], box[3:], strict=True))
    require(proper, where, "needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX")


def check_mission_table(table: MissionTable) -> None:
    """Refuse keys of other missions, and those that contradict each other."""
    default = MissionTable()
    for key, kinds in USED.items():
        given = getattr(table, key) != getattr(default, key)
        words = f"is for missions of kind {' or '.join(kinds)}, and this one is {table.kind}"
        require(not given or table.kind in kinds, f"mission.{key}", words)
    boxed = table.start_box_m is not None
    require(not boxed or table.start_m is None, "mission.start_box_m", "and start_m: give one of the two")
    for key in ("start_velocity_m_s", "start_yaw_deg") if boxed else ("start_tilt_deg",):
        unset = getattr(table, key) == getattr(default, key)
        require(unset, f"mission.{key}", f"goes with {'start_m' if boxed else 'start_box_m'}")
    drawn = table.kind != "pilot" or boxed or table.start_speed_m_s == default.start_speed_m_s
    require(drawn, "mission.start_speed_m_s", "of a pilot goes with start_box_m; give start_velocity_m_s")
    both = table.start_velocity_m_s is not None and table.start_speed_m_s != default.start_speed_m_s
    require(not both, "mission.start_speed_m_s", "and start_velocity_m_s: give one of the two")
    _check_box("mission.start_box_m", table.start_box_m, FARTHEST_M)
    _check_box("mission.bounds_m", table.bounds_m, LARGEST)
    if table.pairs_from is not None:
        for key in _SAMPLING:
            unset = getattr(table, key) == getattr(default, key)
            require(unset, f"mission.{key}", "is for random pairs; leave it out with pairs_from")
    same = table.kind == "goal" and table.start_m is not None and table.start_m == table.goal_m
    require(not same, "mission.goal_m", "is the start; a mission of kind hover stays there")
    points = [table.start_m, *table.waypoints_m]
    for i, (before, after) in enumerate(pairwise(points)):
        require(before != after, f"mission.waypoints_m[{i}]", "is the point before it")
    controller = table.controller
    unguided = controller.guide == NO_FILTER and bool(controller.guide_parameters)
    require(not unguided, "mission.controller.guide_parameters", "is for a guide, and there is none")
    _check_outage("mission.pilot.radio", table.pilot.radio_from_s, table.pilot.radio_for_s)


def _check_outage(what: str, begins_s: float | None, lasts_s: float | None) -> None:
    name = what.rpartition(".")[2]
    require(begins_s is not None or lasts_s is None, f"{what}_for_s", f"needs {name}_from_s")


def check_estimation_table(table: EstimationTable) -> None:
    """Check outages, sensor and tracker."""
    _check_outage("estimation.lost", table.lost_from_s, table.lost_for_s)
    estimated_s = table.disturbance_time_s
    fits = estimated_s == 0 or estimated_s >= 0.05
    require(fits, "estimation.disturbance_time_s", "must be 0 or at least 0.05")
    require(table.sensor.delay_s <= 10, "estimation.sensor.delay_s", "must be at most 10")
    tracker = table.tracker
    fits = tracker.confirm_hits <= tracker.confirm_scans
    require(fits, "estimation.tracker.confirm_hits", "is above confirm_scans")


def check_safety_table(table: SafetyTable, dt_s: float) -> None:
    """Check the list of filters, and parameters that depend on each other or on the time step.

    Args:
        dt_s: duration of a time step [s].
    """
    names = table.filters
    require(NO_FILTER not in names, "safety.filters", "has none beside others")
    require(len(set(names)) == len(names), "safety.filters", "has a filter twice")
    require(all(name.strip() for name in names), "safety.filters", "has an empty name")
    if "polytope-cbf" in names:
        beta = table.polytope_cbf.beta
        words = f"must be at most 1 / dt_s = {1 / dt_s:g}, not {beta:g}"
        require(beta * dt_s <= 1 + 1e-12, "safety.polytope-cbf.beta", words)
    values = table.geofence
    require(values.slow_m_s <= values.fast_m_s, "safety.geofence.fast_m_s", "must not be below slow_m_s")
    if any(TABLES.get(name) == "geofence" for name in names):
        most = MOST_LATENCY * values.tick_s
        words = f"is above {MOST_LATENCY} calls of the filter, {most:g} s"
        require(values.latency_s <= most, "safety.geofence.latency_s", words)


def check_rules_table(table: RulesTable) -> None:
    """Check the duration of a flight."""
    if table.max_time_s is not None:
        require(table.max_time_s >= table.dt_s, "rules.max_time_s", "is below dt_s")
        ticks = table.max_time_s / table.dt_s
        require(ticks <= 1e7, "rules.max_time_s", f"has {ticks:.3g} time steps, more than 10,000,000")


def check_speeds(vehicle: VehicleTable, mission: MissionTable) -> None:
    """Refuse a mission that is faster than the limit that the scenario itself sets."""
    limit = math.inf if vehicle.max_speed_m_s is None else vehicle.max_speed_m_s
    for key in ("speed_m_s", "start_speed_m_s"):
        speed = getattr(mission, key)
        require(speed is None or speed <= limit, f"mission.{key}", "is above vehicle.max_speed_m_s")
