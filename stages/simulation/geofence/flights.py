"""Native flights of a racing drone in a geofence, and their logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.filter_options import GeofenceParameters
from alula.schemas.vehicle import FASTBRIDGE
from alula.stages.vehicles.bodies import quadrotor

Rule = Literal["none", "geofence", "backup-qp"]


@dataclass(frozen=True, slots=True, kw_only=True)
class FenceFlights:
    """Flights of a racing drone but for the geofence and the random numbers.

    Attributes:
        model: of plant and pilot; the filter has its own.
        options: disturbances of the plant that the model omits.
        pilot: with the sticks.
        rule: the filter; `none` flies the pilot's commands.
        alpha_per_s: gain of backup-qp [1/s].
        duration_s: of a flight [s].
        plant_steps: steps of the plant per tick of the filter.
        losses: of navigation and radio.
        start: state at the start, see `start_of`.
        start_box: without a start: lower and upper corner of the box of random starts with h_I > 0 [m].
        start_speed_m_s: maximum speed of a random start [m/s].
        start_tilt_rad: maximum tilt of a random start [rad].

    Raises:
        ValueError: a number is out of range, or the flights have neither start nor box.
    """

    model: _core.RacerModel = field(default_factory=_core.RacerModel)
    options: _core.RacerOptions = field(default_factory=_core.RacerOptions)
    pilot: _core.Pilot = field(default_factory=lambda: _core.Pilot("straight"))
    rule: Rule = "geofence"
    alpha_per_s: float = GeofenceParameters().alpha
    duration_s: float = 8.0
    plant_steps: int = 4
    losses: _core.Losses = field(default_factory=_core.Losses)
    start: FloatArray | None = None
    start_box: tuple[Sequence[float], Sequence[float]] | None = None
    start_speed_m_s: float = 10.0
    start_tilt_rad: float = 1.0

    def __post_init__(self) -> None:
        """Refuse what cannot be flown."""
        if not 0 < self.duration_s <= 3600:
            raise ValueError("a flight takes 0 to 3600 s")
        if self.start is None and self.start_box is None:
            raise ValueError("a flight needs a start or a box of starts")

    def start_of(self, geofence: _core.Geofence, seed: int, trial: int) -> FloatArray:
        """State at the start of a trial: position, velocity, attitude w x y z, body rates; shape (13,).

        Args:
            geofence: random starts have h_I > 0 in it.
            seed: of the random numbers.
            trial: its number.

        Raises:
            ValueError: no start in the box is safe.
        """
        if self.start is not None:
            return self.start
        assert self.start_box is not None
        return _core.safe_racer_start(
            geofence,
            self.start_box,
            speed_m_s=self.start_speed_m_s,
            tilt_rad=self.start_tilt_rad,
            seed=seed,
            trial=trial,
        )

    def task(self, start: FloatArray, tick_s: float) -> _core.Task:
        """The task of a trial.

        Args:
            start: shape (13,).
            tick_s: of the filter [s], the shortest flight.
        """
        duration = max(self.duration_s, tick_s)
        return _core.Task(start, _core.Mission.by_sticks(), pilot=self.pilot, max_time_s=duration)

    def spec(self, geofence: _core.Geofence, *, keeps_ticks: bool) -> _core.SimulationSpec:
        """All parts of the simulation but the tasks and the filter.

        Args:
            geofence: whose fence, tick and limits judge the flights.
            keeps_ticks: logs have a row per tick.

        Raises:
            ValueError: a number is out of range.
        """
        # A racer moves by its own model: the body and its controller are not used.
        vehicle = _core.VehicleSpec(
            quadrotor(FASTBRIDGE),
            model="racer",
            interface="sticks",
            racer=self.model,
            racer_options=self.options,
        )
        rules = _core.SimulationRules(
            plant_steps=self.plant_steps,
            ends_when_refused=False,
            keeps_path=False,
            keeps_ticks=keeps_ticks,
        )
        return _core.SimulationSpec(
            vehicle,
            options=_core.FlightOptions(dt_s=geofence.parameters["tick_s"]),
            rules=rules,
            losses=self.losses,
            fence=geofence,
        )

    def filter(self, geofence: _core.Geofence) -> _core.FenceFilter:
        """The filter of the rule.

        Args:
            geofence: of which it is made.

        Raises:
            ValueError: alpha is not positive.
        """
        alpha = self.alpha_per_s if self.rule == "backup-qp" else None
        return _core.FenceFilter(geofence, alpha, is_bare=self.rule == "none")


def fly_trials(
    flights: FenceFlights,
    geofence: _core.Geofence,
    *,
    seed: int = 0,
    first: int = 0,
    count: int = 1,
    keeps_ticks: bool = False,
    jobs: int = 0,
) -> list[dict[str, Any]]:
    """Fly consecutive trials, each a function of (seed, trial) but for measured times.

    Returns:
        Per trial the figures of `FenceLog` in native/core by name, `path_length_m`, `start` (13) and position
        `end` (3), and with keeps_ticks per tick `state` (position, velocity, attitude w x y z, body rates:
        13), `pilot` and `command` (throttle, rates: 4), `figure` (lambda, h_I, the filter's distance and
        margin, speed towards the fence: 5), the true `distance` and `status` (number of
        alula_geofence_status).

    Args:
        flights: all but the geofence.
        geofence: the filter, with its fence, which also judges.
        seed: of the random numbers.
        first: number of the first trial.
        count: number of trials.
        keeps_ticks: the logs have a row per tick.
        jobs: threads, 0 for all processors; only measured times depend on it.

    Raises:
        ValueError: no start in the box is safe, or a number is out of range.
        OverflowError: the simulated motion diverges.
    """
    tick_s = geofence.parameters["tick_s"]
    starts = [flights.start_of(geofence, seed, trial) for trial in range(first, first + count)]
    logs = _core.simulate(
        flights.spec(geofence, keeps_ticks=keeps_ticks),
        [flights.task(start, tick_s) for start in starts],
        [flights.filter(geofence)],
        seed=seed,
        first_trial=first,
        jobs=jobs,
    )
    return [_flown(log, start, keeps_ticks=keeps_ticks) for log, start in zip(logs, starts, strict=True)]


def _flown(log: dict[str, Any], start: FloatArray, *, keeps_ticks: bool) -> dict[str, Any]:
    flown: dict[str, Any] = log["fence"] | {
        "path_length_m": log["path_length_m"],
        "start": start,
        "end": log["last"][:3],
    }
    if keeps_ticks:
        state = log["state"][:-1]
        parts = (state[:, :3], state[:, 6:9], log["attitude"][:-1], state[:, 9:])
        flown |= {"state": np.hstack(parts), "pilot": log["sticks"], "command": log["command"][:, 7:]}
    return flown
