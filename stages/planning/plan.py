"""Planning of a flight: a lattice path among the hulls, a smooth trajectory along it, and its proof."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from alula._core import PolytopeSet
from alula.schemas.arrays import FloatArray
from alula.schemas.artifact import Artifact, make_artifact
from alula.schemas.configs.plan import MARGIN_M, PlanConfig
from alula.schemas.errors import InfeasibleError, InputError, UsageError
from alula.schemas.kinds import PLAN
from alula.schemas.manifest import Guarantee
from alula.schemas.progress import Progress
from alula.schemas.provenance import parameters_of
from alula.schemas.vehicle import FASTBRIDGE, Vehicle
from alula.stages.clearance import hull_obstacles, path_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.verify import require_solid_hulls
from alula.stages.planning.curve_certificate import METHOD, Certificate, certify_curve
from alula.stages.planning.path import Polyline, find_polyline
from alula.stages.planning.trajectory import (
    DEGREE,
    allocate_times,
    control_points,
    evaluate,
    peak_bounds,
    septic_spline,
    subdivided,
)
from alula.stages.planning.unseen import joined, require_seen, unseen_hulls

_SPLITS = 4  # times that a piece without proof is halved before it becomes a straight line


def resolve_plan(config: PlanConfig, vehicle: Vehicle = FASTBRIDGE) -> PlanConfig:
    """Complete the distance to keep: the vehicle's radius and the margin that its filter keeps.

    Args:
        config: as given by the user.
        vehicle: that will fly the plan.

    Raises:
        UsageError: a margin is given with the whole distance.
    """
    if config.radius_m is None:
        margin = MARGIN_M if config.margin_m is None else config.margin_m
        return dataclasses.replace(config, radius_m=vehicle.body.radius_m + margin, margin_m=margin)
    if config.margin_m is not None:
        raise UsageError("--radius is the whole distance to keep; leave out --margin")
    return dataclasses.replace(config, margin_m=0.0)


def plan(
    config: PlanConfig,
    cover: Artifact,
    *,
    within: Artifact | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Artifact:
    """Plan a smooth flight that provably keeps a distance from every hull of a cover.

    A lattice search joins the points by straight lines that keep `radius_m` exactly. A
    minimum-snap trajectory of degree 7 follows them within the limits of speed and acceleration,
    both over the continuous time. `certify` proves each of its pieces. A piece without proof gets
    more waypoints on its line, and in the end becomes that line, flown from rest to rest. So the
    result is always proven. With seen space, what was not seen is an obstacle like the hulls.

    Args:
        config: see `PlanConfig`; without a radius, for the quadrotor of FastBridge.
        cover: an `alula/cover`.
        within: an `alula/seen` in the cover's frame, to stay in.
        jobs: threads; the result does not depend on it.
        progress: called with (points visited, 0) by the search; 0 stands for an unknown total.

    Raises:
        ArtifactError: planes and vertices of the cover do not describe the same polytopes.
        InfeasibleError: a point is too close to a hull or to unseen space, or there is no path at this
            resolution.
        InputError: the seen space has another frame than the cover.
        UsageError: the lattice would be too large.
    """
    if config.radius_m is None:
        config = resolve_plan(config)
    require_solid_hulls(cover, jobs=jobs)
    hulls, kept_from = Hulls.from_cover(cover), "every hull of the cover"
    if within is not None:
        if within.manifest.frame != cover.manifest.frame:
            raise InputError("the seen space has another frame than the cover")
        unseen = unseen_hulls(within)
        require_seen(config, within, hull_obstacles(unseen))
        hulls, kept_from = joined([hulls, unseen]), f"{kept_from} and from all space that was not seen"
    obstacles = hull_obstacles(hulls)
    path = find_polyline(config, obstacles, jobs=jobs, progress=progress)
    waypoint, rest, time, coefficient, proof = _smooth(config, obstacles, path, jobs)

    yaw = np.zeros((len(coefficient), 1, DEGREE + 1))
    yaw[:, 0, 0] = config.yaw_rad
    dense = evaluate(time, coefficient, _sample_times(time))
    closest = path_clearance(dense, obstacles, jobs=jobs)
    bound = float(proof.clearance_m.min(initial=2 * config.keep_m))
    return make_artifact(
        PLAN,
        {
            "time": time,
            "coefficient": np.concatenate([coefficient, yaw], axis=1),
            "waypoint": np.column_stack([waypoint, np.full(len(waypoint), config.yaw_rad)]),
        },
        frame=cover.manifest.frame,
        unit="m",
        parameters=parameters_of(config),
        radius_m=config.keep_m,
        speed_m_s=config.speed_m_s,
        margin_m=config.margin_m or 0.0,
        via_m=[list(point) for point in config.via],
        certificate={
            "method": METHOD,
            "pieces": len(coefficient),
            "checked_pairs": proof.pairs,
            "depth": proof.depth,
            "min_proven_clearance_m": bound,
        },
        summary={
            "length_m": float(np.linalg.norm(np.diff(dense, axis=0), axis=1).sum()),
            "straight_m": sum(math.dist(a, b) for a, b in pairwise(config.points)),
            "duration_s": float(time[-1]),
            "pieces": len(coefficient),
            "stops": int(rest[1:-1].sum()),
            "min_clearance_m": float(closest.min()) if len(obstacles) else None,
            "max_speed_m_s": float(peak_bounds(time, coefficient, 1).max()),
            "max_acceleration_m_s2": float(peak_bounds(time, coefficient, 2).max()),
            "resolution_m": path.resolution_m,
            "lattice_points": path.lattice_points,
            "visited_points": path.visited,
        },
        guarantee=Guarantee(
            f"Every point of the trajectory is at least radius_m from {kept_from}, and speed and "
            "acceleration stay within their limits at every instant.",
            {
                "radius_m": config.keep_m,
                "speed_m_s": config.speed_m_s,
                "acceleration_m_s2": config.acceleration_m_s2,
                **({} if within is None else {"within_seen_space": True}),
            },
        ),
    )


def _smooth(
    config: PlanConfig, obstacles: PolytopeSet, path: Polyline, jobs: int
) -> tuple[FloatArray, NDArray[np.bool_], FloatArray, FloatArray, Certificate]:
    """Waypoints, stops, knots, coefficients and proof of a trajectory along the polyline."""
    waypoint = path.point
    rest = np.zeros(len(waypoint), np.bool_)
    rest[[0, -1]] = True
    splits = np.zeros(len(waypoint) - 1, np.int64)
    while True:
        duration = allocate_times(waypoint, config.speed_m_s, config.acceleration_m_s2, rest)
        time = np.concatenate([[0.0], np.cumsum(duration)])
        coefficient = septic_spline(waypoint, np.diff(time), rest)
        proof = certify_curve(time, coefficient, obstacles, config.keep_m, jobs=jobs)
        good = proof.proven & _within(path, control_points(time, coefficient))
        if good.all():
            return waypoint, rest, time, coefficient, proof
        straight = rest[:-1] & rest[1:]
        if (straight & ~good).any():
            raise InfeasibleError("a straight part of the path cannot be proven clear; use a larger --radius")
        waypoint, rest, splits = _refine(waypoint, rest, splits, ~good)


def _refine(
    waypoint: FloatArray, rest: NDArray[np.bool_], splits: NDArray[np.int64], failed: NDArray[np.bool_]
) -> tuple[FloatArray, NDArray[np.bool_], NDArray[np.int64]]:
    """Halve the pieces that failed; pieces halved `_SPLITS` times become straight, from rest to rest."""
    halve = failed & (splits < _SPLITS)
    stop = rest.copy()
    stop[:-1] |= failed & ~halve
    stop[1:] |= failed & ~halve
    at = np.flatnonzero(halve)
    middle = 0.5 * (waypoint[at] + waypoint[at + 1])
    splits = splits + halve
    return (
        np.insert(waypoint, at + 1, middle, axis=0),
        np.insert(stop, at + 1, False),
        np.insert(splits, at + 1, splits[at]),
    )


def _within(path: Polyline, points: FloatArray) -> NDArray[np.bool_]:
    """Find the pieces, control points (K, 3, 8), that lie in the searched box; shape (K,)."""
    slack = 1e-9
    parts = subdivided(points)
    low, high = parts.min(axis=(2, 3)), parts.max(axis=(2, 3))
    return np.asarray(((low >= path.lower - slack) & (high <= path.upper + slack)).all(axis=1))


def _sample_times(time: FloatArray) -> FloatArray:
    """64 instants per piece, and the end."""
    return np.append((time[:-1, None] + np.diff(time)[:, None] * (np.arange(64) / 64)).reshape(-1), time[-1])
