"""The parts of a scenario of version 2.0, made into a native simulation that is ready to fly."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from alula import _core
from alula.schemas.artifact import Artifact
from alula.schemas.configs.plan import PlanConfig
from alula.schemas.errors import UsageError
from alula.schemas.filter_options import FILTERS
from alula.schemas.progress import Progress
from alula.schemas.vehicle import Vehicle
from alula.schemas.vehicles import DEFAULT_SPEED_M_S, PLAN_SPEED_FACTOR
from alula.schemas.world import WorldScenario
from alula.schemas.world_check import refusal
from alula.schemas.world_defaults import completed, vehicle_of
from alula.stages.filtering.polytope_cbf import barrier
from alula.stages.filtering.registry import filter_kind
from alula.stages.planning.adherence import FINISHED_M_S, PlanJudge, require_room, via_tolerance
from alula.stages.planning.plan_samples import curve_of, sample_plan
from alula.stages.simulation.moving import moving_spec
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.world.among_hulls import note_of_psi
from alula.stages.simulation.world.behind import behind, undisturbed
from alula.stages.simulation.world.encounters import seen_by
from alula.stages.simulation.world.filters import (
    filter_world,
    needs_image,
    risk_window_s,
    safety_filters,
    watcher,
)
from alula.stages.simulation.world.judge import WorldJudge
from alula.stages.simulation.world.piloted import is_fenced, pilots_geofence, start_h_i
from alula.stages.simulation.world.prepared_run import PreparedRun
from alula.stages.simulation.world.tasks import Missions, missions_of
from alula.stages.simulation.world.vehicle import vehicle_spec, velocity_lags_s
from alula.stages.simulation.world.world import StaticWorld, require_named, static_world

_PLANT_STEP_S = 1e-3
_STUCK_S = 2.0
_STUCK_POINT_S = 1.0
_FAR_M = 1e9  # beyond every position
_PLANNED_RADII = 6  # plans keep to a box around the hulls that is 3 radii larger


def prepare(
    scenario: WorldScenario,
    vehicle: Vehicle | None = None,
    *,
    cover: Artifact | None = None,
    scene: Artifact | None = None,
    seen: Artifact | None = None,
    plan: Artifact | None = None,
    pairs: Pairs | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> PreparedRun:
    """Make all parts of a run.

    Args:
        scenario: as read.
        vehicle: of the file that it names; default: the one built in by its name.
        cover: that it names.
        scene: that it names.
        seen: space that it names.
        plan: that it names.
        pairs: starts and goals of the run that it names.
        jobs: threads, 0 for all processors.
        progress: of planning.

    Raises:
        UsageError: parts that make no sense together, in one sentence with what would work instead; or values
            that are inconsistent.
        InputError: files do not fit each other.
        ArtifactError: planes and vertices of the cover do not describe the same polytopes.
        InfeasibleError: no clear start-goal pairs were found.
    """
    if vehicle is None:
        vehicle = vehicle_of(scenario, Path())
    require_named(scenario, cover=cover, scene=scene, seen=seen, plan=plan)
    foreign = {name: filter_kind(name) for name in scenario.safety.filters if name not in FILTERS}
    if words := refusal(scenario, vehicle, foreign):
        raise UsageError(words)
    full = completed(scenario, vehicle)
    rules, mission, table = full.rules, full.mission, full.vehicle
    assert table.radius_m is not None
    peak, most = _speeds(full, vehicle, plan)
    lag_s = velocity_lags_s(full, vehicle, most)
    names = list(full.safety.filters)
    if mission.controller.guide != "none":
        names.insert(0, mission.controller.guide)
    world = static_world(
        full,
        radius_m=table.radius_m,
        cover=cover,
        scene=scene,
        seen=seen,
        needs_image=full.world.onboard or needs_image(full),
        jobs=jobs,
    )
    spec = vehicle_spec(full, vehicle, peak_m_s=peak, max_speed_m_s=most, lag_s=lag_s)
    extent = _extent(full, world, most, max(lag_s), pairs, plan)
    known_m_s = most if math.isfinite(most) else PLAN_SPEED_FACTOR * peak  # a point may have no limit
    told = filter_world(full, vehicle, world, speed_m_s=peak, max_speed_m_s=known_m_s, extent_m=extent)
    filters = safety_filters(full, told, lag_s)
    geofence = pilots_geofence(full, told)
    judging = geofence if is_fenced(full, told) else None
    if judging is not None and not filters:
        filters = [_core.FenceFilter(judging, is_bare=True)]  # tells the figures of a flight without a filter
    among = None
    if world.hulls is not None and ("polytope-cbf" in names or full.vehicle.interface == "velocity"):
        among = barrier(told)
    options, is_point = _options(full), vehicle.model == "single-integrator"
    flown_behind = None
    if mission.planned:
        still = undisturbed(full)
        flown_behind = behind(
            full,
            filters,
            int(mission.controller.guide != "none"),
            vehicle_spec(still, vehicle, peak_m_s=peak, max_speed_m_s=most, lag_s=lag_s),
            options,
            plant_steps=plant_steps_of(full, is_point=is_point),
            max_speed_m_s=most,
        )
    missions = missions_of(
        full,
        world,
        count=_count(full, pairs),
        speed_m_s=peak,
        max_speed_m_s=most,
        plan=plan,
        cover=cover,
        scene=scene,
        vehicle=vehicle,
        behind=flown_behind,
        given=pairs,
        geofence=geofence,
        psi=None if among is None else lambda points: among.psi(points, jobs=jobs)[1],
        jobs=jobs,
        progress=progress,
    )
    # References and ellipsoids are compared with rows of ticks; a point's motion is that from tick to tick.
    by_ticks = any(missions.curves) or is_point or world.ellipsoids is not None
    simulation, bare = (
        _core.SimulationSpec(
            spec,
            options=options,
            rules=_rules(full, world, missions, most_m_s=most, is_point=is_point, **kept),
            losses=_losses(full),
            moving=moving_spec(
                full.world.moving,
                full.estimation.sensor,
                full.estimation.tracker,
                yaw_rate_rad_s=full.estimation.sensor.yaw_rate_rad_s,
            ),
            fence=judging,
            watcher=watcher(full, told),
        )
        for kept in (
            {"keeps_path": True, "keeps_ticks": True},
            {
                "keeps_path": world.polytopes is not None or bool(world.parts) or mission.kind == "plan",
                "keeps_ticks": by_ticks,
            },
        )
    )
    judge = WorldJudge(
        world=world,
        filters=names,
        guides=int(mission.controller.guide != "none"),
        has_goal=mission.kind not in ("hover", "pilot"),
        obstacle_radii_m=[one.radius_m for one in full.world.moving],
        seen_by=seen_by(full),
        via_tolerance_m=via_tolerance(mission.via_tolerance_m, table.radius_m),
        dt_s=rules.dt_s,
        by_ticks=by_ticks,
        is_point=is_point,
        jobs=jobs,
    )
    flown_plan = judge.of_plan(plan if mission.kind == "plan" else None)
    notes = [] if flown_plan is None else _notes(full, world, names, flown_plan, among, plan)

    def of_trial(index: int) -> PlanJudge | None:
        return flown_plan if flown_plan is not None else judge.of_plan(missions.plans[index])

    return PreparedRun(
        scenario=full,
        vehicle=vehicle,
        world=world,
        told=told,
        missions=missions,
        vehicle_spec=spec,
        options=options,
        spec=simulation,
        bare=bare,
        filters=filters,
        names=names,
        judge=judge,
        plans=of_trial,
        start_h_i_m=start_h_i(full, geofence),
        among=among,
        start_margin_m=None
        if among is None
        else among.psi(np.ascontiguousarray(missions.start), jobs=jobs)[1] - world.hull_keep_m,
        notes=notes,
    )


def _options(scenario: WorldScenario) -> _core.FlightOptions:
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
        has_losses=_has_losses(scenario),
        disturbance_time_s=known.disturbance_time_s,
    )


def _has_losses(scenario: WorldScenario) -> bool:
    return scenario.estimation.lost_share > 0 or scenario.estimation.lost_from_s is not None


def _rules(
    scenario: WorldScenario,
    world: StaticWorld,
    missions: Missions,
    *,
    most_m_s: float,
    is_point: bool,
    keeps_path: bool,
    keeps_ticks: bool,
) -> _core.SimulationRules:
    """When a flight ends, where it may be, and what of it is kept."""
    paths = [missions.start, missions.goal]
    paths += [curve.at(np.linspace(0, curve.duration_s, 64))[:, :3] for curve in missions.curves[:1] if curve]
    moving, has_pilot = scenario.world.moving, scenario.mission.kind == "pilot"
    lower, upper = world.room(paths, has_moving=bool(moving))
    if has_pilot:  # without a reference near which the flight must stay
        lower, upper = (-_FAR_M,) * 3, (_FAR_M,) * 3
    waits = scenario.mission.receded_s is not None  # for what moves, and not for the goal
    stuck_s = _STUCK_POINT_S if is_point else _STUCK_S
    return _core.SimulationRules(
        plant_steps=plant_steps_of(scenario, is_point=is_point),
        **({"stop_speed_m_s": FINISHED_M_S} if scenario.mission.waits else {}),
        stuck_ticks=max(1, round(stuck_s / scenario.rules.dt_s)),
        stuck_speed_m_s=1e-3 * most_m_s if is_point else 0.02,
        receded_s=math.inf if scenario.mission.receded_s is None else scenario.mission.receded_s,
        lower=lower,
        upper=upper,
        ends_when_refused=not (moving or waits or _has_losses(scenario) or has_pilot),
        ends_at_goal=not waits,
        risk_window_s=risk_window_s(scenario),
        keeps_path=keeps_path,
        keeps_ticks=keeps_ticks,
    )


def _notes(
    scenario: WorldScenario,
    world: StaticWorld,
    names: list[str],
    flown: PlanJudge,
    among: _core.PolytopeCbf | None,
    plan: Artifact | None,
) -> list[str]:
    """Warnings of a plan with less clearance than the filters keep; refused unless that is allowed."""
    if not names:
        return []
    sets = [each for each in (world.polytopes, world.ellipsoids) if each is not None]
    keeps: list[float | None] = [
        world.hull_keep_m
        if each is world.polytopes
        else None
        if names == ["polytope-cbf"]  # it does not see them
        else world.keep_m
        for each in sets
    ]
    notes = require_room(
        flown,
        keeps,
        " + ".join(names),
        allow_tight=scenario.mission.allow_tight,
        insist="--set mission.allow_tight=true",
    )
    if among is not None and "polytope-cbf" in names and not notes:
        assert plan is not None
        notes = note_of_psi(sample_plan(plan, scenario.rules.dt_s), among, world.hull_keep_m)
    return notes


def plant_steps_of(scenario: WorldScenario, *, is_point: bool) -> int:
    """Number of steps of the plant in a time step: the given one, or as many as keep them within 1 ms.

    One is exact for a point whose velocity is held, where nothing else moves.

    Args:
        scenario: completed.
        is_point: whether the vehicle is a single integrator.
    """
    if scenario.rules.plant_steps is not None:
        return scenario.rules.plant_steps
    if is_point and not scenario.world.moving and not scenario.estimation.delay_s:
        return 1
    return max(1, math.ceil(scenario.rules.dt_s / _PLANT_STEP_S - 1e-9))


def _speeds(scenario: WorldScenario, vehicle: Vehicle, plan: Artifact | None) -> tuple[float, float]:
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


def _lead_m_s(scenario: WorldScenario, plan: Artifact | None) -> float:
    """How much faster than a plan set-points of the velocity are that lead by its acceleration [m/s]."""
    table, mission = scenario.vehicle, scenario.mission
    if table.interface not in ("wrench", "body-rates") or table.velocity_gain_per_s is None:
        return 0.0
    if mission.planned:
        return PlanConfig().acceleration_m_s2 / table.velocity_gain_per_s
    limits: dict[str, float] = {} if plan is None else plan.manifest.limits  # type: ignore[attr-defined]
    return limits.get("acceleration_m_s2", 0.0) / table.velocity_gain_per_s


def _count(scenario: WorldScenario, pairs: Pairs | None) -> int:
    if scenario.rules.trials is not None:
        return scenario.rules.trials
    if scenario.mission.kind != "pairs":
        return 1
    return 100 if pairs is None else len(pairs.start)


def _extent(
    scenario: WorldScenario,
    world: StaticWorld,
    most: float,
    lag_s: float,
    pairs: Pairs | None,
    plan: Artifact | None,
) -> float:
    """Twice the largest coordinate known beforehand, and a second of flight; filters refuse beyond it [m]."""
    points = [world.vertices if scenario.world.has_hulls else world.centres]
    mission = scenario.mission
    given = [mission.start_m, mission.goal_m, *mission.waypoints_m]
    points += [np.array([point]) for point in given if point is not None]
    for box in (mission.bounds_m, mission.start_box_m):
        if box is not None:
            points.append(np.array(box).reshape(2, 3))
    if pairs is not None:
        points += [pairs.start, pairs.goal]
    if plan is not None:
        curve = curve_of(plan)
        points.append(curve.at(np.linspace(0, curve.duration_s, 256))[:, :3])
    speed = most if math.isfinite(most) else 10.0
    seconds = 1 + lag_s
    radii = _PLANNED_RADII if mission.planned else 1
    return (
        2 * float(np.abs(np.concatenate(points)).max(initial=1.0)) + radii * world.radius_m + seconds * speed
    )


def _losses(scenario: WorldScenario) -> _core.Losses:
    known, pilot = scenario.estimation, scenario.mission.pilot

    def outage(what: str, begins_s: float | None, lasts_s: float | None) -> dict[str, float]:
        if begins_s is None:
            return {}
        return {f"{what}from_s": begins_s, f"{what}for_s": 1e9 if lasts_s is None else lasts_s}

    return _core.Losses(
        share=known.lost_share,
        **outage("", known.lost_from_s, known.lost_for_s),
        **outage("radio_", pilot.radio_from_s, pilot.radio_for_s),
    )
