"""Summary, measured times and guarantee of all flights of a scenario with a fence."""

from __future__ import annotations

import statistics
from collections.abc import Iterable
from typing import Any

from alula.schemas.geofence import FenceScenario
from alula.schemas.manifest import Guarantee
from alula.schemas.run import FenceResult, TrialResult
from alula.stages.simulation.geofence.simulate import FenceRun, Times, worst_trial
from alula.stages.simulation.geofence.world import is_random
from alula.stages.verdict import UNFILTERED, head, minimum, statement

_COUNTS = ("passed", "blended", "backup", "no_pilot", "hand_over", "refused")
_HOLDS = {
    "geofence": "As long as the model is right, h_I > 0 at the start and navigation is received, the onboard "
    "geofence keeps the vehicle inside. Its conditions, that the horizon reaches rest and that "
    "β D / v_c <= 1, were checked on sample flights of the model; for a vehicle that is upside down they "
    "rest on random flights. This is not a proof.",
    "backup-qp": "As long as the model is right and the program has a solution, the backup-set barrier keeps "
    "the vehicle inside, between ticks to first order.",
    "none": UNFILTERED,
}


def fence_results(trials: list[TrialResult]) -> list[FenceResult]:
    """Results of the flights that were flown in a fence.

    Args:
        trials: verdicts.
    """
    return [trial.fence for trial in trials if trial.fence is not None]


def fence_summary(scenario: FenceScenario, flown: FenceRun) -> dict[str, Any]:
    """Violations with a 95 % Wilson interval, extremes and sums; it has no measured time.

    A flight without any random number has no interval: it would repeat itself bit by bit.
    `brake_distance_m` and `stop_distance_m` are medians over the flights that have one.

    Args:
        scenario: what was flown.
        flown: the run.
    """
    trials, found = flown.trials, fence_results(flown.trials)
    out = sum(trial.collision for trial in trials)
    summary = {
        **head(trials, (), lambda trial: not trial.collision),
        "violations": out,
        "min_distance_m": minimum(t.map_clearance_m or 0.0 for t in trials),
        "worst_trial": worst_trial(trials).index,
        "max_speed_km_h": 3.6 * max(trial.max_speed_m_s for trial in trials),
        "interventions": sum(result.interventions for result in found),
        "engaged_trials": sum(result.interventions > 0 for result in found),
        "ticks": sum(trial.steps for trial in trials),
        **{name: sum(getattr(result, f"{name}_steps") for result in found) for name in _COUNTS},
        "altered_passes": sum(result.altered_passes for result in found),
        "out_of_range": sum(result.out_of_range for result in found),
        "longest_backup_s": max(result.longest_backup_s for result in found),
        "min_lambda": minimum(result.min_lambda for result in found),
        "min_h_i_m": minimum(result.min_h_i_m for result in found),
        "brake_distance_m": _median(result.brake_distance_m for result in found),
        "stop_distance_m": _median(result.stop_distance_m for result in found),
        "start_h_i_m": flown.world.start_h_i_m,
    }
    if not is_random(scenario, flown.world):
        summary["success_interval"] = None
    if notes := _notes(scenario, flown, summary):
        summary["notes"] = notes
    return summary


def _notes(scenario: FenceScenario, flown: FenceRun, summary: dict[str, Any]) -> list[str]:
    """Conditions that void the guarantee, or show a defect."""
    found = []
    start = flown.world.start_h_i_m
    if scenario.filter.name != "none" and start is not None and start <= 0:
        found.append(f"h_I is {start:.4g} m at the start: braking from there is not known to end inside")
    if summary["hand_over"]:
        found.append(
            "navigation was lost for longer than stale_limit_s: from then on the fence was not enforced"
        )
    if summary["refused"] and scenario.filter.name == "geofence":
        found.append("there was no navigation at the start: the filter refused and the motors stood still")
    if summary["altered_passes"] or summary["out_of_range"]:
        found.append(
            "the filter changed a command that it reports as passed, or left the limits: please report this"
        )
    return found


def _median(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return statistics.median(known) if known else None


def fence_timing(times: Times) -> dict[str, Any]:
    """Measured times of the filter, quantiles to 1.2 %; none without calls.

    Args:
        times: of all chunks.
    """
    if times.calls == 0:
        return {"filter_calls": 0}
    return {
        "filter_calls": times.calls,
        "filter_p50_s": times.quantile(0.5),
        "filter_p99_s": times.quantile(0.99),
        "filter_max_s": times.max_s,
        "filter_mean_s": times.total_s / times.calls,
        "filter_total_s": times.total_s,
        "overruns": times.overruns,
    }


def fence_guarantee(scenario: FenceScenario, flown: FenceRun) -> Guarantee:
    """State what holds beforehand, for which model, and what the run shows.

    Args:
        scenario: what was flown.
        flown: the run.
    """
    trials, deviates = flown.trials, flown.world.deviations
    out = sum(trial.collision for trial in trials)
    name = scenario.filter.name
    limits = ""
    if deviates and name != "none":
        limits = f"The vehicle differed from the filter's model: {', '.join(deviates)}."
    return Guarantee(
        statement=statement(
            _HOLDS[name],
            "from the simulated truth, along chords of the plant's steps",
            out,
            len(trials),
            "flights left the fence",
            limits,
        ),
        claims={
            "filter": name,
            "trials": len(trials),
            "violations": out,
            "as_modelled": not deviates,
            "proven": False,
        },
    )
