"""Flights in a geofence: rows and columns of the report's tables, and the data of its figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.log.run import FenceResult, TrialResult
from alula.stages.reporting.material import Run, outcome_of
from alula.stages.runlog.maps import fence_shell
from alula.stages.vehicles.fence import fence_faces
from alula.stages.verdict import FENCED, clearance_of

FENCE_NOTE = (
    "Distances are those of the vehicle's sphere to the nearest face or hull, computed from the true path "
    "and not by the filter; below zero is outside. lambda is the regulation function: at 1 the pilot's "
    "command passes bit for bit, at 0 the backup controller flies alone."
)
_COUNTS = ("passed", "blended", "backup", "no_pilot", "hand_over", "refused")


def is_fenced(run: Run) -> bool:
    """Return whether a run was flown in a geofence."""
    return any(trial.fence is not None for trial in run.record.trials)


def fence_figures(run: Run) -> dict[str, Any]:
    """Figures of the fence in a run's summary."""
    found: dict[str, Any] = run.record.summary["fence"]
    return found


def fence_distance(trial: TrialResult) -> float:
    """Minimum distance of a flight to its fence, faces and hulls, infinite where unknown [m]."""
    found = clearance_of(trial, *FENCED)
    return math.inf if found is None else found


def fence_rows(run: Run) -> dict[str, Any]:
    """Rows of the table of runs for a run in a geofence, after filter, vehicle and trials."""
    summary, trials = fence_figures(run), run.record.trials
    ticks = sum(trial.steps for trial in trials)
    counts = {f"fraction of ticks: {name.replace('_', ' ')}": summary.get(name) for name in _COUNTS}
    return {
        "left the fence": summary.get("violations"),
        "minimum distance to the fence [m]": summary.get("min_distance_m"),
        "in trial": run.record.summary.get("worst_trial"),
        "distance at the first intervention, median [m]": summary.get("brake_distance_m"),
        "distance when stopped after it, median [m]": summary.get("stop_distance_m"),
        "top speed [km/h]": summary.get("max_speed_km_h"),
        "interventions": summary.get("interventions"),
        "trials with interventions": summary.get("engaged_trials"),
        "minimum lambda": summary.get("min_lambda"),
        "minimum h_I [m]": summary.get("min_h_i_m"),
        "longest time of the backup controller alone [s]": summary.get("longest_backup_s"),
        "ticks": ticks,
        **{key: count / ticks if count is not None and ticks else None for key, count in counts.items()},
        "passed commands that differ from the pilot's": summary.get("altered_passes"),
        "commands beyond the limits": summary.get("out_of_range"),
    }


def fence_columns() -> dict[str, Callable[[TrialResult], Any]]:
    """Columns of the table of trials."""

    def of(get: Callable[[FenceResult], Any]) -> Callable[[TrialResult], Any]:
        return lambda trial: None if trial.fence is None else get(trial.fence)

    return {
        "trial": lambda t: t.index,
        "outcome": outcome_of,
        "minimum distance [m]": fence_distance,
        "top speed [km/h]": lambda t: 3.6 * t.max_speed_m_s,
        "path [m]": lambda t: t.path_length_m,
        "interventions": of(lambda f: f.interventions),
        "braked at [m]": of(lambda f: f.brake_distance_m),
        "stopped at [m]": of(lambda f: f.stop_distance_m),
        "minimum λ": of(lambda f: f.min_lambda),
        "minimum h_I [m]": of(lambda f: f.min_h_i_m),
        "passed": of(lambda f: f.passed_steps),
        "blended": of(lambda f: f.blended_steps),
        "backup": of(lambda f: f.backup_steps),
        "no pilot": of(lambda f: f.no_pilot_steps),
        "hand over": of(lambda f: f.hand_over_steps),
    }


@dataclass(frozen=True, slots=True)
class FenceShape:
    """The visible part of the fence: corners, shape (V, 3) [m], and triangles, shape (T, 3)."""

    corners_world: FloatArray
    triangles: NDArray[np.int64]


def fence_shape(run: Run) -> FenceShape | None:
    """Box and faces in which a run was flown; None where its parameters have no fence."""
    world = run.record.provenance.parameters.get("world")
    table = world.get("fence") if isinstance(world, Mapping) else None
    if not isinstance(table, Mapping) or not is_fenced(run):
        return None
    faces = fence_faces(table.get("box_m"), table.get("faces") or ())
    paths = [flight.position_world for flight in run.flights.values()]
    return FenceShape(*fence_shell(faces, paths)) if len(faces) else None
