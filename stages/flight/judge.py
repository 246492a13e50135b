"""Verdict on a real flight: its measured positions against the map, independent of any filter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import Guarantee
from alula.schemas.decimals import exact
from alula.schemas.log.run import PLAN_OUTCOMES, Outcome, TrialResult
from alula.stages.clearance import (
    is_collision,
    path_metrics,
    sphere_clearance,
)
from alula.stages.compression.level import (
    level_of,
    omissions,
    recorded_level,
    scene_level,
)
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.loop.control_loop import Counters
from alula.stages.flight.loop.supervisor import Event, State, Supervision, Taken
from alula.stages.flight.mission import PlannedFlight
from alula.stages.planning.adherence import PlanJudge, outcome_of_plan
from alula.stages.verdict import head, mean_path_ratio, totals


def outcome_of_cause(cause: Event | None) -> Outcome:
    """Outcome of a flight in its record.

    Args:
        cause: first event that ended the flight; None if there was none.
    """
    if cause is Event.PLAN_FINISHED:
        return "reached"
    if cause is Event.TIMED_OUT:
        return "timeout"
    return "refused" if cause in (Event.FILTER_REFUSED, Event.FILTER_FAILED) else "stopped"


def judge(
    mission: PlannedFlight,
    rows: FloatArray,
    cause: Event | None,
    jobs: int = 0,
    joined: Sequence[tuple[float, Artifact]] = (),
) -> TrialResult:
    """Judge a flight by the exact distances of its measured path to the map, and by its plans.

    The path must pass all via points in their order, and each part of it must stay in the tube of the plan
    that was flown then.

    Args:
        rows: `FlightRecorder.rows`, shape (n, 13) with n >= 1.
        joined: plans that the vehicle joined in flight, with their times, see `ControlLoop.joined`.
    """
    position, velocity = np.ascontiguousarray(rows[:, 1:4]), rows[:, 4:7]
    radius, dt = mission.world.vehicle.body.radius_m, 1 / mission.config.rate_hz
    clearance: dict[str, float | None] = {"a hull": None, "an ellipsoid": None}
    for name, obstacles in mission.obstacles:
        clearance[name] = sphere_clearance(position, obstacles, radius, jobs=jobs)
    flying = rows[:, 7] >= 0
    status = np.bincount(rows[flying, 7].astype(np.int64), minlength=len(FilterStatus))
    flags = rows[flying, 8].astype(np.int64)
    infeasible = ((flags & 1) != 0) | (rows[flying, 7] == FilterStatus.REFUSED)
    path = path_metrics(position, dt)
    followed = None
    if flying.any():
        first = np.searchsorted(rows[flying, 0], [time_s for time_s, _ in joined], side="right")
        later = [_tube(mission, plan, jobs) for _, plan in joined]
        followed = mission.along.result(
            position[flying], rows[flying, 0], list(zip(first.tolist(), later, strict=True))
        )
    speed = np.linalg.norm(velocity, axis=1)
    margin = rows[flying, 9]
    margin = margin[np.isfinite(margin)]
    error = rows[flying, 10]
    among_ellipsoids: dict[str, Any] = {}
    if mission.is_splat:
        among_ellipsoids = {
            "backup_steps": int(status[FilterStatus.BACKUP]),
            "certified_steps": int(((flags & 2) != 0).sum()),
        }
    return TrialResult(
        index=0,
        start_m=position[0].tolist(),
        goal_m=mission.goal.tolist(),
        outcome=outcome_of_plan(outcome_of_cause(cause), followed),
        collision=is_collision(*clearance.values()),
        steps=int(flying.sum()),
        duration_s=float(rows[-1, 0] - rows[0, 0]),
        path_length_m=float(np.linalg.norm(np.diff(position, axis=0), axis=1).sum()),
        straight_length_m=float(np.linalg.norm(mission.goal - position[0])),
        map_clearance_m=clearance["a hull"],
        scene_clearance_m=clearance["an ellipsoid"],
        max_speed_m_s=float(speed.max(initial=0.0)),
        filtered_steps=int(status[1:].sum()),
        shortened_steps=int(status[FilterStatus.SHORTENED]),
        infeasible_steps=int(infeasible.sum()),
        fallback_steps=int(status[FilterStatus.RECOVERING] + status[FilterStatus.BACKUP]),
        mean_jerk_m_s3=path.mean_jerk_m_s3,
        max_jerk_m_s3=path.max_jerk_m_s3,
        max_tracking_error_m=float(error.max(initial=0.0)),
        min_margin=float(margin.min()) if len(margin) else None,
        plan=followed,
        **among_ellipsoids,
    )


def _tube(mission: PlannedFlight, plan: Artifact, jobs: int) -> PlanJudge:
    obstacles = [each for _, each in mission.obstacles]
    return PlanJudge(plan, obstacles, mission.world.vehicle.body.radius_m, mission.along.tolerance_m, jobs)


def summary_of(
    trial: TrialResult,
    supervision: Supervision,
    taken: Sequence[tuple[float, Taken]],
    new_plans: int = 0,
) -> dict[str, Any]:
    """Summary of a flight, with the keys of `simulate`."""
    cause = supervision.cause
    return {
        **head([trial], ("reached", *PLAN_OUTCOMES, "stuck", "timeout", "refused", "stopped")),
        "min_map_clearance_m": trial.map_clearance_m,
        "min_scene_clearance_m": trial.scene_clearance_m,
        "mean_path_ratio": mean_path_ratio([trial]),
        "ended_by": cause.value if cause is not None else "nothing",
        **({"new_plans": new_plans} if new_plans else {}),
        "holds": sum(each.step.state is State.HOLD and each.state is not State.HOLD for _, each in taken),
        "max_tracking_error_m": trial.max_tracking_error_m,
        **totals([trial], ("steps", "filtered_steps", "infeasible_steps", "fallback_steps")),
    }


def timing_of(counters: Counters, dropped: int, rate_hz: float) -> dict[str, Any]:
    """Measured times of the loop, for the record."""
    found: dict[str, Any] = {}
    for name, values in (
        ("filter", counters.filter_s),
        ("tick", counters.tick_s),
        ("lateness", counters.late_s),
    ):
        if values:
            found |= {f"{name}_p50_s": values.quantile(0.5), f"{name}_p99_s": values.quantile(0.99)}
            found[f"{name}_max_s"] = values.max_s
    ticks = len(counters.tick_s)
    return found | {
        "rate_hz": rate_hz,
        "ticks": ticks,
        "overruns": counters.overruns,
        "skipped": counters.skipped,
        "filter_calls": len(counters.filter_s),
        "dropped_samples": dropped,
    }


def guarantee_of(mission: PlannedFlight, trial: TrialResult, new_plans: int = 0) -> Guarantee:
    """Statement of what a flight shows; a real flight proves nothing about other flights."""
    name = mission.config.filter
    who = "without a filter" if name == "none" else f"behind the filter {name!r}"
    map_ = mission.map_words
    touched = f"came closer than its radius to {map_}" if trial.collision else f"kept its radius from {map_}"
    proven, how = mission.is_clear
    later = f" Plans made in flight, each proven before it was flown: {new_plans}." if new_plans else ""
    return Guarantee(
        statement=f"A real flight {who}, with a geofence. The plan before the flight: {how}.{later} "
        "According to the positions that the vehicle measured, sampled at "
        f"{exact(mission.config.rate_hz)} Hz and joined by straight lines, it {touched}. Motion that the "
        "vehicle did not measure is not covered, nor are obstacles that the map does not contain.",
        claims={
            "proven_by_filter": False,
            "plan_certified": proven and mission.along.is_proven,
            **({"new_plans": new_plans} if new_plans else {}),
            "map_clear": not trial.collision,
            "map": _map_record(mission),
            "continuous_time": False,
            "positions": "as measured by the vehicle",
            "radius_m": mission.world.vehicle.body.radius_m,
            "margin_m": mission.config.margin_m,
            "inflation_m": mission.world.static.inflation_m["ellipsoids" if mission.is_splat else "hulls"],
        },
    )


def _map_record(mission: PlannedFlight) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if mission.cover is not None:
        level = level_of(mission.cover)
        found["cover"] = recorded_level(level) | {"omits": omissions(level)}
    if mission.world.static.scene is not None:
        found["scene"] = scene_level(mission.config.sigma)
    return found
