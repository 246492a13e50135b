"""Simulation of a scenario of version 2.0: its parts together in one native loop, judged from the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import lru_cache, partial
from threading import Lock
from typing import Any
from uuid import uuid4

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifact import Artifact
from alula.schemas.configs.simulate import DEFAULT_SPEED_M_S
from alula.schemas.errors import InputError, UsageError
from alula.schemas.filter_options import FILTERS
from alula.schemas.progress import Progress
from alula.schemas.run import TrialResult
from alula.schemas.vehicle import Vehicle
from alula.schemas.world import WorldScenario
from alula.schemas.world_check import FILTER_COMMANDS, refusal
from alula.schemas.world_defaults import completed
from alula.stages.filtering.polytope_cbf import barrier
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.filtering.registry import filter_kind
from alula.stages.planning.adherence import PlanJudge, require_room, via_tolerance
from alula.stages.simulation.chunks import TrialJournal, fly_missing, shown
from alula.stages.simulation.moving import moving_spec
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.result import WorldFlight
from alula.stages.simulation.world.chunks import FlownChunk, RunParts, TrialChunk
from alula.stages.simulation.world.encounters import rows_of_obstacles, seen_by
from alula.stages.simulation.world.filters import filter_world, risk_window_s, safety_filters, watcher
from alula.stages.simulation.world.judge import WorldJudge, worst_clearance
from alula.stages.simulation.world.tasks import Missions, missions_of
from alula.stages.simulation.world.vehicle import vehicle_spec
from alula.stages.simulation.world.world import StaticWorld, static_world
from alula.stages.vehicles.racer import racer_model

CHUNK = 16  # trials whose full-rate samples are in memory at once
WORST = 3  # flights with the least clearance, which are always in the log
_PLANT_STEP_S = 1e-3
_STUCK_S = 2.0
_STUCK_POINT_S = 1.0
_PLAN_SPEED_FACTOR = 1.5  # leaves room to catch up with the plan


@dataclass(frozen=True, slots=True)
class WorldRun:
    """All trials of a scenario; what ends in `_s` is measured, the rest is not.

    Attributes:
        scenario: completed with the values of the vehicle.
        vehicle: that it names.
        trials: verdicts, in their order.
        flights: samples of those that the log shows: the first ones, and the worst.
        world: static obstacles.
        counts: of sampled points and pairs.
        notes: for the summary.
        filter_s: times of the filters, shape (F,) [s]: of `PreparedRun.filter_times`.
        tick_s: time of a tick on board, shape (T,) [s].
        command_s, reaction_s: of `FlownChunk`, shape (trials, n) with n moving obstacles [s].
    """

    scenario: WorldScenario
    vehicle: Vehicle
    trials: list[TrialResult]
    flights: list[WorldFlight]
    world: StaticWorld
    counts: dict[str, int]
    notes: list[str]
    filter_s: NDArray[np.float32]
    tick_s: NDArray[np.float32]
    command_s: FloatArray
    reaction_s: FloatArray


@dataclass(frozen=True, slots=True)
class PreparedRun:
    """A scenario ready to be flown; `fly` flies some of its trials.

    Attributes:
        scenario: completed.
        vehicle: that it names.
        world: static obstacles.
        told: what the filters were built for.
        missions: tasks of all trials.
        vehicle_spec, options: what the computer on board knows.
        spec: native simulation.
        bare: the same, whose logs have only what the judge needs.
        filters: native, in their order.
        names: of the filters, in their order.
        judge: of the flights.
        plans: judges of the plans, by trial.
        notes: for the summary.
    """

    scenario: WorldScenario
    vehicle: Vehicle
    world: StaticWorld
    told: FilterWorld
    missions: Missions
    vehicle_spec: _core.VehicleSpec
    options: _core.FlightOptions
    spec: _core.SimulationSpec
    bare: _core.SimulationSpec
    filters: list[_core.SafetyFilter]
    names: list[str]
    judge: WorldJudge
    plans: Callable[[int], PlanJudge | None]
    notes: list[str] = field(default_factory=list)

    def fly(
        self,
        first: int,
        count: int,
        *,
        is_logged: bool = True,
        jobs: int = 0,
        progress: Progress | None = None,
    ) -> list[dict[str, Any]]:
        """Fly consecutive trials; their native logs.

        Args:
            first: number of the first trial.
            count: number of trials.
            is_logged: keep their path and a row per tick, besides what the judge needs.
            jobs: threads, 0 for all processors; only measured times depend on it.
            progress: called with (trials done, trials).

        Raises:
            UsageError: an obstacle cannot meet the vehicle.
            InputError: the motion diverges, or a filter in Python returned no command.
        """
        try:
            return _core.simulate(
                self.spec if is_logged else self.bare,
                self.missions.tasks[first : first + count],
                self.filters,
                seed=self.scenario.rules.seed,
                first_trial=first,
                jobs=1 if any(one.shares_state for one in self.filters) else jobs,
                progress=progress,
            )
        except ValueError as error:
            raise UsageError(f"`$.world.moving`: {error}") from error
        except OverflowError as error:
            raise InputError(str(error)) from error

    def on_board(self, index: int) -> _core.Flight:
        """The flight of one trial as the computer on board sees it, without a simulation around it.

        Args:
            index: number of the trial.
        """
        return _core.Flight(self.vehicle_spec, self.options, self.missions.missions[index], self.filters)

    def judged(self, index: int, flown: dict[str, Any]) -> TrialResult:
        """Verdict on one flight.

        Args:
            index: number of the trial.
            flown: its native log.
        """
        goal = self.missions.goal[index]
        if self.scenario.mission.kind == "pilot":
            goal = flown["last"][:3]
        start, curve = self.missions.start[index], self.missions.curves[index]
        return self.judge.trial(index, start, goal, curve, flown, self.plans(index))

    def filter_times(self, flown: dict[str, Any]) -> NDArray[np.float32]:
        """Measured times of the filters in a flight, shape (F,) [s].

        Of all filters together in each tick; of one among moving obstacles in the ticks of a manoeuvre or a
        warning, as in the others it has little to do.

        Args:
            flown: its native log.
        """
        if self.names == [self.judge.seen_by]:
            return np.asarray(flown["active_tick_s"])
        return np.asarray(
            flown["filter_s"].sum(axis=1, dtype=np.float32)[:: self.scenario.rules.filter_ticks]
        )


def prepare(
    scenario: WorldScenario,
    vehicle: Vehicle,
    *,
    cover: Artifact | None = None,
    scene: Artifact | None = None,
    plan: Artifact | None = None,
    pairs: Pairs | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> PreparedRun:
    """Make all parts of a run.

    Args:
        scenario: as read.
        vehicle: that it names.
        cover: that it names.
        scene: that it names.
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
    foreign = {name: filter_kind(name) for name in scenario.safety.filters if name not in FILTERS}
    if words := refusal(scenario, vehicle, foreign):
        raise UsageError(words)
    full = completed(scenario, vehicle)
    rules, mission, table = full.rules, full.mission, full.vehicle
    assert table.radius_m is not None
    peak, most = _speeds(full, vehicle, plan)
    names = list(full.safety.filters)
    if mission.controller.guide != "none":
        names.insert(0, mission.controller.guide)
    world = static_world(
        full,
        radius_m=table.radius_m,
        cover=cover,
        scene=scene,
        needs_image=full.world.onboard or "geofence" in names,
        jobs=jobs,
    )
    spec = vehicle_spec(full, vehicle, peak_m_s=peak, max_speed_m_s=most)
    extent = _extent(full, world, most, pairs, plan)
    known_m_s = most if math.isfinite(most) else _PLAN_SPEED_FACTOR * peak  # a point may have no limit
    told = filter_world(full, vehicle, world, speed_m_s=peak, max_speed_m_s=known_m_s, extent_m=extent)
    filters = safety_filters(full, told)
    psi = None
    if "polytope-cbf" in names:
        guard = barrier(told)

        def psi(points: FloatArray) -> FloatArray:
            return np.asarray(guard.psi(points)[1])

    missions = missions_of(
        full,
        world,
        count=_count(full, pairs),
        model=vehicle.model,
        speed_m_s=peak,
        max_speed_m_s=most,
        plan=plan,
        cover=cover,
        given=pairs,
        is_safe=_safety_of_starts(full, vehicle, names, world),
        start_value=psi,
        jobs=jobs,
        progress=progress,
    )
    paths = [missions.start, missions.goal]
    paths += [curve.at(np.linspace(0, curve.duration_s, 64))[:, :3] for curve in missions.curves[:1] if curve]
    lower, upper = world.room(paths, has_moving=bool(full.world.moving))
    known = full.estimation
    has_losses = known.lost_share > 0 or known.lost_from_s is not None
    is_point = vehicle.model == "single-integrator"
    waits = mission.receded_s is not None  # for what moves, and not for the goal
    stuck_s = _STUCK_POINT_S if is_point else _STUCK_S
    dt_s = rules.dt_s
    flight = _core.FlightOptions(
        dt_s=dt_s,
        controller_ticks=rules.controller_ticks,
        filter_ticks=rules.filter_ticks,
        stale_s=min(known.stale_s, 1e3),
        has_losses=has_losses,
    )
    # References are compared with rows of ticks.
    needs = {
        "keeps_path": world.polytopes is not None or bool(world.parts) or mission.kind == "plan",
        "keeps_ticks": any(missions.curves),
    }
    spec_of = partial(
        _core.SimulationSpec,
        spec,
        options=flight,
        losses=_losses(full),
        moving=moving_spec(
            full.world.moving,
            known.sensor,
            known.tracker,
            yaw_rate_rad_s=known.sensor.yaw_rate_rad_s,
        ),
        watcher=watcher(full, told),
    )
    simulation, bare = (
        spec_of(
            rules=_core.SimulationRules(
                plant_steps=rules.plant_steps or max(1, math.ceil(dt_s / _PLANT_STEP_S - 1e-9)),
                stuck_ticks=max(1, round(stuck_s / dt_s)),
                stuck_speed_m_s=1e-3 * most if is_point else 0.02,
                receded_s=math.inf if mission.receded_s is None else mission.receded_s,
                lower=lower,
                upper=upper,
                ends_when_refused=not (full.world.moving or waits or has_losses or mission.kind == "pilot"),
                ends_at_goal=not waits,
                risk_window_s=risk_window_s(full),
                **kept,
            )
        )
        for kept in ({}, needs)
    )
    judge = WorldJudge(
        world=world,
        filters=names,
        obstacle_radii_m=[one.radius_m for one in full.world.moving],
        seen_by=seen_by(full),
        via_tolerance_m=via_tolerance(mission.via_tolerance_m, table.radius_m),
        dt_s=dt_s,
        jobs=jobs,
    )
    flown_plan = judge.of_plan(plan if mission.kind == "plan" else None)
    notes: list[str] = []
    if flown_plan is not None and names:
        sets = [each for each in (world.polytopes, world.ellipsoids) if each is not None]
        keeps: list[float | None] = [
            world.hull_keep_m if each is world.polytopes else world.keep_m for each in sets
        ]
        notes = require_room(flown_plan, keeps, " + ".join(names), allow_tight=mission.allow_tight)

    def of_trial(index: int) -> PlanJudge | None:
        return flown_plan if flown_plan is not None else judge.of_plan(missions.plans[index])

    return PreparedRun(
        scenario=full,
        vehicle=vehicle,
        world=world,
        told=told,
        missions=missions,
        vehicle_spec=spec,
        options=flight,
        spec=simulation,
        bare=bare,
        filters=filters,
        names=names,
        judge=judge,
        plans=of_trial,
        notes=notes,
    )


def simulate_world(
    scenario: WorldScenario,
    vehicle: Vehicle,
    *,
    cover: Artifact | None = None,
    scene: Artifact | None = None,
    plan: Artifact | None = None,
    pairs: Pairs | None = None,
    journal: TrialJournal[FlownChunk] | None = None,
    jobs: int = 0,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> WorldRun:
    """Fly all trials of a scenario, and judge each from the truth.

    Trial k is a function of the scenario, its files and (seed, k) alone: except for measured times, results
    do not depend on jobs, scheduler or journal. The log keeps samples of the first `rules.logged` flights and
    of the ones with the least clearance, which are flown again for it.

    Args:
        scenario: as read.
        vehicle: that it names.
        cover: that it names.
        scene: that it names.
        plan: that it names.
        pairs: starts and goals of the run that it names.
        journal: finished chunks are taken from it, others added.
        jobs: threads, 0 for all processors.
        scheduler: address of a `dask.distributed` scheduler, whose workers fly the trials.
        progress: called with (trials done, trials).

    Raises:
        UsageError, InputError, ArtifactError, InfeasibleError: as `prepare` and `PreparedRun.fly`.
        LinkError: see `distribute`.
    """
    parts = RunParts(
        key=uuid4().hex, scenario=scenario, vehicle=vehicle, cover=cover, scene=scene, plan=plan, pairs=pairs
    )
    ready = _prepared(parts, jobs)
    total, rules = len(ready.missions.tasks), ready.scenario.rules
    chunks = fly_missing(
        partial(fly_chunk, ready, jobs) if scheduler is None else fly_elsewhere,
        lambda first, count: TrialChunk(None if scheduler is None else parts, first, count),
        total,
        CHUNK,
        TrialJournal(FlownChunk) if journal is None else journal,
        jobs=1,  # threads are those of the native simulation
        scheduler=scheduler,
        progress=progress,
    )
    trials = [trial for chunk in chunks for trial in chunk.trials]
    flights = [flight for chunk in chunks for flight in chunk.flights]
    worst = sorted(trials, key=lambda trial: (worst_clearance(trial), trial.index))[:WORST]
    for trial in sorted((one for one in worst if one.index >= rules.logged), key=lambda one: one.index):
        (log,) = ready.fly(trial.index, 1, jobs=jobs)
        flights.append(WorldFlight.of(trial.index, log, rules.dt_s, rules.log_rate_hz))
    return WorldRun(
        scenario=ready.scenario,
        vehicle=vehicle,
        trials=trials,
        flights=flights,
        world=ready.world,
        counts=ready.missions.counts,
        notes=ready.notes,
        filter_s=np.frombuffer(b"".join(chunk.filter_s for chunk in chunks), np.float32),
        tick_s=np.frombuffer(b"".join(chunk.tick_s for chunk in chunks), np.float32),
        command_s=rows_of_obstacles([chunk.command_s for chunk in chunks], total),
        reaction_s=rows_of_obstacles([chunk.reaction_s for chunk in chunks], total),
    )


_ELSEWHERE = Lock()


def fly_elsewhere(chunk: TrialChunk) -> FlownChunk:
    """Fly a chunk on the calling thread of a worker, which prepares each run once.

    Args:
        chunk: with the parts of its run.
    """
    assert chunk.parts is not None
    with _ELSEWHERE:
        ready = _prepared_once(chunk.parts)
    # A filter in Python has one state for all threads.
    with _ELSEWHERE if any(one.shares_state for one in ready.filters) else nullcontext():
        return fly_chunk(ready, 1, chunk)


def _prepared(parts: RunParts, jobs: int) -> PreparedRun:
    given = {role: getattr(parts, role) for role in ("cover", "scene", "plan", "pairs")}
    return prepare(parts.scenario, parts.vehicle, **given, jobs=jobs)


@lru_cache(maxsize=1)
def _prepared_once(parts: RunParts) -> PreparedRun:
    return _prepared(parts, 1)


def fly_chunk(ready: PreparedRun, jobs: int, chunk: TrialChunk) -> FlownChunk:
    """Fly the trials of a chunk and judge them.

    Args:
        ready: the run.
        jobs: threads, 0 for all processors; only measured times depend on it.
        chunk: numbers of the trials.
    """
    trials, flights, filters, ticks, commands, reactions = [], [], [], [], [], []
    rules, first = ready.scenario.rules, chunk.first
    kept = shown(chunk, rules.logged)
    logs = ready.fly(first, kept, jobs=jobs)
    logs += ready.fly(first + kept, chunk.count - kept, is_logged=False, jobs=jobs)
    for index, log in enumerate(logs, first):
        trials.append(ready.judged(index, log))
        filters.append(ready.filter_times(log).tobytes())
        ticks.append(log["tick_s"][:: rules.filter_ticks].tobytes())
        commands.append(log["command_s"].tobytes())
        reactions.append((log["command_s"] + log["reaction_s"]).tobytes())
        if index < rules.logged:
            flights.append(WorldFlight.of(index, log, rules.dt_s, rules.log_rate_hz))
    return FlownChunk(
        first=first,
        trials=trials,
        filter_s=b"".join(filters),
        tick_s=b"".join(ticks),
        command_s=b"".join(commands),
        reaction_s=b"".join(reactions),
        flights=flights,
    )


def _speeds(scenario: WorldScenario, vehicle: Vehicle, plan: Artifact | None) -> tuple[float, float]:
    """Peak speed of the references, and limit of velocity commands [m/s]."""
    mission, limit = scenario.mission, scenario.vehicle.max_speed_m_s
    if mission.kind == "plan" and plan is not None:
        peak = float(plan.manifest.speed_m_s)  # type: ignore[attr-defined]
        fast = _PLAN_SPEED_FACTOR * peak
    else:
        peak = (
            mission.speed_m_s
            or (limit if vehicle.model == "single-integrator" and limit else None)
            or (DEFAULT_SPEED_M_S)
        )
        fast = peak if vehicle.model == "single-integrator" else _PLAN_SPEED_FACTOR * peak
        if mission.planned and vehicle.model == "single-integrator":
            peak /= _PLAN_SPEED_FACTOR
    if vehicle.model == "double-integrator":
        return peak, math.inf if limit is None else limit
    return peak, fast if limit is None else min(fast, limit)


def _count(scenario: WorldScenario, pairs: Pairs | None) -> int:
    if scenario.rules.trials is not None:
        return scenario.rules.trials
    if scenario.mission.kind != "pairs":
        return 1
    return 100 if pairs is None else len(pairs.start)


def _extent(
    scenario: WorldScenario, world: StaticWorld, most: float, pairs: Pairs | None, plan: Artifact | None
) -> float:
    """Bound of the coordinates of all positions [m]."""
    points = [world.centres]
    mission = scenario.mission
    given = [mission.start_m, mission.goal_m, *mission.waypoints_m]
    points += [np.array([point]) for point in given if point is not None]
    for box in (mission.bounds_m, mission.start_box_m):
        if box is not None:
            points.append(np.array(box).reshape(2, 3))
    if pairs is not None:
        points += [pairs.start, pairs.goal]
    if plan is not None:
        curve = _core.ReferenceCurve(
            np.asarray(plan["time"], np.float64), np.asarray(plan["coefficient"], np.float64)
        )
        points.append(curve.at(np.linspace(0, curve.duration_s, 256))[:, :3])
    speed = most if math.isfinite(most) else 10.0
    seconds = 10 + (scenario.vehicle.velocity_lag_s or 0.0)
    return float(np.abs(np.concatenate(points)).max(initial=1.0)) + 6 * world.radius_m + seconds * speed


def _safety_of_starts(
    scenario: WorldScenario, vehicle: Vehicle, names: list[str], world: StaticWorld
) -> Callable[[FloatArray], FloatArray] | None:
    """h_I of start states, where a geofence flies and starts are drawn."""
    if scenario.mission.start_box_m is None or not any(
        FILTER_COMMANDS.get(name) == "sticks" for name in names
    ):
        return None
    box = None if scenario.world.fence is None else scenario.world.fence.box_m
    others = world.faces[6 if box is not None else 0 :]
    where = _core.Fence(
        box=None if box is None else (box[:3], box[3:]),
        faces=np.ascontiguousarray(others) if len(others) else None,
        image=world.image or None,
        keep_out=world.polytopes if world.image else None,
    )
    values: dict[str, Any] = msgspec.structs.asdict(scenario.safety.geofence)
    del values["alpha"]
    native = _core.Geofence(where, racer_model(vehicle), values | {"radius_m": world.radius_m})
    return lambda states: np.asarray(native.evaluate(states)[0][:, 0])


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
