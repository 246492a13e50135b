"""Plans between random pairs that a fine grid proves connected: success, time to plan, flight time, limits.

Pairs are points of a grid with a spacing of a quarter of the radius. Two neighbours are joined where their
distances from the map, which are 1-Lipschitz, prove that the segment between them keeps the radius; a pair
is two points of one connected component. Flights begin and end at rest. Limits of speed and acceleration are
equal; plans also keep those of thrust, tilt, body rates and rotors, and room for filters beside obstacles.

- `time_over_today`: over the planner before 1.1 of the artifact along the same path: minimum snap with its
  own allocation of times, halved or straight where it was not proven clear, all of it stretched until the
  same limits hold; `time_over_today_without_limits`: until speed and acceleration hold, as it was flown;
- `time_over_splatnav`: over the curve of minimum snap in the same corridor with durations by the lengths of
  the segments, all stretched until the limits hold (Chen et al. 2024);
- `time_over_bound`: over a point on the merged path with full acceleration that stops for no corner. That
  point needs `bound_over_today` of the older planner's time, 0.7 to 0.9: no planner along these paths can be
  as fast as 0.6 of it;
- `time_over_line`: over the fastest curve along a straight line of the same length in free space, within the
  limits of jerk and snap, too;
- `gates_passed`: fraction of the gates of random missions, three gates and two laps each, that samples of the
  flown curve pass through their disc in their direction and order, by the judge of flights;
- `limit_violations`: plans whose limits `verify` does not prove again in rational arithmetic.

Times of planning are processor seconds of one thread, after the map is loaded, proof included.

    python benchmarks/plan.py --quick --json     # the built-in room, under a minute
    python benchmarks/plan.py --pairs 100        # and three real scenes of ALULA_DATA
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent))
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # convex_core

import numpy as np
from measure import FloatArray
from older_plan import older_curve, stretched_s
from scenes import real, room, voxels_of
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import pdist

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import InfeasibleError
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.schemas.parameters.configs.plan import Gate, PlanConfig, Point
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.compression.merge import merge
from alula.stages.planning.adherence import PlanJudge
from alula.stages.planning.corridor import Corridor, find_corridor
from alula.stages.planning.curve_certificate import certify_in
from alula.stages.planning.fastest import fastest_curve, keeps
from alula.stages.planning.limits import Limits, motion_limits
from alula.stages.planning.path import find_polyline
from alula.stages.planning.plan import curve_along, plan
from alula.stages.planning.plan_samples import sample_plan
from alula.stages.planning.space import PlanSpace, plan_space
from alula.stages.planning.verify import verify_plan
from support.models import convex_core

ACCELERATION = 3.0
GRID = 0.25  # spacing, in radii
APART_M = 1.0  # between the points of a pair, at least
# Real scenes under ALULA_DATA: metres per unit, voxel edge [m], hulls.
REAL = {
    "istanbul-outdoor/tile_x000_y003.splat": (1.0, 0.5, 200),
    "istanbul-outdoor/tile_x001_y000.splat": (1.0, 0.5, 200),
    "cc0-corpus/leica-sofort-top8192.ply": (1.0, 0.3, 150),
}


@dataclass(frozen=True, slots=True)
class World:
    """A cover to plan in, and the radius to keep [m]."""

    name: str
    cover: Artifact
    radius_m: float


def built_in() -> World:
    """The built-in room."""
    return World("room", merge(MergeConfig(hulls=150), voxels_of(room(200_000), 0.1, 1)), 0.25)


def real_worlds() -> list[World]:
    """Those of ALULA_DATA."""
    if "ALULA_DATA" not in os.environ:
        return []
    data = Path(os.environ["ALULA_DATA"])
    return [
        World(
            Path(name).stem, merge(MergeConfig(hulls=hulls), voxels_of(real(data / name, scale), edge)), 0.35
        )
        for name, (scale, edge, hulls) in REAL.items()
        if (data / name).exists()
    ]


def connected_pairs(space: PlanSpace, count: int, seed: int) -> list[tuple[Point, Point]]:
    """Random pairs of grid points of one component each, drawn from all joined points alike."""
    return [(start, goal) for start, goal in connected_chains(space, 2, count, seed)]


def connected_chains(space: PlanSpace, length: int, count: int, seed: int) -> list[list[Point]]:
    """The same for chains of some points, any two of which are apart."""
    box = space.box()
    assert box is not None
    lower, upper = box
    step = max(GRID * space.keep_m, float(np.prod(upper - lower) / 2e6) ** (1 / 3))
    axes = [np.arange(a + 0.5 * step, b, step) for a, b in zip(lower, upper, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    distance = space.map.distance(np.ascontiguousarray(grid), space.keep_m + step)
    number = np.arange(len(grid)).reshape([len(axis) for axis in axes])
    ends = [
        np.stack([np.delete(number, -1, axis=axis).reshape(-1), np.delete(number, 0, axis=axis).reshape(-1)])
        for axis in range(3)
    ]
    a, b = np.concatenate(ends, axis=1)
    joined = 0.5 * (distance[a] + distance[b] - step) >= space.keep_m + 1e-6
    a, b = a[joined], b[joined]
    graph = coo_array((np.ones(len(a), np.bool_), (a, b)), shape=(len(grid), len(grid)))
    _, part = connected_components(graph, directed=False)
    points = np.unique(np.concatenate([a, b]))
    rng = np.random.default_rng(seed)
    chains: list[list[Point]] = []
    for _ in range(1000 * count):
        if len(chains) == count:
            break
        start = rng.choice(points)
        others = [rng.choice(points[part[points] == part[start]]) for _ in range(length - 1)]
        chosen = grid[[start, *others]]
        if pdist(chosen).min() >= APART_M:
            chains.append([tuple(point) for point in chosen.tolist()])
    return chains


def scaled_time(corridor: Corridor, limits: Limits, speed: float) -> float:
    """Time of the curve with fixed ratios of durations, stretched until the limits hold [s]."""
    cells = len(corridor.start) - 1
    length = np.linalg.norm(np.diff(corridor.point, axis=0), axis=1)
    duration = np.repeat(length / speed / 2, 2)
    rows = [corridor.rows(i) for i in range(cells)]
    answer = convex_core.minimum_snap(
        convex_core.Problem(
            normal=[normal for normal, _ in rows],
            offset=[offset for _, offset in rows],
            cell=np.repeat(np.arange(cells), 2),
            limits=Limits(speed_m_s=math.inf, acceleration_m_s2=math.inf, gravity_m_s2=limits.gravity_m_s2),
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


def bound(path: FloatArray, speed: float) -> float:
    """Time along a path with full acceleration and deceleration [s]."""
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    ramp = speed**2 / ACCELERATION
    return length / speed + speed / ACCELERATION if length >= ramp else 2 * math.sqrt(length / ACCELERATION)


def line_s(path: FloatArray, limits: Limits) -> float:
    """Duration of the fastest curve along a straight, level line of the same length in free space [s]."""
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    corridor = Corridor(
        normal=np.concatenate([np.eye(3), -np.eye(3)]),
        offset=np.full(6, 2 * length),
        start=np.array([0, 6]),
        point=np.array([[0.0, 0, 0], [length, 0, 0]]),
        joint=np.empty((0, 3)),
        is_open=np.empty(0, np.bool_),
        is_via=np.empty(0, np.bool_),
        is_free=np.ones(1, np.bool_),
    )
    curve = fastest_curve(corridor, range(1), limits, 3)
    return math.nan if curve is None else float(curve.time[-1])


def figures(world: World, speed: float, count: int, compared: int, seed: int) -> dict[str, Any]:
    """Plan all pairs of a world at one limit of the speed; `compared` of them in other ways, too."""
    base = PlanConfig(radius_m=world.radius_m, speed_m_s=speed, acceleration_m_s2=ACCELERATION)
    space, limits = plan_space(base, world.cover), motion_limits(base, FASTBRIDGE)
    pairs = connected_pairs(space, count, seed)
    seconds, ours, free, others, bounds, lines, scaled = [], [], [], [], [], [], []
    stops, violations, least = 0, 0, math.inf
    for i, (start, goal) in enumerate(pairs):
        config = dataclasses.replace(base, start=start, goal=goal)
        begin = time.process_time()
        try:
            path = find_polyline(config, space, jobs=1)
            via = np.zeros(len(path.point), np.bool_)
            box = (path.lower, path.upper)
            corridor = find_corridor(path.point, via, space.solids(), space.keep_m, box, jobs=1)
            curve = curve_along(corridor, config, limits, space, jobs=1)
            proof = certify_in(curve.time, curve.coefficient(), space, jobs=1)
        except InfeasibleError as error:
            sys.stderr.write(f"{world.name}: {start} {goal}: {error}\n")
            continue
        seconds.append(time.process_time() - begin)
        least = min(least, float(proof.clearance_m.min()))
        stops += int(curve.stop[:-1].sum())
        ours.append(curve.time[-1])
        older = older_curve(path, speed, ACCELERATION, space)
        free.append(math.nan if older is None else older[0][-1])
        others.append(math.nan if older is None else stretched_s(*older, limits))
        bounds.append(bound(corridor.point, speed))
        lines.append(line_s(corridor.point, limits))
        scaled.append(scaled_time(corridor, limits, speed) if i < compared else math.nan)
        if i < compared:
            made = plan(config, world.cover, jobs=1)
            violations += not verify_plan(made, cover=world.cover, jobs=1).covered
    time_s, free_s, today_s, bound_s, line, scaled_s = map(
        np.array, (ours, free, others, bounds, lines, scaled)
    )
    return {
        "world": world.name,
        "radius_m": world.radius_m,
        "speed_m_s": speed,
        "connected_pairs": len(pairs),
        "planned_pairs": len(ours),
        "stops": stops,
        "min_proven_clearance_m": least,
        "plan_median_s": float(np.median(seconds)),
        "plan_p95_s": float(np.quantile(seconds, 0.95)),
        "time_over_today": float(np.nanmedian(time_s / today_s)),
        "time_over_today_without_limits": float(np.nanmedian(time_s / free_s)),
        "time_over_splatnav": float(np.nanmedian(time_s / scaled_s)),
        "largest_time_over_splatnav": float(np.nanmax(time_s / scaled_s)),
        "time_over_bound": float(np.median(time_s / bound_s)),
        "time_over_line": float(np.nanmedian(time_s / line)),
        "bound_over_today": float(np.nanmedian(bound_s / today_s)),
        "verified_again": min(compared, len(ours)),
        "limit_violations": violations,
    }


def random_gate(space: PlanSpace, grid: FloatArray, rng: np.random.Generator) -> Gate:
    """A gate at a random point, in a random horizontal direction, with a free way straight through."""
    while True:
        centre, angle = rng.choice(grid), rng.uniform(-np.pi, np.pi)
        normal = np.array([np.cos(angle), np.sin(angle), 0.0])
        ends = np.stack([centre - space.keep_m * normal, centre + space.keep_m * normal])
        if space.map.segment_distance(ends[:1], ends[1:], 2 * space.keep_m)[0] >= space.keep_m + 1e-5:
            return (*centre.tolist(), *normal.tolist(), space.keep_m + rng.uniform(0.01, 0.3))


def gate_figures(world: World, count: int, seed: int) -> dict[str, Any]:
    """Fly random missions of gates: how many are planned, and the fraction of their gates that are passed."""
    base = PlanConfig(radius_m=world.radius_m, speed_m_s=2.0, acceleration_m_s2=ACCELERATION, loops=2)
    space = plan_space(base, world.cover)
    pairs = connected_pairs(space, 4 * count, seed)
    grid = np.array([point for pair in pairs for point in pair])
    rng = np.random.default_rng(seed)
    seconds, passed, wanted, unproven = [], 0, 0, 0
    for start, goal in pairs[:count]:
        gates = tuple(random_gate(space, grid, rng) for _ in range(3))
        config = dataclasses.replace(base, start=start, goal=goal, gate=gates)
        wanted += 6
        begin = time.process_time()
        try:
            made = plan(config, world.cover, jobs=1)
        except InfeasibleError as error:
            sys.stderr.write(f"{world.name}: {config.gate}: {error}\n")
            continue
        seconds.append(time.process_time() - begin)
        unproven += not verify_plan(made, cover=world.cover, jobs=1).covered
        found = PlanJudge(made, [], world.radius_m, 0.1).result(sample_plan(made, 1e-3))
        passed += sum(one.passed for one in found.passes)
    return {
        "gate_missions": count,
        "gates": wanted,
        "gates_passed": passed / wanted,
        "gate_plan_median_s": float(np.median(seconds)) if seconds else math.nan,
        "gate_plans_unproven": unproven,
    }


def main() -> int:
    """Print a table, or JSON; return 1 if a pair has no plan, a gate is missed or a plan not proven again."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the built-in room alone, 40 pairs at 1 m/s")
    parser.add_argument("--pairs", type=int, default=100, help="in each world: 100")
    parser.add_argument("--compared", type=int, default=20, help="pairs that are timed in other ways: 20")
    parser.add_argument("--speed", type=float, nargs="+", default=[1.0, 3.0], help="limits [m/s]: 1 and 3")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table as a page")
    given = parser.parse_args()
    worlds = [built_in()] if given.quick else [built_in(), *real_worlds()]
    speeds, pairs, compared = ([1.0], 40, 8) if given.quick else (given.speed, given.pairs, given.compared)
    missions = 8 if given.quick else 30
    found = [
        figures(world, v, pairs, compared, given.seed) | gate_figures(world, missions, given.seed)
        for world in worlds
        for v in speeds
    ]
    if given.json:
        json.dump(found[0] if given.quick else found, sys.stdout, indent=2)
        sys.stdout.write("\n")
    else:
        sys.stdout.write(table(found))
    if given.markdown is not None:
        given.markdown.write_text(f"{_PREFACE}{__doc__}\n{table(found)}")
    missed = any(each["planned_pairs"] < each["connected_pairs"] for each in found)
    missed |= any(each["gates_passed"] < 1 for each in found)
    return int(missed or any(each["limit_violations"] + each["gate_plans_unproven"] for each in found))


_PREFACE = """# Plans, measured

Look up here how often `plan` finds a way, how long that takes, and how fast its flights are.
Written by `python benchmarks/plan.py --markdown FILE`.

"""


def table(found: list[dict[str, Any]]) -> str:
    """Figures as rows of a Markdown table, a column for each set of them."""
    rows = [list(found[0]), ["---"] * len(found[0])]
    rows += [
        [f"{value:.3g}" if isinstance(value, float) else str(value) for value in each.values()]
        for each in found
    ]
    columns = [list(column) for column in zip(*rows, strict=True)]  # a row for each figure
    heads = columns[0]
    lines = [[heads[0], *heads[2:]], ["---"] * (len(heads) - 1)]
    lines += [[column[0], *column[2:]] for column in columns[1:]]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
