"""The parts of a scenario, made into a native simulation that is ready to fly."""

from __future__ import annotations

import math
from typing import Unpack

import numpy as np

from alula import _core
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.progress import Progress
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.filtering.polytope_cbf import barrier
from alula.stages.planning.adherence import FINISHED_M_S, PlanJudge, require_room, via_tolerance
from alula.stages.planning.plan_samples import sample_plan
from alula.stages.simulation.among_hulls import note_of_psi
from alula.stages.simulation.encounters import risk_window_s, seen_by, watcher
from alula.stages.simulation.judge import WorldJudge
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.piloted import is_fenced, pilots_geofence, start_h_i
from alula.stages.simulation.planned import PlanMaps
from alula.stages.simulation.prepared_run import PreparedRun
from alula.stages.simulation.tasks import Missions, missions_of
from alula.stages.world.moving import moving_spec
from alula.stages.world.obstacles import StaticWorld
from alula.stages.world.world import WorldFiles, has_losses, make_world, plant_steps_of

_STUCK_S = 2.0
_STUCK_POINT_S = 1.0
_FAR_M = 1e9  # beyond every position


def prepare(
    scenario: Scenario,
    vehicle: Vehicle | None = None,
    *,
    pairs: Pairs | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
    **files: Unpack[WorldFiles],
) -> PreparedRun:
    """Make all parts of a run.

    Args:
        vehicle: of the file that it names; default: the one built in by its name.
        pairs: starts and goals of the run that it names.
        **files: those that the scenario names.

    Raises:
        UsageError: parts that make no sense together, in one sentence with what would work instead; or values
            that are inconsistent.
        InputError: files do not fit each other.
        ArtifactError: planes and vertices of the cover do not describe the same polytopes.
        InfeasibleError: no clear start-goal pairs were found.
    """
    ends = None if pairs is None else np.concatenate([pairs.start, pairs.goal])
    built = make_world(scenario, vehicle, ends=ends, jobs=jobs, **files)
    plan = files.get("plan")
    full, world, told, filters = built.scenario, built.static, built.told, built.filters
    rules, mission, table = full.rules, full.mission, full.vehicle
    assert table.radius_m is not None
    most, names = built.max_speed_m_s, built.names
    geofence = pilots_geofence(full, told)
    judging = geofence if is_fenced(full, told) else None
    if judging is not None and not filters:
        filters = [_core.FenceFilter(judging, is_bare=True)]  # tells the figures of a flight without a filter
    among = None
    if world.hulls is not None and ("polytope-cbf" in names or full.vehicle.interface == "velocity"):
        among = barrier(told)
    is_point = built.is_point
    missions = missions_of(
        full,
        world,
        count=_count(full, pairs),
        speed_m_s=built.peak_m_s,
        max_speed_m_s=most,
        plan=plan,
        maps=PlanMaps(files.get("cover"), files.get("scene"), files.get("seen"), world.among),
        vehicle=built.vehicle,
        behind=built.behind() if mission.planned else None,
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
            built.spec,
            options=built.options,
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
        guides=built.guides,
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
        vehicle=built.vehicle,
        world=world,
        told=told,
        missions=missions,
        vehicle_spec=built.spec,
        options=built.options,
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
        else among.psi(np.ascontiguousarray(missions.start), jobs=jobs)[1] - world.keeps_m("hulls"),
        notes=notes + missions.notes,
    )


def _rules(
    scenario: Scenario,
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
        ends_when_refused=not (moving or waits or has_losses(scenario) or has_pilot),
        ends_at_goal=not waits,
        risk_window_s=risk_window_s(scenario),
        keeps_path=keeps_path,
        keeps_ticks=keeps_ticks,
    )


def _notes(
    scenario: Scenario,
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
        world.keeps_m("hulls")
        if each is world.polytopes
        else None
        if names == ["polytope-cbf"]  # it does not see them
        else world.keeps_m("ellipsoids")
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
        notes = note_of_psi(sample_plan(plan, scenario.rules.dt_s), among, world.keeps_m("hulls"))
    return notes


def _count(scenario: Scenario, pairs: Pairs | None) -> int:
    if scenario.rules.trials is not None:
        return scenario.rules.trials
    if scenario.mission.kind != "pairs":
        return 1
    return 100 if pairs is None else len(pairs.start)


def _losses(scenario: Scenario) -> _core.Losses:
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
