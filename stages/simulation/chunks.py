"""Trials of a scenario in chunks: what to fly, what comes back, and a journal of what is finished."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec

from alula.schemas.decode import msgpack_decoder
from alula.schemas.log.run import TrialResult
from alula.schemas.progress import Progress
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.distribute import distribute
from alula.stages.durations import Times
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.result import WorldFlight
from alula.stages.world.world import WorldFiles


class FlownChunk(msgspec.Struct, frozen=True, kw_only=True):
    """Consecutive trials; times are measured and differ from run to run.

    Attributes:
        first: number of the first trial.
        filter_times: of the filters, see `PreparedRun.filter_seconds`.
        tick_times: of each tick on board.
        command_s: time of the filter in the tick of the warning, per trial and obstacle, float64 [s]; NaN
            without a warning.
        reaction_s: time from the warning to the reaction, including `command_s`, float64 [s]; NaN without
            one.
        flights: samples of the trials that the log shows.
    """

    first: int
    trials: list[TrialResult]
    filter_times: Times
    tick_times: Times
    command_s: bytes
    reaction_s: bytes
    flights: list[WorldFlight]


class RunFiles(WorldFiles, total=False):
    """Files of a run by role; those that the scenario does not name are left out, or None."""

    pairs: Pairs | None


@dataclass(frozen=True, slots=True)
class RunParts:
    """What a run is prepared from, on this machine or another; `key` alone tells runs apart."""

    key: str
    scenario: Scenario = field(compare=False)
    vehicle: Vehicle | None = field(compare=False)
    files: RunFiles = field(compare=False)


@dataclass(frozen=True, slots=True)
class TrialChunk:
    """Consecutive trials to fly; `parts` only where they are flown elsewhere."""

    parts: RunParts | None
    first: int
    count: int


class TrialJournal:
    """Finished chunks of a run; decoding a `snapshot` gives the same journal.

    Args:
        snapshot: of another journal; no bytes give an empty one.

    Raises:
        ValueError: the bytes are not those of a snapshot.
    """

    def __init__(self, snapshot: bytes = b"") -> None:
        chunks = msgpack_decoder(list[FlownChunk]).decode(snapshot) if snapshot else []
        self.chunks = {chunk.first: chunk for chunk in chunks}

    def __len__(self) -> int:
        """Number of finished trials."""
        return sum(len(chunk.trials) for chunk in self.chunks.values())

    def add(self, chunk: FlownChunk) -> None:
        """Add a finished chunk."""
        self.chunks[chunk.first] = chunk

    def in_order(self) -> list[FlownChunk]:
        """All chunks, in the order of their trials."""
        return [self.chunks[first] for first in sorted(self.chunks)]

    def snapshot(self) -> bytes:
        """All chunks, as bytes."""
        return msgspec.msgpack.encode(self.in_order())


def shown(chunk: TrialChunk, logged: int) -> int:
    """Number of trials at the beginning of a chunk that the log shows.

    Args:
        logged: the log shows this many first trials of the run.
    """
    return min(max(logged - chunk.first, 0), chunk.count)


def fly_missing(
    fly: Callable[[TrialChunk], FlownChunk],
    parts: RunParts | None,
    total: int,
    size: int,
    journal: TrialJournal,
    *,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> list[FlownChunk]:
    """Fly the chunks that a journal lacks and add them to it; return all chunks, in their order.

    Args:
        fly: flies a chunk, with a scheduler on another machine: see `distribute`.
        parts: of the run, for another machine.
        size: maximum number of trials per chunk.
        journal: finished chunks are taken from it, others added.
        scheduler: address of a `dask.distributed` scheduler, instead of the calling thread.

    Raises:
        LinkError: see `distribute`.
    """
    missing = [
        TrialChunk(parts, first, min(size, total - first))
        for first in range(0, total, size)
        if first not in journal.chunks
    ]
    done = total - sum(chunk.count for chunk in missing)
    if progress is not None and done > 0:
        progress(done, total)
    if missing:  # otherwise do not connect to a scheduler
        # An interruption reaches the calling thread at once.
        flown = map(fly, missing) if scheduler is None else distribute(fly, missing, scheduler=scheduler)
        for chunk in flown:
            journal.add(chunk)
            done += len(chunk.trials)
            if progress is not None:
                progress(done, total)
    return journal.in_order()
