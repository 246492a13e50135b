"""What the certified steps of a shield prove, in words and as claims."""

from __future__ import annotations

from typing import Any

import msgspec

from alula.schemas.artifact import Artifact
from alula.schemas.decimals import exact
from alula.schemas.filter_options import FILTERS
from alula.schemas.filters.values import Options
from alula.schemas.manifest import CoverManifest, LevelManifest
from alula.schemas.world import WorldScenario
from alula.schemas.world_check import FILTER_COMMANDS, TRACKING
from alula.schemas.world_tables import WorldTable
from alula.stages.clearance import is_collision
from alula.stages.compression.level import (
    level_words,
    mass_within,
    obstacle_of,
    obstacles_words,
    require_sigma,
)
from alula.stages.simulation.world.parts import plant_steps_of
from alula.stages.simulation.world.simulate import WorldRun
from alula.stages.verdict import UNFILTERED

_SHIELD = ("margin_m", "rest_drift_m", "early_end")  # parameters that the certificate of a step depends on
_AGAINST = {"ellipsoids": ("ellipsoids",), "hulls": ("hulls",), "both": ("ellipsoids", "hulls")}
_MODELS = {"wrench": "quadrotor with rotor limits", "body-rates": "quadrotor with rotor limits"}


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
    return [name for name in (*_AGAINST[against], "fence") if name in run.world.parts]


def beforehand(run: WorldRun, left: list[str], chain: dict[str, Any] | None) -> str:
    """State what the filters guarantee before the flights are judged.

    Args:
        run: all trials.
        left: what the flights had and the model of the last filter leaves out, in words.
        chain: claim of that name.
    """
    names, guide = run.scenario.safety.filters, run.scenario.mission.controller.guide
    tracks = TRACKING.issuperset(names)
    if not names:
        words = UNFILTERED
    elif certifying(run):
        words = _certified_words(run, left)
        words += f" {chain['statement']}" if chain is not None else ""
    elif any(name not in FILTERS for name in names):
        what = f"the filter {names[0]!r} guarantees" if len(names) == 1 else f"{_listed(names)} guarantee"
        words = f"alula does not check what {what}."
    elif len(names) == 1 and FILTER_COMMANDS[names[0]] in ("acceleration", "wrench") and not tracks:
        words = f"The filter {names[0]!r} bounds the rate of a barrier at each step; it proves no flight."
    else:
        verb = "decides" if len(names) == 1 else "decide"
        seen = "by what was tracked, " if tracks else ""
        words = (
            f"{_listed(names)} {verb} {seen}tick by tick; nothing was guaranteed beforehand for this vehicle."
        )
    if guide != "none":
        words += f" The guide {guide!r} only changes the nominal command; no proof depends on it."
    return words


def judged_words(run: WorldRun) -> str:
    """State what the flights were judged against, after "Judged".

    Args:
        run: all trials.
    """
    table, parts = run.scenario.world, []
    if run.world.ellipsoids is not None:
        parts.append(f"the scene's ellipsoids at {level_words(run.world.sigma)}")
    if run.world.polytopes is not None:
        parts.append(_hulls_words(table, "the cover's hulls", "the walls"))
    if len(run.world.faces):
        parts.append("the fence")
    if table.moving:
        parts.append("the moving obstacles")
    against = f" against {_listed(parts)}" if parts else ""
    return f"afterwards from the simulated truth over the whole path, in continuous time,{against}".rstrip(
        ","
    )


def limits_words(run: WorldRun) -> str:
    """State for what the judgement holds.

    Args:
        run: all trials.
    """
    contains = "its ellipsoids contain it" if run.world.ellipsoids is not None else "the hulls contain it"
    table = run.scenario.world
    real = f", and for the real scene as far as {contains}" if table.scene or table.cover else ""
    flown = "obstacles, the sensor and the vehicle as simulated" if table.moving else ""
    return f"This holds for the {flown or f'simulated {model_words(run)}'}{real}."


def model_words(run: WorldRun) -> str:
    """The simulated model, in words.

    Args:
        run: all trials.
    """
    interface = run.scenario.vehicle.interface
    if run.vehicle.model != "quadrotor":
        return run.vehicle.model.replace("-", " ")
    return _MODELS.get(interface or "", f"quadrotor by {interface}")


def claims_of(run: WorldRun, cover: Artifact | None, left: list[str]) -> dict[str, Any]:
    """The claims of a run about its parts of the world, and about the steps that a shield certified.

    Args:
        run: all trials.
        cover: that was flown in.
        left: what the flights had and the model of the last filter leaves out, in words.
    """
    trials, world, parts = run.trials, run.world, certifying(run)
    steps, certified = sum(t.steps for t in trials), sum(t.certified_steps or 0 for t in trials)
    claims: dict[str, Any] = {
        "certified_steps": certified,
        "steps": steps,
        "every_step_certified": bool(parts) and certified == steps,
        "certified_against": parts or None,
        "chain": _chain(run, cover, left, complete=certified == steps) if "hulls" in parts else None,
        "shield": _shield_of(run.scenario) if parts and certified else {},
        "continuous_time": True,
        "path_sampling_s": run.scenario.rules.dt_s
        / plant_steps_of(run.scenario, is_point=run.vehicle.model == "single-integrator"),
        "vehicle_model": model_words(run),
    }
    if world.ellipsoids is not None:
        hits = sum(is_collision(trial.scene_clearance_m) for trial in trials)
        claims |= {"scene_clear": hits == 0, "scene_collisions": hits}
        claims |= {"sigma": world.sigma, "mass_fraction": mass_within(world.sigma)}
        claims |= {"inflation_m": world.inflation_m}
    if world.polytopes is not None:
        hits = sum(is_collision(trial.map_clearance_m) for trial in trials)
        claims |= {"hulls_clear": hits == 0, "hull_collisions": hits}
    return claims | world.claims


def _contained_words(level: LevelManifest) -> str:
    """Name what a cover contains."""
    if level.imported is not None:
        return obstacles_words(level)
    grown = f"grown by {exact(level.inflation_m)} m"
    return f"the ellipsoids of the scene at {level_words(require_sigma(level))}, {grown}"


def not_covered(level: Any) -> list[str]:
    """What a cover leaves out of the scene by its own parameters, in words.

    Args:
        level: manifest of the cover.
    """
    found = {
        f"voxels that fewer than {level.min_overlap} {obstacle_of(level)}s touch": level.min_overlap > 1,
        f"Gaussians of opacity below {exact(level.min_opacity)}": level.min_opacity > 0,
        "everything outside of its crop": level.crop is not None,
        "the loss of the splat file's format": level.ignore_loss,
    }
    return [words for words, is_so in found.items() if is_so]


def _certified_words(run: WorldRun, left: list[str]) -> str:
    """State what the certified steps of a run prove."""
    scenario, world, parts = run.scenario, run.world, certifying(run)
    steps = sum(trial.steps for trial in run.trials)
    certified = sum(trial.certified_steps or 0 for trial in run.trials)
    table = scenario.world
    kept = {
        "ellipsoids": "every ellipsoid",
        "hulls": _hulls_words(table, "every hull of the cover", "every wall"),
        "fence": "the outside of the fence",
    }
    shield, radius_m = _shield_of(scenario), world.most_keep_m
    radius = "the radius" if radius_m == world.radius_m else "the radius and the inflation"
    half = f" and half of margin_m, {exact(shield['margin_m'] / 2)} m," if "margin_m" in shield else ""
    shown = "all" if certified == steps else f"{certified} of {steps}"
    words = (
        f"In {shown} steps {scenario.safety.filters[-1]} proved, by a rollout of the model, that a backup "
        f"manoeuvre from the end of the step keeps {exact(radius_m)} m, {radius},{half} from "
        f"{_listed([kept[name] for name in parts])} until it rests, for {_model(run)}.{_tested(shield)}"
    )
    if scenario.world.moving:
        moving = sum(trial.certified_moving_steps or 0 for trial in run.trials)
        words += (
            f" In {moving} of them that manoeuvre also stays clear of the tube of every tracked "
            "obstacle, for the horizon of the tubes; nothing can exclude that a vehicle at rest is hit."
        )
    return f"{words} These flights had {', '.join(left)}, which that model leaves out." if left else words


def _chain(run: WorldRun, cover: Artifact | None, left: list[str], *, complete: bool) -> dict[str, Any]:
    """The chain from the scene to the flight, when the shield certified against hulls.

    scene within cover (`alula verify`) + every step certified against the cover => the vehicle met no
    ellipsoid of the scene.
    """
    if cover is None:
        return {
            "holds": False,
            "statement": "There is no cover, so nothing chains to a scene.",
            "assumptions": [],
        }
    level = cover.manifest
    assert isinstance(level, CoverManifest)
    origin = "scene" if level.imported is None else level.imported.kind
    table, rules, missing = run.scenario.vehicle, run.scenario.rules, not_covered(level)
    delay, lag = table.assumed.delay_s or 0.0, table.assumed.motor_time_constant_s or 0.0
    tested = _tested(_shield_of(run.scenario))
    beyond = f" The cover leaves out {', '.join(missing)}." if missing else ""
    assumptions = [
        f"Cover: alula verify proves that its hulls contain {_contained_words(level)}; the run does not "
        "check this." + beyond,
        "Model: the vehicle is a rigid body with the limits of its rotors, commanded by "
        + ("thrust and torque" if table.interface == "wrench" else "thrust and body rates")
        + f" that are held for {exact(rules.dt_s * rules.filter_ticks)} s"
        + ("" if table.interface == "wrench" else f", which a rate loop with {_rate_lags(run)} follows")
        + (f", with a motor time constant of {exact(lag)} s." if lag else ", and its rotors follow at once."),
        "Estimation: the state that the filter gets has no error"
        + (f"; it is {exact(delay)} s old, and the model predicts the present one." if delay else "."),
        f"Delay: the filter assumes {exact(delay)} s, which must be the true one.",
        f"Inflation: {exact(run.world.hull_keep_m - run.world.radius_m)} m beyond the vehicle's radius and "
        f"{exact(level.inflation_m)} m in the cover bound the error of the {origin}'s alignment and whatever "
        "else the model leaves out.",
        *([f"Rest:{tested}"] if tested else []),
        f"World: the static obstacles do not move, and the {origin} contains the real ones.",
    ]
    words = (
        "Every step was certified against the hulls of the cover. Where alula verify proves that the "
        f"{origin} lies in the cover, the vehicle met no {obstacle_of(level)} of the {origin}, under the "
        "assumptions listed."
        if complete
        else "Not every step was certified against the hulls of the cover, so the chain is broken."
    )
    words += beyond
    if left:
        words += f" These flights had {', '.join(left)}, which the model leaves out."
    return {"statement": words, "holds": complete and not left and not missing, "assumptions": assumptions}


def _shield_of(scenario: WorldScenario) -> dict[str, Any]:
    """The parameters of the last filter that a certificate depends on, those that it has."""
    given = scenario.safety.parameters(scenario.safety.filters[-1])
    values = msgspec.structs.asdict(given) if isinstance(given, Options) else given
    return {name: values[name] for name in _SHIELD if name in values}


def _rate_lags(run: WorldRun) -> str:
    """Time constants of the rate loop, in words."""
    roll, pitch, yaw = run.vehicle.rates.axes_s
    if roll == pitch == yaw:
        return f"a time constant of {exact(roll)} s"
    return f"time constants of {exact(roll)}, {exact(pitch)} and {exact(yaw)} s in roll, pitch and yaw"


def _model(run: WorldRun) -> str:
    """The filters' model of the vehicle, in words."""
    table = run.scenario.vehicle
    lag, delay = table.assumed.motor_time_constant_s, table.assumed.delay_s
    loop = f"a rate loop with {_rate_lags(run)}"
    parts = (
        (loop, table.interface != "wrench"),
        (f"a motor time constant of {exact(lag or 0.0)} s", lag),
        (f"states that are {exact(delay or 0.0)} s old", delay),
    )
    known = [text for text, value in parts if value]
    return f"the model with {' and '.join(known)}" if known else "the model without disturbances"


def _tested(shield: dict[str, Any]) -> str:
    """What of a certificate is tested and not proven, in words."""
    if "rest_drift_m" not in shield:
        return ""
    words = (
        f" At rest the linear loop about hover drifts by at most {exact(shield['rest_drift_m'])} m; that the "
        "nonlinear loop stays within half of margin_m is tested, not proven."
    )
    if shield.get("early_end"):
        words += (
            " So is the early end of rollouts, where twice the excursion of the linear loop is free "
            "(early_end=false rolls all out to rest)."
        )
    return words


def _hulls_words(table: WorldTable, cover: str, walls: str) -> str:
    parts = ((cover, table.cover is not None), (walls, bool(table.walls)))
    found = [words for words, is_there in (*parts, ("all space that was not seen", table.seen)) if is_there]
    return " and ".join(found)


def _listed(words: list[str] | tuple[str, ...]) -> str:
    """Items in words: "a, b and c"."""
    *others, last = words
    return f"{', '.join(others)} and {last}" if others else last
