"""Triangulation of the facets of a cover's polytopes, in integers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import IntArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import ArtifactError
from alula.stages.compression.hulls import is_outer, outer_solids

_CHUNK = 2**20  # pairs processed together


@dataclass(frozen=True, slots=True)
class Mesh:
    """Closed triangle meshes, one per hull, row-compressed.

    Attributes:
        points_voxel: corners, shape (P, 3) [voxel edges]; integers wherever `exact`.
        point_start: first point of each hull and the end, shape (n + 1,).
        triangles: rows of `points_voxel`, counter-clockwise from outside, shape (T, 3).
        triangle_start: first triangle of each hull and the end, shape (n + 1,).
        exact: True where the mesh equals the hull; False where corners are not lattice points and were
            rounded, shape (n,).
    """

    points_voxel: NDArray[np.float64]
    point_start: IntArray
    triangles: IntArray
    triangle_start: IntArray
    exact: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.point_start) - 1


def mesh(cover: Artifact) -> Mesh:
    """Triangulate the boundary of every polytope {x : normal . x <= offset} of an `alula/cover`.

    A hull has its lattice vertices as corners and is triangulated by `triangles`. The corners of an outer
    polytope are computed exactly from its planes and then rounded.

    Raises:
        ArtifactError: the planes of a hull bound no solid.
    """
    if is_outer(cover):
        solid = outer_solids(cover)
        return Mesh(
            solid["point"],
            solid["point_start"],
            solid["triangle"],
            solid["triangle_start"],
            solid["is_lattice"].astype(np.bool_),
        )
    found, start = triangles(cover)
    if len(open_hulls := np.flatnonzero(np.diff(start) == 0)):
        raise ArtifactError(f"hull {open_hulls[0]}: its planes are not the facets of its vertices")
    vertex_start = np.asarray(cover["vertex_start"], np.int64)
    exact = np.ones(len(start) - 1, np.bool_)
    return Mesh(np.asarray(cover["vertex"], np.float64), vertex_start, found, start, exact)


def triangles(cover: Artifact) -> tuple[IntArray, IntArray]:
    """Triangulate each hull of an `alula/cover` over its own vertices.

    The corners of a facet are the vertices v with normal . v = offset. Projected along the axis of the
    normal's largest component they are sorted by angle around the lexicographically smallest of them. All
    comparisons are signs of 2x2 determinants of differences, exact in 64 bits for hulls up to 2^30 voxels
    wide.

    Returns:
        Rows of `vertex`, counter-clockwise from outside, shape (T, 3), and the first triangle of
        each hull and the end, shape (n + 1,). A hull whose facets do not close over its vertices
        has no triangles (see `mesh`).
    """
    plane_start = np.asarray(cover["plane_start"], np.int64)
    vertex_start = np.asarray(cover["vertex_start"], np.int64)
    vertex = np.asarray(cover["vertex"], np.int64)
    normal = np.asarray(cover["plane_normal"], np.int64)
    n = len(plane_start) - 1
    hull_of_plane = np.repeat(np.arange(n), np.diff(plane_start))
    plane, corner = _incidences(vertex, vertex_start, normal, cover["plane_offset"], hull_of_plane)
    # A point on fewer than three planes is inside a facet or an edge, not a corner.
    keep = np.bincount(corner, minlength=len(vertex))[corner] >= 3
    plane, corner = plane[keep], corner[keep]
    keep = np.bincount(plane, minlength=len(normal))[plane] >= 3
    plane, corner = plane[keep], corner[keep]
    fans, fan_plane = _fans(vertex, normal, plane, corner)
    hull = hull_of_plane[fan_plane]
    closed = _closed(fans, hull, n, len(vertex))
    fans, hull = fans[closed[hull]], hull[closed[hull]]
    return fans, _starts(np.bincount(hull, minlength=n))


def _starts(counts: NDArray[np.int64]) -> IntArray:
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)


def _groups(counts: IntArray) -> Iterator[slice]:
    """Consecutive slices of rows whose counts add up to about `_CHUNK`."""
    total = np.cumsum(counts)
    begin = 0
    while begin < len(counts):
        done = total[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(total, done + _CHUNK, side="right")))
        yield slice(begin, end)
        begin = end


def _expand(counts: IntArray) -> tuple[IntArray, IntArray]:
    """For each row, `counts` copies of its number, and 0, 1, ... beside them."""
    row = np.repeat(np.arange(len(counts)), counts)
    return row, np.arange(len(row)) - np.repeat(_starts(counts)[:-1], counts)


def _incidences(
    vertex: IntArray,
    vertex_start: IntArray,
    normal: IntArray,
    offset: NDArray[np.int64],
    hull_of_plane: IntArray,
) -> tuple[IntArray, IntArray]:
    """All pairs of a plane and a vertex of its hull on it, sorted.

    Offsets and products may wrap around 2^64; their difference, the slack, is small and so exact.
    """
    candidates = np.diff(vertex_start)[hull_of_plane]
    first = vertex_start[hull_of_plane]
    planes, corners = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for rows in _groups(candidates):
        row, offset_in_row = _expand(candidates[rows])
        at = first[rows][row] + offset_in_row
        slack = np.asarray(offset[rows], np.int64)[row]
        for axis in range(3):
            slack -= normal[rows, axis][row] * vertex[at, axis]
        on = np.flatnonzero(slack == 0)
        planes.append(row[on] + rows.start)
        corners.append(at[on])
    return np.concatenate(planes), np.concatenate(corners)


def _fans(vertex: IntArray, normal: IntArray, plane: IntArray, corner: IntArray) -> tuple[IntArray, IntArray]:
    """Triangles of each facet, as a fan around its smallest corner, and the plane of each triangle."""
    if len(plane) == 0:
        return np.empty((0, 3), np.int64), np.empty(0, np.int64)
    facet_plane, begin, size = np.unique(plane, return_index=True, return_counts=True)
    facet = np.repeat(np.arange(len(size)), size)
    direction = normal[facet_plane]
    axis = np.abs(direction).argmax(axis=1)
    mirrored = np.take_along_axis(direction, axis[:, None], 1)[:, 0] < 0
    u = vertex[corner, ((axis + 1) % 3)[facet]]
    w = vertex[corner, ((axis + 2) % 3)[facet]] * np.where(mirrored, -1, 1)[facet]
    order = np.lexsort((corner, w, u, facet))
    corner, u, w = corner[order], u[order], w[order]
    u, w = u - u[begin][facet], w - w[begin][facet]
    rank = np.empty_like(corner)
    for rows in _groups(size * size):
        count = size[rows]
        row, offset_in_row = _expand(count * count)
        a = begin[rows][row] + offset_in_row // count[row]
        b = begin[rows][row] + offset_in_row % count[row]
        turn = u[b] * w[a] - w[b] * u[a]
        before = (turn > 0) | ((turn == 0) & (b < a))
        here = slice(begin[rows][0], begin[rows][-1] + count[-1])
        rank[here] = np.bincount(a - here.start, weights=before, minlength=here.stop - here.start)
    around = np.empty_like(corner)
    around[begin[facet] + rank] = corner
    row, offset_in_row = _expand(size - 2)
    first = begin[row]
    fans = np.stack(
        [around[first], around[first + offset_in_row + 1], around[first + offset_in_row + 2]], axis=1
    )
    return fans, facet_plane[row]


def _closed(fans: IntArray, hull: IntArray, n: int, vertices: int) -> NDArray[np.bool_]:
    """Mask of the hulls in which triangles meet edge to edge, each edge once in each direction."""
    ahead, back = (fans, np.roll(fans, -1, axis=1))
    forward = np.sort((ahead * vertices + back).reshape(-1))
    backward = np.sort((back * vertices + ahead).reshape(-1))
    edge_hull = np.repeat(hull, 3)  # the keys sort by vertex, the vertices by hull
    bad = forward != backward
    bad[1:] |= forward[1:] == forward[:-1]
    closed = np.bincount(hull, minlength=n) > 0
    closed[edge_hull[bad]] = False
    return closed
