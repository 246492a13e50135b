"""World, vehicle and filters of a scenario as native parts, before its missions are made."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.tiles import TileFiles
from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.parameters.filter_options import FILTERS
from alula.schemas.parameters.flight_defaults import NO_FILTER
from alula.schemas.scenarios.check import refusal
from alula.schemas.scenarios.defaults import completed, vehicle_of
from alula.schemas.scenarios.scenario import Scenario, decoded
from alula.schemas.scenarios.vehicle import Vehicle
from alula.schemas.scenarios.vehicles import DEFAULT_SPEED_M_S, PLAN_SPEED_FACTOR
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.filtering.registry import filter_kind
from alula.stages.planning.behind import Behind
from alula.stages.planning.plan_samples import curve_of
from alula.stages.world.behind import flown_behind, undisturbed
from alula.stages.world.filters import filter_world, needs_image, needs_index, safety_filters
from alula.stages.world.obstacles import StaticWorld, require_named, static_world
from alula.stages.world.vehicle import known_vehicle, vehicle_spec, velocity_lags_s

PLANT_STEP_S = 1e-3  # longest step of the plant by default, and period of the modelled rate loop [s]
_PLANNED_RADII = 6  # plans keep to a box around the hulls that is 3 radii larger


class WorldFiles(TypedDict, total=False):
    """Files of a world by role; those that the scenario does not name are left out, or None."""

    cover: Artifact | None
    scene: Artifact | None
    seen: Artifact | None
    plan: Artifact | None
    tiles: TileFiles | None


@dataclass(frozen=True, slots=True)
class World:
    """What does not depend on the missions.

    Attributes:
        static: obstacles that do not move.
        told: what the filters were built for.
        spec, options: what the computer on board knows.
        filters: native, in their order.
        names: of the scenario's filters, in their order; the guide of the controller before them.
        peak_m_s: peak speed of the references [m/s].
        max_speed_m_s: limit of velocity commands [m/s].
        lag_s: with which velocities are followed along x, y, z [s].
    """

    scenario: Scenario
    vehicle: Vehicle
    static: StaticWorld
    told: FilterWorld
    spec: _core.VehicleSpec
    options: _core.FlightOptions
    filters: list[_core.SafetyFilter]
    names: list[str]
    peak_m_s: float
    max_speed_m_s: float
    lag_s: tuple[float, float, float]

    @property
    def is_point(self) -> bool:
        """Whether the vehicle is moved by velocities."""
        return self.vehicle.model == "single-integrator"

    @property
    def guides(self) -> int:
        """Number of guides before the filters."""
        return len(self.names) - len(self.scenario.safety.filters)

    @property
    def known(self) -> dict[str, Any]:
        """What the computer on board knows of the vehicle, see `known_vehicle`."""
        return known_vehicle(
            self.scenario,
            self.vehicle,
            peak_m_s=self.peak_m_s,
            max_speed_m_s=self.max_speed_m_s,
            lag_s=self.lag_s,
        )

    def behind(self) -> Behind | None:
        """How a plan is flown for its planner; None without filters."""
        if not self.scenario.safety.filters:
            return None
        return flown_behind(
            self.scenario,
            self.filters,
            self.guides,
            vehicle_spec(
                undisturbed(self.scenario),
                self.vehicle,
                peak_m_s=self.peak_m_s,
                max_speed_m_s=self.max_speed_m_s,
                lag_s=self.lag_s,
            ),
            self.options,
            plant_steps=plant_steps_of(self.scenario, is_point=self.is_point),
            max_speed_m_s=self.max_speed_m_s,
        )


def make_world(
    scenario: Scenario,
    vehicle: Vehicle | None = None,
    *,
    ends: FloatArray | None = None,
    max_speed_m_s: float | None = None,
    lag_s: tuple[float, float, float] | None = None,
    jobs: int = 0,
    **files: Unpack[WorldFiles],
) -> World:
    """Make them.

    Args:
        vehicle: of the file that it names; default: the one built in by its name.
        ends: starts and goals of the run that it names, or corners of the flight's fence, shape (N, 3) [m].
        max_speed_m_s: limit of velocity commands of a real flight; default: that of the scenario [m/s].
        lag_s: with which a real vehicle follows them along x, y, z; default: that of the scenario [s].
        **files: those that the scenario names.

    Raises:
        UsageError: parts that make no sense together, in one sentence with what would work instead; or values
            that are inconsistent.
        InputError: files do not fit each other.
        ArtifactError: planes and vertices of the cover do not describe the same polytopes.
    """
    if vehicle is None:
        vehicle = vehicle_of(scenario, Path())
    tiles, plan = files.pop("tiles", None), files.pop("plan", None)
    cover, scene, seen = files.get("cover"), files.get("scene"), files.get("seen")
    require_named(scenario, cover=cover, scene=scene, seen=seen, plan=plan)
    if (tiles is None) != (scenario.world.tiles is None):
        raise UsageError("`$.world.tiles`: the tiles that the scenario names must be given, and no others")
    foreign = {name: filter_kind(name) for name in scenario.safety.filters if name not in FILTERS}
    if words := refusal(scenario, vehicle, foreign):
        raise UsageError(words)
    full = completed(scenario, vehicle)
    mission = full.mission
    peak, most = _speeds(full, vehicle, plan)
    most = most if max_speed_m_s is None else max_speed_m_s
    lag_s = lag_s or velocity_lags_s(full, vehicle, most)
    names = list(full.safety.filters)
    if mission.controller.guide != "none":
        names.insert(0, mission.controller.guide)
    world = static_world(
        full,
        cover=cover,
        scene=scene,
        seen=seen,
        tiles=tiles,
        beyond_map_m=max(mission.beyond_map_m, 0.0 if plan is None else plan.manifest.beyond_map_m),  # type: ignore[attr-defined]
        needs_image=full.world.onboard or needs_image(full),
        needs_index=needs_index(full, names),
        jobs=jobs,
    )
    spec = vehicle_spec(full, vehicle, peak_m_s=peak, max_speed_m_s=most, lag_s=lag_s)
    extent = _extent(full, world, most, max(lag_s), ends, plan)
    known_m_s = most if math.isfinite(most) else PLAN_SPEED_FACTOR * peak  # a point may have no limit
    told = filter_world(full, vehicle, world, speed_m_s=peak, max_speed_m_s=known_m_s, extent_m=extent)
    return World(
        scenario=full,
        vehicle=vehicle,
        static=world,
        told=told,
        spec=spec,
        options=_options(full),
        filters=safety_filters(full, told, lag_s),
        names=names,
        peak_m_s=peak,
        max_speed_m_s=most,
        lag_s=lag_s,
    )


def behind_filters(
    config: PlanConfig,
    vehicle: Vehicle,
    *,
    cover: Artifact | None = None,
    scene: Artifact | None = None,
    within: Artifact | None = None,
    jobs: int = 0,
) -> Behind | None:
    """How `simulate` flies a plan behind filters that keep the vehicle's radius, for its planner.

    Args:
        config: with the names of the filters.

    Returns:
        None for the filter `none`.

    Raises:
        UsageError: there is no such filter, or it does not fit the vehicle or the maps.
    """
    names = [name.strip() for name in (config.filter or NO_FILTER).split(",")]
    maps = {"cover": cover, "scene": scene, "seen": within}
    level = {"sigma": config.sigma, "confidence": config.confidence, "inflation_m": config.inflation_m}
    is_followed = vehicle.model == "quadrotor" and config.interface not in (None, "body-rates")
    followed = {"interface": config.interface} if is_followed else {}
    tree = {
        "vehicle": {"file": vehicle.name} | followed,
        "world": {role: role for role, each in maps.items() if each is not None}
        | {key: value for key, value in level.items() if value is not None},
        "mission": {"planned": True, "speed_m_s": config.speed_m_s},
        "safety": {"filters": [] if names == [NO_FILTER] else names},
    }
    try:
        scenario = decoded(tree, "--filter")
        return make_world(scenario, vehicle, cover=cover, scene=scene, seen=within, jobs=jobs).behind()
    except UsageError as error:
        raise UsageError(f"--filter {config.filter}: {str(error).removeprefix('--filter: ')}") from error


def _options(scenario: Scenario) -> _core.FlightOptions:
    rules, known = scenario.rules, scenario.estimation
    if known.disturbance_time_s and scenario.vehicle.interface not in ("wrench", "body-rates"):
        raise UsageError(
            "`$.estimation.disturbance_time_s`: disturbances are estimated for a quadrotor that is commanded "
            "by wrench or body-rates"
        )
    return _core.FlightOptions(
        dt_s=rules.dt_s,
        controller_ticks=rules.controller_ticks,
        filter_ticks=rules.filter_ticks,
        stale_s=min(known.stale_s, 1e3),
        has_losses=has_losses(scenario),
        disturbance_time_s=known.disturbance_time_s,
    )


def has_losses(scenario: Scenario) -> bool:
    """Whether measurements can be missing."""
    return scenario.estimation.lost_share > 0 or scenario.estimation.lost_from_s is not None


def plant_steps_of(scenario: Scenario, *, is_point: bool) -> int:
    """Number of steps of the plant in a time step: the given one, or as many as keep them within 1 ms.

    One is exact for a point whose velocity is held, where nothing else moves.
    """
    if scenario.rules.plant_steps is not None:
        return scenario.rules.plant_steps
    if is_point and not scenario.world.moving and not scenario.estimation.delay_s:
        return 1
    return max(1, math.ceil(scenario.rules.dt_s / PLANT_STEP_S - 1e-9))


def _speeds(scenario: Scenario, vehicle: Vehicle, plan: Artifact | None) -> tuple[float, float]:
    """Peak speed of the references, and limit of velocity commands [m/s]."""
    mission, limit = scenario.mission, scenario.vehicle.max_speed_m_s
    is_point = vehicle.model == "single-integrator"
    if mission.kind == "plan" and plan is not None:
        peak = float(plan.manifest.speed_m_s)  # type: ignore[attr-defined]
        fast = limit if is_point and limit else PLAN_SPEED_FACTOR * peak
    else:
        peak = mission.speed_m_s or (limit if is_point and limit else None) or (DEFAULT_SPEED_M_S)
        fast = peak if is_point else PLAN_SPEED_FACTOR * peak
        if mission.planned and is_point:
            peak /= PLAN_SPEED_FACTOR
    if vehicle.model == "double-integrator":
        return peak, math.inf if limit is None else limit
    fast += _lead_m_s(scenario, plan)
    return peak, fast if limit is None else min(fast, limit)


def _lead_m_s(scenario: Scenario, plan: Artifact | None) -> float:
    """How much faster than a plan set-points of the velocity are that lead by its acceleration [m/s]."""
    table, mission = scenario.vehicle, scenario.mission
    if table.interface not in ("wrench", "body-rates") or table.velocity_gain_per_s is None:
        return 0.0
    if mission.planned:
        return PlanConfig().acceleration_m_s2 / table.velocity_gain_per_s
    limits: dict[str, float] = {} if plan is None else plan.manifest.limits  # type: ignore[attr-defined]
    return limits.get("acceleration_m_s2", 0.0) / table.velocity_gain_per_s


def _extent(
    scenario: Scenario,
    world: StaticWorld,
    most: float,
    lag_s: float,
    ends: FloatArray | None,
    plan: Artifact | None,
) -> float:
    """Bound of the coordinates of all positions, by all points that are known beforehand [m]."""
    mission = scenario.mission
    given = [mission.start_m, mission.goal_m, *mission.waypoints_m]
    points = [np.array([point]) for point in given if point is not None]
    for box in (mission.bounds_m, mission.start_box_m):
        if box is not None:
            points.append(np.array(box).reshape(2, 3))
    if ends is not None:
        points.append(ends)
    if plan is not None:
        curve = curve_of(plan)
        points.append(curve.at(np.linspace(0, curve.duration_s, 256))[:, :3])
    return world.extent_m(
        points,
        speed_m_s=most if math.isfinite(most) else 10.0,
        lag_s=lag_s,
        radii=_PLANNED_RADII if mission.planned else 1,
    )
