"""Flights by the sticks of a pilot in a fence: geofence that judges them, starts, verdict, summary."""

from __future__ import annotations

import dataclasses
import math
import statistics
from collections.abc import Iterable
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import UsageError
from alula.schemas.log.run import FenceResult, TrialResult
from alula.schemas.parameters.filter_options import FILTERS, GeofenceParameters
from alula.schemas.scenarios.ranges import FARTHEST_M
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.tables import MissionTable
from alula.stages.clearance import is_collision
from alula.stages.filtering.fence_filters import native_geofence
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.verdict import FENCED, clearance_of, minimum
from alula.stages.world.obstacles import StaticWorld, require_clear

_COUNTS = ("passed", "blended", "backup", "no_pilot", "hand_over", "refused")
HOLDS = {
    "geofence": "As long as the model is right, h_I > 0 at the start and navigation is received, the onboard "
    "geofence keeps the vehicle inside. Its conditions, that the horizon reaches rest and that "
    "β D / v_c <= 1, were checked on sample flights of the model; for a vehicle that is upside down they "
    "rest on random flights. This is not a proof.",
    "backup-qp": "As long as the model is right and the program has a solution, the backup-set barrier keeps "
    "the vehicle inside, between ticks to first order.",
}
"""What the last filter of a pilot's sticks guarantees beforehand, by its name."""


def pilots_geofence(scenario: Scenario, world: FilterWorld) -> _core.Geofence | None:
    """Geofence whose h_I > 0 makes a start safe, and whose fence and limits judge; None without a pilot.

    Its fence has the faces, and the hulls of the cover, also where the filter knows only one of them. Without
    either it is a box that nobody reaches.

    Raises:
        UsageError: the parameters of the geofence have no meaning for this vehicle.
    """
    if scenario.mission.kind != "pilot":
        return None
    name = fence_filter_of(scenario) or "geofence"
    parameters = scenario.safety.parameters(name)
    assert isinstance(parameters, GeofenceParameters)
    if not _has_fence(world):
        low, high = (-FARTHEST_M,) * 3, (FARTHEST_M,) * 3
        world = dataclasses.replace(world, fence_box=(low, high))
    is_flown = name in scenario.safety.filters[-1:]
    try:
        return native_geofence(
            name, world, parameters, has_regulation=is_flown and name == "geofence", keeps_out=True
        )
    except UsageError as error:
        raise UsageError(f"`$.safety.geofence`: {str(error).removeprefix(f'{name}: ')}") from error


def fence_filter_of(scenario: Scenario) -> str | None:
    """The last filter of a pilot's sticks, where it is one of this package; None otherwise."""
    last = scenario.safety.filters[-1:]
    return last[0] if last and FILTERS.get(last[0]) is GeofenceParameters else None


def is_fenced(scenario: Scenario, world: FilterWorld) -> bool:
    """Whether flights have figures of a fence: by a racer's pilot, without a filter or behind a geofence."""
    known = not scenario.safety.filters or fence_filter_of(scenario) is not None
    by_sticks = scenario.mission.kind == "pilot" and scenario.vehicle.interface == "sticks"
    return by_sticks and known and _has_fence(world)


def _has_fence(world: FilterWorld) -> bool:
    return world.fence_box is not None or len(world.fence_faces) > 0 or bool(world.image)


def pilots_starts(
    scenario: Scenario, world: StaticWorld, geofence: _core.Geofence, count: int, jobs: int
) -> FloatArray:
    """Start states of a pilot's flights: the one of the scenario, or one drawn for each trial.

    Args:
        world: static obstacles, which starts are clear of.
        geofence: in which drawn starts have h_I > 0.

    Returns:
        Position, velocity, attitude w x y z, body rates; shape (count, 13).

    Raises:
        UsageError: the start touches an obstacle, or no start in the box is safe.
    """
    mission = scenario.mission
    if mission.start_m is not None:
        require_clear(world, np.array([mission.start_m]), "`$.mission.start_m`: the start", jobs)
        return np.tile(_given_start(mission), (count, 1))
    assert mission.start_box_m is not None
    box = (mission.start_box_m[:3], mission.start_box_m[3:])
    try:
        starts = [
            _core.safe_racer_start(
                geofence,
                box,
                speed_m_s=mission.start_speed_m_s,
                tilt_rad=math.radians(mission.start_tilt_deg),
                seed=scenario.rules.seed,
                trial=trial,
                others=world.map,
            )
            for trial in range(count)
        ]
    except ValueError as error:
        raise UsageError(f"`$.mission.start_box_m`: {error}") from error
    return np.array(starts)


def _given_start(mission: MissionTable) -> FloatArray:
    """The start of all trials, level, shape (13,)."""
    assert mission.start_m is not None
    half = math.radians(mission.start_yaw_deg) / 2
    velocity = mission.start_velocity_m_s or (0.0, 0.0, 0.0)
    return np.array([*mission.start_m, *velocity, math.cos(half), 0.0, 0.0, math.sin(half), 0.0, 0.0, 0.0])


def start_h_i(scenario: Scenario, geofence: _core.Geofence | None) -> float | None:
    """h_I of the start of all trials [m]; None where it is drawn, or without a pilot.

    Raises:
        UsageError: the start is farther than the geofence can tell.
    """
    if geofence is None or scenario.mission.start_m is None:
        return None
    try:
        return float(geofence.evaluate(_given_start(scenario.mission)[None])[0][0, 0])
    except ValueError as error:
        raise UsageError(f"`$.mission.start_m`: {error}") from error


def fence_result(flown: dict[str, Any]) -> FenceResult | None:
    """Figures of one flight in a fence; None for others."""
    if (log := flown.get("fence")) is None:
        return None
    return FenceResult(
        **{f"{name}_steps": log[name] for name in _COUNTS},
        interventions=log["interventions"],
        altered_passes=log["altered_passes"],
        out_of_range=log["out_of_range"],
        longest_backup_s=log["longest_backup_s"],
        min_lambda=_known(log["min_lambda"]),
        min_h_i_m=_known(log["min_h_i"]),
        brake_distance_m=_known(log["brake_distance_m"]),
        stop_distance_m=_known(log["stop_distance_m"]),
    )


def _known(value: float) -> float | None:
    """None for a value that was never set: infinite, NaN, or the largest float."""
    return float(value) if abs(value) < 1e30 else None


def fence_summary(trials: list[TrialResult], start_h_i_m: float | None) -> dict[str, Any] | None:
    """Extremes and sums of the figures of flights in a fence; None for others.

    `brake_distance_m` and `stop_distance_m` are medians over the flights that have one.

    Args:
        trials: verdicts, at least one.
        start_h_i_m: h_I of the start of all trials [m]; None where it is drawn.
    """
    found = [trial.fence for trial in trials if trial.fence is not None]
    if not found:
        return None
    distances = [clearance_of(trial, *FENCED) for trial in trials]
    return {
        "violations": sum(map(is_collision, distances)),
        "min_distance_m": minimum(distances),
        "max_speed_km_h": 3.6 * max(trial.max_speed_m_s for trial in trials),
        "interventions": sum(result.interventions for result in found),
        "engaged_trials": sum(result.interventions > 0 for result in found),
        **{name: sum(getattr(result, f"{name}_steps") for result in found) for name in _COUNTS},
        "altered_passes": sum(result.altered_passes for result in found),
        "out_of_range": sum(result.out_of_range for result in found),
        "longest_backup_s": max(result.longest_backup_s for result in found),
        "min_lambda": minimum(result.min_lambda for result in found),
        "min_h_i_m": minimum(result.min_h_i_m for result in found),
        "brake_distance_m": _median(result.brake_distance_m for result in found),
        "stop_distance_m": _median(result.stop_distance_m for result in found),
        "start_h_i_m": start_h_i_m,
    }


def fence_notes(summary: dict[str, Any], name: str | None) -> list[str]:
    """Conditions that void what the geofence guarantees, or show a defect.

    Args:
        summary: of `fence_summary`.
        name: of the last filter; None without one.
    """
    found = []
    start = summary["start_h_i_m"]
    if name is not None and start is not None and start <= 0:
        found.append(f"h_I is {start:.4g} m at the start: braking from there is not known to end inside")
    if summary["hand_over"]:
        found.append(
            "navigation was lost for longer than stale_limit_s: from then on the fence was not enforced"
        )
    if summary["refused"] and name == "geofence":
        found.append("there was no navigation at the start: the filter refused and the motors stood still")
    if summary["altered_passes"] or summary["out_of_range"]:
        found.append(
            "the filter changed a command that it reports as passed, or left the limits: please report this"
        )
    return found


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.median(known) if known else None
