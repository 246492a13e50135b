"""Closed-loop flights among ellipsoids, native on threads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.progress import Progress
from alula.schemas.run import Outcome
from alula.stages.filtering.bridge import NativeFilter, native_filter
from alula.stages.filtering.protocol import SafetyFilter
from alula.stages.simulation.result import LOOP_OUTCOMES, SplatFlightLog, logged_ticks

_LOGGED = (
    *("a_nominal", "a_command", "a_error", "u_nominal", "u", "rotor_thrust", "margin", "gate_m", "active"),
    *("candidates", "rows", "iterations", "status", "capped", "infeasible", "certified", "saturated"),
)


@dataclass(frozen=True, slots=True)
class SplatFlown:
    """One flight of S ticks; a row per tick, at its beginning unless stated otherwise.

    Attributes:
        position: path at the rate of the plant, shape (S plant_steps + 1, 3), world frame [m].
        state: position, attitude (MRP), velocity, body rates, shape (S + 1, 12); the last row is the end.
        a_nominal: acceleration of the nominal command, shape (S, 3) [m/s^2].
        a_command: acceleration after the filter, shape (S, 3) [m/s^2]; for a wrench, that of its thrust along
            the axis that the filter saw, held for the tick.
        a_error: maximum of |a - a_command| within the tick, shape (S,) [m/s^2].
        u_nominal: thrust and torque of the controller, shape (S, 4) [N, N m].
        u: thrust and torque as flown, within the limits of the rotors, shape (S, 4); 0 without rotors.
        rotor_thrust: of each rotor, shape (S, 4) [N].
        margin: the filter's own barrier, shape (S,); infinite without an obstacle.
        gate_m: distance within which the filter considered ellipsoids, shape (S,) [m].
        active: ellipsoid of the decisive row, or the number of ellipsoids plus that of a hull; -1 for none,
            shape (S,).
        candidates, rows, iterations: of the filter's program, shape (S,).
        status: `FilterStatus`, shape (S,).
        capped, infeasible, certified, saturated: shape (S,).
        filter_s: measured time of the filter, shape (S,) [s].
        tick_s: measured time of controller and filter, shape (S,) [s].
        outcome: end of the flight.
    """

    position: FloatArray
    state: FloatArray
    a_nominal: FloatArray
    a_command: FloatArray
    a_error: FloatArray
    u_nominal: FloatArray
    u: FloatArray
    rotor_thrust: FloatArray
    margin: FloatArray
    gate_m: FloatArray
    active: NDArray[np.int64]
    candidates: NDArray[np.uint32]
    rows: NDArray[np.uint32]
    iterations: NDArray[np.uint32]
    status: NDArray[np.uint8]
    capped: NDArray[np.bool_]
    infeasible: NDArray[np.bool_]
    certified: NDArray[np.bool_]
    saturated: NDArray[np.bool_]
    filter_s: NDArray[np.float32]
    tick_s: NDArray[np.float32]
    outcome: Outcome


def fly(
    safety_filter: SafetyFilter | None,
    vehicle: _core.FlightVehicle,
    references: Sequence[_core.ReferenceCurve],
    rules: _core.FlightRules,
    *,
    guide: NativeFilter | None = None,
    seed: int = 0,
    first_trial: int = 0,
    jobs: int = 0,
    progress: Progress | None = None,
) -> list[SplatFlown]:
    """Fly every reference in closed loop; see native/core/include/alula/flight/splat_flight.hpp.

    Args:
        safety_filter: None flies the nominal command.
        vehicle: body, controller and plant.
        references: one per flight.
        rules: times and end of a flight.
        guide: filter of accelerations that changes the nominal command before `safety_filter` gets it.
        seed: of the plant's noise, together with the trial's number, which counts from `first_trial`.
        first_trial: number of the first flight.
        jobs: threads, 0 for all processors; only measured times depend on it. A filter in Python runs in one.
        progress: called with (flights done, flights).

    Raises:
        InputError: a Python filter returned something that cannot be flown.
        ValueError: the rules are inconsistent, or a double integrator cannot fly a wrench.
    """
    native = None if safety_filter is None else native_filter(safety_filter)
    logs = _core.fly(
        vehicle,
        rules,
        list(references),
        native,
        guide=None if guide is None else guide.native,
        seed=seed,
        first_trial=first_trial,
        jobs=1 if native is not None and native.shares_state else jobs,
        progress=progress,
    )
    return [_flown(log) for log in logs]


def _flown(log: dict[str, Any]) -> SplatFlown:
    flags = log.pop("flags")
    named = {
        name: (flags & bit) != 0
        for name, bit in (("capped", 1), ("infeasible", 2), ("certified", 4), ("saturated", 8))
    }
    return SplatFlown(**{**log, **named, "outcome": LOOP_OUTCOMES[log["outcome"] - 1]})


def decimate(flown: SplatFlown, dt_s: float, rate_hz: float) -> SplatFlightLog:
    """Sample a flight for the log, see `logged_ticks`; `a_error` is the maximum since the sample before.

    Args:
        flown: the flight.
        dt_s: duration of a tick [s].
        rate_hz: samples per second in the log.
    """
    steps = len(flown.status)
    sample = logged_ticks(steps, dt_s, rate_hz)
    held = np.minimum(sample, steps - 1)
    rows = {name: getattr(flown, name)[held] for name in _LOGGED}
    rows["a_error"][1:] = np.maximum.reduceat(flown.a_error, sample[:-1])
    rows["a_error"][0] = flown.a_error[0]
    state = flown.state[sample]
    is_finite = np.isfinite(state).all(axis=1)  # a flight whose state is not finite is refused at once
    return SplatFlightLog(
        time_s=sample[is_finite].astype(np.float64) * dt_s,
        position=state[is_finite, :3],
        state=state[is_finite],
        flown={name: row[is_finite] for name, row in rows.items()},
    )
