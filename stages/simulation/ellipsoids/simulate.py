"""Simulation of flights of a rigid body among the ellipsoids of a scene, and their judgement."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifact import Artifact
from alula.schemas.configs.simulate import DEFAULT_SPEED_M_S, SimulateConfig
from alula.schemas.decimals import exact
from alula.schemas.errors import InputError, UsageError
from alula.schemas.manifest import Guarantee
from alula.schemas.progress import Progress
from alula.schemas.run import TrialResult
from alula.schemas.vehicle import FASTBRIDGE, Vehicle
from alula.stages.clearance import hull_obstacles, is_collision
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.level import level_words, mass_within
from alula.stages.compression.verify import require_solid_hulls
from alula.stages.compression.voxelize import sigma_of_confidence
from alula.stages.filtering.bridge import NativeFilter
from alula.stages.filtering.ellipsoid_filters import (
    ELLIPSOIDS,
    GUIDES,
    certified_against,
    keeps_from_hulls,
)
from alula.stages.filtering.obstacles import beyond_hulls, ellipsoid_index, require_metric
from alula.stages.filtering.protocol import FilterWorld, SafetyFilter
from alula.stages.filtering.registry import (
    FLIES_AMONG_HULLS,
    NO_FILTER,
    complete_parameters,
    make_filter,
)
from alula.stages.planning.adherence import PlanJudge, require_room, via_tolerance
from alula.stages.progress import share
from alula.stages.simulation.ellipsoids.certificate import certified_words, chain_of, shield_of
from alula.stages.simulation.ellipsoids.closed_loop import decimate, fly
from alula.stages.simulation.ellipsoids.judge import SplatJudge
from alula.stages.simulation.ellipsoids.references import references_of
from alula.stages.simulation.pairs import Pairs
from alula.stages.simulation.result import RunResult, SplatFlightLog, outcomes_of
from alula.stages.vehicles.bodies import (
    actuator_model,
    disturbances,
    plant_options,
    quadrotor,
    tracking_gains,
)
from alula.stages.verdict import UNFILTERED, head, mean, mean_path_ratio, minimum, statement, totals

_COUNTED = (
    *("steps", "filtered_steps", "infeasible_steps", "fallback_steps", "backup_steps"),
    *("certified_steps", "capped_steps", "saturated_steps"),
)
_BATCH = 16  # trials whose full-rate samples are in memory at once
_PLANT_STEP_S = 1e-3  # maximum, the default of FlightRules
_STUCK_S = 2.0
_CATCH_UP = 0.5  # speed above the reference's for a delayed vehicle, as a fraction of the peak speed
_ROOM_M = 20.0  # around the scene and the references; a flight that leaves it is refused


def resolve_splat(
    config: SimulateConfig, vehicle: Vehicle, plan: Artifact | None, *, has_scene: bool = True
) -> SimulateConfig:
    """Complete the configuration from the vehicle, the plan or defaults.

    Args:
        config: see `SimulateConfig`.
        vehicle: quadrotor or double integrator.
        plan: the `alula/plan` to fly, if any.
        has_scene: False where the hulls of a cover are all obstacles.

    Raises:
        UsageError: a number of trials or a speed is given with a plan, which sets both; the vehicle's model
            does not fly among ellipsoids; or a parameter of the filter or the guide is unknown.
    """
    if vehicle.model == "single-integrator":
        raise UsageError(
            f"{vehicle.name} is a single-integrator, which flies among the hulls of a cover, not "
            "among ellipsoids"
        )
    if config.plant == "quadrotor" != vehicle.model:
        raise UsageError(f"--plant quadrotor: {vehicle.name} is a {vehicle.model}")
    if config.plant == "double-integrator" or vehicle.model == "double-integrator":
        if config.interface != "wrench":
            raise UsageError(
                f"--interface {config.interface}: a double integrator is commanded by acceleration"
            )
        if alone := [name for name in disturbances(vehicle) if name not in ("noise", "delay")]:
            raise UsageError(
                f"--plant double-integrator has no {' or '.join(alone)}, which {vehicle.name} has"
            )
    if plan is not None and config.planned:
        raise UsageError("--planned is for start-goal pairs; a plan is flown as it is")
    if plan is not None and config.trials not in (None, 1):
        raise UsageError("--trials is for random pairs; a plan is flown once")
    if plan is not None and config.speed_m_s is not None:
        raise UsageError("--speed is for random pairs; a plan has its own speed")
    if plan is not None and config.pairs != "any":
        raise UsageError(f"--pairs {config.pairs} is for random pairs; a plan has its own start and goal")
    if config.guide not in (NO_FILTER, *GUIDES):
        raise UsageError(f"--guide {config.guide}: a guide is {' or '.join(GUIDES)}")
    if config.guide == NO_FILTER and config.guide_parameters:
        raise UsageError(f"--set guide.{next(iter(config.guide_parameters))}: there is no --guide")
    if not has_scene and config.guide not in (NO_FILTER, *FLIES_AMONG_HULLS):
        raise UsageError(f"--guide {config.guide} needs a scene, for its ellipsoids; add --scene")
    given = complete_parameters(config.filter, config.filter_parameters, has_ellipsoids=has_scene)
    speed = config.speed_m_s or DEFAULT_SPEED_M_S if plan is None else None
    peak = _peak_speed(plan) if plan is not None else speed
    assert peak is not None
    catch_up = vehicle.tracking.catch_up_m_s or _CATCH_UP * peak
    return dataclasses.replace(
        config,
        sigma=config.sigma if config.confidence is None else sigma_of_confidence(config.confidence),
        radius_m=vehicle.body.radius_m if config.radius_m is None else config.radius_m,
        plant=config.plant or ("quadrotor" if vehicle.model == "quadrotor" else "double-integrator"),
        speed_m_s=speed,
        trials=(100 if plan is None else 1) if config.trials is None else config.trials,
        filter_parameters=given,
        guide_parameters=complete_parameters(config.guide, config.guide_parameters),
        catch_up_m_s=config.catch_up_m_s or catch_up,
    )


def simulate_splat(
    config: SimulateConfig,
    scene: Artifact | None,
    vehicle: Vehicle,
    *,
    plan: Artifact | None = None,
    cover: Artifact | None = None,
    given: Pairs | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> RunResult:
    """Fly start-goal pairs, or a plan, among the ellipsoids of a scene, and judge each flight.

    The plant is a rigid body with rotors, in steps of at most 1 ms, or an ideal double integrator, as `plant`
    says. Tracking controller, guide and filter run at every `dt_s`. A pair is joined by a straight septic
    reference from rest to rest with the peak speed `speed_m_s`, regardless of obstacles; a plan is flown as
    it is, and with `planned` each pair follows a plan of its own among the hulls of the cover. The map of the
    filters is the ellipsoids at the level `sigma`; their sphere has the vehicle's radius plus `inflation_m`.
    Shields certify against the obstacles that their parameter `shield_map` names, also hulls of the cover.
    Every flight is judged independently of the filter: exact signed Euclidean distance of the path at the
    plant's rate to the ellipsoids, and to the hulls if the filter has them, minus the radius. A success is a
    flight that reached its goal without collision.

    Args:
        config: see `SimulateConfig`.
        scene: metric scene; None to fly among the hulls of the cover alone, behind a filter that takes them.
        vehicle: body, rotors, controller and disturbances.
        plan: flown instead of random pairs.
        cover: clearance to its hulls is also reported; `planned` plans among them, at the distance of the
            radius plus `inflation_m`. Shields keep the radius from them, plus `inflation_m` where it is
            given, else what the suggestion of the scene exceeds the cover's own inflation by.
        given: pairs flown instead of random ones.
        jobs: threads, 0 for all processors; only measured times depend on it.
        progress: called with (trials done, trials).

    Raises:
        UsageError: the filter is unknown, a parameter does not apply, the plant cannot fly the filter's
            output, a map that the filter needs is missing, or a given start or goal is not clear of the map.
        InputError: the scene is not metric, or plan or cover do not fit it.
        ArtifactError: planes and vertices of the cover do not describe the same polytopes.
        InfeasibleError: no clear start-goal pairs were found.

    Source: FastBridge (arXiv 2607.01200), section IV.
    """
    config = resolve_splat(config, vehicle, plan, has_scene=scene is not None)
    assert config.radius_m is not None
    assert config.trials is not None
    assert config.plant is not None
    found_in = scene or cover
    if found_in is None:
        raise UsageError("a flight needs a scene or a cover")
    _check_fit(found_in, plan, cover)
    if cover is not None:
        require_solid_hulls(cover, jobs=jobs)
    against = certified_against(config.filter, config.filter_parameters)
    suggested = 0.0 if scene is None else float(scene.manifest.suggested_inflation_m)  # type: ignore[attr-defined]
    inflation = suggested if config.inflation_m is None else config.inflation_m
    keep = config.radius_m + inflation
    hulls, centres = None, np.empty((0, 3))
    if cover is not None:
        solid = Hulls.from_cover(cover)
        hulls, centres = hull_obstacles(solid), solid.vertices_world
    if scene is not None:
        centres = np.asarray(scene["mean"], np.float64)
    hull_keep = config.radius_m + beyond_hulls(config.inflation_m, cover, suggested)
    index = ellipsoid_index(scene, config.sigma, keep)
    gains = tracking_gains(vehicle, config.catch_up_m_s)
    # A point has no rotors: its controller and filters use only the translation, with any body.
    body = quadrotor(vehicle if vehicle.model == "quadrotor" else FASTBRIDGE)
    assumed = actuator_model(vehicle)
    world = FilterWorld(
        index=index,
        body=body,
        gains=gains,
        radius_m=keep,
        dt_s=config.dt_s * config.filter_ticks,
        motor_time_constant_s=assumed.motor_time_constant_s,
        rate_time_constant_s=vehicle.rates.time_constant_s if config.interface == "body-rates" else 0.0,
        max_rate_rad_s=vehicle.rates.max_rad_s,
        polytopes=hulls,
        hull_radius_m=hull_keep,
    )
    safety_filter = make_filter(config.filter, world, config.filter_parameters)
    guide = make_filter(config.guide, world, config.guide_parameters)
    assert guide is None or isinstance(guide, NativeFilter)
    if config.plant == "double-integrator" and safety_filter is not None and safety_filter.kind == "wrench":
        raise UsageError(f"--plant double-integrator has no thrust and torque, which {config.filter} returns")
    sees_hulls = keeps_from_hulls(config.filter, config.filter_parameters, has_ellipsoids=scene is not None)
    judge = SplatJudge(scene, config.sigma, hulls, config.radius_m, jobs, avoids_hulls=sees_hulls)
    if config.planned and cover is None:
        raise UsageError("--planned needs a cover to plan in; give it as SOURCE, and the scene as --scene")
    planning = share(progress, 0, 0.5) if config.planned else None
    progress = share(progress, 0.5, 1) if config.planned else progress
    references, plans, goals, sampled = references_of(
        config, centres, plan, given, judge, keep, cover if config.planned else None, jobs, planning
    )
    tolerance = via_tolerance(config.via_tolerance_m, config.radius_m)

    def along(own: Artifact | None) -> PlanJudge | None:
        assert config.radius_m is not None
        return None if own is None else PlanJudge(own, judge.avoided, config.radius_m, tolerance, jobs)

    flown_plan = along(plan)
    keeps = ([] if scene is None else [keep]) + ([hull_keep] if judge.avoids_hulls else [])
    notes = (
        []
        if flown_plan is None
        else require_room(flown_plan, keeps, config.filter, allow_tight=config.allow_tight)
    )
    lower, upper = _room(centres, references, config.dt_s)
    rules = _core.FlightRules(
        dt_s=config.dt_s,
        controller_ticks=config.controller_ticks,
        filter_ticks=config.filter_ticks,
        stop_fraction=config.stop_fraction,
        stuck_ticks=max(1, round(_STUCK_S / config.dt_s)),
        max_time_s=config.max_time_s or 0.0,
        lower=lower,
        upper=upper,
    )
    flying = _core.FlightVehicle(
        body,
        gains,
        plant_options(vehicle),
        plant=config.plant,
        interface=config.interface,
        max_rate_rad_s=vehicle.rates.max_rad_s,
        rate_time_constant_s=vehicle.rates.time_constant_s,
        max_acceleration_m_s2=vehicle.limits.max_acceleration_m_s2 or math.inf,
        assumed=assumed,
    )
    trials: list[TrialResult] = []
    flights: list[SplatFlightLog] = []
    seconds: list[tuple[NDArray[np.float32], NDArray[np.float32]]] = []
    for begin in range(0, len(references), _BATCH):
        batch = references[begin : begin + _BATCH]
        found = fly(
            safety_filter,
            flying,
            batch,
            rules,
            guide=guide,
            seed=config.seed,
            first_trial=begin,
            jobs=jobs,
            progress=_shifted(progress, begin, len(references)),
        )
        for i, (reference, flown) in enumerate(zip(batch, found, strict=True), begin):
            rows = reference.at(np.arange(len(flown.status) + 1, dtype=np.float64) * config.dt_s)
            followed = flown_plan if plan is not None else along(plans[i])
            trials.append(judge.trial(i, rows, goals[i], flown, config.dt_s, index, followed))
            flights.append(decimate(flown, config.dt_s, config.log_rate_hz))
            seconds.append((flown.filter_s[:: config.filter_ticks], flown.tick_s[:: config.filter_ticks]))
    return RunResult(
        filter=config.filter,
        vehicle=_describe(config, vehicle),
        trials=trials,
        summary=_summary(trials, sampled, safety_filter)
        | {"sigma": config.sigma, "inflation_m": inflation}
        | _certified(against, trials, hull_keep)
        | ({"notes": notes} if notes else {}),
        guarantee=_guarantee(config, vehicle, scene, cover, trials, inflation, hull_keep),
        flights=flights,
        map=found_in,
        filter_s=np.concatenate([pair[0] for pair in seconds]),
        tick_s=np.concatenate([pair[1] for pair in seconds]),
    )


def _peak_speed(plan: Artifact) -> float:
    return float(plan.manifest.speed_m_s)  # type: ignore[attr-defined]


def _shifted(progress: Progress | None, begin: int, total: int) -> Progress | None:
    """Progress of a batch as a part of the whole."""
    return None if progress is None else lambda done, _: progress(begin + done, total)


def _check_fit(found_in: Artifact, plan: Artifact | None, cover: Artifact | None) -> None:
    role = found_in.kind.name.removeprefix("alula/")
    require_metric(role, found_in)
    for other_role, other in (("plan", plan), ("cover", cover)):
        if other is not None and other.manifest.frame != found_in.manifest.frame:
            raise InputError(
                f"the {other_role} is in the frame {other.manifest.frame!r}, the {role} in "
                f"{found_in.manifest.frame!r}"
            )


def _room(
    points: FloatArray, references: list[_core.ReferenceCurve], dt_s: float
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """A box around the map's points and the references; a flight that leaves it is refused."""
    parts = [points]
    for curve in references:
        time = np.linspace(0, curve.duration_s, max(2, int(curve.duration_s / dt_s)))
        parts.append(curve.at(time)[:, :3])
    low = np.min([part.min(axis=0) for part in parts if len(part)], axis=0) - _ROOM_M
    high = np.max([part.max(axis=0) for part in parts if len(part)], axis=0) + _ROOM_M
    return tuple(low.tolist()), tuple(high.tolist())


def _describe(config: SimulateConfig, vehicle: Vehicle) -> str:
    guided = "" if config.guide == NO_FILTER else f", guided by {config.guide}"
    found = disturbances(vehicle)
    disturbed = f", with {', '.join(found)}" if found else ""
    assert config.radius_m is not None
    sphere = f"sphere of radius {exact(config.radius_m)} m"
    if config.plant == "double-integrator":
        return f"{vehicle.name}: {sphere}, double integrator{guided}{disturbed}"
    command = "thrust and torque" if config.interface == "wrench" else "thrust and body rates"
    assert vehicle.body.mass_kg is not None
    body = f"quadrotor of {exact(vehicle.body.mass_kg)} kg in a {sphere}"
    return f"{vehicle.name}: {body}, commanded by {command}{guided}{disturbed}"


def _summary(
    trials: list[TrialResult], sampled: dict[str, int], safety_filter: SafetyFilter | None
) -> dict[str, Any]:
    native = safety_filter is None or isinstance(safety_filter, NativeFilter)
    return {
        **head(trials, outcomes_of(trials)),
        "min_map_clearance_m": minimum(t.map_clearance_m for t in trials),
        "min_scene_clearance_m": minimum(t.scene_clearance_m for t in trials),
        "min_gamma": minimum(t.min_gamma for t in trials),
        "min_margin": minimum(t.min_margin for t in trials),
        "mean_path_ratio": mean_path_ratio(trials),
        "max_speed_m_s": max(t.max_speed_m_s for t in trials),
        "max_jerk_m_s3": max(t.max_jerk_m_s3 for t in trials),
        "mean_jerk_m_s3": mean(t.mean_jerk_m_s3 for t in trials),
        "peak_realisation_error_m_s2": max(t.peak_realisation_error_m_s2 or 0.0 for t in trials),
        **totals(trials, _COUNTED),
        **sampled,
        "filter_kind": "native" if native else "python filter",
    }


def _certified(against: str | None, trials: list[TrialResult], hull_radius_m: float) -> dict[str, Any]:
    """Fraction of the steps that a shield certified, and against what; nothing without a shield."""
    if against is None:
        return {}
    steps, certified = sum(t.steps for t in trials), sum(t.certified_steps or 0 for t in trials)
    kept = {} if against == ELLIPSOIDS else {"hull_radius_m": hull_radius_m}
    return {"certified_against": against, "certified_share": certified / steps, **kept}


def _guarantee(
    config: SimulateConfig,
    vehicle: Vehicle,
    scene: Artifact | None,
    cover: Artifact | None,
    trials: list[TrialResult],
    inflation_m: float,
    hull_radius_m: float,
) -> Guarantee:
    """State what the run shows, and in how many steps the filter proved a backup; the log has the steps."""
    hits = sum(t.collision for t in trials)
    steps, certified = sum(t.steps for t in trials), sum(t.certified_steps or 0 for t in trials)
    against = certified_against(config.filter, config.filter_parameters)
    sees_hulls = keeps_from_hulls(config.filter, config.filter_parameters, has_ellipsoids=scene is not None)
    chain = None
    if config.filter == NO_FILTER:
        beforehand = UNFILTERED
    elif certified:
        beforehand = certified_words(config, vehicle, certified, steps)
    else:
        beforehand = (
            f"The filter {config.filter!r} bounds the rate of a barrier at each step; it proves no flight."
        )
    if against not in (None, ELLIPSOIDS):
        assert cover is not None
        chain = chain_of(
            config, vehicle, cover, hull_radius_m=hull_radius_m, every_step_certified=certified == steps
        )
        beforehand += f" {chain['statement']}"
    if config.guide != NO_FILTER:
        beforehand += f" The guide {config.guide!r} only changes the nominal command; no proof depends on it."
    model = "double integrator" if config.plant == "double-integrator" else "quadrotor with rotor limits"
    source = scene or cover
    assert source is not None
    given = source.manifest.guarantee
    ellipsoids = f"the scene's ellipsoids at {level_words(config.sigma)}"
    judged, what, contains = {
        (True, False): (ellipsoids, "an ellipsoid", "its ellipsoids contain it"),
        (True, True): (f"{ellipsoids} and the cover's hulls", "an obstacle", "its ellipsoids contain it"),
        (False, True): ("the cover's hulls", "a hull", "the hulls contain it"),
    }[scene is not None, sees_hulls]
    return Guarantee(
        statement=statement(
            beforehand,
            f"afterwards over the whole path against {judged}",
            hits,
            len(trials),
            f"flights came closer to {what} than the radius",
            f"This holds for the simulated {model}, and for the real scene as far as {contains}.",
        ),
        claims={
            "proven_by_filter": False,
            **({} if scene is None else _scene_claims(trials)),
            **(_hull_claims(trials) if sees_hulls else {}),
            "certified_steps": certified,
            "steps": steps,
            "every_step_certified": certified == steps,
            "certified_against": against,
            "chain": chain,
            "shield": shield_of(config) if certified else {},
            "continuous_time": True,
            "path_sampling_s": min(_PLANT_STEP_S, config.dt_s),
            "sigma": config.sigma,
            "mass_fraction": mass_within(config.sigma),
            "inflation_m": inflation_m,
            "vehicle_model": model,
            ("cover_claims" if scene is None else "scene_claims"): given.claims if given is not None else {},
        },
    )


def _scene_claims(trials: list[TrialResult]) -> dict[str, Any]:
    hits = sum(is_collision(t.scene_clearance_m) for t in trials)
    return {"scene_clear": hits == 0, "scene_collisions": hits}


def _hull_claims(trials: list[TrialResult]) -> dict[str, Any]:
    hits = sum(is_collision(t.map_clearance_m) for t in trials)
    return {"hulls_clear": hits == 0, "hull_collisions": hits}
