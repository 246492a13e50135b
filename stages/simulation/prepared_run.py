"""A scenario made into a native simulation: flies its trials, judges them, and takes samples of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError, UsageError
from alula.schemas.log.run import TrialResult
from alula.schemas.progress import Progress
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.planning.adherence import PlanJudge
from alula.stages.simulation.judge import WorldJudge
from alula.stages.simulation.result import WorldFlight
from alula.stages.simulation.tasks import Missions
from alula.stages.world.obstacles import StaticWorld


@dataclass(frozen=True, slots=True)
class PreparedRun:
    """A scenario ready to be flown; `fly` flies some of its trials.

    Attributes:
        told: what the filters were built for.
        missions: tasks of all trials.
        vehicle_spec, options: what the computer on board knows.
        bare: the same, whose logs have only what the judge needs.
        filters: native, in their order.
        plans: judges of the plans, by trial.
        start_h_i_m: see `start_h_i` [m].
        among: barrier of the hulls, where the vehicle is flown by velocities among them.
        start_margin_m: psi less what filters keep, at the start of each trial, with that barrier [m].
    """

    scenario: Scenario
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
    start_h_i_m: float | None
    among: _core.PolytopeCbf | None
    start_margin_m: FloatArray | None
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
            is_logged: keep their path and a row per tick, besides what the judge needs.
            jobs: threads, 0 for all processors; only measured times depend on it.

        Raises:
            UsageError: an obstacle cannot meet the vehicle, or the motion diverges.
            InputError: a filter returned no command or one beyond the limits.
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
            if not self.scenario.world.moving:
                raise InputError(str(error)) from error
            raise UsageError(f"`$.world.moving`: {error}") from error
        except OverflowError as error:
            raise UsageError(f"`$.vehicle`: {error}") from error

    def on_board(self, index: int) -> _core.Flight:
        """The flight of one trial as the computer on board sees it, without a simulation around it."""
        return _core.Flight(self.vehicle_spec, self.options, self.missions.missions[index], self.filters)

    def judged(self, index: int, flown: dict[str, Any]) -> TrialResult:
        """Verdict on one flight."""
        goal = self.missions.goal[index]
        if self.scenario.mission.kind == "pilot":
            goal = flown["last"][:3]
        margin = math.inf if self.start_margin_m is None else float(self.start_margin_m[index])
        start, curve = self.missions.start[index], self.missions.curves[index]
        trial = self.judge.trial(index, start, goal, curve, flown, self.plans(index))
        return msgspec.structs.replace(trial, start_margin_m=margin if math.isfinite(margin) else None)

    def shown(self, index: int, flown: dict[str, Any]) -> WorldFlight:
        """Samples of one flight for the log; a flight without a filter has the margin of polytope-cbf."""
        if self.among is not None and not self.filters:
            smooth = self.among.psi(np.ascontiguousarray(flown["state"][:-1, :3]), jobs=1)[0]
            flown = flown | {"margin": smooth[:, None] - self.world.keeps_m("hulls")}
        rules = self.scenario.rules
        return WorldFlight.of(index, flown, rules.dt_s, rules.log_rate_hz, rules.filter_ticks)

    def filter_seconds(self, flown: dict[str, Any]) -> NDArray[np.float32]:
        """Measured times of the filters in a flight, shape (F,) [s].

        Of all filters together in each tick; of one among moving obstacles in the ticks of a manoeuvre or a
        warning, as in the others it has little to do.
        """
        if self.names == [self.judge.seen_by]:
            return np.asarray(flown["active_tick_s"])
        return np.asarray(
            flown["filter_s"].sum(axis=1, dtype=np.float32)[:: self.scenario.rules.filter_ticks]
        )
