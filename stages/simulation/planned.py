"""Plans for start-goal pairs: each pair is flown along its own plan instead of straight at its goal."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Literal, NamedTuple

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import InfeasibleError
from alula.schemas.parameters.configs.plan import PlanConfig
from alula.schemas.progress import Progress
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.planning.behind import Behind
from alula.stages.planning.plan import plan
from alula.stages.planning.space import Ellipsoids, plan_space
from alula.stages.simulation.pairs import Pairs
from alula.stages.world.obstacles import StaticWorld

_ROUNDING_M = 1e-6
_NAMED = 10  # maximum number of pairs that a note names


class PlanMaps(NamedTuple):
    """What plans keep away from."""

    cover: Artifact | None
    scene: Artifact | None
    within: Artifact | None  # seen space
    ellipsoids: Ellipsoids | None = None  # of the scene, where they have been made before


def plan_config(scenario: Scenario, world: StaticWorld, speed_m_s: float) -> PlanConfig:
    """Configuration of the plans, with the distance that filters keep as their radius."""
    table = scenario.vehicle
    followed: Literal["body-rates", "acceleration", "velocity"] = "body-rates"
    if table.autopilot and (table.interface == "velocity" or table.interface == "acceleration"):
        followed = table.interface
    return PlanConfig(
        radius_m=world.most_keep_m,
        speed_m_s=speed_m_s,
        sigma=world.sigma,
        interface=followed,
        beyond_map_m=scenario.mission.beyond_map_m,
    )


def margins(world: StaticWorld, pairs: Pairs, margin_m: float, jobs: int = 0) -> FloatArray:
    """Distance that the plan of each pair keeps beyond what filters keep, shape (N,) [m].

    Args:
        margin_m: to keep, where both ends of the pair have it [m].
    """
    cap = world.most_keep_m + margin_m + _ROUNDING_M
    ends = [world.clearance(each, each, cap, jobs) for each in (pairs.start, pairs.goal)]
    spare = np.minimum(*ends) - world.most_keep_m - _ROUNDING_M
    return np.clip(spare, 0.0, margin_m)


def plans_of(
    pairs: Pairs,
    maps: PlanMaps,
    *,
    vehicle: Vehicle,
    config: PlanConfig,
    margin_m: FloatArray,
    behind: Behind | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> list[Artifact | None]:
    """Plan each pair as `alula plan` does.

    Args:
        pairs: starts and goals, world frame [m].
        config: of the plans, but start, goal and heading; with the radius that filters keep.
        margin_m: distance to keep beyond it, of each pair, shape (N,) [m].
        behind: filters behind which they will be flown.

    Returns:
        A plan per pair, with the heading from start to goal; None where the planner finds no way.
    """
    found: list[Artifact | None] = []
    cover, scene, within, ellipsoids = maps
    space = plan_space(config, cover, scene, None, within, ellipsoids=ellipsoids, jobs=jobs)
    rows = zip(pairs.start.tolist(), pairs.goal.tolist(), margin_m.tolist(), strict=True)
    for i, (start, goal, margin) in enumerate(rows):
        own = dataclasses.replace(
            config,
            start=tuple(start),
            goal=tuple(goal),
            radius_m=config.keep_m + margin,
            yaw=repr(math.atan2(goal[1] - start[1], goal[0] - start[0])),
        )
        try:
            known: dict[str, Any] = {"vehicle": vehicle, "behind": behind, "space": space.kept(margin)}
            found.append(plan(own, cover, scene=scene, within=within, **known, jobs=jobs))
        except InfeasibleError:
            found.append(None)
        if progress is not None:
            progress(i + 1, len(pairs.start))
    return found


class Planned(NamedTuple):
    """The pairs that are flown, with their plans.

    Attributes:
        pairs: those with a plan, in their order.
        counts: for the summary: pairs with a plan, and without.
        notes: names the pairs without a plan, which are not flown; empty where there are none.
    """

    pairs: Pairs
    plans: list[Artifact | None]
    counts: dict[str, int]
    notes: list[str]


def planned_alone(pairs: Pairs, plans: list[Artifact | None]) -> Planned:
    """Leave out the pairs for which there is no plan: a flight straight at the goal is no planned flight.

    Args:
        plans: of each; None without one.

    Raises:
        InfeasibleError: no pair has a plan.
    """
    has = np.array([one is not None for one in plans])
    without = np.flatnonzero(~has).tolist()
    counts = {"planned_pairs": int(has.sum()), "unplanned_pairs": len(without)}
    if not without:
        return Planned(pairs, plans, counts, [])
    names = [
        f"pair {i} from ({_place(pairs.start[i])}) to ({_place(pairs.goal[i])})" for i in without[:_NAMED]
    ]
    names += [f"{len(without) - _NAMED} more"] * (len(without) > _NAMED)
    words = f"the planner found no way for {len(without)} of {len(plans)} pairs"
    if len(without) == len(plans):
        raise InfeasibleError(
            f"{words}: {'; '.join(names)}; choose others with mission.bounds_m or mission.goal_m, or fly "
            "straight without mission.planned"
        )
    kept = dataclasses.replace(pairs, start=pairs.start[has], goal=pairs.goal[has])
    note = f"{words}, which were not flown: {'; '.join(names)}"
    return Planned(kept, [one for one in plans if one is not None], counts, [note])


def _place(point: FloatArray) -> str:
    return " ".join(f"{value:.3f}" for value in point)
