"""Closed-loop flights of the single integrator, native on threads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.progress import Progress
from alula.schemas.run import Outcome
from alula.stages.filtering.bridge import native_filter
from alula.stages.filtering.protocol import SafetyFilter
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
    safety_filter: SafetyFilter,
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
        safety_filter: of velocities.
        start: shape (N, 3), world frame [m].
        goal: shape (N, 3), world frame [m].
        rules: time step, controller and end of a flight.
        reference: plan to track; empty to fly to the goal.
        jobs: threads, 0 for all processors; only measured times depend on it. A filter in Python runs in one.
        progress: called with (flights done, flights).

    Raises:
        InputError: a Python filter returned something that is no velocity.
        ValueError: the filter is one of other commands.
    """
    native = native_filter(safety_filter)
    logs = _core.rollout(
        native,
        start,
        goal,
        rules,
        reference.position_world,
        reference.velocity_world,
        jobs=1 if native.shares_state else jobs,
        progress=progress,
    )
    return [_flown(log) for log in logs]


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
