"""Simulation of flights in a cover behind a safety filter, and their judgement against cover and scene."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifact import Artifact
from alula.schemas.configs.simulate import DEFAULT_RADIUS_M, DEFAULT_SPEED_M_S, SimulateConfig
from alula.schemas.decimals import at_least, at_most, exact
from alula.schemas.errors import InputError, UsageError
from alula.schemas.manifest import Guarantee
from alula.schemas.progress import Progress
from alula.schemas.run import TrialResult
from alula.schemas.vehicle import Vehicle
from alula.stages.clearance import (
    hull_obstacles,
    is_collision,
    path_metrics,
    scene_obstacles,
    segment_clearance,
    sphere_clearance,
)
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.compression.verify import require_solid_hulls
from alula.stages.filtering.bridge import NativeFilter
from alula.stages.filtering.obstacles import require_metric
from alula.stages.filtering.polytope_cbf import barrier, without_filter
from alula.stages.filtering.protocol import FilterStatus, FilterWorld, SafetyFilter
from alula.stages.filtering.registry import make_filter
from alula.stages.planning.adherence import PlanJudge, outcome_of_plan, require_room, via_tolerance
from alula.stages.planning.plan_samples import NO_REFERENCE, Reference, sample_plan
from alula.stages.progress import share
from alula.stages.simulation.hulls.closed_loop import Flown, fly
from alula.stages.simulation.pairs import Pairs, central_box, check_clear, sample_pairs
from alula.stages.simulation.planned import count_planned, plans_of
from alula.stages.simulation.result import FlightLog, RunResult, logged_ticks, outcomes_of
from alula.stages.verdict import UNFILTERED, head, mean_path_ratio, minimum, statement, totals

_BATCH = 64  # trials whose full-rate samples are in memory at once
_STUCK_STEPS = 100
_STUCK_FRACTION = 1e-3  # of the speed limit
_PLAN_SPEED_FACTOR = 1.5  # leaves room to catch up with the plan
_EXTRA_TIME_S = 10.0
_PLANNED_RADII = 6  # plans keep to a box around the hulls that is 3 radii larger


def resolve(config: SimulateConfig, plan: Artifact | None, vehicle: Vehicle | None = None) -> SimulateConfig:
    """Complete the configuration from the vehicle, the plan or defaults.

    Args:
        config: see `SimulateConfig`.
        plan: the `alula/plan` to fly, if any.
        vehicle: a single integrator, if a file is given.

    Raises:
        UsageError: a number of trials is given with a plan, which is flown once; a gain is too high for the
            time step; the vehicle is no single integrator, or slower than the given speed.
    """
    config.check_gains()
    radius, speed = DEFAULT_RADIUS_M, DEFAULT_SPEED_M_S
    if plan is not None:
        if config.planned:
            raise UsageError("--planned is for start-goal pairs; a plan is flown as it is")
        if config.trials not in (None, 1):
            raise UsageError("--trials is for random pairs; a plan is flown once")
        radius = float(plan.manifest.radius_m - plan.manifest.margin_m)  # type: ignore[attr-defined]
        speed = _PLAN_SPEED_FACTOR * float(plan.manifest.speed_m_s)  # type: ignore[attr-defined]
    if vehicle is not None:
        if vehicle.model != "single-integrator":
            raise UsageError(
                f"{vehicle.name} is a {vehicle.model}, which flies among the ellipsoids of a scene, "
                "not among hulls"
            )
        limit = vehicle.limits.max_speed_m_s
        assert limit is not None
        if config.speed_m_s is not None and config.speed_m_s > limit:
            raise UsageError(f"--speed {config.speed_m_s:g}: {vehicle.name} flies at most {limit:g} m/s")
        radius, speed = vehicle.body.radius_m, limit
    return dataclasses.replace(
        config,
        radius_m=radius if config.radius_m is None else config.radius_m,
        speed_m_s=speed if config.speed_m_s is None else config.speed_m_s,
        trials=(100 if plan is None else 1) if config.trials is None else config.trials,
    )


def simulate(
    config: SimulateConfig,
    cover: Artifact,
    *,
    plan: Artifact | None = None,
    scene: Artifact | None = None,
    vehicle: Vehicle | None = None,
    given: Pairs | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> RunResult:
    """Fly random or given start-goal pairs, or a plan, and judge each flight afterwards.

    With `planned`, each pair follows a plan of its own, made among the hulls with the radius of the vehicle;
    else the nominal controller flies straight at the goal, and the filter alone, which sees no way around an
    obstacle, ends most flights in a room in front of one.

    The vehicle is a single integrator x' = u with exact state, under the nominal controller of eq. 16 and the
    filter. Every flight is judged independently of the filter: exact signed Euclidean distance of the
    continuous path to the hulls and, with a scene, to its ellipsoids at the cover's sigma, minus the
    vehicle's radius. A success is a flight that reached its goal without collision.

    Args:
        config: see `SimulateConfig`.
        cover: map of the filter.
        plan: flown instead of random pairs.
        scene: metric scene in the cover's frame; starts and goals also keep clear of its ellipsoids.
        vehicle: a single integrator; its radius and speed limit replace the defaults.
        given: pairs flown instead of random ones.
        jobs: threads, 0 for all processors; only measured times depend on it.
        progress: called with (trials done, trials).

    Raises:
        ArtifactError: planes and vertices of the cover do not describe the same polytopes.
        UsageError: the filter is unknown, a parameter does not apply, the vehicle is of the wrong model, or a
            given start or goal is not clear of the map.
        InputError: scene or plan do not fit the cover.
        InfeasibleError: no clear start-goal pairs were found.

    Source: PolyMerge (arXiv 2606.16232), section VI-A.
    """
    config = resolve(config, plan, vehicle)
    assert config.radius_m is not None
    assert config.speed_m_s is not None
    assert config.trials is not None
    _check_fit(cover, "scene", scene)
    _check_fit(cover, "plan", plan)
    require_solid_hulls(cover, jobs=jobs)
    hulls = Hulls.from_cover(cover)
    judge = _Judge(hulls, scene, float(cover.manifest.sigma), config.radius_m, jobs)  # type: ignore[attr-defined]
    reference = NO_REFERENCE if plan is None else sample_plan(plan, config.dt_s)
    flown_plan = None if plan is None else judge.of_plan(plan, config)
    notes = (
        []
        if flown_plan is None
        else require_room(flown_plan, [config.radius_m], config.filter, allow_tight=config.allow_tight)
    )
    corners = hulls.vertices_world
    if given is not None and len(corners) == 0:
        corners = np.concatenate([given.start, given.goal])
    bounds = None if plan is not None else central_box(corners, config.bounds, "hulls")
    world = FilterWorld(
        hulls=hulls,
        radius_m=config.radius_m,
        speed_m_s=config.speed_m_s,
        dt_s=config.dt_s,
        extent_m=_extent(hulls, bounds, reference, given)
        + (_PLANNED_RADII if config.planned else 1) * config.radius_m
        + config.speed_m_s,
        image=encode_map(cover, indexed=True, jobs=jobs) if config.onboard else b"",
    )
    parameters = _filter_parameters(config)
    safety_filter = make_filter(config.filter, world, parameters) or without_filter(world, parameters)
    if safety_filter.kind != "velocity":
        raise UsageError(
            f"{config.filter} gives {safety_filter.kind} commands; a point is moved by velocities"
        )
    psi = barrier(world).psi
    if flown_plan is not None and config.filter == "polytope-cbf":
        lowest = float(psi(reference.position_world, jobs=jobs)[0].min(initial=math.inf))
        if lowest < config.radius_m and not notes:
            notes = [
                f"psi falls to {at_least(lowest)} m along the plan, below the radius: near edges the "
                "filter may hold the vehicle back"
            ]
    if bounds is None:
        ends = reference.position_world[[0, -1]]
        pairs = Pairs(ends[:1], ends[1:], 0, 0)
        allowed_s = (len(reference.position_world) - 1) * config.dt_s + _EXTRA_TIME_S
    else:
        diagonal = float(np.linalg.norm(bounds[1] - bounds[0]))
        allowed_s = 5 * diagonal / config.speed_m_s + _EXTRA_TIME_S
    if given is not None:
        pairs = given
        check_clear(pairs, lambda points: judge.is_clear(points, psi(points, jobs=jobs)[1], 0.0))
    elif bounds is not None:
        pairs = sample_pairs(
            config.trials,
            config.seed,
            bounds,
            config.separation * diagonal,
            lambda points: psi(points, jobs=jobs)[1],
            lambda points, hard: judge.is_clear(points, hard, config.margin_m),
        )

    def rules_of(time_s: float) -> _core.TrialRules:
        assert config.speed_m_s is not None
        return _core.TrialRules(
            dt_s=config.dt_s,
            gain=config.gain,
            v_max=config.speed_m_s,
            stop_fraction=config.stop_fraction,
            stuck_speed=_STUCK_FRACTION * config.speed_m_s,
            stuck_steps=_STUCK_STEPS,
            max_steps=math.ceil(time_s / config.dt_s),
        )

    rules = rules_of(config.max_time_s or allowed_s)
    plans = None
    if config.planned:
        planning, progress = share(progress, 0, 0.5), share(progress, 0.5, 1)
        speed = config.speed_m_s / _PLAN_SPEED_FACTOR
        plans = plans_of(
            pairs, cover, radius_m=config.radius_m, speed_m_s=speed, jobs=jobs, progress=planning
        )
    start_margin_m = psi(np.ascontiguousarray(pairs.start), jobs=jobs)[1] - config.radius_m
    trials: list[TrialResult] = []
    flights: list[FlightLog] = []
    seconds: list[NDArray[np.float32]] = []
    step = _BATCH if plans is None else 1
    for begin in range(0, len(pairs.start), step):
        end = min(begin + step, len(pairs.start))
        mine, limits, along = reference, rules, flown_plan
        if plans is not None and (own := plans[begin]) is not None:
            mine, along = sample_plan(own, config.dt_s), judge.of_plan(own, config)
            planned_s = (len(mine.position_world) - 1) * config.dt_s + _EXTRA_TIME_S
            limits = rules_of(config.max_time_s or planned_s)
        batch = fly(safety_filter, pairs.start[begin:end], pairs.goal[begin:end], limits, mine, jobs=jobs)
        for index, flown in enumerate(batch, begin):
            margin = float(start_margin_m[index])
            trials.append(judge.trial(index, pairs.goal[index], flown, config.dt_s, margin, along))
            flights.append(_decimate(flown, config.dt_s, config.log_rate_hz))
            seconds.append(flown.filter_s)
            if progress is not None:
                progress(index + 1, len(pairs.start))
    named = "" if vehicle is None else f"{vehicle.name}: "
    return RunResult(
        filter=config.filter,
        vehicle=f"{named}sphere of radius {exact(config.radius_m)} m, single integrator up to "
        f"{exact(config.speed_m_s)} m/s",
        trials=trials,
        summary=_summary(trials, pairs, safety_filter, notes) | count_planned(plans),
        guarantee=_guarantee(config, cover, trials),
        flights=flights,
        map=cover,
        filter_s=np.concatenate(seconds),
    )


class _Judge:
    """Clearances of the vehicle's sphere to the hulls and to the scene."""

    def __init__(
        self, hulls: Hulls, scene: Artifact | None, sigma: float, radius_m: float, jobs: int
    ) -> None:
        self.hulls = hull_obstacles(hulls)
        self.scene = None if scene is None else scene_obstacles(scene, sigma)
        self.radius_m = radius_m
        self.jobs = jobs

    def is_clear(self, points: FloatArray, psi: FloatArray, margin_m: float) -> NDArray[np.bool_]:
        """Find the points that are clear of the hulls and of the ellipsoids.

        Args:
            points: shape (M, 3), world frame [m].
            psi: psi of the hulls there, shape (M,) [m].
            margin_m: clearance beyond the radius [m].

        Returns:
            Shape (M,).
        """
        needed = self.radius_m + margin_m
        clear = np.asarray(psi >= needed)
        if self.scene is not None and clear.any():
            candidates = np.ascontiguousarray(points[clear])
            distance = segment_clearance(candidates, candidates, self.scene, self.jobs, needed)
            clear[clear] = distance >= needed
        return clear

    def of_plan(self, plan: Artifact, config: SimulateConfig) -> PlanJudge:
        """Make the judge of flights along a plan.

        Args:
            plan: in the cover's frame.
            config: with the tolerance of via points.
        """
        tolerance = via_tolerance(config.via_tolerance_m, self.radius_m)
        return PlanJudge(plan, [self.hulls], self.radius_m, tolerance, self.jobs)

    def trial(
        self,
        index: int,
        goal: FloatArray,
        flown: Flown,
        dt_s: float,
        start_margin_m: float,
        along: PlanJudge | None = None,
    ) -> TrialResult:
        """Judge one flight.

        Args:
            index: number of the trial.
            goal: shape (3,), world frame [m].
            flown: the flight.
            dt_s: duration of a step [s].
            start_margin_m: psi - radius at the start [m].
            along: of the plan that it flew, if any.
        """
        followed = None if along is None else along.result(flown.position)
        path = path_metrics(flown.position, dt_s)
        map_clearance, scene_clearance = (
            None
            if obstacles is None
            else sphere_clearance(flown.position, obstacles, self.radius_m, jobs=self.jobs)
            for obstacles in (self.hulls, self.scene)
        )
        count = np.bincount(flown.status, minlength=len(FilterStatus))
        steps = len(flown.status)
        start = flown.position[0]
        return TrialResult(
            index=index,
            start_m=start.tolist(),
            goal_m=goal.tolist(),
            outcome=outcome_of_plan(flown.outcome, followed),
            collision=is_collision(map_clearance, scene_clearance),
            steps=steps,
            duration_s=steps * dt_s,
            path_length_m=path.length_m,
            straight_length_m=float(np.linalg.norm(goal - start)),
            map_clearance_m=map_clearance,
            scene_clearance_m=scene_clearance,
            max_speed_m_s=path.max_speed_m_s,
            filtered_steps=int(count[1:].sum()),
            shortened_steps=int(count[FilterStatus.SHORTENED]),
            infeasible_steps=int(count[FilterStatus.REFUSED]),
            fallback_steps=int(count[FilterStatus.RECOVERING]),
            mean_jerk_m_s3=path.mean_jerk_m_s3,
            max_jerk_m_s3=path.max_jerk_m_s3,
            start_margin_m=start_margin_m if math.isfinite(start_margin_m) else None,
            plan=followed,
        )


def _unsafe_starts(trials: list[TrialResult]) -> list[float]:
    """Margins psi - radius of the trials that violate the filter's start condition [m]."""
    return [m for trial in trials if (m := trial.start_margin_m) is not None and m < 0]


def _check_fit(cover: Artifact, role: str, other: Artifact | None) -> None:
    if other is None:
        return
    have, need = other.manifest, cover.manifest
    require_metric(role, other)
    if have.frame != need.frame:
        raise InputError(f"the {role} is in the frame {have.frame!r}, the cover in {need.frame!r}")


def _extent(
    hulls: Hulls, bounds: tuple[FloatArray, FloatArray] | None, reference: Reference, given: Pairs | None
) -> float:
    """Twice the largest coordinate that is known beforehand; a flight that exceeds it is refused."""
    ends = () if given is None else (given.start, given.goal)
    parts = [hulls.vertices_world, reference.position_world, *(bounds or ()), *ends]
    return 2 * max(float(np.abs(part).max(initial=0.0)) for part in parts)


def _filter_parameters(config: SimulateConfig) -> dict[str, Any]:
    if config.filter == "polytope-cbf":
        return {"beta": config.beta, "kappa_per_m": config.kappa_per_m, "smoothing": config.smoothing}
    return dict(config.filter_parameters)


def _decimate(flown: Flown, dt_s: float, rate_hz: float) -> FlightLog:
    steps = len(flown.status)
    sample = logged_ticks(steps, dt_s, rate_hz)
    held = np.minimum(sample, steps - 1)
    return FlightLog(
        time_s=sample.astype(np.float64) * dt_s,
        position=flown.position[sample],
        velocity=flown.u[held],
        u_nom=flown.u_nom[held],
        margin=flown.margin[held],
        status=flown.status[held],
    )


def _summary(
    trials: list[TrialResult], pairs: Pairs, safety_filter: SafetyFilter, notes: list[str]
) -> dict[str, Any]:
    unsafe = _unsafe_starts(trials)
    summary = {
        **head(trials, outcomes_of(trials)),
        "min_map_clearance_m": minimum(t.map_clearance_m for t in trials),
        "min_scene_clearance_m": minimum(t.scene_clearance_m for t in trials),
        "mean_path_ratio": mean_path_ratio(trials),
        **totals(
            trials, ("steps", "filtered_steps", "shortened_steps", "infeasible_steps", "fallback_steps")
        ),
        "sampled_points": pairs.sampled,
        "sampled_inside_hulls": pairs.sampled_inside_hulls,
        "filter_kind": "native" if isinstance(safety_filter, NativeFilter) else "python filter",
        "unsafe_starts": len(unsafe),
    }
    if unsafe:
        notes = [
            *notes,
            f"{len(unsafe)} of {len(trials)} flights began with psi below the radius, by up to "
            f"{at_most(-min(unsafe))} m: the filter guaranteed nothing for them",
        ]
    return summary | ({"notes": notes} if notes else {})


def _guarantee(config: SimulateConfig, cover: Artifact, trials: list[TrialResult]) -> Guarantee:
    """State what the run shows and, for the sound filter, what is proven; both relative to the cover."""
    hits = sum(is_collision(t.map_clearance_m) for t in trials)
    unsafe = _unsafe_starts(trials)
    proven = config.filter == "polytope-cbf" and config.smoothing == "sound"
    if proven:
        beforehand = (
            "From every start with psi >= radius, the filter keeps psi >= radius at every sample and, by "
            "clipping each held step against every hull, between samples; psi never exceeds the distance "
            "to a hull."
        )
        if unsafe:
            beforehand += (
                f" {len(unsafe)} of {len(trials)} starts violated this condition, by up to "
                f"{at_most(-min(unsafe))} m; for them nothing was guaranteed beforehand."
            )
    elif config.filter == "none":
        beforehand = UNFILTERED
    elif config.filter == "polytope-cbf":
        beforehand = "UNSAFE: the smoothing as printed may exceed the true barrier and steps are not checked."
    else:
        beforehand = f"alula does not check what the filter {config.filter!r} guarantees."
    given = cover.manifest.guarantee
    return Guarantee(
        statement=statement(
            beforehand,
            "afterwards over the continuous path against the cover's hulls",
            hits,
            len(trials),
            "flights came closer to a hull than the radius",
            "This holds for a velocity-controlled point with exact state, and for the real scene only as far "
            "as the cover contains it.",
        ),
        claims={
            "proven_by_filter": proven and not unsafe,
            "start_condition": "psi >= radius",
            "unsafe_starts": len(unsafe),
            "map_clear": hits == 0,
            "map_collisions": hits,
            "continuous_time": True,
            "vehicle_model": "single integrator, exact state, input held for dt",
            "cover_claims": given.claims if given is not None else {},
        },
    )
