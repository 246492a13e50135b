"""Summary and guarantee of all flights of a scenario."""

from __future__ import annotations

import math
from typing import Any

from alula.schemas.artifact import Artifact
from alula.schemas.decimals import exact
from alula.schemas.filter_options import FILTERS
from alula.schemas.manifest import Guarantee
from alula.schemas.run import Outcome
from alula.schemas.vehicle import Vehicle
from alula.schemas.world import WorldScenario
from alula.schemas.world_check import is_random
from alula.stages.durations import Times
from alula.stages.simulation.ellipsoids.certificate import not_covered
from alula.stages.simulation.result import outcomes_of
from alula.stages.simulation.world.among_hulls import note_of_starts, proof_among_hulls, unsafe_starts
from alula.stages.simulation.world.judge import hits_static, worst_clearance
from alula.stages.simulation.world.piloted import HOLDS, fence_filter_of, fence_notes, fence_summary
from alula.stages.simulation.world.simulate import WorldRun
from alula.stages.verdict import UNFILTERED, head, mean, mean_path_ratio, minimum, statement, totals

_COUNTED = (
    *("steps", "filtered_steps", "shortened_steps", "infeasible_steps", "fallback_steps", "backup_steps"),
    *("certified_steps", "certified_moving_steps", "saturated_steps", "refused_steps", "stale_steps"),
)
_GOOD: dict[str, tuple[Outcome, ...]] = {
    "hover": ("passed", "held"),
    "pilot": ("held",),
}  # outcomes of a flight that did what its mission asks, besides "reached"
_KEPT_FROM = {"ellipsoids": "every ellipsoid", "hulls": "every hull", "fence": "the outside of the fence"}


def world_summary(run: WorldRun) -> dict[str, Any]:
    """Rates with 95 % Wilson intervals, extremes, and shares of certified steps; it has no measured time.

    Without any random number there is no interval: the flight would repeat itself bit by bit. `fence` has the
    figures of a pilot's flights in a fence, see `fence_summary`.

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
        **totals(trials, _COUNTED),
        **run.counts,
        "filter_kind": run.filter_kind,
    }
    if run.scenario.world.scene is not None:
        summary |= {"sigma": run.world.sigma, "inflation_m": run.world.keep_m - run.world.radius_m}
    if certifying(run) and steps:
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
    """Measured times of all filters together, and of whole ticks on board [s].

    Args:
        run: all trials.
    """
    timing: dict[str, Any] = {"ticks": run.tick_times.calls, "overruns": run.tick_times.overruns}
    if run.scenario.safety.filters:
        timing |= _spread("filter", run.filter_times)
        timing |= {"filter_calls": run.filter_times.calls, "filter_total_s": run.filter_times.total_s}
    return timing | _spread("tick", run.tick_times)


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


def world_words(scenario: WorldScenario, vehicle: Vehicle) -> str:
    """The vehicle in words.

    Args:
        scenario: completed.
        vehicle: that it names.
    """
    table = scenario.vehicle
    limit = table.max_speed_m_s
    fast = "" if limit is None or not math.isfinite(limit) else f", up to {exact(limit)} m/s"
    radius = exact(table.radius_m or 0.0)
    return f"{vehicle.name}, {vehicle.model}, by {table.interface}, radius {radius} m{fast}"


def world_guarantee(run: WorldRun, cover: Artifact | None) -> Guarantee:
    """State what was proven, for which model, and what the run shows.

    Args:
        run: all trials.
        cover: that was flown in.
    """
    names, trials = run.scenario.safety.filters, run.trials
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
    among, limits, proof = proof_among_hulls(run.scenario, run.vehicle, cover, trials)
    claims |= proof
    if not names:
        beforehand = UNFILTERED
    elif among:
        beforehand = among
    elif parts:
        shown = "all" if certified == steps else f"{certified} of {steps}"
        kept = " and ".join(_KEPT_FROM[name] for name in parts)
        beforehand = (
            f"In {shown} steps {names[-1]} proved, by a rollout of the model, that a manoeuvre to rest keeps "
            f"{exact(run.world.most_keep_m)} m from {kept}."
        )
        if run.scenario.world.moving:
            moving = sum(trial.certified_moving_steps or 0 for trial in trials)
            beforehand += (
                f" In {moving} of them that manoeuvre also stays clear of the tube of every tracked "
                "obstacle, for the horizon of the tubes; nothing can exclude that a vehicle at rest is hit."
            )
        claims |= {"certified_steps": certified, "steps": steps, "against": parts}
        left = left_out(run.scenario)
        claims["chain"] = _chain(run, cover, parts, complete=certified == steps, left=left)
        if left:
            limits = f"The flights had {', '.join(left)}, which the proof leaves out."
    elif names[-1] in HOLDS and run.scenario.mission.kind == "pilot":
        beforehand, left = HOLDS[names[-1]], left_out(run.scenario)
        claims |= {"as_modelled": not left, "proven": False}
        if left:
            limits = f"The vehicle differed from the filter's model: {', '.join(left)}."
    elif names[-1] not in FILTERS:
        beforehand = f"alula does not check what the filter {names[-1]!r} guarantees."
    else:
        beforehand = (
            f"{' and '.join(names)} decide tick by tick; nothing was guaranteed beforehand for this vehicle."
        )
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
    """What flights have and the model of their last filter leaves out, in words.

    Args:
        scenario: completed.
    """
    table, known = scenario.vehicle, scenario.estimation
    own, assumed = table.disturbance, table.assumed
    by_sticks = table.interface == "sticks"
    mass = _changed(mass_scale=table.mass_scale, thrust_scale=table.thrust_scale)
    gain, sag = _changed(rate_gain_scale=table.rate_gain_scale), own.sag_share or 0.0
    delay_s, most_s = known.delay_s or 0.0, _latency_s(scenario)
    found = {
        "drag": any(own.linear_drag_n_s_m or ()) or any(own.quadratic_drag_n_s2_m2 or ()),
        "wind": any(own.wind_m_s or ()) or any(own.gust_m_s or ()),
        "noise": any(
            (
                *(known.position_noise_m, known.velocity_noise_m_s),
                *(known.attitude_noise_rad, known.rate_noise_rad_s),
            )
        ),
        # A geofence tells when measurements are missing, and a racer has no rotors.
        "lost measurements": not by_sticks and (known.lost_share > 0 or known.lost_from_s is not None),
        f"a mass or thrust other than the model's ({mass})": mass,
        "a motor lag other than assumed": not by_sticks
        and (own.motor_time_constant_s or 0.0) != (assumed.motor_time_constant_s or 0.0),
        f"a delay other than assumed (delay_s {exact(delay_s)})": delay_s > most_s
        if by_sticks
        else delay_s != (assumed.delay_s or 0.0),
        f"a rate loop other than the model's ({gain})": gain
        if table.interface in ("sticks", "body-rates")
        else "",
        f"a battery that sags (sag_share {exact(sag)})": by_sticks and sag > 0,
        "a rate loop": table.interface == "body-rates",
        "the vehicle's own cascade": table.interface in ("velocity", "acceleration"),
    }
    return [words for words, has in found.items() if has]


def _changed(**scales: float) -> str:
    """Names and values of the scales that are not 1."""
    return ", ".join(f"{name} {exact(value)}" for name, value in scales.items() if value != 1)


def _latency_s(scenario: WorldScenario) -> float:
    """The delay that the geofence of a pilot makes up for [s]; 0 without one."""
    name = fence_filter_of(scenario)
    return 0.0 if name is None else float(scenario.safety.parameters(name).latency_s)  # type: ignore[union-attr]


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
