"""Simulation of a scenario: its parts together in one native loop, judged from the truth."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass
from functools import lru_cache, partial
from threading import Lock
from typing import Unpack
from uuid import uuid4

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.log.run import TrialResult
from alula.schemas.progress import Progress
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.durations import Times
from alula.stages.progress import share
from alula.stages.simulation.chunks import (
    FlownChunk,
    RunFiles,
    RunParts,
    TrialChunk,
    TrialJournal,
    fly_missing,
    shown,
)
from alula.stages.simulation.encounters import rows_of_obstacles
from alula.stages.simulation.judge import worst_clearance
from alula.stages.simulation.prepare import prepare
from alula.stages.simulation.prepared_run import PreparedRun
from alula.stages.simulation.result import WorldFlight
from alula.stages.world.obstacles import StaticWorld

CHUNK, CHUNK_TICKS = 16, 100_000  # maximum number of trials and ticks whose samples are in memory at once
WORST = 3  # flights with the least clearance, which are always in the log


@dataclass(frozen=True, slots=True)
class WorldRun:
    """All trials of a scenario; times are measured, the rest is not.

    Attributes:
        trials: verdicts, in their order.
        flights: samples of those that the log shows: the first ones, and the worst.
        counts: of sampled points and pairs.
        start_h_i_m: see `start_h_i` [m].
        filter_kind: whether all filters are native, in words.
        filter_times: of the filters, see `PreparedRun.filter_seconds`.
        command_s, reaction_s: of `FlownChunk`, shape (trials, n) with n moving obstacles [s].
    """

    scenario: Scenario
    vehicle: Vehicle
    trials: list[TrialResult]
    flights: list[WorldFlight]
    world: StaticWorld
    counts: dict[str, int]
    notes: list[str]
    start_h_i_m: float | None
    filter_kind: str
    filter_times: Times
    tick_times: Times
    command_s: FloatArray
    reaction_s: FloatArray


def simulate_world(
    scenario: Scenario,
    vehicle: Vehicle | None = None,
    *,
    journal: TrialJournal | None = None,
    jobs: int = 0,
    scheduler: str | None = None,
    progress: Progress | None = None,
    **files: Unpack[RunFiles],
) -> WorldRun:
    """Fly all trials of a scenario, and judge each from the truth.

    Trial k is a function of the scenario, its files and (seed, k) alone: except for measured times, results
    do not depend on jobs, scheduler or journal. The log keeps samples of the first `rules.logged` flights and
    of the ones with the least clearance, which are flown again for it.

    Args:
        vehicle: of the file that it names; default: the one built in by its name.
        journal: finished chunks are taken from it, others added.
        scheduler: address of a `dask.distributed` scheduler, whose workers fly the trials.
        **files: those that the scenario names; `pairs` are starts and goals of the run that it names.

    Raises:
        UsageError, InputError, ArtifactError, InfeasibleError: as `prepare` and `PreparedRun.fly`.
        LinkError: see `distribute`.
    """
    parts = RunParts(uuid4().hex, scenario, vehicle, files)
    planning = None
    if scenario.mission.planned:
        planning, progress = share(progress, 0, 0.5), share(progress, 0.5, 1)
    ready = prepare(scenario, vehicle, jobs=jobs, progress=planning, **files)
    total, rules = len(ready.missions.tasks), ready.scenario.rules
    chunks = fly_missing(
        partial(fly_chunk, ready, jobs) if scheduler is None else fly_elsewhere,
        None if scheduler is None else parts,
        total,
        chunk_size(ready),
        TrialJournal() if journal is None else journal,
        scheduler=scheduler,
        progress=progress,
    )
    trials = [trial for chunk in chunks for trial in chunk.trials]
    flights = [flight for chunk in chunks for flight in chunk.flights]
    worst = sorted(trials, key=lambda trial: (worst_clearance(trial), trial.index))[:WORST]
    for trial in sorted((one for one in worst if one.index >= rules.logged), key=lambda one: one.index):
        (log,) = ready.fly(trial.index, 1, jobs=jobs)
        flights.append(ready.shown(trial.index, log))
    return WorldRun(
        scenario=ready.scenario,
        vehicle=ready.vehicle,
        trials=trials,
        flights=flights,
        world=ready.world,
        counts=ready.missions.counts,
        notes=ready.notes,
        start_h_i_m=ready.start_h_i_m,
        filter_kind="python filter" if any(one.shares_state for one in ready.filters) else "native",
        filter_times=Times.joined([chunk.filter_times for chunk in chunks]),
        tick_times=Times.joined([chunk.tick_times for chunk in chunks]),
        command_s=rows_of_obstacles([chunk.command_s for chunk in chunks], total),
        reaction_s=rows_of_obstacles([chunk.reaction_s for chunk in chunks], total),
    )


def chunk_size(ready: PreparedRun) -> int:
    """Number of trials that are flown together; smaller for long flights, whose samples take memory."""
    longest_s = max(task.max_time_s for task in ready.missions.tasks)
    return max(1, min(CHUNK, int(CHUNK_TICKS * ready.scenario.rules.dt_s / longest_s)))


_ELSEWHERE = Lock()


def fly_elsewhere(chunk: TrialChunk) -> FlownChunk:
    """Fly a chunk with its parts on the calling thread of a worker, which prepares each run once."""
    assert chunk.parts is not None
    with _ELSEWHERE:
        ready = _prepared_once(chunk.parts)
    # A filter in Python has one state for all threads.
    with _ELSEWHERE if any(one.shares_state for one in ready.filters) else nullcontext():
        return fly_chunk(ready, 1, chunk)


@lru_cache(maxsize=1)
def _prepared_once(parts: RunParts) -> PreparedRun:
    return prepare(parts.scenario, parts.vehicle, jobs=1, **parts.files)


def fly_chunk(ready: PreparedRun, jobs: int, chunk: TrialChunk) -> FlownChunk:
    """Fly the trials of a chunk and judge them.

    Args:
        jobs: threads, 0 for all processors; only measured times depend on it.
    """
    trials, flights, filters, ticks, commands, reactions = [], [], [], [], [], []
    rules, first = ready.scenario.rules, chunk.first
    kept = shown(chunk, rules.logged)
    logs = ready.fly(first, kept, jobs=jobs)
    logs += ready.fly(first + kept, chunk.count - kept, is_logged=False, jobs=jobs)
    for index, log in enumerate(logs, first):
        trials.append(ready.judged(index, log))
        filters.append(ready.filter_seconds(log))
        ticks.append(log["tick_s"][:: rules.filter_ticks])
        commands.append(log["command_s"].tobytes())
        reactions.append((log["command_s"] + log["reaction_s"]).tobytes())
        if index < rules.logged:
            flights.append(ready.shown(index, log))
    held_s = rules.dt_s * rules.filter_ticks
    return FlownChunk(
        first=first,
        trials=trials,
        filter_times=Times.of(np.concatenate(filters), held_s),
        tick_times=Times.of(np.concatenate(ticks), held_s),
        command_s=b"".join(commands),
        reaction_s=b"".join(reactions),
        flights=flights,
    )
