"""The tables of a report. They hold all of its numbers; the page, the Markdown and the CSV only lay them out.

One table compares the runs, one lists the trials of each run. Others describe the map, the measured times,
the parameters, the input files and the course of a real flight.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import UsageError
from alula.schemas.log.run import PLAN_OUTCOMES, FenceResult, TrialResult
from alula.stages.compression.level import obstacle_of
from alula.stages.reporting.fenced import FENCE_NOTE, fence_columns, fence_rows, is_fenced
from alula.stages.reporting.material import (
    OUTCOMES,
    Material,
    Run,
    flew_through,
    is_composed,
    is_covered,
    outcome_of,
)
from alula.stages.reporting.table import Table, csv_cell, flat, text
from alula.stages.verdict import path_ratio

BYTES_PER_GAUSSIAN = 40  # centre, semi-axes, quaternion in single precision
BYTES_PER_VOXEL = 12  # three 32-bit integers
BYTES_PER_HALF_PLANE = 16  # normal and offset in single precision
_ENDS = {"collision": "collided"}
_RARE = ("stopped", "held", *PLAN_OUTCOMES)  # shown only where they occur
_LEVELS = {3: "warning", 4: "error", 5: "fatal"}  # of `foxglove.Log`  # of `foxglove.Log`
LISTED_TRIALS = 500  # per run; the CSV lists all


def all_tables(
    material: Material,
    names: Sequence[str] = (),
    *,
    listed: int | None = LISTED_TRIALS,
) -> list[Table]:
    """Make the tables of a report, in reading order.

    Args:
        names: tables to keep; all when empty.
        listed: number of trials that are listed of each run; None for all.

    Raises:
        UsageError: no table has one of the names.
    """
    tables = []
    if material.runs:
        tables.append(runs_table(material))
    if material.cover is not None or material.scene is not None:
        tables += [compression_table(material), cover_table(material)]
    timed = [run for run in material.runs if run.record.timing]
    if timed:
        tables.append(_beside("timing", "Measured times", timed, lambda run: flat(run.record.timing)))
    if material.runs:
        tables.append(
            _beside("parameters", "Parameters", material.runs, lambda r: flat(r.record.provenance.parameters))
        )
    many = len(material.runs) > 1
    for n, run in enumerate(material.runs, 1):
        tables.append(trials_table(run, f"trials-{n}" if many else "trials", listed))
    tables += [*course_tables(material.runs), inputs_table(material)]
    known = [table.name for table in tables]
    if missing := [name for name in names if name not in known]:
        raise UsageError(f"--table {missing[0]}: this report has {', '.join(known)}")
    return [table for table in tables if not names or table.name in names]


def _beside(
    name: str, title: str, runs: Sequence[Run], values: Callable[[Run], dict[str, Any]], note: str = ""
) -> Table:
    """One row per key, one column per run."""
    found = [values(run) for run in runs]
    keys = list(dict.fromkeys(key for record in found for key in record))
    rows = tuple((key, *(record.get(key) for record in found)) for key in keys)
    return Table(name, title, ("", *(run.label for run in runs)), rows, note)


def success_interval(run: Run) -> tuple[float, float] | None:
    """95 % interval of the success rate in the run's summary."""
    match run.record.summary.get("success_interval"):
        case [float() | int() as low, float() | int() as high]:
            return float(low), float(high)
    return None


def _summary_of(run: Run) -> dict[str, Any]:
    record, summary = run.record, run.record.summary
    interval = success_interval(run)
    trials = record.trials
    steps = sum(trial.steps for trial in trials)
    ends = {end: sum(outcome_of(trial) == end for trial in trials) for end in OUTCOMES}
    counts = {
        "fraction of steps changed by the filter": sum(trial.filtered_steps for trial in trials),
        "fraction of steps shortened": sum(trial.shortened_steps for trial in trials),
        "fraction of steps infeasible": sum(trial.infeasible_steps for trial in trials),
        "fraction of steps on the fallback": sum(trial.fallback_steps for trial in trials),
    }
    head: dict[str, Any] = {"filter": record.filter, "vehicle": record.vehicle}
    head |= {"hulls of the map": run.hulls, "trials": len(trials)}
    if is_fenced(run):
        return head | fence_rows(run) | _composed(run)
    return {
        **head,
        "success rate": summary.get("success_rate"),
        "success rate, 95 % low": interval[0] if interval else None,
        "success rate, 95 % high": interval[1] if interval else None,
        **{_ENDS.get(end, end): count for end, count in ends.items() if count or end not in _RARE},
        "minimum clearance to the hulls [m]": summary.get("min_map_clearance_m"),
        "minimum clearance to the splats [m]": summary.get("min_scene_clearance_m"),
        **course_rows(summary),
        "path / straight line, mean of successes": summary.get("mean_path_ratio"),
        "top speed [m/s]": max((trial.max_speed_m_s for trial in trials), default=None),
        "maximum jerk [m/s³]": max((trial.max_jerk_m_s3 for trial in trials), default=None),
        "mean jerk [m/s³]": float(np.mean([t.mean_jerk_m_s3 for t in trials])) if trials else None,
        "steps": steps,
        **{key: count / steps if steps else None for key, count in counts.items()},
        **_among_ellipsoids(run, steps),
        **_composed(run),
    }


def _composed(run: Run) -> dict[str, Any]:
    """Rows that only simulated flights have; empty for others."""
    summary = run.record.summary
    if not any(map(is_composed, run.record.trials)):
        return {}
    return {
        "minimum clearance inside the fence [m]": summary.get("min_fence_clearance_m"),
        "minimum clearance to moving obstacles [m]": summary.get("min_moving_clearance_m"),
        "flights that touched what does not move": summary.get("static_collisions"),
        "flights that touched a moving obstacle": summary.get("moving_collisions"),
        "fraction of steps certified against what does not move": summary.get("certified_share_static"),
        "fraction of steps certified against tubes of tracks too": summary.get("certified_share_moving"),
    }


def _among_ellipsoids(run: Run, steps: int) -> dict[str, Any]:
    """Rows that only flights among ellipsoids have; empty for others."""
    trials, summary = run.record.trials, run.record.summary
    if all(trial.peak_realisation_error_m_s2 is None for trial in trials):
        return {}
    counts = {
        "fraction of steps on the backup policy": "backup_steps",
        "fraction of steps with a safe backup proven": "certified_steps",
        "fraction of steps with ellipsoids cut off": "capped_steps",
        "fraction of steps beyond the rotors' limits": "saturated_steps",
    }
    maxima = {
        "maximum speed of the references [m/s]": "reference_speed_m_s",
        "maximum mean speed of a trial [m/s]": "mean_speed_m_s",
        "maximum acceleration [m/s²]": "max_acceleration_m_s2",
        "maximum distance from the reference [m]": "max_tracking_error_m",
        "maximum realisation error [m/s²]": "peak_realisation_error_m_s2",
    }
    found: dict[str, Any] = {
        "guide": _guide(run),
        "level of the ellipsoids [σ]": summary.get("sigma"),
        "pairs with a blocked line": summary.get("blocked_pairs"),
        "steps with qp infeasible": sum(trial.infeasible_steps for trial in trials),
    }
    found |= {title: max(_known(trials, key), default=None) for title, key in maxima.items()}
    found["minimum γ = rᵀAr - 1"] = min(_known(trials, "min_gamma"), default=None)
    return found | {
        title: sum(_known(trials, key)) / steps if steps else None for title, key in counts.items()
    }


def _guide(run: Run) -> Any:
    """Name of the mission's guide."""
    mission = run.record.provenance.parameters.get("mission")
    controller = mission.get("controller") if isinstance(mission, dict) else None
    return controller.get("guide") if isinstance(controller, dict) else None


def _known(trials: Sequence[TrialResult], key: str) -> list[Any]:
    return [value for trial in trials if (value := getattr(trial, key)) is not None]


def runs_table(material: Material) -> Table:
    """Compare the runs side by side; rows without any value are left out."""

    def values(run: Run) -> dict[str, Any]:
        known = flew_through(run, material)
        return _summary_of(run) | ({} if known is None else {"flew through the cover shown": known})

    note = (
        "Clearances are those of the vehicle's sphere, computed after the flight; below zero is a collision. "
        "Each trial has one outcome; a trial that collided counts only as a collision."
    )
    if all(map(is_fenced, material.runs)):
        note = FENCE_NOTE
    table = _beside("runs", "Flights", material.runs, values, note)
    known = tuple(row for row in table.rows if any(value is not None for value in row[1:]))
    return replace(table, rows=known)


def course_rows(summary: Mapping[str, Any]) -> dict[str, Any]:
    """Rows that only a real flight's summary has; empty for others."""
    if "ended_by" not in summary:
        return {}
    return {
        "ended by": summary["ended_by"],
        "holds": summary.get("holds"),
        "maximum distance from the plan [m]": summary.get("max_tracking_error_m"),
    }


def course_tables(runs: Sequence[Run]) -> list[Table]:
    """Two tables of each real flight: the supervisor's steps and the log messages."""
    found: list[Table] = []
    for number, run in enumerate(runs, 1):
        if (course := run.course) is None:
            continue
        end = f"-{number}" if len(runs) > 1 else ""
        steps = tuple((round(step.time_s, 3), step.event, step.state, step.action) for step in course.steps)
        lines = tuple(
            (round(line.time_s, 3), _LEVELS.get(line.level, ""), line.words) for line in course.lines
        )
        note = f"Last record of the supervisor at {course.end_s:.2f} s."
        title, columns = f"Course of {run.label}", ("time [s]", "event", "state after it", "action")
        found.append(Table(f"course{end}", title, columns, steps, note))
        title = f"Messages of {run.label}"
        found.append(Table(f"messages{end}", title, ("time [s]", "level", "message"), lines))
    return found


def trials_table(run: Run, name: str, listed: int | None = LISTED_TRIALS) -> Table:
    """List the trials of a run, one row per trial, all where `listed` is None."""
    columns: dict[str, Callable[[TrialResult], Any]] = {
        "trial": lambda t: t.index,
        "outcome": lambda t: t.outcome,
        "collision": lambda t: t.collision,
        "clearance to hulls [m]": lambda t: t.map_clearance_m,
        "clearance to splats [m]": lambda t: t.scene_clearance_m,
        "duration [s]": lambda t: t.duration_s,
        "path [m]": lambda t: t.path_length_m,
        "path / straight": path_ratio,
        "top speed [m/s]": lambda t: t.max_speed_m_s,
        "steps": lambda t: t.steps,
        "changed": lambda t: t.filtered_steps,
        "infeasible": lambda t: t.infeasible_steps,
        "fallback": lambda t: t.fallback_steps,
    }
    trials = run.record.trials
    if is_fenced(run):
        columns = fence_columns()
    if _known(trials, "peak_realisation_error_m_s2"):
        columns = {"qp infeasible" if key == "infeasible" else key: get for key, get in columns.items()}
        columns |= {
            "blocked": lambda t: _is_blocked(t, run),
            "clearance of the straight line [m]": lambda t: t.line_clearance_m,
            "backup": lambda t: t.backup_steps,
            "proven": lambda t: t.certified_steps,
            "realisation error [m/s²]": lambda t: t.peak_realisation_error_m_s2,
            "maximum jerk [m/s³]": lambda t: t.max_jerk_m_s3,
            "minimum γ": lambda t: t.min_gamma,
        }
    rows = tuple(tuple(get(trial) for get in columns.values()) for trial in trials[:listed])
    note = (
        f"The first {len(rows)} of {len(trials)} trials; the CSV file next to the report lists all."
        if len(rows) < len(trials)
        else ""
    )
    return Table(name, f"Trials of {run.label}", tuple(columns), rows, note)


def _is_blocked(trial: TrialResult, run: Run) -> bool | None:
    """Return whether the straight line comes nearer to an ellipsoid than filters allow."""
    added = run.record.summary.get("inflation_m")
    if trial.line_clearance_m is None or not isinstance(added, int | float):
        return None
    return trial.line_clearance_m < added


def compression_table(material: Material) -> Table:
    """Count the Gaussians, voxels and hulls, and their bytes."""
    cover, scene = material.cover, material.scene
    rows: list[tuple[Any, ...]] = []
    gaussians = gaussian_count(material)
    if gaussians is not None:
        size = material.file_bytes.get("scene") if scene is not None else None
        rows.append(("Gaussians", gaussians, None, gaussians * BYTES_PER_GAUSSIAN, size))
    if cover is not None:
        voxels, planes = voxel_count(cover), len(cover["plane_offset"])
        rows.append(("voxels", voxels, None, voxels * BYTES_PER_VOXEL, None))
        hulls = len(cover["plane_start"]) - 1
        size = material.file_bytes.get("cover")
        rows.append(("hulls", hulls, planes, planes * BYTES_PER_HALF_PLANE, size))
    columns = ("representation", "primitives", "half-planes", "geometry [bytes]", "file [bytes]")
    note = (
        f"Geometry counts {BYTES_PER_GAUSSIAN} bytes per Gaussian, {BYTES_PER_VOXEL} per voxel and "
        f"{BYTES_PER_HALF_PLANE} per half-plane. The file also holds vertices, members and provenance."
    )
    return Table("compression", "From Gaussians to half-planes", columns, tuple(rows), note)


def gaussian_count(material: Material) -> int | None:
    """Number of Gaussians of the scene, or else the number in the cover's summary."""
    if material.scene is not None:
        return len(material.scene["mean"])
    found = material.cover.manifest.summary.get("gaussians") if material.cover is not None else None
    return found if isinstance(found, int) else None


def voxel_count(cover: Artifact) -> int:
    """Number of voxels that a cover was built from, each counted once."""
    found = cover.manifest.summary.get("voxels")
    return found if isinstance(found, int) else len(np.unique(np.asarray(cover["member_index"]), axis=0))


def cover_table(material: Material) -> Table:
    """List the values of the cover's manifest and of the certificate."""
    rows: list[tuple[Any, ...]] = []
    cover = material.cover
    if cover is not None:
        manifest: Any = cover.manifest
        planes = np.diff(np.asarray(cover["plane_start"]))
        rows += [
            ("voxel edge [m]", manifest.voxel_size_m),
            ("obstacles", f"every {obstacle_of(manifest)}"),
            ("level of the ellipsoids [σ]", manifest.sigma),
            (f"number of {obstacle_of(manifest)}s that occupy a voxel, minimum", manifest.min_overlap),
            ("inflation [m]", manifest.inflation_m),
            ("conservativeness (volume of hulls / voxels)", manifest.conservativeness),
            ("half-planes per hull, mean", float(planes.mean()) if len(planes) else None),
            ("half-planes per hull, maximum", int(planes.max()) if len(planes) else None),
        ]
        rows += [(f"summary: {key}", value) for key, value in _plain(flat(manifest.summary))]
        rows += [(f"construction: {key}", value) for key, value in _plain(flat(manifest.certificate))]
        if manifest.guarantee is not None:
            rows.append(("guarantee", manifest.guarantee.statement))
    if material.certificate is not None:
        own = {k: v for k, v in material.certificate.items() if k not in ("provenance", "checks", "covered")}
        for check in material.certificate.get("checks", []):
            verdict = "holds" if check.get("ok") else "DOES NOT HOLD"
            rows.append(
                (f"verified: {check.get('name')}", f"{verdict} ({text(check.get('checked'))} checked)")
            )
        rows += [(f"verified: {key}", value) for key, value in _plain(flat(own))]
    if material.scene is not None:
        rows += [(f"scene: {key}", value) for key, value in _plain(flat(material.scene.manifest.summary))]
    rows.append(("verified: covered", is_covered(material.certificate)))
    return Table("cover", "Map", ("", "value"), tuple(rows))


def _plain(record: dict[str, Any]) -> Iterable[tuple[str, Any]]:
    """Entries of a record that fit into a cell."""
    for key, value in record.items():
        if not isinstance(value, list) or (len(value) <= 6 and not any(isinstance(v, dict) for v in value)):
            yield key, value


def inputs_table(material: Material) -> Table:
    """List the files that the report was made from."""
    rows = tuple(
        (ref.role, ref.name, f"{ref.schema} {ref.version}".strip() or None, ref.sha256[:16])
        for ref in material.inputs
    )
    return Table("inputs", "Made from", ("role", "file", "kind", "SHA-256 begins with"), rows)


_FENCE_FIELDS = tuple(field.name for field in msgspec.structs.fields(FenceResult))
_TRIAL_FIELDS = tuple(f.name for f in msgspec.structs.fields(TrialResult) if f.name != "fence")
CSV_COLUMNS = ("run", "filter", "vehicle", *_TRIAL_FIELDS, *(f"fence_{name}" for name in _FENCE_FIELDS))


def to_csv(material: Material) -> str:
    """Write one row per trial of every run as CSV, with all digits.

    Points are x y z; an unknown value is empty.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for run in material.runs:
        for trial in run.record.trials:
            values = [getattr(trial, name) for name in _TRIAL_FIELDS]
            values += [getattr(trial.fence, name, None) for name in _FENCE_FIELDS]
            writer.writerow([run.label, run.record.filter, run.record.vehicle, *map(csv_cell, values)])
    return out.getvalue()
