"""Planning of a flight: a path through the map, a corridor, the fastest curve in it, and its proof."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import PLAN
from alula.schemas.artifacts.manifest import PlanPass, PlanZone
from alula.schemas.decimals import at_most, exact
from alula.schemas.errors import InfeasibleError, UsageError
from alula.schemas.parameters.configs.plan import MARGIN_M, PlanConfig, Point
from alula.schemas.progress import Progress
from alula.schemas.scenarios.mission import Mission
from alula.schemas.scenarios.vehicle import FASTBRIDGE, Vehicle
from alula.stages.planning.behind import Behind, slowed
from alula.stages.planning.corridor import Corridor, find_corridor
from alula.stages.planning.curve_certificate import certify_in, methods
from alula.stages.planning.exact import THROUGH_M, is_crossed
from alula.stages.planning.exact import control_points as control_fractions
from alula.stages.planning.fastest import (
    PIECES_PER_CELL,
    Curve,
    MovingState,
    fastest_curve,
    hold_curve,
    joined,
    keeps,
    straight_curve,
)
from alula.stages.planning.heading import (
    FIRM_S,
    Leg,
    constant_heading,
    has_heading,
    heading_along,
    is_turning,
)
from alula.stages.planning.limits import Limits, motion_limits
from alula.stages.planning.opening import Opening
from alula.stages.planning.passes import Passage, mission_of, passages_of
from alula.stages.planning.path import Polyline, find_polyline
from alula.stages.planning.space import PlanSpace, plan_space
from alula.stages.planning.straight import claimed, proven, straight_plan
from alula.stages.planning.trajectory import DEGREE, control_points, evaluate, peak_bounds
from alula.stages.planning.unseen import require_seen
from alula.stages.planning.zones import Zone, split_at

_ROUNDS = 3  # of curves, with more and more gates that are led through
_LED, _LEAST_ROOM_M = 1.05, 1e-4  # distance from the plane there, in `THROUGH_M`; room about these points [m]
METHOD_FASTEST = "minimum time in a corridor of convex cells"
METHOD_STRAIGHT = "straight lines from rest to rest"


def resolve_plan(config: PlanConfig, vehicle: Vehicle = FASTBRIDGE) -> PlanConfig:
    """Complete the distance to keep: the vehicle's radius and the margin that its filter keeps.

    Raises:
        UsageError: a margin is given with the whole distance.
    """
    if config.radius_m is None:
        margin = MARGIN_M if config.margin_m is None else config.margin_m
        return dataclasses.replace(config, radius_m=vehicle.body.radius_m + margin, margin_m=margin)
    for option, value in (("--margin", config.margin_m), ("--inflate", config.inflation_m)):
        if value is not None:
            raise UsageError(f"--radius is the whole distance to keep; leave out {option}")
    return config


def plan(
    config: PlanConfig,
    cover: Artifact | None = None,
    *,
    scene: Artifact | None = None,
    image: bytes | None = None,
    within: Artifact | None = None,
    mission: Mission | None = None,
    space: PlanSpace | None = None,
    vehicle: Vehicle = FASTBRIDGE,
    motion: MovingState | None = None,
    behind: Behind | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Artifact:
    """Plan a flight of minimum time that provably keeps a distance from every obstacle of a map.

    A search joins the points by straight lines that keep the distance exactly. Convex cells around them,
    every point of which keeps the distance, make a corridor; in it a curve of degree 7 and class C4 is made
    as fast as the limits of user and vehicle allow, which hold at every instant. `certify_in` proves each of
    its pieces again. Where the corridor has no room the curve stops; a part that is not proven becomes
    straight lines, flown from rest to rest. So the result is always proven.

    Args:
        config: see `PlanConfig`; without a radius, for the vehicle.
        cover: an `alula/cover`; one map at least is needed, and plans keep away from all.
        within: an `alula/seen` to stay in; what was not seen is an obstacle like the others.
        mission: what to pass on the way; if None, what the configuration has. Its start and goal are those of
            the configuration.
        space: the obstacles of the maps, where they have been made before; cover, scene and image are then
            not used.
        motion: of the vehicle at the start; at rest if none.
        behind: filters behind which a plan from rest will be flown; it is slower where they would act.
        progress: called with (points visited, 0) by the search; 0 stands for an unknown total.

    Raises:
        ArtifactError: planes and vertices of the cover do not describe the same polytopes, or the onboard map
            is damaged.
        InputError: a map is not metric, or the maps do not fit each other.
        InfeasibleError: a point is too close to an obstacle, there is no path, no curve from this motion, or
            no proof of a straight plan that needs one.
        UsageError: the lattice would be too large, the level of the ellipsoids is invalid, or an option does
            not apply to the vehicle.
    """
    if config.radius_m is None:
        config = resolve_plan(config, vehicle)
    if mission is None:
        mission = mission_of(config)
    passages = passages_of(mission, config)
    limits = motion_limits(config, vehicle, turns=is_turning(mission) and not config.straight)
    if space is None:
        space = plan_space(config, cover, scene, image, within, jobs=jobs)
    if within is not None:
        points = [(each.name, each.point) for each in passages if not each.is_gate]
        ends = [(name, point) for name, point in (("start", config.start), ("goal", config.goal)) if point]
        require_seen(within, [*ends[:1], *points, *ends[1:]])
    if config.straight:
        if mission.passes or mission.zones:
            raise UsageError("--straight leads from --start to --goal, without a mission")
        return straight_plan(config, space, limits, vehicle.name, jobs=jobs)
    path = find_polyline(config, space, passages, jobs=jobs, progress=progress)
    if within is not None:
        names = ["start", *(each.name for each in passages), "goal"]
        require_seen(within, list(zip(names, path.flown, strict=True)))
    zones = [Zone.of(table) for table in mission.zones]
    path = _split(path, zones)

    def solve(cells: Corridor) -> Curve:
        number = {int(i): j - 1 for j, i in enumerate(cells.chosen)}  # of the joint at a point of the path
        holds = {
            number[i]: each.table.hold_s
            for i, each in zip(path.at, passages, strict=True)
            if each.table.hold_s
        }
        return curve_along(cells, config, limits, space, hold_s=holds, motion=motion, jobs=jobs)

    def headed(cells: Corridor, along: Curve) -> tuple[list[PlanPass], FloatArray, float | None]:
        passes = [
            _record(each, float(along.time[i]), point)
            for each, i, point in zip(passages, _passed(along, cells, path), path.flown[1:-1], strict=True)
        ]
        return passes, *_heading(mission, passages, passes, along.time, along.coefficient(), limits)

    led: set[int] = set()  # passages that the first curves only touched
    for _ in range(_ROUNDS):
        corridor = corridor_around(path, passages, space, zones, led=led, jobs=jobs)
        curve, acting = solve(corridor), 0
        if behind is not None and motion is None:
            corridor, curve, acting = slowed(
                corridor, curve, behind, config.speed_m_s, lambda *flown: headed(*flown)[1], solve
            )
        touched = _touched(curve, _passed(curve, corridor, path), passages)
        if not touched:
            break
        led |= touched
    else:
        name = passages[min(touched)].name
        raise InfeasibleError(
            f"no curve was found that flies through {name} and does not only touch its plane"
        )
    time, coefficient = curve.time, curve.coefficient()
    proof = certify_in(time, coefficient, space, jobs=jobs)

    dense = evaluate(time, coefficient, _sample_times(time))
    bound = float(proof.clearance_m.min(initial=2 * space.keep_m))
    knot = np.concatenate([curve.point[:, 0], curve.point[-1:, -1]])
    passes, yaw, off_rad = headed(corridor, curve)
    headings = evaluate(time, yaw, time)
    return make_artifact(
        PLAN,
        {
            "time": time,
            "coefficient": np.concatenate([coefficient, yaw], axis=1),
            "waypoint": np.column_stack([knot, headings]),
            "cell_normal": corridor.normal,
            "cell_offset": corridor.offset,
            "cell_start": corridor.start,
            "piece_cell": _cells_of(time, coefficient, curve, corridor),
        },
        frame=space.frame,
        unit="m",
        **claimed(config, space, limits),
        via_m=[curve.point[i, 0].tolist() for i in _passed(curve, corridor, path)],
        passes=passes,
        zones=[PlanZone(box_m=list(each.box_m), speed_m_s=each.speed_m_s) for each in mission.zones],
        method=METHOD_FASTEST if (curve.cell >= 0).all() else f"{METHOD_FASTEST}; {METHOD_STRAIGHT}",
        vehicle=vehicle.name,
        certificate={
            "method": methods(space),
            "pieces": len(coefficient),
            "checked_pairs": proof.pairs,
            "depth": proof.depth,
            "min_proven_clearance_m": bound,
        },
        summary={
            "length_m": float(np.linalg.norm(np.diff(dense, axis=0), axis=1).sum()),
            "straight_m": sum(math.dist(a, b) for a, b in pairwise(path.flown)),
            "duration_s": float(time[-1]),
            "pieces": len(coefficient),
            "cells": len(corridor.start) - 1,
            "stops": int(curve.stop[:-1].sum()),
            "min_clearance_m": space.clearance_m(dense, jobs),
            "max_speed_m_s": float(peak_bounds(time, coefficient, 1).max()),
            "max_acceleration_m_s2": float(peak_bounds(time, coefficient, 2).max()),
            **({} if off_rad is None else {"max_heading_error_rad": off_rad}),
            "resolution_m": path.resolution_m,
            "lattice_points": path.lattice_points,
            "visited_points": path.visited,
            **({"notes": notes} if (notes := _notes(path, behind, acting)) else {}),
        },
        guarantee=proven(
            space,
            limits,
            config.beyond_map_m,
            **({} if within is None else {"within_seen_space": True}),
        ),
    )


def corridor_around(
    path: Polyline,
    passages: Sequence[Passage],
    space: PlanSpace,
    zones: Sequence[Zone] = (),
    *,
    led: Collection[int] = (),
    jobs: int = 0,
) -> Corridor:
    """The corridor of a plan.

    Args:
        passages: waypoints and gates, in their order.
        zones: boxes with a lower top speed.
        led: passages through gates before and behind which a curve passes also near the points between
            which the path is straight; without this it may only touch the plane of the gate.
    """
    marks = np.zeros(len(path.point), np.bool_)
    marks[list(path.at)] = True
    room = {i: each.opening for i, each in zip(path.at, passages, strict=True) if each.opening is not None}
    gates = [(k, each) for k, each in enumerate(passages) if each.is_gate]
    for number, (k, each) in enumerate(gates):
        if k not in led or each.opening is None:
            continue
        for i in path.beside[2 * number : 2 * number + 2]:  # those of zones follow
            reach_m = abs(float((path.point[i] - each.opening.centre) @ each.opening.normal))
            marks[i] = True
            room[i] = Opening(path.point[i], np.zeros(3), max(reach_m - _LED * THROUGH_M, _LEAST_ROOM_M))
    box = (path.lower, path.upper)
    return find_corridor(
        *(path.point, marks, space.solids(), space.keep_m, box),
        kept=path.beside,
        opening=room,
        zones=zones,
        jobs=jobs,
    )


def _touched(curve: Curve, at: Sequence[int], passages: Sequence[Passage]) -> set[int]:
    """Numbers of the gates whose planes the stored curve does not cross, where the pieces `at` begin."""
    gates = [
        (k, i, each.opening) for k, (i, each) in enumerate(zip(at, passages, strict=True)) if each.is_gate
    ]
    if not gates:
        return set()
    duration = [b - a for a, b in pairwise(map(Fraction, curve.time.tolist()))]
    pieces = [control_fractions(c, t) for c, t in zip(curve.coefficient(), duration, strict=True)]
    return {
        k
        for k, i, disc in gates
        if disc is None or not is_crossed(pieces, i, disc.centre.tolist(), disc.normal.tolist())
    }


def _split(path: Polyline, zones: Sequence[Zone]) -> Polyline:
    """The same path with further corners at zones."""
    if not zones:
        return path
    point, index, further = split_at(path.point, zones)
    at, beside = (tuple(index[list(each)].tolist()) for each in (path.at, path.beside))
    return dataclasses.replace(path, point=point, at=at, beside=(*beside, *further))


def _heading(
    mission: Mission,
    passages: Sequence[Passage],
    passes: Sequence[PlanPass],
    time: FloatArray,
    coefficient: FloatArray,
    limits: Limits,
) -> tuple[FloatArray, float | None]:
    """Coefficients of the heading, shape (K, 1, 8), and its largest error; None for a constant one."""
    if not is_turning(mission):
        yaw = np.zeros((len(coefficient), 1, DEGREE + 1))
        yaw[:, 0, 0] = constant_heading(mission)
        return yaw, None
    legs = [
        Leg(each.time_s + each.hold_s, one.table, each.time_s - FIRM_S)
        if has_heading(one.table)
        else Leg(each.time_s + each.hold_s, mission, each.time_s if each.hold_s else math.inf)
        for one, each in zip(passages, passes, strict=True)
    ]
    found, off = heading_along(time, coefficient, [*legs, Leg(float(time[-1]), mission)], limits)
    return found[:, None], off


def _record(passage: Passage, time_s: float, point: Point) -> PlanPass:
    """A passage for the manifest; of a waypoint that was moved, where it is."""
    opening = passage.opening
    is_gate = passage.is_gate and opening is not None
    return PlanPass(
        kind="gate" if is_gate else "waypoint",
        number=passage.number,
        lap=passage.lap,
        time_s=time_s,
        point_m=list(passage.point if is_gate else point),
        normal=opening.normal.tolist() if is_gate and opening is not None else [],
        radius_m=passage.table.radius_m or 0.0,
        tolerance_m=passage.table.tolerance_m,
        hold_s=passage.table.hold_s,
    )


def _passed(curve: Curve, corridor: Corridor, path: Polyline) -> list[int]:
    """Pieces that begin at the passages, in their order."""
    first = {int(i): int(np.flatnonzero(curve.segment == j)[0]) for j, i in enumerate(corridor.chosen[:-1])}
    return [first[i] for i in path.at]


def _notes(path: Polyline, behind: Behind | None, acting: int) -> list[str]:
    notes = []
    if behind is not None and acting:
        notes.append(f"{behind.name} still acts in {acting} ticks of a flight along the plan")
    return notes + [
        f"the {name} ({exact(given)}) is not free; the plan has ({exact(taken)}), "
        f"{at_most(math.dist(given, taken))} m from it (--nearest-free)"
        for name, given, taken in path.moved
    ]


def curve_along(
    corridor: Corridor,
    config: PlanConfig,
    limits: Limits,
    space: PlanSpace,
    *,
    hold_s: Mapping[int, float] | None = None,
    motion: MovingState | None = None,
    jobs: int = 0,
) -> Curve:
    """The fastest curve along a corridor, proven in its stored form, as `plan` describes it.

    Args:
        corridor: around a path that keeps the radius.
        config: with a radius.
        hold_s: times to rest at joints, by their numbers [s].
        motion: of the vehicle at the start; at rest if none.

    Raises:
        InfeasibleError: a straight line cannot be proven, or no curve leads from this motion.
    """
    return _Task(config, limits, corridor, space, jobs).curve(motion, hold_s or {})


@dataclass(frozen=True, slots=True)
class _Task:
    """What all parts of a curve have in common."""

    config: PlanConfig
    limits: Limits
    corridor: Corridor
    space: PlanSpace
    jobs: int

    def curve(self, motion: MovingState | None, hold_s: Mapping[int, float]) -> Curve:
        """A proven curve along the corridor, with stops where it is closed or holds."""
        stops = ~self.corridor.is_open
        stops[list(hold_s)] = True
        closed = (np.flatnonzero(stops) + 1).tolist()
        curves: list[Curve] = []
        for begin, end in pairwise([0, *closed, len(self.corridor.start) - 1]):
            moving = motion if begin == 0 else None
            fastest = self.fastest(range(begin, end), moving)
            if fastest is None and moving is not None:
                raise InfeasibleError(
                    "no curve leads from this motion along the path within the limits; start slower, or "
                    "raise --acceleration"
                )
            if begin - 1 in hold_s:
                curves.append(hold_curve(self.corridor.point[begin], hold_s[begin - 1], begin))
            curves += self.straight(range(begin, end)) if fastest is None else [fastest]
        return joined(curves)

    def fastest(self, cells: range, motion: MovingState | None) -> Curve | None:
        """Through open cells in minimum time, with few or more pieces; None if that is not proven."""
        if not self.corridor.is_free[cells.start : cells.stop].all():
            return None
        for pieces in PIECES_PER_CELL:
            curve = fastest_curve(
                self.corridor,
                cells,
                self.limits,
                pieces,
                start=motion,
                smooth=self.config.smooth,
            )
            if curve is not None and self.is_proven(curve):
                return curve
        return None

    def straight(self, segments: range) -> list[Curve]:
        """Straight lines along the segments."""
        corner = self.corridor.point
        curves = [
            straight_curve(corner[i], corner[i + 1], self.limits_in(i), self.config.smooth, i)
            for i in segments
        ]
        if not all(self.is_proven(curve) for curve in curves):
            raise InfeasibleError("a straight part of the path cannot be proven clear; use a larger --radius")
        return curves

    def limits_in(self, segment: int) -> Limits:
        """Limits on a segment, with those of the zones that it touches."""
        if self.corridor.speed is None or self.corridor.speed[segment] >= self.limits.speed_m_s:
            return self.limits
        return dataclasses.replace(self.limits, speed_m_s=float(self.corridor.speed[segment]))

    def is_proven(self, curve: Curve) -> bool:
        """Whether the stored form of a curve keeps the radius and the limits."""
        time, coefficient = curve.time, curve.coefficient()
        points = control_points(time, coefficient).transpose(0, 2, 1)
        speed = None if self.corridor.speed is None else self.corridor.speed[curve.segment]
        if not keeps(points, np.diff(time), self.limits, speed).all():
            return False
        return certify_in(time, coefficient, self.space, jobs=self.jobs).holds


def _cells_of(
    time: FloatArray, coefficient: FloatArray, curve: Curve, corridor: Corridor
) -> NDArray[np.int64]:
    """Cell of each piece that lies in it as stored, beyond rounding, else -1; shape (K,)."""
    points = control_points(time, coefficient).transpose(0, 2, 1)
    cell = curve.cell.copy()
    for i in np.flatnonzero(cell >= 0):
        normal, offset = corridor.rows(cell[i])
        slack = 2.0**-48 * (1 + np.abs(points[i]).max())
        if not (points[i] @ normal.T <= offset - slack).all():
            cell[i] = -1
    return cell


def _sample_times(time: FloatArray) -> FloatArray:
    """64 instants per piece, and the end."""
    return np.append((time[:-1, None] + np.diff(time)[:, None] * (np.arange(64) / 64)).reshape(-1), time[-1])
