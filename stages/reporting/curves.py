"""The data of a report's figures, as plain arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifact import Artifact
from alula.schemas.run import TrialResult
from alula.stages.reporting.material import Material, Run, clearance_of, outcome_of
from alula.stages.reporting.tables import path_ratio

Floats = NDArray[np.float64]

_QUIET = ("", "ok", "filtered")  # what a filter does all the time
_PLAN_SAMPLES = 400
_DRAWN_POINTS = 600  # per path; more are not told apart on a page


@dataclass(frozen=True, slots=True)
class Distribution:
    """Sorted values of one run; `share[i]` of them are at most `value[i]`."""

    label: str
    value: Floats
    share: Floats


@dataclass(frozen=True, slots=True)
class Path:
    """One flown or planned path."""

    label: str
    outcome: str
    position_world: Floats


@dataclass(frozen=True, slots=True)
class FlightMap:
    """A map from above: footprints (counter-clockwise polygons) and paths.

    `band_m` is the range of heights that was flown; footprints of hulls outside it are left out.
    """

    label: str
    footprints: tuple[Floats, ...]
    paths: tuple[Path, ...]
    band_m: tuple[float, float] | None
    hulls: int


@dataclass(frozen=True, slots=True)
class Compression:
    """Conservativeness and half-planes over the number of hulls; one of them may be missing."""

    hulls: Floats
    conservativeness: Floats | None
    planes: Floats | None


@dataclass(frozen=True, slots=True)
class WorstFlight:
    """The margin over time of the flight that came closest.

    `trouble` marks the margins where the filter had to do more than change the input; `statuses` are
    the words for it.
    """

    label: str
    trial: int
    clearance_m: float
    margin_time_s: Floats
    margin_m: Floats
    speed_time_s: Floats
    speed_m_s: Floats
    trouble: NDArray[np.bool_]
    statuses: tuple[str, ...]


def distribution(label: str, values: Iterable[float | None]) -> Distribution:
    """The empirical distribution of the values that are known."""
    known = np.sort(np.array([v for v in values if v is not None], np.float64))
    return Distribution(label, known, np.arange(1, len(known) + 1) / max(len(known), 1))


def clearances(runs: Sequence[Run]) -> list[Distribution]:
    """Least clearance of each trial, by run; runs without any are left out."""
    found = [distribution(run.label, map(clearance_of, run.record.trials)) for run in runs]
    return [one for one in found if len(one.value)]


def path_ratios(runs: Sequence[Run]) -> list[Distribution]:
    """Path over straight line of the trials that reached their goal without a collision, by run."""
    found = [
        distribution(run.label, [path_ratio(t) for t in run.record.trials if outcome_of(t) == "reached"])
        for run in runs
    ]
    return [one for one in found if len(one.value)]


def plan_positions(plan: Artifact) -> Floats:
    """Points along a plan, evenly spaced in time over each piece, shape (n, 3) [m]."""
    time, coefficient = np.asarray(plan["time"]), np.asarray(plan["coefficient"])
    pieces = len(coefficient)
    if pieces == 0:
        return np.asarray(plan["waypoint"])[:, :3]
    each = max(2, _PLAN_SAMPLES // pieces)
    local = np.linspace(0, 1, each)[None, :] * np.diff(time)[:, None]
    powers = local[:, :, None] ** np.arange(coefficient.shape[2])
    points: Floats = np.einsum("kaj,ksj->ksa", coefficient[:, :3], powers).reshape(-1, 3)
    return points


def thin(points: Floats, most: int = _DRAWN_POINTS) -> Floats:
    """At most `most` of the points, evenly spaced, the first and the last among them."""
    if len(points) <= most:
        return points
    return points[np.linspace(0, len(points) - 1, most).round().astype(np.int64)]


def paths_of(run: Run) -> list[Path]:
    """What was flown in a run; a straight line to the goal is never drawn for what was not logged."""
    results = {trial.index: trial for trial in run.record.trials}
    return [
        Path(run.label, outcome_of(results[index]), thin(flight.position_world))
        for index, flight in sorted(run.flights.items())
        if index in results
    ]


def flight_maps(material: Material) -> list[FlightMap]:
    """One map per run that has logged flights; of the cover and plan alone when there are none."""
    planned = []
    if material.plan is not None:
        planned = [Path("plan", "planned", thin(plan_positions(material.plan)))]
    maps = []
    for run in material.runs:
        flown = paths_of(run)
        if flown:
            maps.append(_flight_map(material.cover, run.label, planned + flown))
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
    edge = float(cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
    vertex, start = np.asarray(cover["vertex"], np.int64), np.asarray(cover["vertex_start"])
    shown: list[Floats] = []
    for hull in range(len(start) - 1):
        own = vertex[start[hull] : start[hull + 1]]
        low, high = own[:, 2].min() * edge, own[:, 2].max() * edge
        if band is None or (low <= band[1] and high >= band[0]):
            shown.append(np.asarray(footprint(own[:, :2]) * edge, np.float64))
    return FlightMap(label, tuple(shown), tuple(paths), band, len(start) - 1)


def footprint(points: NDArray[np.int64]) -> NDArray[np.int64]:
    """Convex hull of integer points in the plane, counter-clockwise from the least, exact.

    Source: Andrew 1979, monotone chain.
    """
    ordered: list[tuple[int, int]] = sorted({(int(x), int(y)) for x, y in points})
    if len(ordered) < 3:
        return np.array(ordered, np.int64).reshape(-1, 2)
    return np.array(_chain(ordered)[:-1] + _chain(ordered[::-1])[:-1], np.int64)


def _chain(ordered: list[tuple[int, int]]) -> list[tuple[int, int]]:
    chain: list[tuple[int, int]] = []
    for x, y in ordered:
        while len(chain) > 1:
            (ax, ay), (bx, by) = chain[-2], chain[-1]
            if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                break
            chain.pop()
        chain.append((x, y))
    return chain


def compression(cover: Artifact | None) -> Compression | None:
    """The curve that merging left in the cover's summary, or else None.

    The summary's `curve` is a list of records with `hulls`, `conservativeness` and `planes`.
    """
    rows: Any = cover.manifest.summary.get("curve") if cover is not None else None
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        return None
    hulls = _column(rows, "hulls")
    if hulls is None:
        return None
    return Compression(hulls, _column(rows, "conservativeness"), _column(rows, "planes"))


def _column(rows: Sequence[dict[str, Any]], key: str) -> Floats | None:
    if not all(isinstance(row.get(key), int | float) for row in rows):
        return None
    return np.array([row[key] for row in rows], np.float64)


def worst_flight(runs: Sequence[Run]) -> WorstFlight | None:
    """The logged flight with the least clearance; of those without any, the least margin."""
    candidates: list[tuple[float, int, int, Run, TrialResult]] = []
    for place, run in enumerate(runs):
        for trial in run.record.trials:
            flight = run.flights.get(trial.index)
            if flight is None or not np.isfinite(flight.margin_m).any():
                continue
            clearance = clearance_of(trial)
            least = float(np.nanmin(flight.margin_m)) if clearance is None else clearance
            candidates.append((least, place, trial.index, run, trial))
    if not candidates:
        return None
    least, _, index, run, _ = min(candidates, key=lambda c: c[:3])
    flight = run.flights[index]
    trouble = [status.lower() not in _QUIET for status in flight.status]
    return WorstFlight(
        run.label,
        index,
        least,
        flight.margin_time_s,
        flight.margin_m,
        flight.time_s,
        flight.speed_m_s,
        np.array(trouble, np.bool_),
        tuple(sorted({s.lower() for s, bad in zip(flight.status, trouble, strict=True) if bad})),
    )
