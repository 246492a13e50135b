"""Summary and guarantee of all flights of a scenario."""

from __future__ import annotations

from typing import Any

import numpy as np

from alula.schemas.artifact import Artifact
from alula.schemas.decimals import exact
from alula.schemas.manifest import Guarantee
from alula.schemas.run import Outcome, TrialResult
from alula.schemas.vehicle import Vehicle
from alula.schemas.world import WorldScenario
from alula.schemas.world_check import FILTER_COMMANDS
from alula.stages.simulation.result import outcomes_of
from alula.stages.simulation.world.certificate import (
    beforehand,
    certifying,
    claims_of,
    judged_words,
    limits_words,
)
from alula.stages.simulation.world.judge import hits_static, worst_clearance
from alula.stages.simulation.world.simulate import WorldRun
from alula.stages.verdict import head, mean, mean_path_ratio, minimum, statement, totals

_COUNTED = (
    *("steps", "filtered_steps", "infeasible_steps", "fallback_steps", "backup_steps"),
    *("certified_steps", "certified_moving_steps", "capped_steps", "saturated_steps"),
    *("refused_steps", "stale_steps"),
)
_GOOD: dict[str, tuple[Outcome, ...]] = {
    "hover": ("passed", "held"),
    "pilot": ("held",),
}  # outcomes of a flight that did what its mission asks, besides "reached"


_COMMANDED = {
    "velocity": "velocity",
    "acceleration": "acceleration",
    "wrench": "thrust and torque",
    "body-rates": "thrust and body rates",
    "sticks": "sticks",
}


def world_summary(run: WorldRun) -> dict[str, Any]:
    """Rates with 95 % Wilson intervals, extremes, and shares of certified steps; it has no measured time.

    Args:
        run: all trials.
    """
    trials = run.trials
    good = ("reached", *_GOOD.get(run.scenario.mission.kind, ()))
    steps = sum(trial.steps for trial in trials)
    outcomes = (*outcomes_of(trials), "passed", "held")
    moving = [[one.collision for one in trial.obstacles or []] for trial in trials]
    worst = min(trials, key=lambda trial: (worst_clearance(trial), trial.index))
    summary = {
        **head(trials, outcomes, lambda trial: trial.outcome in good and not trial.collision),
        "static_collisions": sum(map(hits_static, trials)),
        "moving_collisions": sum(map(any, moving)),
        "worst_trial": worst.index,
        "min_map_clearance_m": minimum(trial.map_clearance_m for trial in trials),
        "min_scene_clearance_m": minimum(trial.scene_clearance_m for trial in trials),
        "min_fence_clearance_m": minimum(trial.fence_clearance_m for trial in trials),
        "min_moving_clearance_m": minimum(trial.moving_clearance_m for trial in trials),
        "mean_path_ratio": mean_path_ratio(trials),
        "mean_speed_m_s": mean(trial.mean_speed_m_s for trial in trials),
        **_extremes(trials),
        **totals(trials, _COUNTED),
        **run.counts,
        "filter_kind": _kind_of_filters(run.scenario),
    }
    if run.scenario.world.scene is not None:
        summary |= {"sigma": run.world.sigma, "inflation_m": run.world.inflation_m}
    if (against := certifying(run)) and steps:
        summary["certified_against"] = against
        if "hulls" in against:
            summary["hull_radius_m"] = run.world.hull_keep_m
        summary["certified_share_static"] = summary["certified_steps"] / steps
        if run.scenario.world.moving:
            summary["certified_share_moving"] = summary["certified_moving_steps"] / steps
    if run.notes:
        summary["notes"] = run.notes
    return summary


def _extremes(trials: list[TrialResult]) -> dict[str, Any]:
    """Extremes of barrier and motion; None where no flight has the value."""
    errors = [t.peak_realisation_error_m_s2 for t in trials if t.peak_realisation_error_m_s2 is not None]
    return {
        "min_gamma": minimum(trial.min_gamma for trial in trials),
        "min_margin": minimum(trial.min_margin for trial in trials),
        "max_speed_m_s": max(trial.max_speed_m_s for trial in trials),
        "max_jerk_m_s3": max(trial.max_jerk_m_s3 for trial in trials),
        "mean_jerk_m_s3": mean(trial.mean_jerk_m_s3 for trial in trials),
        "peak_realisation_error_m_s2": max(errors, default=None),
    }


def _kind_of_filters(scenario: WorldScenario) -> str:
    is_native = all(name in FILTER_COMMANDS for name in scenario.safety.filters)
    return "native" if is_native else "python filter"


def world_timing(run: WorldRun) -> dict[str, Any]:
    """Measured times of all filters together, and of whole ticks on board [s].

    Args:
        run: all trials.
    """
    timing: dict[str, Any] = {}
    each = {"tick": run.tick_s} | ({"filter": run.filter_s} if run.scenario.safety.filters else {})
    for what, seconds in each.items():
        found = np.percentile(seconds, [50, 99, 100]).tolist()
        timing |= dict(zip((f"{what}_p50_s", f"{what}_p99_s", f"{what}_max_s"), found, strict=True))
        timing[f"{what}_mean_s"] = float(seconds.mean(dtype=np.float64))
    rules = run.scenario.rules
    timing["ticks"] = len(run.tick_s)
    timing["overruns"] = int((run.tick_s > rules.dt_s * rules.filter_ticks).sum())
    return timing


def world_words(scenario: WorldScenario, vehicle: Vehicle) -> str:
    """The vehicle in words.

    Args:
        scenario: completed.
        vehicle: that it names.
    """
    table, guide = scenario.vehicle, scenario.mission.controller.guide
    sphere = f"sphere of radius {exact(table.radius_m or 0.0)} m"
    body = f"{sphere}, {vehicle.model.replace('-', ' ')}"
    if vehicle.model == "quadrotor":
        assert vehicle.body.mass_kg is not None
        body = f"quadrotor of {exact(vehicle.body.mass_kg)} kg in a {sphere}"
    guided = "" if guide == "none" else f", guided by {guide}"
    found = disturbances(scenario)
    disturbed = f", with {', '.join(found)}" if found else ""
    return f"{vehicle.name}: {body}, commanded by {_COMMANDED[table.interface or '']}{guided}{disturbed}"


def world_guarantee(run: WorldRun, cover: Artifact | None) -> Guarantee:
    """State what was proven, for which model, and what the run shows.

    Args:
        run: all trials.
        cover: that was flown in.
    """
    trials, left = run.trials, left_out(run.scenario)
    hits = sum(trial.collision for trial in trials)
    claims = {
        "proven_by_filter": False,
        "filters": list(run.scenario.safety.filters),
        "trials": len(trials),
        "collisions": hits,
        "static_collisions": sum(map(hits_static, trials)),
        **claims_of(run, cover, left),
    }
    return Guarantee(
        statement=statement(
            beforehand(run, left, claims["chain"]),
            judged_words(run),
            hits,
            len(trials),
            "flights touched an obstacle or left the fence",
            limits_words(run),
        ),
        claims=claims,
    )


def disturbances(scenario: WorldScenario) -> list[str]:
    """What a scenario adds to the bare model of its vehicle and to exact measurements, in words.

    Args:
        scenario: completed.
    """
    table, known = scenario.vehicle, scenario.estimation
    own = table.disturbance
    found = {
        "motor lag": own.motor_time_constant_s,
        "drag": any((*(own.linear_drag_n_s_m or ()), *(own.quadratic_drag_n_s2_m2 or ()))),
        "wind": any((*(own.wind_m_s or ()), *(own.gust_m_s or ()))),
        "noise": any(
            (
                *(known.position_noise_m, known.velocity_noise_m_s),
                *(known.attitude_noise_rad, known.rate_noise_rad_s),
            )
        ),
        "delay": known.delay_s,
        "lost measurements": known.lost_share > 0 or known.lost_from_s is not None,
        "a mass or thrust other than the model's": table.mass_scale != 1 or table.thrust_scale != 1,
        "a rate loop other than the model's": table.rate_gain_scale != 1,
    }
    return [words for words, has in found.items() if has]


def left_out(scenario: WorldScenario) -> list[str]:
    """What flights have and the model of a shield leaves out, in words.

    Args:
        scenario: completed.
    """
    table, known = scenario.vehicle, scenario.estimation
    true, assumed = table.disturbance, table.assumed
    lag_s, assumed_s = true.motor_time_constant_s or 0.0, assumed.motor_time_constant_s or 0.0
    found = [words for words in disturbances(scenario) if words not in ("motor lag", "delay")]
    found += ["a motor lag other than assumed"] if lag_s != assumed_s else []
    found += ["a delay other than assumed"] if (known.delay_s or 0.0) != (assumed.delay_s or 0.0) else []
    return found + (["the vehicle's own cascade"] if table.interface in ("velocity", "acceleration") else [])
