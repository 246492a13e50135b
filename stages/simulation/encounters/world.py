"""Native world, vehicle and filter of a scenario with moving obstacles."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.artifact import Artifact
from alula.schemas.encounter_filter import native_options
from alula.schemas.encounters import Encounters, WallTable
from alula.schemas.errors import UsageError
from alula.schemas.vehicle import FASTBRIDGE
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering.moving_filters import WALL_FRACTION
from alula.stages.simulation.moving import moving_spec
from alula.stages.vehicles.bodies import quadrotor

_FACES = np.concatenate([np.eye(3), -np.eye(3)])
_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)


def static_walls(walls: Sequence[WallTable], cover: Artifact | None) -> Hulls | None:
    """Join the hulls of a cover and the boxes of a scenario to one set; None when there are none.

    Args:
        walls: the boxes.
        cover: an `alula/cover`, in metres, if there is one.
    """
    parts = [_box(wall) for wall in walls]
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


def native_encounter(scenario: Encounters, *, keeps_path: bool, keeps_ticks: bool) -> _core.SimulationSpec:
    """Make the native simulation, all but the task and the filter.

    Args:
        scenario: all parameters.
        keeps_path: the path is kept, for a judge of the walls.
        keeps_ticks: a row per tick is kept, for the log.

    Raises:
        UsageError: values are inconsistent; the message has the path of their key.
    """
    body, run = scenario.vehicle, scenario.run
    moving = moving_spec(
        scenario.obstacles, scenario.sensor, scenario.tracker, yaw_rate_rad_s=body.yaw_rate_rad_s
    )
    try:
        vehicle = _core.VehicleSpec(
            quadrotor(FASTBRIDGE),  # a point has no rotors: any body
            model="double-integrator",
            interface="acceleration",
            max_speed_m_s=body.v_max_m_s,
            max_acceleration_m_s2=body.a_max_m_s2,
            max_jerk_m_s3=body.j_max_m_s3,
            actuation_delay_s=body.actuation_delay_s,
            radius_m=body.radius_m,
        )
        return _core.SimulationSpec(
            vehicle,
            options=_core.FlightOptions(dt_s=run.dt_s),
            rules=_core.SimulationRules(
                plant_steps=run.plant_steps,
                receded_s=scenario.encounter.receded_s,
                ends_when_refused=False,
                ends_at_goal=False,
                risk_window_s=scenario.filter.parameters.h_max_s,
                keeps_path=keeps_path,
                keeps_ticks=keeps_ticks,
            ),
            moving=moving,
        )
    except ValueError as error:
        raise UsageError(f"`$.encounter`: {error}") from error


def native_task(scenario: Encounters) -> _core.Task:
    """Make the task of every trial: start at the speed along the course, fly to the goal or hold the start.

    Args:
        scenario: all parameters.
    """
    encounter = scenario.encounter
    start = np.array(encounter.start_m, np.float64)
    way = np.array(encounter.goal_m, np.float64) - start
    course = np.array([1.0, 0.0, 0.0]) if encounter.hovers else 1 / math.sqrt(sum(way * way)) * way
    resting = 0.0 if encounter.hovers else encounter.cruise_m_s
    velocity = (resting if encounter.start_speed_m_s is None else encounter.start_speed_m_s) * course
    return _core.Task(
        np.concatenate([start, np.zeros(3), velocity, np.zeros(3)]),
        _core.Mission.to(
            encounter.start_m if encounter.hovers else encounter.goal_m,
            gain_per_s=encounter.gain_per_s,
            speed_m_s=encounter.cruise_m_s,
            hovers=encounter.hovers,
        ),
        max_time_s=scenario.run.max_time_s,
        expected_velocity_m_s=velocity.tolist(),
    )


def native_filter(scenario: Encounters, walls: _core.PolytopeSet | None = None) -> _core.MovingSafety:
    """Make the native filter.

    Args:
        scenario: all parameters.
        walls: static obstacles.

    Raises:
        UsageError: its parameters are inconsistent.
    """
    body = scenario.vehicle
    try:
        native = _core.moving_filter(scenario.filter.name.replace("-", "_"), filter_options(scenario))
    except ValueError as error:
        raise UsageError(f"`$.filter.parameters`: {error}") from error
    return _core.MovingSafety(
        native,
        None if walls is None else _core.HullMap(walls),
        max_speed_m_s=body.v_max_m_s,
        max_acceleration_m_s2=body.a_max_m_s2,
        radius_m=body.radius_m,
    )


def filter_options(scenario: Encounters) -> dict[str, float]:
    """All options of the native filter by name: those of the scenario, and its vehicle and time step.

    Args:
        scenario: all parameters.
    """
    body = scenario.vehicle
    options = {"wall_deceleration": WALL_FRACTION * body.a_max_m_s2} | native_options(
        scenario.filter.parameters
    )
    options |= {"dt_s": scenario.run.dt_s, "radius_m": body.radius_m}
    options |= {"a_max": body.a_max_m_s2, "v_max": body.v_max_m_s, "j_max": body.j_max_m_s3}
    return {key: float(value) for key, value in options.items()}
