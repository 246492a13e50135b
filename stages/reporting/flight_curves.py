"""Data of the figures of single flights: clearance to parts of the world, commands, limits and statuses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import InputRef
from alula.schemas.log.flights import Flight
from alula.stages.clearance import hull_obstacles, kept_obstacles, path_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.reporting.curves import Spell, encounter_clearance, spells
from alula.stages.reporting.fenced import fence_distance, is_fenced
from alula.stages.reporting.material import Material, Run, outcome_of
from alula.stages.verdict import clearance_of

MOST_RUNS = 4
_CAP_M = 20.0  # larger clearances are drawn as this
_FLOWN = {"velocity [m/s]": "max_speed_m_s", "acceleration [m/s²]": "max_acceleration_m_s2"}


@dataclass(frozen=True, slots=True)
class Curve:
    """A quantity over time."""

    name: str
    time_s: FloatArray
    value: FloatArray


@dataclass(frozen=True, slots=True)
class FilterAnswers:
    """Statuses that a filter reported, m words at times of shape (m,) [s]."""

    name: str
    time_s: FloatArray
    status: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class FlightCurves:
    """All curves of one flight, over one time.

    Attributes:
        outcome: as the report counts it; None where it was not judged.
        closest_m: minimum clearance as judged [m]; None where it was not.
        logged: number of logged flights of the run where one that was not logged came closer, else None.
        speed: in m/s.
        clearances: of the vehicle's sphere to each part of the world [m].
        margin: that the filter reported; None where it did not.
        margin_unit: "m", or the quantity in words.
        commands: length of the nominal and of the filtered command; empty where they are not logged.
        quantity: of the commands, with the unit.
        limit: of that quantity; None where none is known.
        speed_limit_m_s: None where none is known.
        regulation: regulation function lambda of a geofence; None elsewhere.
        worst_s: time of the minimum clearance, else of the minimum margin; None where neither is known.
    """

    run: str
    trial: int
    outcome: str | None
    closest_m: float | None
    logged: int | None
    speed: Curve
    clearances: tuple[Curve, ...]
    margin: Curve | None
    margin_unit: str
    commands: tuple[Curve, ...]
    quantity: str
    limit: float | None
    speed_limit_m_s: float | None
    regulation: Curve | None
    filters: tuple[FilterAnswers, ...]
    spells: tuple[Spell, ...]
    worst_s: float | None


def worst_flights(material: Material) -> list[FlightCurves]:
    """Curves of the closest logged flight of each run, of the first runs that have any."""
    found = []
    for run in material.runs:
        if (chosen := closest_flight(run)) is not None:
            found.append(_curves(material, run, *chosen))
    return found[:MOST_RUNS]


def closest_flight(run: Run) -> tuple[int, float | None, int | None] | None:
    """Find the logged flight that came closest to an obstacle, or had the minimum margin.

    Args:
        run: with flights.

    Returns:
        Its trial, its minimum clearance as judged [m], and the number of logged flights where one that was
        not logged came closer; None when no flight is logged.
    """
    trials = {trial.index: trial for trial in run.record.trials}
    if not any(index in trials for index in run.flights):
        return (min(run.flights), None, None) if run.flights else None
    ranked: list[tuple[float, int, float | None]] = []
    others: list[float] = []
    for index, trial in trials.items():
        if is_fenced(run):
            clearance: float | None = fence_distance(trial)
        else:
            clearance = encounter_clearance(run, trial) if trial.obstacles else clearance_of(trial)
        if (flight := run.flights.get(index)) is None:
            others += [] if clearance is None else [clearance]
            continue
        margin = flight.margin[np.isfinite(flight.margin)]
        rank = clearance if clearance is not None else float(margin.min()) if len(margin) else np.inf
        ranked.append((rank, index, clearance))
    rank, index, clearance = min(ranked, key=lambda one: one[:2])
    return index, clearance, len(ranked) if min(others, default=rank) < rank else None


def _curves(
    material: Material, run: Run, index: int, closest_m: float | None, logged: int | None
) -> FlightCurves:
    flight = run.flights[index]
    trial = next((trial for trial in run.record.trials if trial.index == index), None)
    clearances = _clearances(material, run, flight)
    margin = None
    # beside moving obstacles and in a fence the log's margin is a clearance that is drawn anyway
    is_drawn = bool(clearances) and (flight.moving is not None or flight.regulation is not None)
    in_metres = flight.margin_unit == "m"
    if np.isfinite(flight.margin).any() and not is_drawn and (in_metres or not clearances):
        margin = Curve("margin of the filter", flight.margin_time_s, flight.margin)
    commands: tuple[Curve, ...] = ()
    quantity = ""
    if (given := flight.commands) is not None:
        quantity = given.quantity
        commands = tuple(
            Curve(name, flight.margin_time_s, np.linalg.norm(values, axis=1))
            for name, values in (("nominal", given.nominal), ("sent", given.filtered))
        )
    regulation = flight.regulation
    each = flight.each_status or ({run.record.filter: flight.status} if flight.status else {})
    answers = (FilterAnswers(name, flight.margin_time_s, status) for name, status in each.items())
    return FlightCurves(
        run=run.label,
        trial=index,
        outcome=outcome_of(trial) if trial is not None else None,
        closest_m=closest_m,
        logged=logged,
        speed=Curve("speed", flight.time_s, flight.speed_m_s),
        clearances=clearances,
        margin=margin,
        margin_unit=flight.margin_unit,
        commands=commands,
        quantity=quantity,
        limit=_limit(run, _FLOWN.get(quantity, "")),
        speed_limit_m_s=_limit(run, "max_speed_m_s"),
        regulation=None if regulation is None else Curve("λ", flight.margin_time_s, regulation),
        filters=tuple(answers),
        spells=spells(run.course),
        worst_s=_worst(clearances, margin),
    )


def _worst(clearances: Sequence[Curve], margin: Curve | None) -> float | None:
    lowest = []
    for curve in clearances or ([margin] if margin is not None else []):
        if np.isfinite(curve.value).any():
            at = int(np.nanargmin(curve.value))
            lowest.append((float(curve.value[at]), float(curve.time_s[at])))
    return min(lowest)[1] if lowest else None


def _clearances(material: Material, run: Run, flight: Flight) -> tuple[Curve, ...]:
    """Clearance of the sphere to each part of the world that the report has or the log tells."""
    radius = radius_of(run)
    path, time_s = flight.position_world, flight.time_s
    found = []
    if radius is not None and len(path):
        to_end = time_s[1:] if len(path) > 1 else time_s
        if material.cover is not None and _is_same(run, material.inputs, "cover"):
            obstacles = hull_obstacles(Hulls.from_cover(material.cover))
            distance = path_clearance(path, obstacles, cap_m=_CAP_M)
            found.append(Curve("hulls", to_end, distance - radius))
        # the path of a flight is in metres, and so is only a scene that was aligned
        is_metric = material.scene is not None and material.scene.manifest.unit == "m"
        if material.scene is not None and is_metric and _is_same(run, material.inputs, "scene"):
            ellipsoids = kept_obstacles(material.scene, sigma_of(run), material.trees)
            distance = path_clearance(path, ellipsoids, cap_m=_CAP_M)
            found.append(Curve("splats", to_end, distance - radius))
        if (moving := flight.moving) is not None:
            apart = np.linalg.norm(moving.position_world - path[:, None], axis=2) - moving.radius_m
            apart = np.where(np.isfinite(apart), apart, np.inf).min(axis=1) - radius
            found.append(Curve("moving obstacles", time_s, np.where(np.isfinite(apart), apart, np.nan)))
    to_fence = flight.fence_distance_m
    if to_fence is not None and np.isfinite(to_fence).any():
        found.append(Curve("fence", flight.margin_time_s, to_fence))
    return tuple(found)


def radius_of(run: Run) -> float | None:
    """Radius of the vehicle's sphere in a run's parameters [m]; None where they have none."""
    parameters = run.record.provenance.parameters
    for keys in (
        ("vehicle", "radius_m"),
        ("vehicle", "body", "radius_m"),
        ("vehicle_file", "body", "radius_m"),
    ):
        if (value := _number(parameters, *keys)) is not None:
            return value
    return None


def _limit(run: Run, name: str) -> float | None:
    """Limit of the vehicle in a run's parameters; None where it has none."""
    parameters = run.record.provenance.parameters
    for keys in (("vehicle", name), ("vehicle", "limits", name), ("vehicle_file", "limits", name)):
        if (value := _number(parameters, *keys)) is not None:
            return value
    return None


def sigma_of(run: Run) -> float:
    """Level of the ellipsoids in a run's parameters; 1 where they have none."""
    parameters = run.record.provenance.parameters
    for keys in (("world", "sigma"), ("sigma",), ("map", "sigma")):
        if (value := _number(parameters, *keys)) is not None and value > 0:
            return value
    return 1.0


def _number(table: Any, *keys: str) -> float | None:
    for key in keys:
        table = table.get(key) if isinstance(table, Mapping) else None
    is_number = isinstance(table, int | float) and not isinstance(table, bool)
    return float(table) if is_number and np.isfinite(table) else None


def _is_same(run: Run, shown: Sequence[InputRef], role: str) -> bool:
    """Whether a run was flown through the artifact that is shown, as far as its record tells."""
    of_run = next((ref.sha256 for ref in run.record.provenance.inputs if ref.role == role), None)
    of_report = next((ref.sha256 for ref in shown if ref.role == role), None)
    return of_run is None or of_report is None or of_run == of_report
