"""Straight plans: the reference of FastBridge, proven to be clear or said not to be."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import PLAN
from alula.schemas.artifacts.manifest import UNPROVEN_PLAN, Guarantee
from alula.schemas.artifacts.provenance import parameters_of
from alula.schemas.decimals import at_least
from alula.schemas.errors import InfeasibleError
from alula.schemas.parameters.configs.plan import PlanConfig, Point
from alula.stages.compression.level import without
from alula.stages.planning.curve_certificate import Certificate, certify_in, methods
from alula.stages.planning.endpoints import free_points_of_flight
from alula.stages.planning.limits import Limits
from alula.stages.planning.mapped import words_beyond
from alula.stages.planning.rest_to_rest import PEAK_SPEED, rest_to_rest
from alula.stages.planning.space import PlanSpace, room_around
from alula.stages.planning.trajectory import evaluate

METHOD_SEPTIC = "a straight line from rest to rest, of degree 7 in time"
# Largest magnitudes of the derivatives of 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7 on [0, 1], orders 1 to 4: at
# s = 1/2, at s = 1/2 -+ 1/sqrt(20), at s = 1/2, and at both ends. The second one has either sign.
PEAKS = (PEAK_SPEED, 84 / (5 * math.sqrt(5)), 52.5, 840.0)
_ROOM = 1 + 1e-6  # of the duration, for the rounding of what is stored
_SAMPLES = 256


def straight_duration(start: FloatArray, goal: FloatArray, limits: Limits) -> float:
    """Shortest duration in which the straight septic keeps the limits at every instant [s].

    Its derivatives lie along the line, and the k-th has the largest magnitude PEAKS[k - 1] L / T^k. The sets
    of allowed accelerations are convex, so all accelerations are allowed if those at both peaks are. This
    holds with equality for one limit at least: no shorter duration is possible.

    Args:
        start: shape (3,) [m].
        goal: shape (3,), another point [m].
    """
    length = float(np.linalg.norm(goal - start))
    direction = (goal - start) / length
    bounds = (limits.speed_m_s, limits.acceleration_m_s2, limits.jerk_m_s3, limits.snap_m_s4)
    shares = [
        (peak * length / bound) ** (1 / k)
        for k, (peak, bound) in enumerate(zip(PEAKS, bounds, strict=True), 1)
    ]
    high: float = max(shares)
    if _is_lifted(PEAKS[1] * length / high**2 * direction, limits):
        return high
    low = high
    while not _is_lifted(PEAKS[1] * length / high**2 * direction, limits):
        low, high = high, 2 * high
    for _ in range(60):
        middle = 0.5 * (low + high)
        fits = _is_lifted(PEAKS[1] * length / middle**2 * direction, limits)
        low, high = (low, middle) if fits else (middle, high)
    return high


def _is_lifted(peak: FloatArray, limits: Limits) -> bool:
    """Whether thrust and tilt keep their limits at both peaks of an acceleration, shape (3,) [m/s^2]."""
    for sign in (1, -1):
        thrust = sign * peak + np.array([0, 0, limits.gravity_m_s2])
        if np.linalg.norm(thrust) > limits.most_thrust_m_s2 or thrust[2] < limits.least_thrust_m_s2:
            return False
        if math.isfinite(limits.tangent) and np.hypot(*thrust[:2]) > limits.tangent * thrust[2]:
            return False
    return True


def _named(config: PlanConfig) -> list[tuple[str, Point]]:
    assert config.start is not None
    assert config.goal is not None
    return [("start", config.start), ("goal", config.goal)]


def straight_plan(
    config: PlanConfig, space: PlanSpace, limits: Limits, vehicle: str, *, jobs: int = 0
) -> Artifact:
    """Plan straight from start to goal, and try to prove the plan.

    Args:
        config: with a radius, and with `straight`.

    Returns:
        Of kind `alula/plan`. With `allow_blocked` one that is not proven has `requires` and a guarantee that
        say so.

    Raises:
        InfeasibleError: start or goal is not free, or the plan is not proven and this is not allowed.
    """
    lower, upper = room_around(config, space, config.points)
    points, moved = free_points_of_flight(config, space, _named(config), lower, upper, space.keep_m)
    start, goal = np.array(points[0]), np.array(points[-1])
    if not (start != goal).any():
        raise InfeasibleError("start and goal are the same free point")
    duration = _ROOM * config.smooth * straight_duration(start, goal, limits)
    peak = PEAKS[0] * float(np.linalg.norm(goal - start)) / duration
    yaw_rad = config.heading.get("yaw_rad", math.atan2(goal[1] - start[1], goal[0] - start[0]))
    time, coefficient = rest_to_rest(start, goal, peak, yaw_rad=yaw_rad)
    proof = certify_in(time, coefficient, space, jobs=jobs)
    dense = evaluate(time, coefficient[:, :3], np.linspace(0, time[-1], _SAMPLES))
    clearance = space.clearance_m(dense, jobs)
    if not proof.holds and not config.allow_blocked:
        near = "" if clearance is None else f", and is {at_least(max(clearance, 0.0))} m from an obstacle"
        if clearance is not None and clearance <= 0:
            near = ", and leads through an obstacle"
        raise InfeasibleError(
            f"the straight line is not proven to keep {space.keep_m:g} m{near}; leave out --straight, or "
            "write it for a flight behind a filter with --allow-blocked"
        )
    length = float(np.linalg.norm(goal - start))
    return make_artifact(
        PLAN,
        {
            "time": time,
            "coefficient": coefficient,
            "waypoint": np.array([[*point, yaw_rad] for point in (points[0], points[-1])]),
        },
        frame=space.frame,
        unit="m",
        **claimed(config, space, limits),
        method=METHOD_SEPTIC,
        vehicle=vehicle,
        certificate={
            "method": methods(space),
            "pieces": len(coefficient),
            "unproven_pieces": int((~proof.proven).sum()),
            "checked_pairs": proof.pairs,
            "depth": proof.depth,
            "min_proven_clearance_m": float(proof.clearance_m.min()) if proof.holds else 0.0,
        },
        summary={
            "length_m": length,
            "straight_m": length,
            "duration_s": float(time[-1]),
            "pieces": len(coefficient),
            "min_clearance_m": clearance,
            "max_speed_m_s": PEAKS[0] * length / float(time[-1]),
            "max_acceleration_m_s2": PEAKS[1] * length / float(time[-1]) ** 2,
            **({} if proof.holds else {"is_proven": False}),
            **(
                {"notes": [f"the {name} was moved to a free point (--nearest-free)" for name, _, _ in moved]}
                if moved
                else {}
            ),
        },
        guarantee=_guarantee(proof, space, limits, config.beyond_map_m),
        requires=[] if proof.holds else [UNPROVEN_PLAN],
    )


def claimed(config: PlanConfig, space: PlanSpace, limits: Limits) -> dict[str, Any]:
    """Fields of a plan's manifest that say which distances and limits it keeps."""
    return {
        "parameters": parameters_of(config),
        "radius_m": space.keep_m,
        "speed_m_s": config.speed_m_s,
        "margin_m": config.margin_m or 0.0,
        "beyond_map_m": config.beyond_map_m,
        "maps": [one.facts for one in space.maps],
        "limits": limits.record(),
    }


def proven(space: PlanSpace, limits: Limits, beyond_m: float, **claims: Any) -> Guarantee:
    """Guarantee of a plan that is proven."""
    return Guarantee(
        f"Every point of the trajectory is at least {space.distances()}, and its motion stays within the "
        f"limits at every instant{without(space.omits())}.{words_beyond(beyond_m)}",
        {
            "radius_m": space.keep_m,
            **limits.record(),
            **({"beyond_map_m": beyond_m} if beyond_m else {}),
            **claims,
        },
    )


def _guarantee(proof: Certificate, space: PlanSpace, limits: Limits, beyond_m: float) -> Guarantee:
    if proof.holds:
        return proven(space, limits, beyond_m)
    return Guarantee(
        "The motion stays within the limits at every instant. The trajectory is not proven to keep any "
        "distance from the map, and may lead through obstacles: only a safety filter keeps a vehicle that "
        "follows it from them.",
        {"map_clear": False, **limits.record()},
    )
