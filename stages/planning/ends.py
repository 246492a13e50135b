"""Start and goal of a first plan through a map, chosen as a person would: in the open, above the ground."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import InfeasibleError
from alula.schemas.parameters.configs.plan import PlanConfig, Point
from alula.stages.planning.endpoints import free_points
from alula.stages.planning.plan import plan
from alula.stages.planning.space import PlanSpace

_CANDIDATES = (240, 60, 12, 4, 2)  # free points; fewer where there are no more
_TRIES = 12  # pairs of them that are planned
_DROPS_M = (3.0, 2.5, 2.0, 1.7, 1.4, 1.2, 1.0, 0.85, 0.7, 0.5, 0.3)  # from a point to where a vehicle stands
_ABOVE_M = (0.5, 2.0)  # comfortable heights above where it stands
_HEADROOM_M = 0.5  # that is free above a point which is not under a table
_LEVEL_M = 0.3  # by which two places to stand may differ in height and count as one ground


@dataclass(frozen=True, slots=True)
class Ends:
    """What a first plan needs.

    Attributes:
        start, goal: of the plan [m].
        stand: below the start, where a vehicle stands before it takes off [m].
        is_plain: both are at a comfortable height with room above.
    """

    start: Point
    goal: Point
    stand: Point
    is_plain: bool


def ends_of(config: PlanConfig, space: PlanSpace, cover: Artifact, *, jobs: int = 0) -> Ends:
    """Choose two free points far apart with a plan between them.

    Points come from `free_points`. Preferred are those 0.5 to 2 m above the ground that have 0.5 m of room
    above them, pairs whose places to stand are equally high, and then those that are far apart.

    Args:
        config: of the plan, with its radius.
        cover: the same.

    Raises:
        InfeasibleError: there is no free space, or no way between the points.
    """
    points = _candidates(config, space)
    drop = np.array([_reach(space, each, -1.0, _DROPS_M) for each in points])
    open_above = np.array([_reach(space, each, 1.0, (_HEADROOM_M,)) > 0 for each in points])
    low, high = _ABOVE_M
    is_good = open_above & (drop >= low) & (drop <= high)
    ground = points[:, 2] - drop

    first, second = np.nonzero(~np.eye(len(points), dtype=bool))
    poor = (~is_good).astype(int)
    away = points[first, :2] - points[second, :2]
    distance = np.sqrt(away[:, None, :] @ away[:, :, None])[:, 0, 0]
    uneven = np.abs(ground[first] - ground[second]) > _LEVEL_M
    worse = poor[first] + poor[second] + 2 * (drop[first] == 0)
    best = np.lexsort((-distance, uneven, worse))[:_TRIES]
    failure: InfeasibleError | None = None
    for a, b in zip(first[best], second[best], strict=True):
        start, goal = _point(points[a]), _point(points[b])
        try:
            plan(dataclasses.replace(config, start=start, goal=goal), cover, space=space, jobs=jobs)
        except InfeasibleError as error:
            failure = error
            continue
        stand = _point(points[a] - (0.0, 0.0, drop[a]))
        return Ends(start, goal, stand, bool(is_good[a] and is_good[b]))
    raise InfeasibleError(f"no way between free points was found: {failure}")


def _candidates(config: PlanConfig, space: PlanSpace) -> FloatArray:
    for count in _CANDIDATES:
        try:
            return free_points(config, space, count)
        except InfeasibleError:
            continue
    raise InfeasibleError(f"no free space was found for a ball of {space.keep_m:g} m in the mapped box")


def _reach(space: PlanSpace, point: FloatArray, way: float, lengths: tuple[float, ...]) -> float:
    """The largest of some lengths that a ball can go up or down from a point and stay free [m]; or 0."""
    start = np.repeat(point[None], len(lengths), axis=0)
    end = start + np.array([[0.0, 0.0, way * each] for each in lengths])
    clear = space.map.is_clear(start, end, space.keep_m)
    return max((each for each, is_clear in zip(lengths, clear, strict=True) if is_clear), default=0.0)


def _point(values: FloatArray) -> Point:
    x, y, z = (round(float(value), 3) for value in values)
    return x, y, z
