"""Pre-flight check: what the vehicle does by itself in an emergency must not meet the map."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from alula._core import EllipsoidSet, PolytopeSet
from alula.schemas.arrays import FloatArray
from alula.stages.clearance import segment_clearance
from alula.stages.flight.links.own_safety import Action, OwnSafety

_COASTED = (0.0, 0.5, 1.0)  # parts of the way to rest from which ways home are judged


class Meeting(NamedTuple):
    """Where a way home comes closest to the map.

    Attributes:
        distance_m: distance to the obstacle [m].
        name: of the obstacle.
        at: where on the plan the vehicle turns home, shape (3,), world frame [m].
        height_m: height of the level part above the take-off position [m].
        coast_m: how far it flies on before the way begins [m].
    """

    distance_m: float
    name: str
    at: FloatArray
    height_m: float
    coast_m: float = 0.0


def coasts(path: FloatArray, step_s: float, limit_m_s: float, stop_m: Callable[[float], float]) -> FloatArray:
    """Way to rest from each point of a path, along its direction there, shape (T, 3) [m].

    A vehicle that catches up with its path flies faster than the path, in proportion, up to the limit.

    Args:
        path: points at equal intervals, shape (T, 3) [m].
        step_s: interval [s].
        limit_m_s: limit of the speed [m/s].
        stop_m: distance of a stop from a speed.
    """
    if len(path) < 2:
        return np.zeros_like(path)
    velocity = np.gradient(path, step_s, axis=0)
    speed = np.linalg.norm(velocity, axis=1)
    faster = max(1.0, limit_m_s / max(float(speed.max()), 1e-9))
    flown = np.minimum(speed * faster, limit_m_s)
    distance = np.array([stop_m(each) for each in flown.tolist()])
    found: FloatArray = velocity * (distance / np.maximum(speed, 1e-9))[:, None]
    return found


def closest_way_home(
    own: OwnSafety,
    path: FloatArray,
    home: FloatArray,
    obstacles: Sequence[tuple[str, PolytopeSet | EllipsoidSet]],
    *,
    radius_m: float,
    foot_m: float,
    coast: FloatArray | None = None,
) -> Meeting:
    """Closest approach to the map of the ways home from all points of a path where the vehicle fits.

    The vehicle first flies on to rest, and may turn home from there, from half the way, and at once.

    Args:
        own: of the vehicle.
        path: shape (T, 3), world frame, z up [m].
        home: take-off position, shape (3,), world frame [m].
        obstacles: by name, world frame.
        radius_m: radius of the vehicle; points closer to an obstacle are left out [m].
        foot_m: the last part of the way down, to leave out the ground [m].
        coast: ways to rest from the points, shape (T, 3) [m]; None if the vehicle rests at once.
    """
    fits = np.ones(len(path), bool)
    for _, each in obstacles:
        fits &= segment_clearance(path, path, each, jobs=1) >= radius_m
    coast = np.zeros((int(fits.sum()), 3)) if coast is None else coast[fits]
    path = path[fits]
    if len(path) == 0:
        return Meeting(math.inf, "", home, 0.0)
    parts = _COASTED if coast.any() else (0.0,)
    rests = np.concatenate([path + part * coast for part in parts])
    path = np.tile(path, (len(parts), 1))
    away = np.hypot(rests[:, 0] - home[0], rests[:, 1] - home[1])
    level_m = own.way_home.heights(rests[:, 2] - home[2], away)
    above = rests.copy()
    above[:, 2] = home[2] + level_m
    over = np.column_stack([np.full(len(path), home[0]), np.full(len(path), home[1]), above[:, 2]])
    down = over.copy()
    down[:, 2] = np.minimum(over[:, 2], home[2] + foot_m)
    begins = np.concatenate([path, rests, above, over])
    ends = np.concatenate([rests, above, over, down])
    found = Meeting(math.inf, "", path[0], float(level_m[0]))
    for name, each in obstacles:
        distance = segment_clearance(begins, ends, each, jobs=1).reshape(4, -1).min(axis=0)
        worst = int(distance.argmin())
        if distance[worst] < found.distance_m:
            coast_m = float(np.linalg.norm(rests[worst] - path[worst]))
            found = Meeting(float(distance[worst]), name, path[worst], float(level_m[worst]), coast_m)
    return found


def failsafe_faults(
    own: OwnSafety,
    path: FloatArray,
    home: FloatArray,
    obstacles: Sequence[tuple[str, PolytopeSet | EllipsoidSet]],
    *,
    radius_m: float,
    foot_m: float,
    coast: FloatArray | None = None,
) -> tuple[list[str], str]:
    """What is wrong with the vehicle's failsafes and fence for a flight.

    Args:
        own: of the vehicle.
        path: points of the plan, shape (T, 3), world frame, z up [m].
        home: take-off position, shape (3,), world frame [m].
        obstacles: by name, world frame.
        radius_m: radius of the vehicle [m].
        foot_m: the last part of the way down, to leave out the ground [m].
        coast: ways to rest from the points of the plan, shape (T, 3) [m]; None if the vehicle rests at once.

    Returns:
        A sentence for each fault; and what was found if there is none.
    """
    faults = [f"the vehicle does not report {name}" for name in own.unknown]
    heights_m = path[:, 2] - home[2]
    above_m, low_m = float(heights_m.max()), float(heights_m.min())
    away_m = float(np.hypot(path[:, 0] - home[0], path[:, 1] - home[1]).max())
    if above_m >= own.highest_m or away_m >= own.farthest_m or low_m <= own.lowest_m:
        faults.append(
            f"the plan leaves the vehicle's own fence ({own.fence}): it goes {low_m:.1f} to {above_m:.1f} m "
            f"up and {away_m:.1f} m away; widen or disable that fence"
        )
    for each in own.failsafes:
        if each.action is Action.RETRACE:
            faults.append(
                f"{each.setting}: when {each.cause} it flies back along a simplified way (SmartRTL), which "
                f"cannot be judged; set {each.stays} so that it does not"
            )
    returning = [each for each in own.failsafes if each.action is Action.RETURN]
    exists = "".join(f"; {words}" for words in own.unjudged)
    if not returning:
        return faults, f"none of them flies home{exists}"
    causes = " or ".join(f"{each.cause} ({each.setting})" for each in returning)
    advice = f"set {' and '.join(each.stays for each in returning)} so that it does not fly home"
    faults += [f"when {causes} it flies home, but {why}; or {advice}" for why in own.not_home]
    met = closest_way_home(own, path, home, obstacles, radius_m=radius_m, foot_m=foot_m, coast=coast)
    if not met.distance_m >= radius_m:
        x, y, z = met.at
        meets = f"meets {met.name}" if met.distance_m <= 0 else f"is {met.distance_m:.2f} m from {met.name}"
        faults.append(
            f"when {causes} it flies home {met.height_m:.1f} m above the take-off "
            f"({own.way_home.setting}); from ({x:.1f} {y:.1f} {z:.1f}), after {met.coast_m:.1f} m to rest, "
            f"that {meets}, and {radius_m:.3f} m are required; {advice}"
        )
    clear = (
        "clear of everything" if math.isinf(met.distance_m) else f"{met.distance_m:.2f} m clear of the map"
    )
    return faults, f"ways home from all of the plan are {clear}{exists}"
