"""Summary and guarantee of all flights of a scenario."""

from __future__ import annotations

from typing import Any

import numpy as np

from alula.schemas.artifact import Artifact
from alula.schemas.decimals import exact
from alula.schemas.manifest import Guarantee
from alula.schemas.run import Outcome
from alula.schemas.vehicle import Vehicle
from alula.schemas.world import WorldScenario
from alula.schemas.world_check import TRACKING
from alula.schemas.world_tables import MissionTable
from alula.stages.simulation.ellipsoids.certificate import not_covered
from alula.stages.simulation.result import outcomes_of
from alula.stages.simulation.world.encounters import encounter_summary, encounter_timing
from alula.stages.simulation.world.judge import hits_static, worst_clearance
from alula.stages.simulation.world.simulate import WorldRun
from alula.stages.verdict import UNFILTERED, head, mean, mean_path_ratio, minimum, statement, totals

_COUNTED = (
    *("steps", "filtered_steps", "infeasible_steps", "fallback_steps", "backup_steps"),
    *("certified_steps", "certified_moving_steps", "saturated_steps", "refused_steps", "stale_steps"),
)
_GOOD: dict[str, tuple[Outcome, ...]] = {
    "hover": ("passed", "held"),
    "pilot": ("held",),
}  # outcomes of a flight that did what its mission asks, besides "reached"
_AS_SIMULATED = "This holds for the obstacles, the sensor and the vehicle as simulated."
_KEPT_FROM = {"ellipsoids": "every ellipsoid", "hulls": "every hull", "fence": "the outside of the fence"}


def world_summary(run: WorldRun) -> dict[str, Any]:
    """Rates with 95 % Wilson intervals, extremes, and shares of certified steps; it has no measured time.

    Args:
        run: all trials.
    """
    trials = run.trials
    good = ("reached", *_good(run.scenario.mission))
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
        **totals(trials, _COUNTED),
        **run.counts,
        **encounter_summary(run.scenario, trials),
    }
    if run.scenario.world.scene is not None:
        summary |= {"sigma": run.world.sigma, "inflation_m": run.world.keep_m - run.world.radius_m}
    if certifying(run) and steps:
        summary["certified_share_static"] = summary["certified_steps"] / steps
        if run.scenario.world.moving:
            summary["certified_share_moving"] = summary["certified_moving_steps"] / steps
    if run.notes:
        summary["notes"] = run.notes
    return summary


def _good(mission: MissionTable) -> tuple[Outcome, ...]:
    """Outcomes besides "reached" of a flight that did what its mission asks."""
    # Such a flight waits until all obstacles have passed, and not for its goal.
    waits: tuple[Outcome, ...] = () if mission.receded_s is None else ("passed", "timeout")
    return (*waits, *_GOOD.get(mission.kind, ()))


def certifying(run: WorldRun) -> list[str]:
    """Names of the parts of the world that the last filter certifies against; none without a shield.

    Args:
        run: all trials.
    """
    names = run.scenario.safety.filters
    if not names:
        return []
    given = run.scenario.safety.parameters(names[-1])
    against = getattr(given, "shield_map", None)
    if against is None or not getattr(given, "shield", True):
        return []
    wanted = {"ellipsoids": ("ellipsoids",), "hulls": ("hulls",), "both": ("ellipsoids", "hulls")}[against]
    return [name for name in (*wanted, "fence") if name in run.world.parts]


def world_timing(run: WorldRun) -> dict[str, Any]:
    """Measured times of the filters, of whole ticks on board, and of encounters with moving obstacles [s].

    Those of the filters are of all of them together in each tick; where there is one alone, and it sees
    moving obstacles, of its ticks in a manoeuvre or with a warning.

    Args:
        run: all trials.
    """
    timing: dict[str, Any] = {}
    each = {"tick": run.tick_s} | ({"filter": run.filter_s} if run.scenario.safety.filters else {})
    for what, seconds in each.items():
        timing |= {"filter_calls": len(seconds)} if what == "filter" else {}
        if not len(seconds):
            continue
        found = np.percentile(seconds, [50, 99, 100]).tolist()
        timing |= dict(zip((f"{what}_p50_s", f"{what}_p99_s", f"{what}_max_s"), found, strict=True))
        timing[f"{what}_mean_s"] = float(seconds.mean(dtype=np.float64))
        if what == "filter":
            timing["filter_std_s"] = float(seconds.std(dtype=np.float64))
            timing["filter_total_s"] = float(seconds.sum(dtype=np.float64))
    rules = run.scenario.rules
    timing["ticks"] = len(run.tick_s)
    timing["overruns"] = int((run.tick_s > rules.dt_s * rules.filter_ticks).sum())
    return timing | encounter_timing(run.command_s, run.reaction_s)


def world_words(scenario: WorldScenario, vehicle: Vehicle) -> str:
    """The vehicle in words.

    Args:
        scenario: completed.
        vehicle: that it names.
    """
    table = scenario.vehicle
    return f"{vehicle.name}, {vehicle.model}, by {table.interface}, radius {exact(table.radius_m or 0.0)} m"


def world_guarantee(run: WorldRun, cover: Artifact | None) -> Guarantee:
    """State what was proven, for which model, and what the run shows.

    Args:
        run: all trials.
        cover: that was flown in.
    """
    names, trials, world = run.scenario.safety.filters, run.trials, run.scenario.world
    parts = certifying(run)
    hits = sum(trial.collision for trial in trials)
    steps = sum(trial.steps for trial in trials)
    certified = sum(trial.certified_steps or 0 for trial in trials)
    claims: dict[str, Any] = {
        "filters": list(names),
        "trials": len(trials),
        "collisions": hits,
        "static_collisions": sum(map(hits_static, trials)),
    }
    limits = _AS_SIMULATED if world.moving else ""
    if not names:
        beforehand = UNFILTERED
    elif parts:
        shown = "all" if certified == steps else f"{certified} of {steps}"
        kept = " and ".join(_KEPT_FROM[name] for name in parts)
        beforehand = (
            f"In {shown} steps {names[-1]} proved, by a rollout of the model, that a manoeuvre to rest keeps "
            f"{exact(run.world.most_keep_m)} m from {kept}."
        )
        if world.moving:
            moving = sum(trial.certified_moving_steps or 0 for trial in trials)
            beforehand += (
                f" In {moving} of them that manoeuvre also stays clear of the tube of every tracked "
                "obstacle, for the horizon of the tubes; nothing can exclude that a vehicle at rest is hit."
            )
        claims |= {"certified_steps": certified, "steps": steps, "against": parts}
        left = left_out(run.scenario)
        claims["chain"] = _chain(run, cover, parts, complete=certified == steps, left=left)
        if left:
            limits = f"The flights had {', '.join(left)}, which the proof leaves out. {limits}".strip()
    else:
        seen = "by what was tracked, " if TRACKING.issuperset(names) else ""
        beforehand = (
            f"{' and '.join(names)} {'decide' if len(names) > 1 else 'decides'} {seen}tick by tick; nothing "
            "was guaranteed beforehand for this vehicle."
        )
        claims["proven"] = False
    return Guarantee(
        statement=statement(
            beforehand,
            "from the simulated truth, in continuous time",
            hits,
            len(trials),
            "flights touched an obstacle or left the fence",
            limits,
        ),
        claims=claims,
    )


def left_out(scenario: WorldScenario) -> list[str]:
    """What flights have and the model of a shield leaves out, in words.

    Args:
        scenario: completed.
    """
    table, known = scenario.vehicle, scenario.estimation
    own, assumed = table.disturbance, table.assumed
    found = {
        "drag": any(own.linear_drag_n_s_m or ()) or any(own.quadratic_drag_n_s2_m2 or ()),
        "wind": any(own.wind_m_s or ()) or any(own.gust_m_s or ()),
        "noise": any(
            (
                *(known.position_noise_m, known.velocity_noise_m_s),
                *(known.attitude_noise_rad, known.rate_noise_rad_s),
            )
        ),
        "lost measurements": known.lost_share > 0 or known.lost_from_s is not None,
        "a mass or thrust other than the model's": table.mass_scale != 1 or table.thrust_scale != 1,
        "a motor lag other than assumed": (own.motor_time_constant_s or 0.0)
        != (assumed.motor_time_constant_s or 0.0),
        "a delay other than assumed": (known.delay_s or 0.0) != (assumed.delay_s or 0.0),
        "a rate loop": table.interface == "body-rates",
        "the vehicle's own cascade": table.interface in ("velocity", "acceleration"),
    }
    return [words for words, has in found.items() if has]


def _chain(
    run: WorldRun, cover: Artifact | None, parts: list[str], *, complete: bool, left: list[str]
) -> dict[str, Any]:
    """The chain from the scene to the flight: scene within cover, every step certified against the cover."""
    if cover is None or "hulls" not in parts:
        return {
            "holds": False,
            "statement": "There is no cover, so nothing chains to a scene.",
            "assumptions": [],
        }
    level: Any = cover.manifest
    table, rules = run.scenario.vehicle.assumed, run.scenario.rules
    missing = not_covered(level)
    beyond = f" The cover leaves out {', '.join(missing)}." if missing else ""
    assumptions = [
        "Cover: alula verify proves that its hulls contain the ellipsoids of the scene at its level, grown "
        f"by {exact(level.inflation_m)} m; the run does not check this.{beyond}",
        "Model: a rigid body with the limits of its rotors, commands held for "
        f"{exact(rules.dt_s * rules.filter_ticks)} s, a motor time constant of "
        f"{exact(table.motor_time_constant_s or 0.0)} s.",
        f"Estimation: the state has no error but an age of {exact(table.delay_s or 0.0)} s, which the "
        "model predicts.",
        f"Inflation: {exact(run.world.hull_keep_m - run.world.radius_m)} m beyond the radius.",
        "World: static obstacles do not move, and the scene contains the real ones.",
    ]
    words = (
        "Every step was certified against the hulls of the cover. Where alula verify proves that the scene "
        "lies in the cover, the vehicle met no ellipsoid of the scene, under the assumptions listed."
        if complete
        else "Not every step was certified against the hulls of the cover, so the chain is broken."
    )
    words += beyond
    if left:
        words += f" These flights had {', '.join(left)}, which the model leaves out."
    return {"statement": words, "holds": complete and not left and not missing, "assumptions": assumptions}
