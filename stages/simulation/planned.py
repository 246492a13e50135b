"""Plans for start-goal pairs: each pair is flown along its own plan instead of straight at its goal."""

from __future__ import annotations

import math

from alula.schemas.artifact import Artifact
from alula.schemas.configs.plan import PlanConfig
from alula.schemas.errors import InfeasibleError
from alula.schemas.progress import Progress
from alula.stages.planning.plan import plan
from alula.stages.simulation.pairs import Pairs


def plans_of(
    pairs: Pairs,
    cover: Artifact,
    *,
    radius_m: float,
    speed_m_s: float,
    jobs: int = 0,
    progress: Progress | None = None,
) -> list[Artifact | None]:
    """Plan each pair as `alula plan` does, with its defaults for everything but the radius and the speed.

    Args:
        pairs: starts and goals, world frame [m].
        cover: hulls to plan among.
        radius_m: minimum distance of the plans to every hull [m].
        speed_m_s: maximum speed of the plans [m/s].
        jobs: threads; the result does not depend on it.
        progress: called with (pairs planned, pairs).

    Returns:
        A plan per pair, with the heading from start to goal; None where the planner finds no way.
    """
    found: list[Artifact | None] = []
    for i, (start, goal) in enumerate(zip(pairs.start.tolist(), pairs.goal.tolist(), strict=True)):
        config = PlanConfig(
            start=tuple(start),
            goal=tuple(goal),
            radius_m=radius_m,
            speed_m_s=speed_m_s,
            yaw=repr(math.atan2(goal[1] - start[1], goal[0] - start[0])),
        )
        try:
            found.append(plan(config, cover, jobs=jobs))
        except InfeasibleError:
            found.append(None)
        if progress is not None:
            progress(i + 1, len(pairs.start))
    return found


def count_planned(plans: list[Artifact | None] | None) -> dict[str, int]:
    """Counts for the summary: pairs with a plan, and pairs without one, which are flown straight."""
    if plans is None:
        return {}
    without = sum(one is None for one in plans)
    return {"planned_pairs": len(plans) - without, "unplanned_pairs": without}
