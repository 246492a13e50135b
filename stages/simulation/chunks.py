"""Trials of a scenario in chunks: what to fly, what comes back, and a journal of what is finished."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, Protocol, TypeVar

import msgspec

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.tiles import TileFiles
from alula.schemas.decode import msgpack_decoder
from alula.schemas.log.run import TrialResult
from alula.schemas.progress import Progress
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.distribute import distribute
from alula.stages.durations import Times
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.result import WorldFlight


class FlownTrials(msgspec.Struct, frozen=True, kw_only=True):
    """Consecutive trials of a run, `first` being the number of the first one.

    Stages extend it; every field can be written as MessagePack.
    """

    first: int
    trials: list[TrialResult]


class FlownChunk(FlownTrials, frozen=True, kw_only=True):
    """Consecutive trials; times are measured and differ from run to run.

    Attributes:
        filter_times: of the filters, see `PreparedRun.filter_seconds`.
        tick_times: of each tick on board.
        command_s: time of the filter in the tick of the warning, per trial and obstacle, float64 [s]; NaN
            without a warning.
        reaction_s: time from the warning to the reaction, including `command_s`, float64 [s]; NaN without
            one.
        flights: samples of the trials that the log shows.
    """

    filter_times: Times
    tick_times: Times
    command_s: bytes
    reaction_s: bytes
    flights: list[WorldFlight]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunParts:
    """What a run is prepared from, on this machine or another; `key` alone tells runs apart."""

    key: str
    scenario: Scenario = field(compare=False)
    vehicle: Vehicle | None = field(compare=False)
    cover: Artifact | None = field(compare=False)
    scene: Artifact | None = field(compare=False)
    seen: Artifact | None = field(default=None, compare=False)
    plan: Artifact | None = field(compare=False)
    tiles: TileFiles | None = field(default=None, compare=False)
    pairs: Pairs | None = field(compare=False)


@dataclass(frozen=True, slots=True)
class TrialChunk:
    """Consecutive trials to fly; `parts` only where they are flown elsewhere."""

    parts: RunParts | None
    first: int
    count: int


class _Chunk(Protocol):
    """Trials to fly together."""

    @property
    def first(self) -> int: ...

    @property
    def count(self) -> int: ...


Flown = TypeVar("Flown", bound=FlownTrials)
Chunk = TypeVar("Chunk", bound=_Chunk)


class TrialJournal(Generic[Flown]):
    """Finished chunks of a run; decoding a `snapshot` gives the same journal.

    Args:
        kind: type of the chunks.
        snapshot: of another journal of such chunks; no bytes give an empty one.

    Raises:
        ValueError: the bytes are not those of a snapshot.
    """

    def __init__(self, kind: type[Flown], snapshot: bytes = b"") -> None:
        chunks: list[Flown] = msgpack_decoder(list[kind]).decode(snapshot) if snapshot else []  # type: ignore[valid-type]
        self.chunks = {chunk.first: chunk for chunk in chunks}

    def __len__(self) -> int:
        """Number of finished trials."""
        return sum(len(chunk.trials) for chunk in self.chunks.values())

    def add(self, chunk: Flown) -> None:
        """Add a finished chunk."""
        self.chunks[chunk.first] = chunk

    def in_order(self) -> list[Flown]:
        """All chunks, in the order of their trials."""
        return [self.chunks[first] for first in sorted(self.chunks)]

    def snapshot(self) -> bytes:
        """All chunks, as bytes."""
        return msgspec.msgpack.encode(self.in_order())


def shown(chunk: _Chunk, logged: int) -> int:
    """Number of trials at the beginning of a chunk that the log shows.

    Args:
        logged: the log shows this many first trials of the run.
    """
    return min(max(logged - chunk.first, 0), chunk.count)


def fly_missing(
    fly: Callable[[Chunk], Flown],
    chunk_of: Callable[[int, int], Chunk],
    total: int,
    size: int,
    journal: TrialJournal[Flown],
    *,
    jobs: int = 0,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> list[Flown]:
    """Fly the chunks that a journal lacks and add them to it; return all chunks, in their order.

    Args:
        fly: flies a chunk, possibly on another machine: see `distribute`.
        chunk_of: makes a chunk from the number of its first trial and the number of trials.
        size: maximum number of trials per chunk.
        journal: finished chunks are taken from it, others added.
        scheduler: address of a `dask.distributed` scheduler, instead of threads.

    Raises:
        LinkError: see `distribute`.
    """
    missing = [
        chunk_of(first, min(size, total - first))
        for first in range(0, total, size)
        if first not in journal.chunks
    ]
    done = total - sum(chunk.count for chunk in missing)
    if progress is not None and done > 0:
        progress(done, total)
    if missing:  # otherwise do not connect to a scheduler
        # One thread is the calling one, which an interruption reaches at once.
        is_here = jobs == 1 and scheduler is None
        flown = map(fly, missing) if is_here else distribute(fly, missing, jobs=jobs, scheduler=scheduler)
        for chunk in flown:
            journal.add(chunk)
            done += len(chunk.trials)
            if progress is not None:
                progress(done, total)
    return journal.in_order()
