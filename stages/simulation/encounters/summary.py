"""Summary, measured times and guarantee of all trials of a scenario with moving obstacles."""

from __future__ import annotations

from typing import Any

import numpy as np

from alula.schemas.encounters import Encounters
from alula.schemas.manifest import Guarantee
from alula.schemas.run import ObstacleResult, TrialResult
from alula.stages.clearance import is_collision
from alula.stages.simulation.encounters.simulate import EncounterRun
from alula.stages.verdict import UNFILTERED, head, mean, minimum, statement, success, totals

_COUNTED = (
    "steps",
    "active_steps",
    "filtered_steps",
    "infeasible_steps",
    "fallback_steps",
    "refused_steps",
)


def encounter_summary(scenario: Encounters, trials: list[TrialResult]) -> dict[str, Any]:
    """Success of runs and per obstacle with 95 % Wilson intervals; means over obstacles with a warning.

    A run succeeds when the vehicle touched no obstacle and no wall, an obstacle when the vehicle did not
    touch it.

    Args:
        scenario: what was flown.
        trials: verdicts, at least one.
    """
    met = [list(column) for column in zip(*(trial.obstacles or [] for trial in trials), strict=True)]
    steps = sum(trial.steps for trial in trials)
    return {
        **head(trials, ("passed", "timeout"), lambda trial: not trial.collision),
        "obstacles": [_met(column) for column in met],
        "wall_collisions": sum(is_collision(trial.map_clearance_m) for trial in trials),
        "min_map_clearance_m": minimum(trial.map_clearance_m for trial in trials),
        "min_scene_clearance_m": None,
        "mean_path_ratio": None,
        **totals(trials, _COUNTED),
        "mean_iterations": sum(trial.iterations or 0 for trial in trials) / steps if steps else None,
        "worst_violation_m_s2": max((trial.worst_violation_m_s2 or 0.0 for trial in trials), default=0.0),
        "mean_risk_spent": mean(trial.risk_spent for trial in trials),
        "mean_mission_risk": mean(trial.mission_risk for trial in trials),
        "max_jerk_limit_m_s3": scenario.vehicle.j_max_m_s3,
    }


def _met(met: list[ObstacleResult]) -> dict[str, Any]:
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


def encounter_timing(scenario: Encounters, flown: EncounterRun) -> dict[str, Any]:
    """Measured times: of the filter in active ticks, and per obstacle to the command and to the reaction.

    Args:
        scenario: what was flown.
        flown: the run.
    """
    timing: dict[str, Any] = {"filter_calls": len(flown.tick_s)}
    if len(flown.tick_s):
        found = np.percentile(flown.tick_s, [50, 99, 100]).tolist()
        timing |= dict(zip(("filter_p50_s", "filter_p99_s", "filter_max_s"), found, strict=True))
        timing["filter_mean_s"] = float(flown.tick_s.mean(dtype=np.float64))
        timing["filter_std_s"] = float(flown.tick_s.std(dtype=np.float64))
        timing["filter_total_s"] = float(flown.tick_s.sum(dtype=np.float64))
        timing["overruns"] = int((flown.tick_s > scenario.run.dt_s).sum())
    for name, times in (("command", flown.command_s), ("reaction", flown.reaction_s)):
        timing[f"{name}_mean_s"] = [mean(v for v in row.tolist() if v == v) for row in times.T]
    return timing


def encounter_guarantee(scenario: Encounters, trials: list[TrialResult]) -> Guarantee:
    """State what the run shows; nothing is proven beforehand.

    Args:
        scenario: what was flown.
        trials: verdicts, at least one.
    """
    hits = sum(trial.collision for trial in trials)
    if scenario.filter.name == "none":
        beforehand = UNFILTERED
    else:
        beforehand = (
            f"{scenario.filter.name} decides by what was tracked, tick by tick; nothing was guaranteed "
            "beforehand."
        )
    return Guarantee(
        statement=statement(
            beforehand,
            "from the simulated truth, between ticks too",
            hits,
            len(trials),
            "trials touched an obstacle or a wall",
            "This holds for the obstacles, the sensor and the vehicle as simulated.",
        ),
        claims={"filter": scenario.filter.name, "trials": len(trials), "collisions": hits, "proven": False},
    )
