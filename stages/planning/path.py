"""Polyline for a ball from point to point among hulls: lattice search, shortcuts, rounded corners."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from alula._core import MAX_LATTICE_POINTS, PolytopeSet, SearchStatus, find_path, tighten_path
from alula.schemas.arrays import FloatArray
from alula.schemas.configs.plan import PlanConfig, Point
from alula.schemas.errors import InfeasibleError, UsageError
from alula.schemas.progress import Progress
from alula.stages.clearance import path_clearance, segment_clearance

_MARGIN_M = 1e-9  # that paths keep beyond the radius, so that the proof of a line is never marginal
_DEFAULT_LATTICE = 4_000_000  # points of the lattice when its spacing is not given
_COMFORT = 1.0  # distance beyond the radius, in radii, below which a path costs more
_TIGHTEN_ROUNDS = 3
_RELAX_ROUNDS = 10
_WAYPOINT_RADII = 3.0  # between waypoints, in radii
_WAYPOINT_MIN_M = 0.3


@dataclass(frozen=True, slots=True)
class Polyline:
    """Path of straight segments that keep the radius.

    Attributes:
        point: shape (W, 3), world frame [m].
        lower, upper: corners of the searched box, shape (3,) [m]; it contains the path.
        resolution_m: spacing of the search lattice [m].
        lattice_points: number of its points.
        visited: number of points that the searches visited, over all legs.
    """

    point: FloatArray
    lower: FloatArray
    upper: FloatArray
    resolution_m: float
    lattice_points: int
    visited: int


def find_polyline(
    config: PlanConfig, obstacles: PolytopeSet, *, jobs: int = 0, progress: Progress | None = None
) -> Polyline:
    """Join the points of a flight by straight segments that keep `radius_m` from every hull, exactly.

    A leg is the straight line when its clearance is comfortable. Otherwise an A* search runs on a lattice
    whose edges are proven free. Its path is shortcut, and points every three radii are moved towards the
    middle of their neighbours as long as both segments stay free, which rounds the corners.

    Args:
        config: see `PlanConfig`.
        obstacles: hulls in a search tree.
        jobs: threads, 0 for all processors; the result does not depend on it.
        progress: called with (points visited, 0); 0 stands for an unknown total.

    Raises:
        InfeasibleError: a point is too close to a hull, or there is no path at this resolution.
        UsageError: the lattice would be too large.
    """
    _check_points(config, obstacles)
    lower, upper = _bounds(config, obstacles)
    origin, spacing, count = _lattice(config, lower, upper)
    names = ["--start", *(f"--via {i + 1}" for i in range(len(config.via))), "--goal"]
    legs, visited = [np.array([config.start])], 0
    for i, ends in enumerate(pairwise(config.points)):
        leg, expanded = _leg(
            config, obstacles, origin, spacing, count, ends, (names[i], names[i + 1]), jobs, progress
        )
        legs.append(_rounded(config, obstacles, leg, jobs)[1:])
        visited += expanded
    point = np.concatenate(legs)
    if not (path_clearance(point, obstacles, jobs=jobs, cap_m=config.keep_m) >= config.keep_m).all():
        raise InfeasibleError("the straight path is not clear; use another --resolution")
    return Polyline(point, lower, upper, spacing, math.prod(count), visited)


def _check_points(config: PlanConfig, obstacles: PolytopeSet) -> None:
    """Raise InfeasibleError with the point of the flight that is too close to a hull."""
    names = ["start", *["intermediate point"] * len(config.via), "goal"]
    for name, point in zip(names, config.points, strict=True):
        distance = float(path_clearance([point], obstacles, cap_m=config.keep_m + 1)[0])
        if distance >= config.keep_m + _MARGIN_M:
            continue
        where = f"the {name} ({' '.join(f'{x:g}' for x in point)})"
        if distance <= 0:
            raise InfeasibleError(f"{where} is inside an obstacle, {-distance:.3g} m deep")
        raise InfeasibleError(
            f"{where} is {distance:.6g} m from an obstacle, and the plan must keep {config.keep_m:g} m "
            "(--radius)"
        )


def _bounds(config: PlanConfig, obstacles: PolytopeSet) -> tuple[FloatArray, FloatArray]:
    """Corners of the box to search: the given one, or one around hulls and points with room to pass."""
    if config.bounds is not None:
        return np.array(config.bounds[:3]), np.array(config.bounds[3:])
    corners = [np.array(config.points), *(np.array([side]) for side in obstacles.bounds() if len(obstacles))]
    every = np.concatenate(corners)
    room = (2 + _COMFORT) * config.keep_m
    return every.min(axis=0) - room, every.max(axis=0) + room


def _lattice(
    config: PlanConfig, lower: FloatArray, upper: FloatArray
) -> tuple[FloatArray, float, tuple[int, int, int]]:
    """First point, spacing and number of points of the search lattice; the start lies on it."""
    size = upper - lower
    spacing = config.resolution_m
    if spacing is None:
        spacing = max(config.keep_m / 2, float(np.prod(size) / _DEFAULT_LATTICE) ** (1 / 3))
    before = np.floor((np.array(config.start) - lower) / spacing)
    steps = before + np.floor((upper - np.array(config.start)) / spacing)
    if not np.prod(steps + 1) <= MAX_LATTICE_POINTS:
        raise UsageError(
            f"a resolution of {spacing:g} m needs {np.prod(steps + 1):.3g} lattice points, more than "
            f"{MAX_LATTICE_POINTS:,}; use a larger --resolution"
        )
    nx, ny, nz = (int(n) + 1 for n in steps)
    return np.array(config.start) - before * spacing, spacing, (nx, ny, nz)


def _leg(
    config: PlanConfig,
    obstacles: PolytopeSet,
    origin: FloatArray,
    spacing: float,
    count: tuple[int, int, int],
    ends: tuple[Point, Point],
    names: tuple[str, str],
    jobs: int,
    progress: Progress | None,
) -> tuple[FloatArray, int]:
    """Short polyline between two points whose segments keep the radius, and number of points visited."""
    radius, comfort = config.keep_m + _MARGIN_M, _COMFORT * config.keep_m
    if path_clearance(ends, obstacles, cap_m=radius + comfort)[0] >= radius + comfort:
        return np.array(ends), 0
    # The number of points that the search will visit is unknown, and far below that of the lattice.
    visited = None if progress is None else lambda done, _: progress(done, 0)
    status, path, expanded = find_path(
        obstacles, origin.tolist(), spacing, count, *ends, radius, comfort, visited
    )
    finer = f"a --resolution below {spacing:.3g} m may find one"
    if status == SearchStatus.start_isolated:
        raise InfeasibleError(f"no straight line leads from {names[0]} to the search lattice; {finer}")
    if status == SearchStatus.goal_isolated:
        raise InfeasibleError(f"no straight line leads from the search lattice to {names[1]}; {finer}")
    if status == SearchStatus.no_path:
        raise InfeasibleError(f"no path from {names[0]} to {names[1]} keeps the radius; {finer}")
    return tighten_path(obstacles, path, radius, comfort, spacing, _TIGHTEN_ROUNDS, jobs), expanded


def _rounded(config: PlanConfig, obstacles: PolytopeSet, leg: FloatArray, jobs: int) -> FloatArray:
    """The leg with additional points, moved towards their neighbours where that stays free."""
    spacing = max(_WAYPOINT_MIN_M, _WAYPOINT_RADII * config.keep_m)
    parts = [leg[:1]]
    for a, b in pairwise(leg):
        pieces = max(1, math.ceil(np.linalg.norm(b - a) / spacing - 1e-9))
        fraction = np.arange(1, pieces + 1)[:, None] / pieces
        parts.append((1 - fraction) * a + fraction * b)
    point = np.concatenate(parts)
    # Moves may reduce the clearance to this, and not at all below it.
    enough = 1.25 * config.keep_m
    radius = config.keep_m + _MARGIN_M

    def clearance(before: FloatArray, middle: FloatArray, after: FloatArray) -> FloatArray:
        return np.minimum(
            segment_clearance(before, middle, obstacles, jobs, enough),
            segment_clearance(middle, after, obstacles, jobs, enough),
        )

    for step in range(2 * _RELAX_ROUNDS):
        i = np.arange(1 + step % 2, len(point) - 1, 2)
        before, here, after = point[i - 1], point[i], point[i + 1]
        moved = 0.25 * before + 0.5 * here + 0.25 * after
        kept = np.minimum(clearance(before, here, after), enough)
        good = clearance(before, moved, after) >= np.maximum(kept, radius)
        point[i[good]] = moved[good]
    return point
