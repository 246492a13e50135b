"""Flight times of plans between random pairs, beside other ways to time them, at equal limits.

`septic` is the minimum-snap spline through the points of the path with its own allocation of times,
stretched until speed and acceleration hold: how `plan` timed flights before version 1.1 of its artifact.
`scaled` fixes the durations by the lengths of the segments, minimises snap in the same corridor, and
stretches all of it until the limits hold, as Splat-Nav does (Chen et al. 2024). `bound` is a point that
follows the merged path with full acceleration and deceleration and stops for no corner. Times of
planning are CPU seconds after the map is loaded.

    python benchmarks/plan_times.py room.cover.npz --pairs 100 --speed 1 --speed 3
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.artifact import read_artifact
from alula.schemas.configs.plan import PlanConfig
from alula.schemas.errors import InfeasibleError
from alula.schemas.kinds import COVER
from alula.schemas.vehicle import FASTBRIDGE, Vehicle, read_vehicle
from alula.stages.clearance import hull_obstacles, path_clearance
from alula.stages.compression.hulls import Hulls
from alula.stages.planning import convex_core
from alula.stages.planning.corridor import Corridor, find_corridor
from alula.stages.planning.curve_certificate import certify_curve
from alula.stages.planning.fastest import Curve, keeps
from alula.stages.planning.limits import Limits, motion_limits
from alula.stages.planning.path import Polyline, find_polyline
from alula.stages.planning.plan import curve_along
from alula.stages.planning.trajectory import allocate_times

ACCELERATION = 3.0
Path3 = tuple[PlanConfig, Polyline, float]


def connected_pairs(obstacles: _core.PolytopeSet, radius_m: float, count: int, seed: int) -> list[Path3]:
    """Random free pairs in the box of the hulls that the search joins, with its path and CPU time."""
    rng = np.random.default_rng(seed)
    lower, upper = (np.array(side) for side in obstacles.bounds())
    box = (*lower.tolist(), *upper.tolist())
    pairs: list[Path3] = []
    anchor = None
    while len(pairs) < count:
        start, goal = rng.uniform(lower, upper, (2, 3))
        if anchor is not None:
            start = anchor
        if (path_clearance([start, start], obstacles, cap_m=1.0).min() < radius_m + 1e-6) or (
            path_clearance([goal, goal], obstacles, cap_m=1.0).min() < radius_m + 1e-6
        ):
            continue
        config = PlanConfig(
            start=tuple(start.tolist()), goal=tuple(goal.tolist()), radius_m=radius_m, bounds=box
        )
        begin = time.process_time()
        try:
            path = find_polyline(config, obstacles, jobs=1)
        except InfeasibleError:
            continue
        pairs.append((config, path, time.process_time() - begin))
        anchor = goal  # the next flight begins here, so that no search is lost on a room apart
    return pairs


def scaled_time(corridor: Corridor, limits: Limits, speed: float) -> float:
    """Time of the curve with fixed ratios of durations, stretched until the limits hold [s]."""
    cells = len(corridor.start) - 1
    length = np.linalg.norm(np.diff(corridor.point, axis=0), axis=1)
    duration = np.repeat(length / speed / 2, 2)
    free = dataclasses.replace(limits, **dict.fromkeys(("speed_m_s", "acceleration_m_s2"), math.inf))
    free = Limits(
        speed_m_s=free.speed_m_s, acceleration_m_s2=free.acceleration_m_s2, gravity_m_s2=limits.gravity_m_s2
    )
    rows = [corridor.rows(i) for i in range(cells)]
    answer = convex_core.minimum_snap(
        convex_core.Problem(
            normal=[normal for normal, _ in rows],
            offset=[offset for _, offset in rows],
            cell=np.repeat(np.arange(cells), 2),
            limits=free,
            state=corridor.point[:1],
            goal=corridor.point[-1],
            via={},
        ),
        duration,
    )
    if answer is None:
        return math.nan
    low, high = 0.0, 1.0
    while not keeps(answer[1], high * duration, limits).all():
        low, high = high, 2 * high
    while high - low > 1e-4 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if keeps(answer[1], middle * duration, limits).all() else (middle, high)
    return high * float(duration.sum())


def bound(path: np.ndarray[Any, Any], speed: float) -> float:
    """Time along a path with full acceleration and deceleration [s]."""
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    ramp = speed**2 / ACCELERATION
    return length / speed + speed / ACCELERATION if length >= ramp else 2 * math.sqrt(length / ACCELERATION)


def figures(
    pairs: list[Path3], obstacles: _core.PolytopeSet, vehicle: Vehicle, speed: float, compared: int
) -> dict[str, float]:
    """Fly all pairs at one limit of the speed."""
    seconds, solving, ours, others, bounds, scaled = [], [], [], [], [], []
    planned, stops, least = 0, 0, math.inf
    for i, (given, path, searching) in enumerate(pairs):
        config = dataclasses.replace(given, speed_m_s=speed, acceleration_m_s2=ACCELERATION)
        limits = motion_limits(config, vehicle)
        begin = time.process_time()
        try:
            corridor = find_corridor(
                path.point,
                np.zeros(len(path.point), np.bool_),
                [obstacles],
                config.keep_m,
                (path.lower, path.upper),
                jobs=1,
            )
            curve: Curve = curve_along(corridor, config, limits, obstacles, jobs=1)
        except InfeasibleError:
            continue
        took = time.process_time() - begin
        seconds.append(searching + took)
        solving.append(took)
        proof = certify_curve(curve.time, curve.coefficient(), obstacles, config.keep_m, jobs=1)
        planned += proof.holds
        stops += int(curve.stop[:-1].sum())
        least = min(least, float(proof.clearance_m.min()))
        ours.append(curve.time[-1])
        others.append(allocate_times(path.point, speed, ACCELERATION).sum())
        bounds.append(bound(corridor.point, speed))
        scaled.append(scaled_time(corridor, limits, speed) if i < compared else math.nan)
    time_s, septic_s, bound_s, scaled_s = (np.array(each) for each in (ours, others, bounds, scaled))
    return {
        "speed_m_s": speed,
        "connected_pairs": len(pairs),
        "planned_pairs": planned,
        "stops": stops,
        "min_proven_clearance_m": least,
        "plan_median_s": float(np.median(seconds)),
        "plan_p95_s": float(np.quantile(seconds, 0.95)),
        "curve_median_s": float(np.median(solving)),
        "curve_p95_s": float(np.quantile(solving, 0.95)),
        "time_over_septic": float(np.median(time_s / septic_s)),
        "time_over_scaled": float(np.nanmedian(time_s / scaled_s)),
        "largest_time_over_scaled": float(np.nanmax(time_s / scaled_s)),
        "time_over_bound": float(np.median(time_s / bound_s)),
        "septic_over_bound": float(np.median(septic_s / bound_s)),
    }


def main() -> None:
    """Print a table, or JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("cover", type=Path)
    parser.add_argument("--pairs", type=int, default=100)
    parser.add_argument("--compared", type=int, default=20, help="pairs that `scaled` is solved for")
    parser.add_argument("--radius", type=float, default=0.25)
    parser.add_argument("--speed", type=float, action="append")
    parser.add_argument("--vehicle", type=Path)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    obstacles = hull_obstacles(Hulls.from_cover(read_artifact(given.cover, COVER)))
    vehicle = FASTBRIDGE if given.vehicle is None else read_vehicle(given.vehicle)
    pairs = connected_pairs(obstacles, given.radius, given.pairs, given.seed)
    found = [figures(pairs, obstacles, vehicle, v, given.compared) for v in given.speed or [1.0, 3.0]]
    if given.json:
        json.dump(found, sys.stdout, indent=2)
        return
    for name in found[0]:
        sys.stdout.write(f"{name:<28}" + "".join(f"{each[name]:>12.4g}" for each in found) + "\n")


if __name__ == "__main__":
    main()
