"""Summary and guarantee of all flights of a scenario."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import Guarantee, InputRef
from alula.schemas.decimals import exact
from alula.schemas.log.run import Outcome, TrialResult
from alula.schemas.scenarios.check import is_random
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.tables import EstimationTable, MissionTable
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.durations import Times
from alula.stages.simulation.among_hulls import note_of_starts, proof_among_hulls, unsafe_starts
from alula.stages.simulation.certificate import (
    beforehand,
    certifying,
    claims_of,
    judged_words,
    limits_words,
)
from alula.stages.simulation.encounters import encounter_summary, encounter_timing
from alula.stages.simulation.judge import hits_static, worst_clearance
from alula.stages.simulation.left_out import left_out
from alula.stages.simulation.piloted import HOLDS, fence_filter_of, fence_notes, fence_summary
from alula.stages.simulation.result import outcomes_of
from alula.stages.simulation.simulate import WorldRun
from alula.stages.verdict import head, mean, mean_path_ratio, minimum, statement, totals

_COUNTED = (
    *("steps", "filtered_steps", "shortened_steps", "infeasible_steps", "fallback_steps", "backup_steps"),
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

    Without any random number there is no interval: the flight would repeat itself bit by bit. `fence` has the
    figures of a pilot's flights in a fence, see `fence_summary`.
    """
    trials = run.trials
    good = good_outcomes(run.scenario.mission)
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
        "filter_kind": run.filter_kind,
        **encounter_summary(run.scenario, trials),
    }
    if run.scenario.world.scene is not None:
        summary |= {"sigma": run.world.sigma, "inflation_m": run.world.inflation_m["ellipsoids"]}
    if (against := certifying(run)) and steps:
        summary["certified_against"] = against
        if "hulls" in against:
            summary["hull_radius_m"] = run.world.keeps_m("hulls")
        summary["certified_share_static"] = summary["certified_steps"] / steps
        if run.scenario.world.moving:
            summary["certified_share_moving"] = summary["certified_moving_steps"] / steps
    if not is_random(run.scenario, run.vehicle):
        summary["success_interval"] = None
    notes = run.notes + note_of_starts(trials)
    if any(trial.start_margin_m is not None for trial in trials):
        summary["unsafe_starts"] = len(unsafe_starts(trials))
    if (fence := fence_summary(trials, run.start_h_i_m)) is not None:
        summary["fence"] = fence
        notes += fence_notes(fence, fence_filter_of(run.scenario))
    if notes:
        summary["notes"] = notes
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


def good_outcomes(mission: MissionTable) -> tuple[Outcome, ...]:
    """Outcomes of a flight that did what its mission asks."""
    # Such a flight waits until all obstacles have passed, and not for its goal.
    waits: tuple[Outcome, ...] = () if mission.receded_s is None else ("passed", "timeout")
    return ("reached", *waits, *_GOOD.get(mission.kind, ()))


def world_timing(run: WorldRun) -> dict[str, Any]:
    """Measured times of the filters, of whole ticks on board, and of encounters with moving obstacles [s].

    Those of the filters are of all of them together in each tick; where there is one alone, and it sees
    moving obstacles, of its ticks in a manoeuvre or with a warning.
    """
    timing: dict[str, Any] = {"ticks": run.tick_times.calls, "overruns": run.tick_times.overruns}
    if run.scenario.safety.filters:
        timing |= _spread("filter", run.filter_times)
        timing |= {"filter_calls": run.filter_times.calls, "filter_total_s": run.filter_times.total_s}
    timing |= _spread("tick", run.tick_times)
    return timing | encounter_timing(run.command_s, run.reaction_s)


def _spread(what: str, times: Times) -> dict[str, float]:
    """Quantiles to 1.2 %, exact mean, standard deviation and maximum; none without times [s]."""
    if not times.calls:
        return {}
    return {
        f"{what}_p50_s": times.quantile(0.5),
        f"{what}_p99_s": times.quantile(0.99),
        f"{what}_max_s": times.max_s,
        f"{what}_mean_s": times.mean_s,
        f"{what}_std_s": times.std_s,
    }


def world_words(scenario: Scenario, vehicle: Vehicle) -> str:
    """The vehicle in words."""
    table, guide = scenario.vehicle, scenario.mission.controller.guide
    sphere = f"sphere of radius {exact(table.radius_m or 0.0)} m"
    limit = table.max_speed_m_s
    if vehicle.model == "single-integrator" and scenario.mission.kind != "plan":
        limit = scenario.mission.speed_m_s or limit
    if vehicle.model == "quadrotor":
        assert vehicle.body.mass_kg is not None
        body = f"quadrotor of {exact(vehicle.body.mass_kg)} kg in a {sphere}"
    else:
        body = f"{sphere}, {vehicle.model.replace('-', ' ')}"
        body += "" if limit is None or not math.isfinite(limit) else f" up to {exact(limit)} m/s"
    if vehicle.model != "single-integrator":  # that has no other
        body += f", commanded by {_COMMANDED[table.interface or '']}"
    guided = "" if guide == "none" else f", guided by {guide}"
    found = disturbances(scenario)
    disturbed = f", with {', '.join(found)}" if found else ""
    return f"{vehicle.name}: {body}{guided}{disturbed}"


def world_guarantee(run: WorldRun, cover: Artifact | None, inputs: Sequence[InputRef] = ()) -> Guarantee:
    """State what was proven, for which model, and what the run shows.

    Args:
        inputs: files of the run; a claim about a scene whose hash is not among them is not made.
    """
    trials, left = run.trials, left_out(run.scenario)
    hits = sum(trial.collision for trial in trials)
    claims = {
        "proven_by_filter": False,
        "filters": list(run.scenario.safety.filters),
        "trials": len(trials),
        "collisions": hits,
        "static_collisions": sum(map(hits_static, trials)),
        **claims_of(run, cover, left, inputs),
    }
    names = run.scenario.safety.filters
    among, limits, proof = proof_among_hulls(run.scenario, run.vehicle, cover, trials)
    claims |= proof
    said = among or beforehand(run, left, claims["chain"])
    if names and names[-1] in HOLDS and run.scenario.mission.kind == "pilot":
        said, limits = HOLDS[names[-1]], ""
        claims["as_modelled"] = not left
        if left:
            limits = f"The vehicle differed from the filter's model: {', '.join(left)}."
    else:
        limits = limits or limits_words(run)
    return Guarantee(
        statement=statement(
            said,
            judged_words(run),
            hits,
            len(trials),
            "flights touched an obstacle or left the fence",
            limits,
        ),
        claims=claims,
    )


def disturbances(scenario: Scenario) -> list[str]:
    """What a scenario adds to the bare model of its vehicle and to exact measurements, in words."""
    table, known = scenario.vehicle, scenario.estimation
    own = table.disturbance
    found = {
        "motor lag": own.motor_time_constant_s,
        "drag": any((*(own.linear_drag_n_s_m or ()), *(own.quadratic_drag_n_s2_m2 or ()))),
        "wind": any((*(own.wind_m_s or ()), *(own.gust_m_s or ()))),
        "noise": _has_noise(known),
        "delay": known.delay_s,
        "lost measurements": known.lost_share > 0 or known.lost_from_s is not None,
        "a mass or thrust other than the model's": table.mass_scale != 1 or table.thrust_scale != 1,
        "a rate loop other than the model's": table.rate_gain_scale != 1,
    }
    return [words for words, has in found.items() if has]


def _has_noise(known: EstimationTable) -> bool:
    return any(
        (
            *(known.position_noise_m, known.velocity_noise_m_s),
            *(known.attitude_noise_rad, known.rate_noise_rad_s),
            *(known.sensor.own_position_sigma_m, known.sensor.own_velocity_sigma_m_s),
        )
    )
