"""Polyline for a ball in a map: lattice search, widest passage, shortcuts, rounded corners."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from alula._core import (
    MAX_LATTICE_POINTS,
    ObstacleMap,
    SearchStatus,
    find_path,
    tighten_path,
    widest_passage,
)
from alula.schemas.arrays import FloatArray
from alula.schemas.decimals import at_least, at_most
from alula.schemas.errors import InfeasibleError, UsageError
from alula.schemas.parameters.configs.plan import PlanConfig, Point
from alula.schemas.progress import Progress
from alula.stages.planning.endpoints import free_points_of_flight
from alula.stages.planning.passes import Passage, mission_of, passages_of, through
from alula.stages.planning.space import PlanSpace, room_around

MARGIN_M = 1e-6  # that paths keep beyond the radius, so that the proof of a line is never marginal
_COMFORT = 1.0  # distance beyond the radius, in radii, below which a path costs more
_SPACINGS = (2.0, 1.0, 0.5)  # of the lattices that are searched in their order, in radii
_MOST_POINTS = 16_000_000  # of a lattice whose spacing is not given
_TIGHTEN_ROUNDS = 3
_RELAX_ROUNDS = 10
_WAYPOINT_RADII = 3.0  # between waypoints, in radii
_WAYPOINT_MIN_M = 0.3
_TOLERANCE = 0.02  # of the widest passage, in radii
_MOST_CELLS = 150_000  # of its search


@dataclass(frozen=True, slots=True)
class Polyline:
    """Path of straight segments that keep the radius.

    Attributes:
        point: shape (W, 3), world frame [m].
        lower, upper: corners of the searched box, shape (3,) [m]; it contains the path.
        resolution_m: spacing of the search lattice [m].
        lattice_points: number of its points.
        visited: number of lattice points and cells that the searches visited, over all legs.
        flown: points of the flight that the path joins: start, vias and points in gates, goal.
        at: indices of the vias and points in gates.
        beside: indices of the points before and behind gates, between which the path is straight.
        moved: name, given and taken position of each of them that was moved to the nearest free one.
    """

    point: FloatArray
    lower: FloatArray
    upper: FloatArray
    resolution_m: float
    lattice_points: int
    visited: int
    flown: tuple[Point, ...]
    at: tuple[int, ...]
    beside: tuple[int, ...]
    moved: tuple[tuple[str, Point, Point], ...]


@dataclass(frozen=True, slots=True)
class _Box:
    """What all legs are searched in.

    Attributes:
        lower, upper: corners of the box, shape (3,) [m].
    """

    map: ObstacleMap
    keep_m: float
    lower: FloatArray
    upper: FloatArray
    spacings: tuple[float, ...]

    @property
    def radius_m(self) -> float:
        """Distance that paths keep [m]."""
        return self.keep_m + MARGIN_M

    @property
    def comfort_m(self) -> float:
        """Distance beyond the radius below which a path costs more [m]."""
        return _COMFORT * self.keep_m

    def distance(self, start: FloatArray, end: FloatArray, upto_m: float) -> FloatArray:
        """Distance of segments, shape (S,), at most `upto_m` [m]."""
        found = self.map.segment_distance(np.ascontiguousarray(start), np.ascontiguousarray(end), upto_m)
        return np.minimum(found, upto_m)


class _Station(NamedTuple):
    """A point that the legs of a path join.

    Attributes:
        label: for messages.
        point: position [m].
        is_passed: whether it is a via or lies in a gate.
        is_straight: whether the path leads straight to it, through a gate.
    """

    label: str
    point: Point
    is_passed: bool = False
    is_straight: bool = False


def find_polyline(
    config: PlanConfig,
    space: PlanSpace,
    passages: Sequence[Passage] | None = None,
    *,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Polyline:
    """Join the points of a flight by straight segments that keep the space's distance, exactly.

    A leg is the straight line when its clearance is comfortable. Otherwise an A* search runs on a lattice
    whose edges are proven free; where that finds no path, the search for the widest passage, which is finer
    wherever it matters and ends with a path or with a bound. Paths are shortcut, and points every three radii
    are moved towards the middle of their neighbours as long as both segments stay free, which rounds the
    corners.

    Args:
        passages: waypoints and gates on the way; if None, those of the options.
        progress: called with (points visited, 0); 0 stands for an unknown total.

    Raises:
        InfeasibleError: a gate has no way through it; a point is too close to an obstacle, with the nearest
            that is not; or there is no path, with the widest passage that there is.
        UsageError: the lattice would be too large.
    """
    if passages is None:
        passages = passages_of(mission_of(config), config)
    assert config.start is not None
    assert config.goal is not None
    lower, upper = room_around(config, space, [config.start, *(each.point for each in passages), config.goal])
    stations, moved = _stations(config, space, passages, lower, upper)
    box = _Box(space.map, space.keep_m, lower, upper, _spacings(config, space.keep_m, lower, upper))
    legs, visited, at, beside = [np.array([stations[0].point])], 0, [], []
    for before, after in pairwise(stations):
        straight = np.array([before.point, after.point])
        if after.is_straight:
            leg, taken = straight, 0
            beside.append(sum(map(len, legs)) - (0 if before.is_passed else 1))
        else:
            leg, taken = _leg(box, (before.point, after.point), (before.label, after.label), progress)
            leg = _rounded(box, leg)
        legs.append(leg[1:])
        visited += taken
        if after.is_passed:
            at.append(sum(map(len, legs)) - 1)
    point = np.concatenate(legs)
    if not (box.distance(point[:-1], point[1:], box.keep_m) >= box.keep_m).all():
        raise InfeasibleError("the straight path is not clear; use another --resolution")
    count = math.prod(_lattice(box, box.spacings[-1], stations[0].point)[1])
    flown = tuple(
        each.point for i, each in enumerate(stations) if each.is_passed or i in (0, len(stations) - 1)
    )
    return Polyline(
        point, lower, upper, box.spacings[-1], count, visited, flown, tuple(at), tuple(beside), tuple(moved)
    )


def _stations(
    config: PlanConfig,
    space: PlanSpace,
    passages: Sequence[Passage],
    lower: FloatArray,
    upper: FloatArray,
) -> tuple[list[_Station], list[tuple[str, Point, Point]]]:
    """Points that the legs join, free ones, and those that were moved: see `free_points_of_flight`."""
    assert config.start is not None
    assert config.goal is not None
    radius = space.keep_m + MARGIN_M
    points = [each for each in passages if not each.is_gate]
    named = [("start", config.start), *((each.name, each.point) for each in points), ("goal", config.goal)]
    free, moved = free_points_of_flight(config, space, named, lower, upper, radius)
    of = {id(each): point for each, point in zip(points, free[1:-1], strict=True)}
    found = [_Station("--start", free[0])]
    for each in passages:
        if not each.is_gate:
            label = f"--via {each.number}" if each.laps == 1 else each.name
            found.append(_Station(label, of[id(each)], is_passed=True))
            continue
        middle, reach = through(each, space, radius)
        assert each.opening is not None
        way = reach * each.opening.normal
        before, here, behind = (tuple(p.tolist()) for p in (middle - way, middle, middle + way))
        found += [
            _Station(f"the front of {each.name}", before),
            _Station(each.name, here, is_passed=True, is_straight=True),
            _Station(f"the back of {each.name}", behind, is_straight=True),
        ]
    found.append(_Station("--goal", free[-1]))
    return found, moved


def _spacings(config: PlanConfig, keep_m: float, lower: FloatArray, upper: FloatArray) -> tuple[float, ...]:
    """Spacings of the lattices that are searched in their order [m]."""
    if config.resolution_m is None:
        least = float(np.prod(upper - lower) / _MOST_POINTS) ** (1 / 3)
        return tuple(dict.fromkeys(max(each * keep_m, least) for each in _SPACINGS))
    points = float(np.prod((upper - lower) / config.resolution_m + 1))
    if not points <= MAX_LATTICE_POINTS:
        raise UsageError(
            f"a resolution of {config.resolution_m:g} m needs {points:.3g} lattice points, more than "
            f"{MAX_LATTICE_POINTS:,}; use a larger --resolution"
        )
    return (config.resolution_m,)


def _lattice(box: _Box, spacing: float, start: Point) -> tuple[FloatArray, tuple[int, int, int]]:
    """First point and number of points of a search lattice; the start lies on it."""
    before = np.floor((np.array(start) - box.lower) / spacing)
    nx, ny, nz = (int(n) + 1 for n in before + np.floor((box.upper - np.array(start)) / spacing))
    return np.array(start) - before * spacing, (nx, ny, nz)


def _leg(
    box: _Box, ends: tuple[Point, Point], names: tuple[str, str], progress: Progress | None
) -> tuple[FloatArray, int]:
    """Short polyline between two points whose segments keep the radius, and number of points visited."""
    radius, comfort = box.radius_m, box.comfort_m
    straight = np.array(ends)
    if box.distance(straight[:1], straight[1:], radius + comfort)[0] >= radius + comfort:
        return straight, 0
    # The number of points that a search will visit is unknown, and far below that of the lattice.
    seen = None if progress is None else lambda done, _: progress(done, 0)
    visited = 0
    for spacing in box.spacings:
        origin, count = _lattice(box, spacing, ends[0])
        status, path, expanded = find_path(
            box.map, origin.tolist(), spacing, count, *ends, radius, comfort, seen
        )
        visited += expanded
        if status == SearchStatus.found:
            return tighten_path(box.map, path, radius, comfort, spacing, _TIGHTEN_ROUNDS), visited
    path, cells = _passage(box, ends, names, seen)
    spacing = box.spacings[-1]
    return tighten_path(box.map, path, radius, comfort, spacing, _TIGHTEN_ROUNDS), visited + cells


def _passage(
    box: _Box, ends: tuple[Point, Point], names: tuple[str, str], progress: Progress | None
) -> tuple[FloatArray, int]:
    """Path through the widest passage, and number of cells.

    Raises:
        InfeasibleError: it is too narrow.
    """
    lower, upper, path, narrowest, cells = widest_passage(
        box.map,
        box.lower.tolist(),
        box.upper.tolist(),
        *ends,
        box.radius_m,
        _TOLERANCE * box.keep_m,
        _MOST_CELLS,
        progress,
    )
    if lower >= box.radius_m:
        return path, cells
    what = f"no path from {names[0]} to {names[1]} keeps {box.keep_m:g} m"
    where = " ".join(f"{x:.3f}" for x in narrowest)
    if upper >= box.radius_m:
        passes = f"a radius of {at_least(lower)} m passes" if lower > 0 else "none was found"
        raise InfeasibleError(
            f"{what} at the finest resolution: {passes}, and whether {box.keep_m:g} m passes is not decided "
            f"after {cells} cells; set --bounds to a smaller box"
        )
    if lower <= 0:
        raise InfeasibleError(f"{what}: no radius above {at_most(upper)} m passes")
    raise InfeasibleError(
        f"{what}: a radius of {at_least(lower)} m would pass, and none above {at_most(upper)} m; the "
        f"narrowest place is at ({where})"
    )


def _rounded(box: _Box, leg: FloatArray) -> FloatArray:
    """The leg with additional points, moved towards their neighbours where that stays free."""
    spacing = max(_WAYPOINT_MIN_M, _WAYPOINT_RADII * box.keep_m)
    parts = [leg[:1]]
    for a, b in pairwise(leg):
        pieces = max(1, math.ceil(np.linalg.norm(b - a) / spacing - 1e-9))
        fraction = np.arange(1, pieces + 1)[:, None] / pieces
        parts.append((1 - fraction) * a + fraction * b)
    point = np.concatenate(parts)
    # Moves may reduce the clearance to this, and not at all below it.
    enough = 1.25 * box.keep_m
    kept = box.distance(point[:-1], point[1:], enough)  # of each segment
    for step in range(2 * _RELAX_ROUNDS):
        i = np.arange(1 + step % 2, len(point) - 1, 2)
        before, here, after = point[i - 1], point[i], point[i + 1]
        moved = 0.25 * before + 0.5 * here + 0.25 * after
        first, second = box.distance(before, moved, enough), box.distance(moved, after, enough)
        good = np.minimum(first, second) >= np.maximum(np.minimum(kept[i - 1], kept[i]), box.radius_m)
        i = i[good]
        point[i], kept[i - 1], kept[i] = moved[good], first[good], second[good]
    return point
