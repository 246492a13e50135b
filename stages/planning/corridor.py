"""Corridor along a path: convex cells that are free of obstacles at a radius, and where they meet."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.stages.clearance import segment_clearance
from alula.stages.planning.opening import Opening
from alula.stages.planning.zones import Zone, touched

_REACH_M = 1.5  # of a cell beyond its segment
_COMFORT = 1.5  # times the radius: distance that cells keep where there is room
_SHARE = 0.75  # of what a segment keeps beyond the radius, for its cell; the rest is room to move in
_MARGIN_M = 1e-9  # that a segment keeps beyond the distance of its cell; that of the path is as large
_OVERLAP_M = 0.02  # of the parts of a cell beyond the plane where it was cut
_ROOM = (0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4, 1e-5, 1e-6)  # of a joint within its two cells, in radii
METHOD = "half-spaces at the radius, separated by duality"

Obstacles = _core.PolytopeSet | _core.EllipsoidSet


class Kept(NamedTuple):
    """Obstacles, and the distance beyond the radius that is kept from them [m]."""

    obstacles: Obstacles
    beyond_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Corridor:
    """Cells {x : normal . x <= offset}, row-compressed, along a path.

    Attributes:
        normal: shape (R, 3), unit length, world frame.
        offset: shape (R,) [m].
        start: first row of each cell, and the end, shape (C + 1,).
        point: ends of the segments that the cells were made around, shape (C + 1, 3) [m].
        joint: points of two consecutive cells, shape (C - 1, 3) [m]: strictly inside of both where `is_open`,
            else ends of segments.
        is_open: shape (C - 1,).
        is_via: whether the joint is a point to pass, shape (C - 1,).
        is_free: whether a segment is in its cell, as it is where it keeps the radius, shape (C,).
        opening: of joints that are vias with room about them, by number of the joint.
        speed: top speed in each cell [m/s], infinite where it touches no zone, shape (C,); None without any.
        chosen: indices of `point` in the path that the corridor was made around, shape (C + 1,).
    """

    normal: FloatArray
    offset: FloatArray
    start: NDArray[np.int64]
    point: FloatArray
    joint: FloatArray
    is_open: NDArray[np.bool_]
    is_via: NDArray[np.bool_]
    is_free: NDArray[np.bool_]
    opening: Mapping[int, Opening] = field(default_factory=dict)
    speed: FloatArray | None = None
    chosen: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def rows(self, cell: int) -> tuple[FloatArray, FloatArray]:
        """Normals and offsets of a cell."""
        part = slice(int(self.start[cell]), int(self.start[cell + 1]))
        return self.normal[part], self.offset[part]


def native_sets(obstacles: Sequence[Obstacles]) -> tuple[list[_core.PolytopeSet], list[_core.EllipsoidSet]]:
    """Hulls and ellipsoids of a mixed list, for the native functions."""
    return (
        [each for each in obstacles if isinstance(each, _core.PolytopeSet)],
        [each for each in obstacles if isinstance(each, _core.EllipsoidSet)],
    )


def find_corridor(
    point: ArrayLike,
    is_via: ArrayLike,
    kept_from: Sequence[Kept],
    radius_m: float,
    bounds: tuple[FloatArray, FloatArray],
    *,
    kept: Sequence[int] = (),
    opening: Mapping[int, Opening] | None = None,
    zones: Sequence[Zone] = (),
    jobs: int = 0,
) -> Corridor:
    """Make a corridor along a path whose segments keep `radius_m`.

    Points of the path that a straight line can pass by are left out first, from the start on, as far as the
    line keeps as much as they do, up to a comfortable distance, 1.5 times the radius. Each remaining segment
    gets a cell by `corridor_cells`. Of what the segment keeps beyond the radius every point of the cell
    keeps three quarters, up to the comfortable distance; the rest is room to move in.

    Args:
        point: the path, shape (W, 3) [m].
        is_via: points that must stay, shape (W,); both ends do.
        radius_m: distance to keep, from those without a larger one [m].
        bounds: corners of the box that contains the path and will contain the cells [m].
        kept: indices of further points of the path that must stay, but need not be passed.
        opening: room of points that must stay, by their index; before and behind a disc the path is on its
            two sides.
        zones: boxes with a lower top speed; cells of segments that touch none do not touch it either.
    """
    path, passed = np.asarray(point, np.float64), np.array(is_via, np.bool_)
    stays = passed.copy()
    stays[[0, -1, *kept]] = True
    comfort = _COMFORT * radius_m
    chosen = _merged(path, stays, kept_from, comfort, zones, jobs)
    corner, via = path[chosen], passed[chosen][1:-1]
    room = {j: opening[i] for j, i in enumerate(chosen[1:-1]) if i in opening} if opening else {}
    begin, end = np.ascontiguousarray(corner[:-1]), np.ascontiguousarray(corner[1:])
    lower, upper = (np.asarray(side, np.float64).tolist() for side in bounds)
    own = _clearance(begin, end, kept_from, radius_m + (comfort - radius_m) / _SHARE, jobs)
    kept_m = radius_m + np.maximum(_SHARE * (own - radius_m) - _MARGIN_M, 0)
    normals, offsets, lengths, free = [], [], [], []
    speed = np.full(len(begin), np.inf)
    for i, distance in enumerate(kept_m.tolist()):
        cell = [
            _core.corridor_cells(
                *native_sets([each.obstacles for each in kept_from if each.beyond_m == beyond]),
                begin[i : i + 1],
                end[i : i + 1],
                distance + beyond,
                _REACH_M,
                lower,
                upper,
                1,
            )
            for beyond in sorted({each.beyond_m for each in kept_from})
        ]
        rows_of, offsets_of = (
            np.concatenate([each[0] for each in cell]),
            np.concatenate([each[1] for each in cell]),
        )
        for zone in zones:
            plane = None if zone.part(begin[i], end[i]) else zone.plane_beside(begin[i], end[i])
            if plane is None:
                speed[i] = min(speed[i], zone.speed_m_s)
            elif not zone.is_beside(rows_of, offsets_of):
                rows_of, offsets_of = np.vstack([rows_of, plane[0]]), np.append(offsets_of, plane[1])
        normals.append(rows_of)
        offsets.append(offsets_of)
        lengths.append(len(offsets_of))
        free.append(all(bool(each[3][0]) for each in cell))
    normal, offset = np.concatenate(normals), np.concatenate(offsets)
    start = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    rows = [slice(a, b) for a, b in pairwise(start.tolist())]
    joint, is_open = corner[1:-1].copy(), np.zeros(len(corner) - 2, np.bool_)
    for i in range(len(joint)):
        a = np.concatenate([normal[rows[i]], normal[rows[i + 1]]])
        b = np.concatenate([offset[rows[i]], offset[rows[i + 1]]])
        if via[i]:
            is_open[i] = (b - a @ joint[i]).min() >= _ROOM[-1] * radius_m
            continue
        for j, sign in ((i - 1, -1.0), (i + 1, 1.0)):  # behind a disc, and before one
            if j in room and room[j].is_disc:
                a = np.vstack([a, sign * room[j].normal])
                b = np.append(b, sign * room[j].normal @ room[j].centre)
        found = _inner_point(a, b, joint[i], radius_m)
        if found is not None:
            joint[i], is_open[i] = found, True
    return Corridor(
        *(normal, offset, start, corner, joint, is_open, via, np.array(free, np.bool_), room),
        speed if zones else None,
        np.array(chosen, np.int64),
    )


def _merged(
    path: FloatArray,
    kept: NDArray[np.bool_],
    kept_from: Sequence[Kept],
    comfort_m: float,
    zones: Sequence[Zone],
    jobs: int,
) -> list[int]:
    """Indices of the points between which straight lines keep enough, each as far on as possible.

    A line touches a zone only where the path that it stands for does.
    """
    slow = touched(path[:-1], path[1:], zones)
    own = _clearance(path[:-1], path[1:], kept_from, comfort_m, jobs)
    chosen = [0]
    while chosen[-1] < len(path) - 1:
        at = chosen[-1]
        last = at + 1 + int(np.flatnonzero(kept[at + 1 :])[0])
        ends = path[at + 1 : last + 1]
        begin = np.repeat(path[at : at + 1], len(ends), axis=0)
        least = np.minimum.accumulate(own[at:last])  # of the segments that a line stands for
        clear = _clearance(begin, ends, kept_from, comfort_m, jobs) >= least - 1e-12
        clear &= np.logical_or.accumulate(slow[at:last]) | ~touched(begin, ends, zones)
        chosen.append(at + 1 + int(np.flatnonzero(clear)[-1]))
    return chosen


def _clearance(
    begin: FloatArray, end: FloatArray, kept_from: Sequence[Kept], cap_m: float, jobs: int
) -> FloatArray:
    """Distance of segments to the nearest obstacle, less what is kept beyond the radius, at most the cap;
    shape (S,) [m].
    """
    found = np.full(len(begin), cap_m)
    for obstacles, beyond in kept_from:
        found = np.minimum(found, segment_clearance(begin, end, obstacles, jobs, cap_m + beyond) - beyond)
    return found


def _inner_point(a: FloatArray, b: FloatArray, near: FloatArray, radius_m: float) -> FloatArray | None:
    """The point nearest to another that is as deep in {x : a x <= b} as one of a few depths, if any."""
    solver = _core.QpSolver()
    rows = np.ascontiguousarray(-a)
    for room in _ROOM:
        bounds = np.ascontiguousarray(a @ near - b + room * radius_m)
        result = solver.solve(np.eye(3), np.zeros(3), rows, bounds)
        inner = near + np.asarray(result.x)
        if result.status == 0 and (b - a @ inner).min() >= 0.5 * room * radius_m:
            return np.asarray(inner)
    return None


def divided(corridor: Corridor, cells: ArrayLike, length_m: float) -> tuple[Corridor, NDArray[np.int64]]:
    """Cut some cells of a corridor across, into parts about segments of at most a length.

    A part is the cell between two planes across its segment; neighbours overlap by 4 cm.

    Args:
        cells: to cut; one without room about its segment, or with a short one, stays as it is.
        length_m: of the segments [m].

    Returns:
        The corridor, and the cell of the given one that each of its cells is a part of, shape (C,).
    """
    cut = set(np.asarray(cells).tolist())
    normals, offsets, points, joints, opens, vias, parts = [], [], [corridor.point[0]], [], [], [], []
    for i, (a, b) in enumerate(pairwise(corridor.point)):
        along = b - a
        length = float(np.linalg.norm(along))
        count = max(1, int(np.ceil(length / length_m))) if i in cut and corridor.is_free[i] else 1
        normal, offset = corridor.rows(i)
        for k in range(count):
            end = a + (k + 1) / count * along
            ends = [(-along / length, a + k / count * along)] if k > 0 else []
            ends += [(along / length, end)] if k + 1 < count else []
            normals.append(np.concatenate([normal, np.reshape([n for n, _ in ends], (-1, 3))]))
            offsets.append(np.concatenate([offset, [n @ q + _OVERLAP_M for n, q in ends]]))
            parts.append(i)
            last = k + 1 == count
            points.append(b if last else end)
            if i + 1 < len(corridor.point) - 1 or not last:
                joints.append(corridor.joint[i] if last else end)
                opens.append(bool(corridor.is_open[i]) if last else True)
                vias.append(bool(corridor.is_via[i]) if last else False)
    part = np.array(parts, np.int64)
    first = np.searchsorted(part, np.arange(len(corridor.start) - 1))  # part of each cell
    chosen = np.full(len(part) + 1, -1)
    if len(corridor.chosen):
        chosen[first], chosen[-1] = corridor.chosen[:-1], corridor.chosen[-1]
    return Corridor(
        np.concatenate(normals),
        np.concatenate(offsets),
        np.concatenate([[0], np.cumsum([len(each) for each in offsets])]).astype(np.int64),
        np.array(points),
        np.array(joints).reshape(-1, 3),
        np.array(opens, np.bool_),
        np.array(vias, np.bool_),
        corridor.is_free[part],
        {int(first[i + 1]) - 1: each for i, each in corridor.opening.items()},
        None if corridor.speed is None else corridor.speed[part],
        chosen,
    ), part
