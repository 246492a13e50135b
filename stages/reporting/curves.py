"""Data of a report's figures, as plain arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.log.flights import Course
from alula.schemas.log.run import TrialResult
from alula.stages.compression.hulls import Hulls
from alula.stages.reporting.fenced import fence_shape
from alula.stages.reporting.material import (
    NOT_JUDGED,
    OUTCOMES,
    Material,
    Run,
    flew_through,
    outcome_of,
)
from alula.stages.reporting.tables import voxel_count
from alula.stages.verdict import clearance_of, path_ratio

_GAP_S = 0.2
_PLAN_SAMPLES = 400
_DRAWN_PATHS = 300  # per run; failures first
_DRAWN_POINTS = 600  # per path; more cannot be distinguished on a page


@dataclass(frozen=True, slots=True)
class Distribution:
    """Empirical distribution of one run: the fraction `fraction[i]` of the values is at most `value[i]`."""

    label: str
    value: FloatArray
    fraction: FloatArray


@dataclass(frozen=True, slots=True)
class Path:
    """A flown or planned path; `position_world` has shape (n, 3) [m]."""

    label: str
    outcome: str
    position_world: FloatArray


@dataclass(frozen=True, slots=True)
class FlightMap:
    """A map seen from above: footprints (counter-clockwise polygons, shape (n, 2) [m]) and paths.

    `band_m` is the range of heights that was flown; footprints of hulls outside it are left out. `hulls`
    counts all hulls of the map.
    """

    label: str
    footprints: tuple[FloatArray, ...]
    paths: tuple[Path, ...]
    band_m: tuple[float, float] | None
    hulls: int
    fence: FloatArray | None = None  # corners of its outline, shape (n, 2); None without a fence


@dataclass(frozen=True, slots=True)
class Compression:
    """Growth and half-planes by number of hulls; growth is the sum of the hulls' volumes over the voxels'."""

    hulls: FloatArray
    growth: FloatArray
    planes: FloatArray


@dataclass(frozen=True, slots=True)
class Spell:
    """Time interval in one state of the supervisor, or with one status of a filter [s]."""

    state: str
    begin_s: float
    end_s: float

    def __str__(self) -> str:
        return f"{self.state} {self.begin_s:.2f} to {self.end_s:.2f} s"


def distribution(label: str, values: Iterable[float | None]) -> Distribution:
    """Make the empirical distribution of the known values."""
    known = np.sort(np.array([v for v in values if v is not None], np.float64))
    return Distribution(label, known, np.arange(1, len(known) + 1) / max(len(known), 1))


def clearances(runs: Sequence[Run]) -> list[Distribution]:
    """Minimum clearance of each trial, by run; runs without any are left out."""
    found = [distribution(run.label, map(clearance_of, run.record.trials)) for run in runs]
    return [one for one in found if len(one.value)]


def path_ratios(runs: Sequence[Run]) -> list[Distribution]:
    """Path length over straight line of the trials that reached their goal without a collision, by run."""
    found = [
        distribution(run.label, [path_ratio(t) for t in run.record.trials if outcome_of(t) == "reached"])
        for run in runs
    ]
    return [one for one in found if len(one.value)]


def plan_positions(plan: Artifact) -> FloatArray:
    """Sample points along a plan, evenly spaced in time over each piece, shape (n, 3) [m]."""
    time, coefficient = np.asarray(plan["time"]), np.asarray(plan["coefficient"])
    pieces = len(coefficient)
    if pieces == 0:
        return np.asarray(plan["waypoint"])[:, :3]
    each = max(2, _PLAN_SAMPLES // pieces)
    local = np.linspace(0, 1, each)[None, :] * np.diff(time)[:, None]
    powers = local[:, :, None] ** np.arange(coefficient.shape[2])
    points: FloatArray = np.einsum("kaj,ksj->ksa", coefficient[:, :3], powers).reshape(-1, 3)
    return points


def thin(points: FloatArray, maximum: int = _DRAWN_POINTS) -> FloatArray:
    """Keep at most `maximum` of the points, shape (n, 3) [m], evenly spaced, with the first and the last."""
    if len(points) <= maximum:
        return points
    return points[np.linspace(0, len(points) - 1, maximum).round().astype(np.int64)]


def paths_of(run: Run) -> list[Path]:
    """Flown paths of a run; a flight that was not logged has no path, not a straight line to its goal."""
    ends = {trial.index: outcome_of(trial) for trial in run.record.trials if trial.index in run.flights}
    if not ends and run.course is not None:  # the log was cut: no trial, but a path
        return [Path(run.label, NOT_JUDGED, thin(flown.position_world)) for flown in run.flights.values()]
    order = sorted(ends, key=lambda index: (-OUTCOMES.index(ends[index]), index))[:_DRAWN_PATHS]
    return [Path(run.label, ends[index], thin(run.flights[index].position_world)) for index in sorted(order)]


def flight_maps(material: Material) -> list[FlightMap]:
    """Make one map per run with logged flights, or one of the cover and plan alone when there are none."""
    planned = []
    if material.plan is not None:
        planned = [Path("plan", "planned", thin(plan_positions(material.plan)))]
    maps = []
    for run in material.runs:
        flown = paths_of(run)
        if flown:
            cover = material.cover if flew_through(run, material) is not False else None
            shape = fence_shape(run)
            fence = None if shape is None else footprint(shape.corners_world[:, :2])
            maps.append(replace(_flight_map(cover, run.label, planned + flown), fence=fence))
    if not maps and (material.cover is not None or planned):
        maps.append(_flight_map(material.cover, "plan" if planned else "cover", planned))
    return maps


def _flight_map(cover: Artifact | None, label: str, paths: list[Path]) -> FlightMap:
    band = None
    heights = [path.position_world[:, 2] for path in paths if len(path.position_world)]
    if heights:
        band = (float(min(h.min() for h in heights)), float(max(h.max() for h in heights)))
    if cover is None:
        return FlightMap(label, (), tuple(paths), band, 0)
    hulls = Hulls.from_cover(cover)
    vertex, start = hulls.vertices_world, hulls.vertex_start
    shown: list[FloatArray] = []
    for hull in range(len(start) - 1):
        own = vertex[start[hull] : start[hull + 1]]
        low, high = own[:, 2].min(), own[:, 2].max()
        if band is None or (low <= band[1] and high >= band[0]):
            shown.append(footprint(own[:, :2]))
    return FlightMap(label, tuple(shown), tuple(paths), band, len(start) - 1)


def footprint(points: FloatArray) -> FloatArray:
    """Convex hull of points in the plane, counter-clockwise from the smallest; exact for small integers.

    Args:
        points: shape (n, 2) [m].

    Source: Andrew 1979, monotone chain.
    """
    ordered: list[tuple[float, float]] = sorted({(x, y) for x, y in points.tolist()})
    if len(ordered) >= 3:
        ordered = _chain(ordered)[:-1] + _chain(ordered[::-1])[:-1]
    return np.array(ordered, np.float64).reshape(-1, 2)


def _chain(ordered: list[tuple[float, float]]) -> list[tuple[float, float]]:
    chain: list[tuple[float, float]] = []
    for x, y in ordered:
        while len(chain) > 1:
            (ax, ay), (bx, by) = chain[-2], chain[-1]
            if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                break
            chain.pop()
        chain.append((x, y))
    return chain


def compression(cover: Artifact | None) -> Compression | None:
    """Read the curve that merging recorded in the cover's certificate; None without one.

    Growth is 1 + (sum over hulls of the volume without voxels) / voxels, before hulls were
    tightened. Where hulls overlap it exceeds the growth of their union.
    """
    curve: Any = cover.manifest.certificate.get("curve") if cover is not None else None  # type: ignore[attr-defined]
    if cover is None or not isinstance(curve, dict):
        return None
    columns = [curve.get(key) for key in ("hulls", "excess_sum_voxels", "half_planes")]
    if not all(isinstance(column, list) and column for column in columns):
        return None
    hulls, excess, planes = (np.array(column, np.float64) for column in columns)
    return Compression(hulls, 1 + excess / max(voxel_count(cover), 1), planes)


def broken(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Insert a NaN into a curve at each gap much longer than its usual step, so that no line bridges it.

    Args:
        time_s: shape (n,), ascending.
        values: shape (n,).
    """
    step = np.diff(time_s)
    if len(step) == 0:
        return time_s, values
    gaps = np.flatnonzero(step > max(10 * float(np.median(step)), _GAP_S)) + 1
    return np.insert(time_s, gaps, time_s[gaps - 1]), np.insert(values, gaps, np.nan)


def spells(course: Course | None) -> tuple[Spell, ...]:
    """Supervisor states in order of time; steps that stay in a state extend it, the last has no duration."""
    found: list[Spell] = []
    for step in course.steps if course is not None else ():
        if found and found[-1].state == step.state:
            continue
        if found:
            found[-1] = Spell(found[-1].state, found[-1].begin_s, step.time_s)
        found.append(Spell(step.state, step.time_s, step.time_s))
    if course is not None and found:
        found[-1] = Spell(found[-1].state, found[-1].begin_s, max(found[-1].begin_s, course.end_s))
    return tuple(spell for spell in found if spell.end_s > spell.begin_s)


def encounter_clearance(run: Run, trial: TrialResult) -> float | None:
    """Minimum distance of a trial's spheres to obstacles and walls [m]; None where no radius is known."""
    parameters = run.record.provenance.parameters
    try:
        own = float(parameters["vehicle"]["radius_m"])
        radii = [float(obstacle["radius_m"]) for obstacle in parameters["obstacles"]]
    except (KeyError, TypeError, ValueError):
        return clearance_of(trial)
    known = [met.closest_m - r - own for met, r in zip(trial.obstacles or [], radii, strict=False)]
    walls = clearance_of(trial)
    return min(known + ([] if walls is None else [walls]), default=None)
