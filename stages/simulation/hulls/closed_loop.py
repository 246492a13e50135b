"""Closed-loop flights of the single integrator: native on threads, or in Python for a Python filter."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.schemas.progress import Progress
from alula.schemas.run import Outcome
from alula.stages.filtering.polytope_cbf import NativeFilter
from alula.stages.filtering.protocol import Filter, FilterStatus
from alula.stages.planning.plan_samples import Reference
from alula.stages.simulation.result import LOOP_OUTCOMES


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight, sampled at every step.

    Attributes:
        position: before each step and at the end, shape (S + 1, 3), world frame [m].
        u_nom: nominal input, shape (S, 3) [m/s].
        u: flown input, held for one step, shape (S, 3) [m/s].
        margin: the filter's barrier before the step, shape (S,) [m].
        status: `FilterStatus`, shape (S,).
        filter_s: measured time of each filter call, shape (S,) [s].
        outcome: end of the flight.
    """

    position: FloatArray
    u_nom: FloatArray
    u: FloatArray
    margin: NDArray[np.float32]
    status: NDArray[np.uint8]
    filter_s: NDArray[np.float32]
    outcome: Outcome


def fly(
    safety_filter: Filter,
    start: FloatArray,
    goal: FloatArray,
    rules: _core.TrialRules,
    reference: Reference,
    *,
    jobs: int = 0,
    progress: Progress | None = None,
) -> list[Flown]:
    """Fly every pair in closed loop.

    The vehicle is the single integrator x' = u with u held for dt; see
    native/core/include/alula/flight/rollout.hpp for the nominal controller and the end of a flight.

    Args:
        safety_filter: native or in Python.
        start: shape (N, 3), world frame [m].
        goal: shape (N, 3), world frame [m].
        rules: time step, controller and end of a flight.
        reference: plan to track; empty to fly to the goal.
        jobs: threads, 0 for all processors; only measured times depend on it.
        progress: called with (flights done, flights).

    Raises:
        InputError: a Python filter returned something that is no velocity.
    """
    position, velocity = reference.position_world, reference.velocity_world
    if isinstance(safety_filter, NativeFilter):
        logs = _core.rollout(
            safety_filter.native,
            start,
            goal,
            rules,
            position,
            velocity,
            use_filter=safety_filter.enabled,
            jobs=jobs,
            progress=progress,
        )
        return [_flown(log) for log in logs]
    flights = []
    for i, (a, b) in enumerate(zip(start, goal, strict=True)):
        trial = _core.Trial(a.tolist(), b.tolist(), rules, position, velocity)
        flights.append(_fly_in_python(safety_filter, trial))
        if progress is not None:
            progress(i + 1, len(start))
    return flights


def _fly_in_python(safety_filter: Filter, trial: _core.Trial) -> Flown:
    rows: dict[str, list[Any]] = {
        name: [] for name in ("position", "u_nom", "u", "margin", "status", "filter_s")
    }
    rows["position"].append(trial.position)
    outcome = 0
    while outcome == 0:
        x, u_nom = np.array(trial.position), np.array(trial.nominal())
        before = time.perf_counter()
        result = safety_filter(x, u_nom.copy())
        seconds = time.perf_counter() - before
        if np.isfinite(result.solve_time):
            seconds = result.solve_time
        status = FilterStatus(result.status)
        u = np.zeros(3) if status is FilterStatus.REFUSED else np.asarray(result.u, np.float64)
        if u.shape != (3,) or not np.isfinite(u).all():
            raise InputError(f"the filter returned {result.u!r}, which is no velocity, at {x.tolist()}")
        outcome = trial.advance(u.tolist(), status is FilterStatus.REFUSED)
        for name, value in (
            ("position", trial.position),
            ("u_nom", u_nom),
            ("u", u),
            ("margin", result.margin),
            ("status", status),
            ("filter_s", seconds),
        ):
            rows[name].append(value)
    return _flown({**rows, "outcome": outcome})


def _flown(log: dict[str, Any]) -> Flown:
    return Flown(
        position=np.asarray(log["position"], np.float64),
        u_nom=np.asarray(log["u_nom"], np.float64),
        u=np.asarray(log["u"], np.float64),
        margin=np.asarray(log["margin"], np.float32),
        status=np.asarray(log["status"], np.uint8),
        filter_s=np.asarray(log["filter_s"], np.float32),
        outcome=LOOP_OUTCOMES[log["outcome"] - 1],
    )
