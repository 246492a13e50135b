"""References of flights among ellipsoids: a plan, random pairs, or the pairs of another run."""

from __future__ import annotations

import math

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifact import Artifact
from alula.schemas.configs.simulate import SimulateConfig
from alula.schemas.progress import Progress
from alula.stages.planning.rest_to_rest import rest_to_rest
from alula.stages.simulation.ellipsoids.judge import SplatJudge
from alula.stages.simulation.pairs import Pairs, central_box, check_clear, sample_pairs
from alula.stages.simulation.planned import count_planned, plans_of


def references_of(
    config: SimulateConfig,
    centres: FloatArray,
    plan: Artifact | None,
    given: Pairs | None,
    judge: SplatJudge,
    keep_m: float,
    cover: Artifact | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> tuple[list[_core.ReferenceCurve], list[Artifact | None], FloatArray, dict[str, int]]:
    """Make the reference curves, their plans and goals, and the counts of sampled points and pairs.

    The goal of a pair is the drawn one, not the end of its curve, as the rounding of the latter depends on
    the speed.

    Args:
        config: see `SimulateConfig`, resolved.
        centres: of the Gaussians, or vertices of the hulls, shape (N, 3), world frame [m].
        plan: the `alula/plan` to fly, if any.
        given: pairs to fly instead of random ones.
        judge: clearances to the obstacles.
        keep_m: radius of the vehicle with its inflation [m].
        cover: plan each pair among its hulls at the distance `keep_m`; pairs without a plan stay straight.
        jobs: threads; the result does not depend on it.
        progress: called with (pairs planned, pairs).

    Returns:
        N curves, N plans (None for a straight curve), goals of shape (N, 3) in the world frame [m], and the
        counts by the keys of the summary.

    Raises:
        UsageError: a given start or goal is closer to an obstacle than `keep_m`, or there are no bounds.
        InfeasibleError: no clear pairs were found.
    """
    if plan is not None:
        curve = _curve(plan)
        return [curve], [plan], curve.at(np.array([curve.duration_s]))[:, :3], {}
    assert config.speed_m_s is not None
    if given is not None:
        check_clear(given, lambda points: np.asarray(judge.distance(points, keep_m) >= keep_m))
    pairs = _sampled(config, centres, judge, keep_m) if given is None else given
    plans: list[Artifact | None] | None = None
    if cover is not None:
        plans = plans_of(
            pairs, cover, radius_m=keep_m, speed_m_s=config.speed_m_s, jobs=jobs, progress=progress
        )
    flown: list[Artifact | None] = [None] * len(pairs.start) if plans is None else plans
    curves = [
        _core.ReferenceCurve(*rest_to_rest(start, goal, config.speed_m_s, yaw_rad=_heading(goal - start)))
        if own is None
        else _curve(own)
        for start, goal, own in zip(pairs.start, pairs.goal, flown, strict=True)
    ]
    blocked = {"blocked_pairs": int(judge.is_blocked(pairs.start, pairs.goal, keep_m).sum())}
    blocked |= count_planned(plans)
    if given is not None:
        return curves, flown, pairs.goal, blocked
    return (
        curves,
        flown,
        pairs.goal,
        blocked
        | {
            "sampled_points": pairs.sampled,
            "sampled_inside_ellipsoids": pairs.sampled_inside_hulls,
            "sampled_pairs": pairs.candidates,
        },
    )


def _curve(plan: Artifact) -> _core.ReferenceCurve:
    time, coefficient = (np.ascontiguousarray(plan[name], np.float64) for name in ("time", "coefficient"))
    return _core.ReferenceCurve(time, coefficient)


def _sampled(config: SimulateConfig, centres: FloatArray, judge: SplatJudge, keep_m: float) -> Pairs:
    assert config.trials is not None
    lower, upper = central_box(centres, config.bounds, "Gaussians" if judge.scene is not None else "hulls")
    needed = keep_m + config.margin_m
    return sample_pairs(
        config.trials,
        config.seed,
        (lower, upper),
        config.separation * float(np.linalg.norm(upper - lower)),
        lambda points: judge.distance(points, needed),
        lambda _, distance: np.asarray(distance >= needed),
        (lambda start, goal: judge.is_blocked(start, goal, keep_m)) if config.pairs == "blocked" else None,
    )


def _heading(direction: FloatArray) -> float:
    return math.atan2(direction[1], direction[0])
