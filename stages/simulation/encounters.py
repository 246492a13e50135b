"""Encounters of flights with moving obstacles: figures of a trial, of a run, and measured times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import UsageError
from alula.schemas.log.run import ObstacleResult, TrialResult
from alula.schemas.parameters.flight_defaults import NO_FILTER
from alula.schemas.scenarios.check import TRACKING
from alula.schemas.scenarios.scenario import Scenario
from alula.stages.filtering.bridge import native_filter
from alula.stages.filtering.moving_filters import moving_filter
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.verdict import mean, success, totals

_EVENTS = ("separation_m", "closing_m_s", "detected_s", "warned_s", "reaction_s", "avoid_s")
WITHOUT_FILTER = (
    "dr-acbf"  # whose values count for flights among moving obstacles without a filter that sees them
)


def seen_by(scenario: Scenario) -> str | None:
    """Name of the last filter that sees tracks, by whose answers encounters are measured.

    `NO_FILTER` where a flight without filters is only watched, so that encounters with and without a filter
    compare; None where nothing sees tracks.
    """
    names = [name for name in scenario.safety.filters if name in TRACKING]
    if names:
        return names[-1]
    # Only the nominal acceleration of such a flight is what is flown.
    is_bare = not scenario.safety.filters and scenario.mission.controller.guide == NO_FILTER
    by_acceleration = scenario.vehicle.interface in ("acceleration", "wrench", "body-rates")
    is_watched = is_bare and by_acceleration and scenario.mission.kind != "pilot"
    return NO_FILTER if scenario.world.moving and is_watched else None


def watcher(scenario: Scenario, world: FilterWorld) -> _core.SafetyFilter | None:
    """The filter that watches flights without filters among moving obstacles, for the metrics of encounters.

    It turns nothing aside, so static obstacles change none of its figures and it is given none.

    Raises:
        UsageError: a parameter is wrong.
    """
    if seen_by(scenario) != NO_FILTER:
        return None
    given = msgspec.structs.asdict(scenario.safety.dr_acbf)
    try:
        return native_filter(moving_filter(NO_FILTER, replace(world, parts={}), given))
    except UsageError as error:
        raise UsageError(
            f"`$.safety.{WITHOUT_FILTER}`: {str(error).removeprefix(f'{NO_FILTER}: ')}"
        ) from error


def risk_window_s(scenario: Scenario) -> float:
    """Window of the risk of a collision: the duration of a command that the last tracking filter assumes."""
    names = [name for name in scenario.safety.filters if name in TRACKING]
    options: Any = scenario.safety.parameters(names[-1] if names else WITHOUT_FILTER)
    return float(options.h_max_s)


def obstacle_results(log: dict[str, Any], reach_m: Sequence[float]) -> list[ObstacleResult]:
    """Encounters of one flight with each obstacle.

    Args:
        reach_m: radius of each obstacle and of the vehicle together [m].
    """
    known = [
        {name: float(log[name][i]) if math.isfinite(log[name][i]) else None for name in _EVENTS}
        for i in range(len(reach_m))
    ]
    return [
        ObstacleResult(closest_m=closest, collision=closest <= reach, **events)
        for closest, reach, events in zip(log["closest_m"].tolist(), reach_m, known, strict=True)
    ]


def encounter_figures(flown: dict[str, Any], seen: str | None) -> dict[str, Any]:
    """Figures of `TrialResult` that come from the answers of the filter that sees tracks.

    Args:
        seen: of `seen_by`.
    """
    if seen is None:
        return {}
    return {
        "active_steps": flown["active_ticks"],
        "iterations": flown["total_iterations"],
        "worst_violation_m_s2": flown["worst_violation"],
        # Other filters have no rows with a risk.
        "risk_spent": flown["risk_spent"] if seen.startswith("dr-acbf") else None,
        "mission_risk": flown["mission_risk"],
    }


def encounter_summary(scenario: Scenario, trials: list[TrialResult]) -> dict[str, Any]:
    """Figures over all trials, per moving obstacle too; means over obstacles with a warning.

    Args:
        trials: verdicts, at least one.
    """
    found: dict[str, Any] = {}
    if scenario.world.moving:
        met = zip(*(trial.obstacles or [] for trial in trials), strict=True)
        found["obstacles"] = [_met(column) for column in met]
        found["max_jerk_limit_m_s3"] = scenario.vehicle.max_jerk_m_s3
    if seen_by(scenario) is None:
        return found
    steps = sum(trial.steps for trial in trials)
    return found | {
        **totals(trials, ("active_steps",)),
        "mean_iterations": sum(trial.iterations or 0 for trial in trials) / steps if steps else None,
        "worst_violation_m_s2": max(trial.worst_violation_m_s2 or 0.0 for trial in trials),
        "mean_risk_spent": mean(trial.risk_spent for trial in trials),
        "mean_mission_risk": mean(trial.mission_risk for trial in trials),
    }


def _met(met: tuple[ObstacleResult, ...]) -> dict[str, Any]:
    """Success against one obstacle, which is not to touch it, with its 95 % Wilson interval, and means."""
    return {
        **success(sum(not obstacle.collision for obstacle in met), len(met)),
        "detected": sum(obstacle.detected_s is not None for obstacle in met),
        "warned": sum(obstacle.warned_s is not None for obstacle in met),
        "mean_closing_m_s": mean(obstacle.closing_m_s for obstacle in met),
        "mean_separation_m": mean(obstacle.separation_m for obstacle in met),
        "mean_closest_m": mean(obstacle.closest_m for obstacle in met),
        "least_closest_m": min(obstacle.closest_m for obstacle in met),
        "mean_reaction_s": mean(obstacle.reaction_s for obstacle in met),
        "mean_avoid_s": mean(obstacle.avoid_s for obstacle in met),
    }


def encounter_timing(command_s: FloatArray, reaction_s: FloatArray) -> dict[str, Any]:
    """Mean measured times per obstacle: of the filter in the tick of its warning, and to the reaction.

    Args:
        command_s: shape (trials, n), NaN without a warning [s].
        reaction_s: shape (trials, n), including `command_s`, NaN without a reaction [s].
    """
    if command_s.shape[1] == 0:
        return {}
    return {
        f"{name}_mean_s": [mean(value for value in row.tolist() if value == value) for row in times.T]
        for name, times in (("command", command_s), ("reaction", reaction_s))
    }


def rows_of_obstacles(stored: list[bytes], trials: int) -> FloatArray:
    """Measured times of all trials and obstacles, shape (trials, n) [s].

    Args:
        stored: float64 numbers of consecutive trials.
    """
    return np.frombuffer(b"".join(stored), np.float64).reshape(trials, -1)
