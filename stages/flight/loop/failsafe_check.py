"""Pre-flight check: what the vehicle does by itself in an emergency must not meet the map."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from alula._core import EllipsoidSet, PolytopeSet
from alula.schemas.arrays import FloatArray
from alula.stages.clearance import segment_clearance
from alula.stages.flight.links.own_safety import Action, OwnSafety


class Meeting(NamedTuple):
    """Where a way home comes closest to the map.

    Attributes:
        distance_m: distance to the obstacle [m].
        name: of the obstacle.
        at: where on the plan the way begins, shape (3,), world frame [m].
        height_m: height of its level part above the take-off position [m].
    """

    distance_m: float
    name: str
    at: FloatArray
    height_m: float


def closest_way_home(
    own: OwnSafety,
    path: FloatArray,
    home: FloatArray,
    obstacles: Sequence[tuple[str, PolytopeSet | EllipsoidSet]],
    *,
    radius_m: float,
    foot_m: float,
) -> Meeting:
    """Closest approach to the map of the ways home from all points of a path where the vehicle fits.

    Args:
        own: of the vehicle.
        path: shape (T, 3), world frame, z up [m].
        home: take-off position, shape (3,), world frame [m].
        obstacles: by name, world frame.
        radius_m: radius of the vehicle; points closer to an obstacle are left out [m].
        foot_m: the last part of the way down, to leave out the ground [m].
    """
    fits = np.ones(len(path), bool)
    for _, each in obstacles:
        fits &= segment_clearance(path, path, each, jobs=1) >= radius_m
    path = path[fits]
    if len(path) == 0:
        return Meeting(math.inf, "", home, 0.0)
    away = np.hypot(path[:, 0] - home[0], path[:, 1] - home[1])
    level_m = own.way_home.heights(path[:, 2] - home[2], away)
    above = path.copy()
    above[:, 2] = home[2] + level_m
    over = np.column_stack([np.full(len(path), home[0]), np.full(len(path), home[1]), above[:, 2]])
    down = over.copy()
    down[:, 2] = np.minimum(over[:, 2], home[2] + foot_m)
    found = Meeting(math.inf, "", path[0], float(level_m[0]))
    for name, each in obstacles:
        distance = (
            segment_clearance(
                np.concatenate([path, above, over]), np.concatenate([above, over, down]), each, jobs=1
            )
            .reshape(3, -1)
            .min(axis=0)
        )
        worst = int(distance.argmin())
        if distance[worst] < found.distance_m:
            found = Meeting(float(distance[worst]), name, path[worst], float(level_m[worst]))
    return found


def failsafe_faults(
    own: OwnSafety,
    path: FloatArray,
    home: FloatArray,
    obstacles: Sequence[tuple[str, PolytopeSet | EllipsoidSet]],
    *,
    radius_m: float,
    foot_m: float,
) -> tuple[list[str], str]:
    """What is wrong with the vehicle's failsafes and fence for a flight.

    Args:
        own: of the vehicle.
        path: points of the plan, shape (T, 3), world frame, z up [m].
        home: take-off position, shape (3,), world frame [m].
        obstacles: by name, world frame.
        radius_m: radius of the vehicle [m].
        foot_m: the last part of the way down, to leave out the ground [m].

    Returns:
        A sentence for each fault; and what was found if there is none.
    """
    faults = [f"the vehicle does not report {name}" for name in own.unknown]
    above_m = float((path[:, 2] - home[2]).max())
    away_m = float(np.hypot(path[:, 0] - home[0], path[:, 1] - home[1]).max())
    if above_m >= own.highest_m or away_m >= own.farthest_m:
        faults.append(
            f"the plan leaves the vehicle's own fence ({own.fence}): it goes {above_m:.1f} m up and "
            f"{away_m:.1f} m away; widen or disable that fence"
        )
    for each in own.failsafes:
        if each.action is Action.RETRACE:
            faults.append(
                f"{each.setting}: when {each.cause} it flies back along a simplified way (SmartRTL), which "
                f"cannot be judged; set {each.lands} so that it lands where it is"
            )
    returning = [each for each in own.failsafes if each.action is Action.RETURN]
    if not returning:
        return faults, "none of them flies home"
    met = closest_way_home(own, path, home, obstacles, radius_m=radius_m, foot_m=foot_m)
    if not met.distance_m >= radius_m:
        x, y, z = met.at
        causes = " or ".join(f"{each.cause} ({each.setting})" for each in returning)
        meets = f"meets {met.name}" if met.distance_m <= 0 else f"is {met.distance_m:.2f} m from {met.name}"
        faults.append(
            f"when {causes} it flies home {met.height_m:.1f} m above the take-off "
            f"({own.way_home.setting}); from ({x:.1f} {y:.1f} {z:.1f}) that {meets}, and "
            f"{radius_m:.3f} m are required; set {' and '.join(each.lands for each in returning)} so that "
            "it lands where it is"
        )
    clear = (
        "clear of everything" if math.isinf(met.distance_m) else f"{met.distance_m:.2f} m clear of the map"
    )
    return faults, f"ways home from all of the plan are {clear}"
