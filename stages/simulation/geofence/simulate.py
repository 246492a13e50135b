"""Flights in a geofence, in chunks of trials on threads or a scheduler."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifact import Artifact
from alula.schemas.errors import UsageError
from alula.schemas.geofence import FenceScenario
from alula.schemas.progress import Progress
from alula.schemas.run import FenceResult, TrialResult
from alula.schemas.vehicle import Vehicle
from alula.stages import durations
from alula.stages.filtering.obstacles import require_obstacles
from alula.stages.simulation.chunks import FlownTrials, TrialJournal, fly_missing, shown
from alula.stages.simulation.geofence.flights import fly_trials
from alula.stages.simulation.geofence.world import FlownWorld, is_random, native_world
from alula.stages.simulation.result import FenceFlight
from alula.stages.vehicles.fence import KeepOut

CHUNK, CHUNK_TICKS = 4, 20_000  # maximum number of trials and ticks; they take less than a second


class Times(msgspec.Struct, frozen=True, kw_only=True):
    """Histogram of the filter's time per tick: counts by logarithm, int64; sum and maximum are exact."""

    counts: bytes
    calls: int
    total_s: float
    max_s: float
    overruns: int

    @classmethod
    def of(cls, seconds: NDArray[np.float32], tick_s: float) -> Times:
        """Count measured times.

        Args:
            seconds: shape (C,) [s].
            tick_s: duration of a tick [s]; longer times are `overruns`.
        """
        return cls(
            counts=durations.counts_of(seconds).tobytes(),
            calls=len(seconds),
            total_s=float(seconds.sum(dtype=np.float64)),
            max_s=float(seconds.max(initial=0.0)),
            overruns=int((seconds > tick_s).sum()),
        )

    @classmethod
    def joined(cls, parts: list[Times]) -> Times:
        """Add up histograms, at least one.

        Args:
            parts: of chunks.
        """
        counts = sum(
            (np.frombuffer(part.counts, np.int64) for part in parts), np.zeros(durations.BINS, np.int64)
        )
        return cls(
            counts=counts.tobytes(),
            calls=sum(part.calls for part in parts),
            total_s=math.fsum(part.total_s for part in parts),
            max_s=max(part.max_s for part in parts),
            overruns=sum(part.overruns for part in parts),
        )

    def quantile(self, fraction: float) -> float:
        """Quantile of the times, to 1.2 % [s].

        Args:
            fraction: of the ticks that take at most this time, in (0, 1].
        """
        return durations.quantile(np.frombuffer(self.counts, np.int64), fraction, self.max_s)


class FlownChunk(FlownTrials, frozen=True, kw_only=True):
    """Consecutive trials, and the samples of those that the log shows."""

    times: Times
    flights: list[FenceFlight]


@dataclass(frozen=True, slots=True)
class FenceRun:
    """All flights of a scenario; `times` are measured, the rest is a function of the scenario.

    Attributes:
        trials: verdicts, in their order.
        flights: samples of the first ones, and of the worst, in their order.
        world: native scenario.
        times: of the filter.
    """

    trials: list[TrialResult]
    flights: list[FenceFlight]
    world: FlownWorld
    times: Times


@dataclass(frozen=True, slots=True)
class _Chunk:
    scenario: FenceScenario
    vehicle: Vehicle
    keep_out: KeepOut | None
    first: int
    count: int


def fly_in_fence(
    scenario: FenceScenario,
    vehicle: Vehicle,
    *,
    cover: Artifact | None = None,
    journal: TrialJournal[FlownChunk] | None = None,
    jobs: int = 0,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> FenceRun:
    """Fly all trials of a scenario with a fence.

    Trial k is a function of the scenario, its files and (seed, k) alone: except for measured times, results
    do not depend on jobs, scheduler or journal. Samples of the first `run.traces` trials are kept. The trial
    with the minimum distance is flown again when it is not among these.

    Args:
        scenario: all parameters.
        vehicle: that of the scenario's file, with a table `[throttle]`.
        cover: hulls to stay out of.
        journal: finished chunks are taken from it, others added.
        jobs: threads, 0 for all processors.
        scheduler: address of a `dask.distributed` scheduler, instead of threads.
        progress: called with (trials done, trials).

    Raises:
        UsageError: values of the scenario are inconsistent, or it begins outside of its fence; the message
            has the path of their key.
        ArtifactError, InputError: the cover is damaged, or not in metres.
        InfeasibleError: it has no onboard map, see `encode_map`.
        LinkError: see `distribute`.
    """
    if cover is not None:
        require_obstacles(cover, jobs=jobs)
    keep_out = None if cover is None else KeepOut.of(cover)
    world = native_world(scenario, vehicle, keep_out)  # refuse wrong values before any work
    if scenario.trials.count > 1 and not is_random(scenario, world):
        raise UsageError(
            f"`$.trials.count`: all {scenario.trials.count} flights would be the same, as nothing in them is "
            "random; fly one, or leave out trials.start_m, or set vehicle.gust_m_s or a random pilot"
        )
    fly: Callable[[_Chunk], FlownChunk] = fly_chunk
    if scheduler is None:
        fly = lambda chunk: fly_chunk(chunk, world)  # noqa: E731  one map for all threads
    chunks = fly_missing(
        fly,
        lambda first, count: _Chunk(scenario, vehicle, keep_out, first, count),
        scenario.trials.count,
        _chunk_size(scenario),
        TrialJournal(FlownChunk) if journal is None else journal,
        jobs=jobs,
        scheduler=scheduler,
        progress=progress,
    )
    trials = [trial for chunk in chunks for trial in chunk.trials]
    flights = [flight for chunk in chunks for flight in chunk.flights]
    worst = worst_trial(trials)
    if worst.index >= scenario.run.traces:
        flights.append(_flown(scenario, world, worst.index, 1, keeps_trace=True)[2][0])
    return FenceRun(trials, flights, world, Times.joined([chunk.times for chunk in chunks]))


def _chunk_size(scenario: FenceScenario) -> int:
    """Number of trials per chunk; smaller for long flights, as a chunk cannot be interrupted."""
    ticks = scenario.run.duration_s / scenario.filter.parameters.tick_s
    return max(1, min(CHUNK, int(CHUNK_TICKS / ticks)))


def worst_trial(trials: list[TrialResult]) -> TrialResult:
    """The trial with the minimum distance to its fence, the first of equal ones.

    Args:
        trials: verdicts, at least one.
    """
    return min(trials, key=lambda trial: (trial.map_clearance_m or 0.0, trial.index))


def fly_chunk(chunk: _Chunk, world: FlownWorld | None = None) -> FlownChunk:
    """Fly the trials of a chunk on the calling thread, without holding the interpreter.

    Args:
        chunk: scenario, vehicle, cover and numbers of the trials.
        world: the native scenario, if it is made already.
    """
    scenario = chunk.scenario
    if world is None:
        world = native_world(scenario, chunk.vehicle, chunk.keep_out)
    kept = shown(chunk, scenario.run.traces)
    trials, times, flights = _flown(scenario, world, chunk.first, kept, keeps_trace=True)
    rest, more, _ = _flown(scenario, world, chunk.first + kept, chunk.count - kept, keeps_trace=False)
    tick_s = scenario.filter.parameters.tick_s
    return FlownChunk(
        first=chunk.first,
        trials=trials + rest,
        times=Times.of(np.concatenate([*times, *more]), tick_s),
        flights=flights,
    )


def _flown(
    scenario: FenceScenario, world: FlownWorld, first: int, count: int, *, keeps_trace: bool
) -> tuple[list[TrialResult], list[NDArray[np.float32]], list[FenceFlight]]:
    if count == 0:
        return [], [], []
    try:
        logs = fly_trials(
            world.spec,
            world.filter,
            seed=scenario.trials.seed,
            first=first,
            count=count,
            keeps_ticks=keeps_trace,
            jobs=1,
        )
    except ValueError as error:
        key = "trials.start_box_m" if scenario.trials.start_m is None else "trials.start_m"
        raise UsageError(f"`$.{key}`: {error}") from error
    except OverflowError as error:
        raise UsageError(f"`$.vehicle`: {error}") from error
    tick_s = scenario.filter.parameters.tick_s
    trials = [_trial(index, log, tick_s) for index, log in enumerate(logs, first)]
    flights = []
    if keeps_trace:
        rate = scenario.run.log_rate_hz
        flights = [FenceFlight.of(index, log, tick_s, rate) for index, log in enumerate(logs, first)]
    return trials, [log["tick_s"] for log in logs], flights


def _trial(index: int, log: dict[str, Any], tick_s: float) -> TrialResult:
    """Judge one flight; the verdict has no measured time."""
    start, end = log["start"][:3].tolist(), log["end"].tolist()
    is_out = log["min_distance_m"] < 0
    counts = ("passed", "blended", "backup", "no_pilot", "hand_over", "refused")
    return TrialResult(
        index=index,
        start_m=start,
        goal_m=end,
        outcome="outside" if is_out else "inside",
        collision=is_out,
        steps=log["ticks"],
        duration_s=log["ticks"] * tick_s,
        path_length_m=log["path_length_m"],
        straight_length_m=math.dist(start, end),
        map_clearance_m=log["min_distance_m"],
        scene_clearance_m=None,
        max_speed_m_s=log["max_speed_m_s"],
        filtered_steps=log["ticks"] - log["passed"],
        shortened_steps=0,
        infeasible_steps=0,
        fallback_steps=log["backup"] + log["no_pilot"],
        mean_jerk_m_s3=log["mean_jerk_m_s3"],
        max_jerk_m_s3=log["max_jerk_m_s3"],
        fence=FenceResult(
            **{f"{name}_steps": log[name] for name in counts},
            interventions=log["interventions"],
            altered_passes=log["altered_passes"],
            out_of_range=log["out_of_range"],
            longest_backup_s=log["longest_backup_s"],
            min_lambda=_known(log["min_lambda"]),
            min_h_i_m=_known(log["min_h_i"]),
            brake_distance_m=_known(log["brake_distance_m"]),
            stop_distance_m=_known(log["stop_distance_m"]),
        ),
    )


def _known(value: float) -> float | None:
    """None for a value that was never set: infinite, NaN, or the largest float."""
    return float(value) if abs(value) < 1e30 else None
