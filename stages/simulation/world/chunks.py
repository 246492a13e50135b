"""Chunks of the trials of a scenario: what to fly, and what comes back."""

from __future__ import annotations

from dataclasses import dataclass, field

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.tiles import TileFiles
from alula.schemas.scenarios.scenario import WorldScenario
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.durations import Times
from alula.stages.simulation.chunks import FlownTrials
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.result import WorldFlight


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
    scenario: WorldScenario = field(compare=False)
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
