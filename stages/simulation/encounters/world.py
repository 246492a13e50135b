"""The native world, vehicle and filter of a scenario with moving obstacles."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np

from alula import _core
from alula.schemas.artifact import Artifact
from alula.schemas.encounter_filter import native_options
from alula.schemas.encounters import Encounters, ObstacleTable, WallTable, interval
from alula.schemas.errors import UsageError
from alula.stages.compression.hulls import Hulls

_FACES = np.concatenate([np.eye(3), -np.eye(3)])
# Of the largest acceleration, with which a wall is reckoned to be stopped at. Below 1 / sqrt(3), so that the
# box holds what three walls at right angles ask for together, however they are turned.
WALL_SHARE = 0.56
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)


def static_walls(scenario: Encounters, cover: Artifact | None) -> Hulls | None:
    """The hulls of a cover and the boxes of a scenario as one set; None when there are none."""
    parts = [_box(wall) for wall in scenario.walls]
    if cover is not None:
        parts.insert(0, Hulls.from_cover(cover))
    if not parts:
        return None

    def starts(each: list[Any]) -> Any:
        lengths = np.concatenate([np.diff(start) for start in each])
        return np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)

    return Hulls(
        normal_world=np.concatenate([part.normal_world for part in parts]),
        offset_m=np.concatenate([part.offset_m for part in parts]),
        plane_start=starts([part.plane_start for part in parts]),
        vertices_world=np.concatenate([part.vertices_world for part in parts]),
        vertex_start=starts([part.vertex_start for part in parts]),
    )


def _box(wall: WallTable) -> Hulls:
    lower, upper = np.array(wall.lower_m, np.float64), np.array(wall.upper_m, np.float64)
    return Hulls(
        normal_world=_FACES.copy(),
        offset_m=np.concatenate([upper, -lower]),
        plane_start=np.array([0, 6], np.int64),
        vertices_world=lower + _CORNERS * (upper - lower),
        vertex_start=np.array([0, 8], np.int64),
    )


def native_encounter(scenario: Encounters, walls: _core.PolytopeSet | None) -> _core.EncounterSpec:
    """Everything but the filter.

    Raises:
        UsageError: numbers mean nothing together.
    """
    way, body, run = scenario.encounter, scenario.vehicle, scenario.run
    resting = 0.0 if way.hovers else way.cruise_m_s
    try:
        return _core.EncounterSpec(
            vehicle=_core.EncounterVehicle(
                start=way.start_m,
                goal=way.goal_m,
                start_speed_m_s=resting if way.start_speed_m_s is None else way.start_speed_m_s,
                cruise_m_s=way.cruise_m_s,
                gain=way.gain_per_s,
                radius_m=body.radius_m,
                max_speed_m_s=body.v_max_m_s,
                max_acceleration_m_s2=body.a_max_m_s2,
                max_jerk_m_s3=body.j_max_m_s3,
                actuation_delay_s=body.actuation_delay_s,
                hovers=way.hovers,
                yaw_rate_rad_s=body.yaw_rate_rad_s,
            ),
            rules=_core.EncounterRules(
                dt_s=run.dt_s,
                plant_steps=run.plant_steps,
                max_time_s=run.max_time_s,
                receded_s=way.receded_s,
                risk_window_s=scenario.filter.parameters.h_max_s,
            ),
            obstacles=[_obstacle(i, table) for i, table in enumerate(scenario.obstacles)],
            radar=_made(_core.RadarOptions, msgspec.structs.asdict(scenario.sensor), "sensor"),
            tracker=_tracker(scenario),
            walls=walls,
        )
    except ValueError as error:
        raise UsageError(f"`$.encounter`: {error}") from error


def _made(native: Any, values: dict[str, Any], where: str) -> Any:
    try:
        return native(**values)
    except ValueError as error:
        raise UsageError(f"`$.{where}`: {error}") from error


def _tracker(scenario: Encounters) -> _core.TrackerOptions:
    options: _core.TrackerOptions = _made(
        _core.TrackerOptions, msgspec.structs.asdict(scenario.tracker), "tracker"
    )
    _made(_core.Tracker, {"options": options}, "tracker")  # which is what looks at them
    return options


def _obstacle(index: int, table: ObstacleTable) -> _core.ObstacleSpec:
    values = msgspec.structs.asdict(table)
    position = values.pop("position_m")
    for key in ("azimuth_rad", "elevation_rad", "speed_m_s", "heading_rad", "acceleration_m_s2"):
        values[key] = interval(values[key])
    values |= {"kind": values.pop("motion"), "way_points": list(values.pop("way_points_m"))}
    values |= {"is_relative": position is None, "position": position or (0.0, 0.0, 0.0)}
    made: _core.ObstacleSpec = _made(_core.ObstacleSpec, values, f"obstacles[{index}]")
    return made


def native_filter(scenario: Encounters) -> _core.MovingFilter:
    """The filter with its parameters.

    Raises:
        UsageError: they mean nothing together.
    """
    try:
        return _core.moving_filter(scenario.filter.name.replace("-", "_"), filter_options(scenario))
    except ValueError as error:
        raise UsageError(f"`$.filter.parameters`: {error}") from error


def filter_options(scenario: Encounters) -> dict[str, float]:
    """All options of the native filter: those of the scenario, and what it knows of vehicle and time."""
    body = scenario.vehicle
    options = {"wall_deceleration": WALL_SHARE * body.a_max_m_s2} | native_options(scenario.filter.parameters)
    options |= {"dt_s": scenario.run.dt_s, "radius_m": body.radius_m}
    options |= {"a_max": body.a_max_m_s2, "v_max": body.v_max_m_s, "j_max": body.j_max_m_s3}
    return {key: float(value) for key, value in options.items()}
