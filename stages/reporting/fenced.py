"""What a report says of flights in a geofence: numbers, rows and columns, and the data of figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.run import FenceResult, TrialResult
from alula.stages.reporting.material import Run
from alula.stages.runlog.maps import fence_shell
from alula.stages.vehicles.fence import fence_faces

FENCE_NOTE = (
    "Distances are of the vehicle's sphere to the nearest face or hull, judged by the true path and not "
    "by the filter; below zero is outside. lambda is the pilot's share of the command: 1 is his, bit by bit."
)
_COUNTS = ("passed", "blended", "backup", "no_pilot", "hand_over", "refused")


def is_fenced(run: Run) -> bool:
    """Whether a run was flown in a geofence."""
    return any(trial.fence is not None for trial in run.record.trials)


def fence_rows(run: Run) -> dict[str, Any]:
    """What the table of runs says of one in a geofence, after filter, vehicle and trials."""
    summary, trials = run.record.summary, run.record.trials
    ticks = sum(trial.steps for trial in trials)
    shares = {f"share of ticks: {name.replace('_', ' ')}": summary.get(name) for name in _COUNTS}
    return {
        "left the fence": summary.get("violations"),
        "least distance to the fence [m]": summary.get("min_distance_m"),
        "in trial": summary.get("worst_trial"),
        "distance at the first intervention, median [m]": summary.get("brake_distance_m"),
        "distance when stopped after it, median [m]": summary.get("stop_distance_m"),
        "top speed [km/h]": summary.get("max_speed_km_h"),
        "interventions": summary.get("interventions"),
        "trials with one": summary.get("engaged_trials"),
        "least lambda": summary.get("min_lambda"),
        "least h_I [m]": summary.get("min_h_i_m"),
        "longest time of the backup controller alone [s]": summary.get("longest_backup_s"),
        "ticks": ticks,
        **{key: count / ticks if count is not None and ticks else None for key, count in shares.items()},
        "passed commands that are not the pilot's bits": summary.get("altered_passes"),
        "commands beyond the limits": summary.get("out_of_range"),
    }


def fence_columns() -> dict[str, Callable[[TrialResult], Any]]:
    """The columns of the table of trials."""

    def of(get: Callable[[FenceResult], Any]) -> Callable[[TrialResult], Any]:
        return lambda trial: None if trial.fence is None else get(trial.fence)

    return {
        "trial": lambda t: t.index,
        "outcome": lambda t: t.outcome,
        "least distance [m]": lambda t: t.map_clearance_m,
        "top speed [km/h]": lambda t: 3.6 * t.max_speed_m_s,
        "path [m]": lambda t: t.path_length_m,
        "interventions": of(lambda f: f.interventions),
        "braked at [m]": of(lambda f: f.brake_distance_m),
        "stopped at [m]": of(lambda f: f.stop_distance_m),
        "least λ": of(lambda f: f.min_lambda),
        "least h_I [m]": of(lambda f: f.min_h_i_m),
        "passed": of(lambda f: f.passed_steps),
        "blended": of(lambda f: f.blended_steps),
        "backup": of(lambda f: f.backup_steps),
        "no pilot": of(lambda f: f.no_pilot_steps),
        "hand over": of(lambda f: f.hand_over_steps),
    }


@dataclass(frozen=True, slots=True)
class FenceShape:
    """The fence as far as it is shown: corners (V, 3) and triangles (T, 3)."""

    corners_world: FloatArray
    triangles: NDArray[np.int64]


def fence_shape(run: Run) -> FenceShape | None:
    """The box and the faces that a run was flown in; None where it says nothing of a fence."""
    table = run.record.provenance.parameters.get("fence")
    if not isinstance(table, Mapping) or not is_fenced(run):
        return None
    faces = fence_faces(table.get("box_m"), table.get("faces") or ())
    paths = [flight.position_world for flight in run.flights.values()]
    return FenceShape(*fence_shell(faces, paths)) if len(faces) else None


@dataclass(frozen=True, slots=True)
class ClosestFlight:
    """The logged flight of a run that came closest to its fence, or went farthest beyond it.

    `distance_m` is the true one, `share` the filter's lambda, NaN where there was none; `status` its words.
    """

    label: str
    trial: TrialResult
    time_s: FloatArray
    distance_m: FloatArray
    share: FloatArray
    status: tuple[str, ...]
    speed_time_s: FloatArray
    speed_m_s: FloatArray


def closest_flights(runs: Sequence[Run]) -> list[ClosestFlight]:
    """One for each run in a fence that has logged flights."""
    found = []
    for run in filter(is_fenced, runs):
        shown = [trial for trial in run.record.trials if trial.index in run.flights]
        if not shown:
            continue
        trial = min(shown, key=lambda t: (t.map_clearance_m or 0.0, t.index))
        flight = run.flights[trial.index]
        share = np.full(len(flight.margin), np.nan) if flight.regulation is None else flight.regulation
        found.append(
            ClosestFlight(
                run.label, trial, flight.margin_time_s, flight.margin, share, flight.status, flight.time_s,
                flight.speed_m_s,
            )
        )  # fmt: skip
    return found
