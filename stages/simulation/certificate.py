"""What the certified steps of a shield prove, in words and as claims."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import msgspec

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import CoverManifest, InputRef, LevelManifest
from alula.schemas.decimals import at_least, at_most, exact
from alula.schemas.log.run import TrialResult
from alula.schemas.parameters.filter_options import FILTERS
from alula.schemas.parameters.filters.values import Options
from alula.schemas.scenarios.check import FILTER_COMMANDS, TRACKING
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.tables import WorldTable
from alula.stages.clearance import is_collision
from alula.stages.compression.level import (
    level_words,
    mass_within,
    obstacle_of,
    obstacles_words,
    omissions,
    recorded_level,
    require_sigma,
)
from alula.stages.simulation.simulate import WorldRun
from alula.stages.verdict import UNFILTERED
from alula.stages.world.world import plant_steps_of

_ROUNDING_M = 1e-9  # of sums of lengths
_SHIELD = ("margin_m", "rest_drift_m", "early_end")  # parameters that the certificate of a step depends on
_PARTS = (  # of the world: name, in words, clearance of a trial
    ("hulls", "a hull", "map_clearance_m"),
    ("ellipsoids", "an ellipsoid of the scene", "scene_clearance_m"),
    ("fence", "the fence", "fence_clearance_m"),
)
_AGAINST = {"ellipsoids": ("ellipsoids",), "hulls": ("hulls",), "both": ("ellipsoids", "hulls")}
_MODELS = {"wrench": "quadrotor with rotor limits", "body-rates": "quadrotor with rotor limits"}


def certifying(run: WorldRun) -> list[str]:
    """Names of the parts of the world that the last filter certifies against; none without a shield."""
    against = _against(run.scenario)
    return [] if against is None else [name for name in (*against, "fence") if name in run.world.parts]


def _against(scenario: Scenario) -> tuple[str, ...] | None:
    """Maps that the last filter is to certify against, of those there may be; None without a shield."""
    names = scenario.safety.filters
    given = scenario.safety.parameters(names[-1]) if names else None
    against = getattr(given, "shield_map", None)
    return None if against is None or not getattr(given, "shield", True) else _AGAINST[against]


def uncertified_words(scenario: Scenario, trials: Sequence[TrialResult]) -> str:
    """State which obstacles that the last filter does not certify flights touched; empty without any."""
    against = _against(scenario)
    touched = [name for name, _, _ in _touched(trials) if name != "fence"]
    others = [] if against is None else [name for name in touched if name not in against]
    if not others:
        return ""
    return (
        f"{scenario.safety.filters[-1]} does not certify {_listed(others)}, which count as obstacles: "
        "shield_map=both certifies both"
    )


def beforehand(run: WorldRun, left: list[str], chain: dict[str, Any] | None) -> str:
    """State what the filters guarantee before the flights are judged.

    Args:
        left: what the flights had and the model of the last filter leaves out, in words.
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
    """State what the flights were judged against, after "Judged"."""
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
    """State for what the judgement holds."""
    contains = "its ellipsoids contain it" if run.world.ellipsoids is not None else "the hulls contain it"
    table = run.scenario.world
    real = f", and for the real scene as far as {contains}" if table.scene or table.cover else ""
    flown = "obstacles, the sensor and the vehicle as simulated" if table.moving else ""
    return f"This holds for the {flown or f'simulated {model_words(run)}'}{real}."


def model_words(run: WorldRun) -> str:
    """The simulated model, in words."""
    interface = run.scenario.vehicle.interface
    if run.vehicle.model != "quadrotor":
        return run.vehicle.model.replace("-", " ")
    return _MODELS.get(interface or "", f"quadrotor by {interface}")


def contradictions(run: WorldRun) -> list[str]:
    """Parts of the world that the last filter certified and that flights touched all the same, in words."""
    parts = certifying(run)
    return [
        f"{hits} of {len(run.trials)} flights touched {part}"
        for name, part, hits in _touched(run.trials)
        if name in parts
    ]


def _touched(trials: Sequence[TrialResult]) -> list[tuple[str, str, int]]:
    """Parts of the world that flights touched: name, in words, number of flights."""
    each = [
        (name, part, sum(is_collision(getattr(trial, clearance)) for trial in trials))
        for name, part, clearance in _PARTS
    ]
    return [found for found in each if found[2]]


def claims_of(
    run: WorldRun, cover: Artifact | None, left: list[str], inputs: Sequence[InputRef]
) -> dict[str, Any]:
    """The claims of a run about its parts of the world, and about the steps that a shield certified.

    `every_step_certified` is false where a flight touched what was certified: the truth has the last word.

    Args:
        left: what the flights had and the model of the last filter leaves out, in words.
    """
    trials, world, parts = run.trials, run.world, certifying(run)
    steps, certified = sum(t.steps for t in trials), sum(t.certified_steps or 0 for t in trials)
    claims: dict[str, Any] = {
        "certified_steps": certified,
        "steps": steps,
        "every_step_certified": bool(parts) and certified == steps > 0 and not contradictions(run),
        "certified_against": parts or None,
        "chain": _chain(run, cover, left, inputs) if "hulls" in parts else None,
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
        claims |= {"inflation_m": world.inflation_m["ellipsoids"]}
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
    shield, radius_m = _shield_of(scenario), world.keeps_m(*parts)
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
    if (met := contradictions(run)) and certified:
        words += f" This did not hold: {' and '.join(met)}."
    return f"{words} These flights had {', '.join(left)}, which that model leaves out." if left else words


def _chain(
    run: WorldRun, cover: Artifact | None, left: list[str], inputs: Sequence[InputRef]
) -> dict[str, Any]:
    """The chain from the scene to the flight, when the shield certified against hulls.

    scene within cover (`alula verify`) + every step certified against the cover => the vehicle met no
    ellipsoid of the scene. It holds where nothing breaks it: neither the certificate, the level and the
    origin of the cover, what was flown, nor the judgement of the flights.
    """
    if cover is None:
        words = "There is no cover, so nothing chains to a scene."
        return {"holds": False, "statement": words, "broken_by": [words], "assumptions": []}
    level = cover.manifest
    assert isinstance(level, CoverManifest)
    broken = _broken(run, level, left, inputs)
    origin = "scene" if level.imported is None else level.imported.kind
    table, rules = run.scenario.vehicle, run.scenario.rules
    delay, lag = table.assumed.delay_s or 0.0, table.assumed.motor_time_constant_s or 0.0
    tested = _tested(_shield_of(run.scenario))
    assumptions = [
        f"Cover: alula verify proves that its hulls contain {_contained_words(level)}; the run does not "
        "check this.",
        "Model: the vehicle is a rigid body with the limits of its rotors, commanded by "
        + ("thrust and torque" if table.interface == "wrench" else "thrust and body rates")
        + f" that are held for {exact(rules.dt_s * rules.filter_ticks)} s"
        + ("" if table.interface == "wrench" else f", which a rate loop with {_rate_lags(run)} follows")
        + (f", with a motor time constant of {exact(lag)} s." if lag else ", and its rotors follow at once."),
        "Estimation: the state that the filter gets has no error"
        + (f"; it is {exact(delay)} s old, and the model predicts the present one." if delay else "."),
        f"Delay: the filter assumes {exact(delay)} s, which must be the true one.",
        f"Inflation: {exact(_beyond_m(run))} m beyond the vehicle's radius and "
        f"{exact(level.inflation_m)} m in the cover bound the error of the {origin}'s alignment and whatever "
        "else the model leaves out.",
        *([f"Rest:{tested}"] if tested else []),
        f"World: the static obstacles do not move, and the {origin} contains the real ones.",
    ]
    if broken:
        words = f"The chain from the {origin} to the flight is broken. {' '.join(broken)}"
    else:
        file = origin_of(level)[0]
        words = (
            "Every step was certified against the hulls of the cover. Where alula verify proves that the "
            f"{origin} {file.name} (sha256 {file.sha256[:12]}…) lies in the cover, the vehicle met no "
            f"{obstacle_of(level)} of the {origin}{_at_level(level)}, under the assumptions listed."
        )
    return {
        "statement": words,
        "holds": not broken,
        "broken_by": broken,
        "level": recorded_level(level),
        "made_from": msgspec.to_builtins(origin_of(level)),
        "inputs": {ref.role: ref.sha256 for ref in inputs if ref.role in ("cover", "scene")},
        "assumptions": assumptions,
    }


def misfits(run: WorldRun, cover: Artifact | None, inputs: Sequence[InputRef]) -> list[str]:
    """How the obstacles in a cover differ from the scene that was flown in beside it, one sentence each."""
    if cover is None or run.scenario.world.scene is None:
        return []
    level = cover.manifest
    assert isinstance(level, CoverManifest)
    return _unlike_the_scene(run, level, origin_of(level), inputs)


def origin_of(level: CoverManifest) -> list[InputRef]:
    """The files that the obstacles of a cover come from: the scene, or the imported map.

    Args:
        level: manifest of the cover.
    """
    return [ref for ref in level.made_from if ref.role in ("scene", "source")]


def _at_level(level: CoverManifest) -> str:
    """The level of the ellipsoids of a cover, after "no ellipsoid of the scene"."""
    return "" if level.sigma is None else f" at {level_words(level.sigma)}"


def _beyond_m(run: WorldRun) -> float:
    """Distance that the filters keep from hulls beyond the vehicle's radius [m]."""
    return run.world.keeps_m("hulls") - run.world.radius_m


def _broken(run: WorldRun, level: CoverManifest, left: list[str], inputs: Sequence[InputRef]) -> list[str]:
    """What breaks the chain from the scene to the flight, one sentence each; none where it holds."""
    trials, found, one = run.trials, [], obstacle_of(level)
    steps, certified = sum(t.steps for t in trials), sum(t.certified_steps or 0 for t in trials)
    if certified < steps or not steps:
        found.append(f"Only {certified} of {steps} steps were certified against the hulls of the cover.")
    if missing := omissions(level):
        found.append(f"The cover leaves out {', '.join(missing)}.")
    if left:
        found.append(f"These flights had {', '.join(left)}, which the model leaves out.")
    origin = origin_of(level)
    if len(origin) != 1:
        found.append(f"The cover does not name the file of its {one}s; make it again with merge.")
    if run.scenario.world.scene is not None:
        found += _unlike_the_scene(run, level, origin, inputs)
    found += [f"{hits} of {len(trials)} flights touched {part}." for _, part, hits in _touched(run.trials)]
    return found


def _unlike_the_scene(
    run: WorldRun, level: CoverManifest, origin: list[InputRef], inputs: Sequence[InputRef]
) -> list[str]:
    """Differences between the obstacles in a cover and the scene that was flown in beside it."""
    if level.imported is not None:
        return [f"The hulls contain the {level.imported.kind} that the cover was made from, not the scene."]
    found = []
    flown = next((ref.sha256 for ref in inputs if ref.role == "scene"), None)
    if flown is None:
        found.append("The run does not know the hash of its scene.")
    elif len(origin) == 1 and origin[0].sha256 != flown:
        found.append(
            f"The cover was made from another scene file, {origin[0].name} (sha256 "
            f"{origin[0].sha256[:12]}…); that of the run has {flown[:12]}…."
        )
    if run.world.sigma > require_sigma(level):
        found.append(
            f"The ellipsoids of the run are those at {exact(run.world.sigma)} sigma, and the cover contains "
            f"those at {exact(require_sigma(level))}."
        )
    kept_m = level.inflation_m + _beyond_m(run)
    if kept_m < run.world.suggested_inflation_m - _ROUNDING_M:
        found.append(
            f"The inflation of the cover and of the run together is {at_least(kept_m)} m, less than the "
            f"{at_most(run.world.suggested_inflation_m)} m that the alignment of the scene suggests."
        )
    return found


def _shield_of(scenario: Scenario) -> dict[str, Any]:
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
