"""Chunks of the trials of a scenario: what to fly, and what comes back."""

from __future__ import annotations

from dataclasses import dataclass, field

from alula.schemas.artifact import Artifact
from alula.schemas.vehicle import Vehicle
from alula.schemas.world import WorldScenario
from alula.stages.simulation.chunks import FlownTrials
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.result import WorldFlight


class FlownChunk(FlownTrials, frozen=True, kw_only=True):
    """Consecutive trials; the arrays, as bytes, are measured times and differ from run to run.

    Attributes:
        filter_s: times of the filters, float32 [s]: of `PreparedRun.filter_times`.
        tick_s: time of each tick on board, float32 [s].
        command_s: time of the filter in the tick of the warning, per trial and obstacle, float64 [s]; NaN
            without a warning.
        reaction_s: time from the warning to the reaction, including `command_s`, float64 [s]; NaN without
            one.
        flights: samples of the trials that the log shows.
    """

    filter_s: bytes
    tick_s: bytes
    command_s: bytes
    reaction_s: bytes
    flights: list[WorldFlight]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunParts:
    """What a run is prepared from, on this machine or another; `key` alone tells runs apart."""

    key: str
    scenario: WorldScenario = field(compare=False)
    vehicle: Vehicle = field(compare=False)
    cover: Artifact | None = field(compare=False)
    scene: Artifact | None = field(compare=False)
    plan: Artifact | None = field(compare=False)
    pairs: Pairs | None = field(compare=False)


@dataclass(frozen=True, slots=True)
class TrialChunk:
    """Consecutive trials to fly; `parts` only where they are flown elsewhere."""

    parts: RunParts | None
    first: int
    count: int
