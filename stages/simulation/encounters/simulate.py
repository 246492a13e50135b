"""Monte Carlo of encounters with moving obstacles, in chunks of trials on threads or a scheduler."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifact import Artifact
from alula.schemas.encounters import Encounters
from alula.schemas.errors import UsageError
from alula.schemas.progress import Progress
from alula.schemas.run import TrialResult
from alula.stages.clearance import hull_obstacles, is_collision, sphere_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering.obstacles import require_obstacles
from alula.stages.simulation.chunks import FlownTrials, TrialJournal, fly_missing, shown
from alula.stages.simulation.encounters.world import (
    native_encounter,
    native_filter,
    native_task,
    static_walls,
)
from alula.stages.simulation.moving import obstacle_results
from alula.stages.simulation.result import WorldFlight

CHUNK = 16  # trials; they take some tenths of a second


class FlownChunk(FlownTrials, frozen=True, kw_only=True):
    """Consecutive trials; the arrays, as bytes, are measured times and differ from run to run.

    Attributes:
        tick_s: time of the filter in each active tick, float32 [s].
        command_s: time of the filter in the tick of the warning, per trial and obstacle, float64 [s]; NaN
            without a warning.
        reaction_s: time from the warning to the reaction, including `command_s`, float64 [s]; NaN without
            one.
        flights: samples of the trials that the log shows.
    """

    tick_s: bytes
    command_s: bytes
    reaction_s: bytes
    flights: list[WorldFlight]


@dataclass(frozen=True, slots=True)
class EncounterRun:
    """All trials of a scenario; `tick_s`, `command_s` and `reaction_s` are measured, the rest is not.

    Attributes:
        trials: verdicts, in their order.
        flights: samples of those that the log shows.
        walls: static obstacles; None without any.
        tick_s: time of the filter in every active tick, shape (T,) [s].
        command_s: time of the filter in the tick of each obstacle's warning, shape (trials, n) [s], else NaN.
        reaction_s: time from the warning to the reaction, including `command_s`, shape (trials, n) [s].
    """

    trials: list[TrialResult]
    flights: list[WorldFlight]
    walls: Hulls | None
    tick_s: NDArray[np.float32]
    command_s: NDArray[np.float64]
    reaction_s: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Chunk:
    scenario: Encounters
    walls: Hulls | None
    first: int
    count: int


def fly_encounters(
    scenario: Encounters,
    *,
    cover: Artifact | None = None,
    journal: TrialJournal[FlownChunk] | None = None,
    jobs: int = 0,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> EncounterRun:
    """Fly all trials of a scenario with moving obstacles.

    Trial k is a function of the scenario and (seed, k) alone: except for measured times, results do not
    depend on jobs, scheduler or journal. Samples of the first `trials.logged` trials are kept. The trial
    that came closest is flown again when it is not among these.

    Args:
        scenario: all parameters.
        cover: static obstacles, in addition to the scenario's own.
        journal: finished chunks are taken from it, others added.
        jobs: threads, 0 for all processors.
        scheduler: address of a `dask.distributed` scheduler, instead of threads.
        progress: called with (trials done, trials).

    Raises:
        UsageError: values of the scenario are inconsistent; the message has the path of their key.
        ArtifactError, InputError: the cover is damaged, or not in metres.
        LinkError: see `distribute`.
    """
    if cover is not None:
        require_obstacles(cover, jobs=jobs)
    walls = static_walls(scenario.walls, cover)
    native_encounter(scenario, keeps_path=False, keeps_ticks=False)  # refuse wrong values before any work
    native_filter(scenario)
    chunks = fly_missing(
        fly_chunk,
        lambda first, count: _Chunk(scenario, walls, first, count),
        scenario.trials.count,
        CHUNK,
        TrialJournal(FlownChunk) if journal is None else journal,
        jobs=jobs,
        scheduler=scheduler,
        progress=progress,
    )
    flown = _joined(scenario, walls, chunks)
    worst = closest_trial(scenario, flown.trials)
    if worst.index >= scenario.trials.logged:
        (log,) = flight_logs(scenario, None if walls is None else hull_obstacles(walls), worst.index, 1)
        again = WorldFlight.of(worst.index, log, scenario.run.dt_s, scenario.run.log_rate_hz)
        flown = replace(flown, flights=[*flown.flights, again])
    return flown


def closest_trial(scenario: Encounters, trials: list[TrialResult]) -> TrialResult:
    """The trial with the minimum distance to an obstacle or a wall, the first of equal ones.

    Args:
        scenario: with the radii of the obstacles.
        trials: verdicts, at least one.
    """

    def clearance(trial: TrialResult) -> float:
        reach = scenario.vehicle.radius_m
        pairs = zip(trial.obstacles or [], scenario.obstacles, strict=True)
        known = [met.closest_m - obstacle.radius_m - reach for met, obstacle in pairs]
        known += [] if trial.map_clearance_m is None else [trial.map_clearance_m]
        return min(known, default=math.inf)

    return min(trials, key=lambda trial: (clearance(trial), trial.index))


def _joined(scenario: Encounters, walls: Hulls | None, chunks: list[FlownChunk]) -> EncounterRun:
    shape = (-1, len(scenario.obstacles))

    def rows(name: str) -> NDArray[np.float64]:
        flat = np.frombuffer(b"".join(getattr(chunk, name) for chunk in chunks), np.float64)
        return flat.reshape(shape) if shape[1] > 0 else np.empty((scenario.trials.count, 0))

    return EncounterRun(
        trials=[trial for chunk in chunks for trial in chunk.trials],
        flights=[flight for chunk in chunks for flight in chunk.flights],
        walls=walls,
        tick_s=np.frombuffer(b"".join(chunk.tick_s for chunk in chunks), np.float32),
        command_s=rows("command_s"),
        reaction_s=rows("reaction_s"),
    )


def fly_chunk(chunk: _Chunk) -> FlownChunk:
    """Fly the trials of a chunk on the calling thread, without holding the interpreter.

    Args:
        chunk: scenario, walls and numbers of the trials.
    """
    scenario, logged = chunk.scenario, chunk.scenario.trials.logged
    walls = None if chunk.walls is None else hull_obstacles(chunk.walls)
    kept = shown(chunk, logged)
    logs = flight_logs(scenario, walls, chunk.first, kept)
    logs += flight_logs(scenario, walls, chunk.first + kept, chunk.count - kept, keeps_ticks=False)
    trials, ticks, commands, reactions, flights = [], [], [], [], []
    for index, log in enumerate(logs, chunk.first):
        trials.append(_trial(scenario, walls, index, log))
        ticks.append(log["active_tick_s"].tobytes())
        commands.append(log["command_s"].tobytes())
        reactions.append((log["command_s"] + log["reaction_s"]).tobytes())
        if index < logged:
            flights.append(WorldFlight.of(index, log, scenario.run.dt_s, scenario.run.log_rate_hz))
    return FlownChunk(
        first=chunk.first,
        trials=trials,
        tick_s=b"".join(ticks),
        command_s=b"".join(commands),
        reaction_s=b"".join(reactions),
        flights=flights,
    )


def flight_logs(
    scenario: Encounters,
    walls: _core.PolytopeSet | None,
    first: int,
    count: int,
    *,
    keeps_ticks: bool = True,
    jobs: int = 1,
) -> list[dict[str, Any]]:
    """Fly consecutive trials; their native logs.

    Args:
        scenario: all parameters.
        walls: static obstacles.
        first: number of the first trial.
        count: number of trials.
        keeps_ticks: the logs have a row per tick.
        jobs: threads, 0 for all processors; only measured times depend on it.

    Raises:
        UsageError: an obstacle cannot meet the vehicle in one of them.
    """
    spec = native_encounter(scenario, keeps_path=walls is not None, keeps_ticks=keeps_ticks)
    try:
        return _core.simulate(
            spec,
            [native_task(scenario)] * count,
            [native_filter(scenario, walls)],
            seed=scenario.trials.seed,
            first_trial=first,
            jobs=jobs,
        )
    except ValueError as error:
        raise UsageError(f"`$.obstacles`: {error}") from error


def _trial(
    scenario: Encounters, walls: _core.PolytopeSet | None, index: int, log: dict[str, Any]
) -> TrialResult:
    """Judge one trial; the verdict has no measured time."""
    encounter, radius_m = scenario.encounter, scenario.vehicle.radius_m
    goal = encounter.start_m if encounter.hovers else encounter.goal_m
    obstacles = obstacle_results(log, [radius_m + obstacle.radius_m for obstacle in scenario.obstacles])
    clearance = None if walls is None else sphere_clearance(log["path"], walls, radius_m, jobs=1)
    return TrialResult(
        index=index,
        start_m=list(encounter.start_m),
        goal_m=list(goal),
        outcome="passed" if log["end"] == "passed" else "timeout",
        collision=any(obstacle.collision for obstacle in obstacles) or is_collision(clearance),
        steps=log["ticks"],
        duration_s=log["ticks"] * scenario.run.dt_s,
        path_length_m=log["path_length_m"],
        straight_length_m=math.dist(encounter.start_m, goal),
        map_clearance_m=clearance,
        scene_clearance_m=None,
        max_speed_m_s=log["max_speed_m_s"],
        filtered_steps=log["filtered_ticks"],
        shortened_steps=0,
        infeasible_steps=log["infeasible_ticks"],
        fallback_steps=log["recovering_ticks"],
        mean_jerk_m_s3=log["mean_jerk_m_s3"],
        max_jerk_m_s3=log["max_jerk_m_s3"],
        obstacles=obstacles,
        active_steps=log["active_ticks"],
        refused_steps=log["refused_ticks"],
        iterations=log["total_iterations"],
        worst_violation_m_s2=log["worst_violation"],
        # Other filters have no rows with a risk.
        risk_spent=log["risk_spent"] if scenario.filter.name.startswith("dr-acbf") else None,
        mission_risk=log["mission_risk"],
    )
