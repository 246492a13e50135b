"""Surfaces of hulls, voxels, corridors and fences: translucent faces and their edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.artifacts.artifact import Artifact
from alula.stages.compression.facets import mesh
from alula.stages.show.drawing.content import Color, Faces, Lines, Part

MOST_TRIANGLES = 200_000
_FLAT = 1 - 1e-6  # cosine between normals of one facet
_SIDES = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
# Corners of each side of the unit cube, counter-clockwise from outside.
_QUADS = np.array(
    [
        [[1, 0, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1]],
        [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]],
        [[0, 1, 0], [0, 1, 1], [1, 1, 1], [1, 1, 0]],
        [[0, 0, 0], [1, 0, 0], [1, 0, 1], [0, 0, 1]],
        [[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]],
        [[0, 0, 0], [0, 1, 0], [1, 1, 0], [1, 0, 0]],
    ]
)


@dataclass(frozen=True, slots=True)
class Solids:
    """Closed triangle meshes, row-compressed.

    Attributes:
        corners: shape (V, 3), world frame [m].
        corner_start: first corner of each solid and the end, shape (n + 1,).
        triangles: rows of `corners`, shape (T, 3).
        triangle_start: first triangle of each solid and the end, shape (n + 1,).
    """

    corners: FloatArray
    corner_start: IntArray
    triangles: IntArray
    triangle_start: IntArray

    def __len__(self) -> int:
        return len(self.corner_start) - 1

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Axis-aligned bounds of each solid: lower and upper, each of shape (n, 3) [m]."""
        if len(self) == 0:
            return np.empty((0, 3)), np.empty((0, 3))
        starts = self.corner_start[:-1]
        return (
            np.minimum.reduceat(self.corners, starts, axis=0),
            np.maximum.reduceat(self.corners, starts, axis=0),
        )

    def of(self, keep: NDArray[np.bool_]) -> tuple[FloatArray, IntArray]:
        """Corners, shape (V, 3), and triangles, shape (T, 3), of some of the solids.

        Args:
            keep: which, shape (n,).
        """
        corner = np.repeat(keep, np.diff(self.corner_start))
        renumber = np.cumsum(corner) - 1
        return self.corners[corner], renumber[
            self.triangles[np.repeat(keep, np.diff(self.triangle_start))]
        ].astype(np.int64)


def solids_of(each: Sequence[tuple[FloatArray, IntArray]]) -> Solids:
    """Join meshes of corners, shape (V, 3), and triangles, shape (T, 3)."""
    corner_start = np.cumsum([0, *(len(corners) for corners, _ in each)])
    triangle_start = np.cumsum([0, *(len(triangles) for _, triangles in each)])
    corners = np.concatenate([np.empty((0, 3)), *(corners for corners, _ in each)])
    triangles = [triangles + first for (_, triangles), first in zip(each, corner_start[:-1], strict=True)]
    return Solids(
        corners, corner_start, np.concatenate([np.empty((0, 3), np.int64), *triangles]), triangle_start
    )


def solids_of_cover(cover: Artifact) -> Solids:
    """Polytopes of an `alula/cover`.

    Raises:
        ArtifactError: the planes of one bound no solid.
    """
    found = mesh(cover)
    edge = float(cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
    return Solids(found.points_voxel * edge, found.point_start, found.triangles, found.triangle_start)


def largest(solids: Solids, maximum: int = MOST_TRIANGLES) -> NDArray[np.bool_]:
    """Mark the solids with the largest bounding boxes that have at most `maximum` triangles together."""
    counts = np.diff(solids.triangle_start)
    low, high = solids.bounds()
    order = np.argsort(-np.prod(high - low, axis=1), kind="stable")
    keep = np.zeros(len(solids), np.bool_)
    keep[order] = np.cumsum(counts[order]) <= maximum
    return keep


def edges(corners: FloatArray, triangles: IntArray) -> FloatArray:
    """Edges of a mesh between facets that are not in one plane, shape (E, 2, 3)."""
    if not len(triangles):
        return np.empty((0, 2, 3))
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    pair = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(triangles)), 3)
    order = np.lexsort((pair[:, 1], pair[:, 0]))
    pair, owner = pair[order], owner[order]
    is_twin = (pair[1:] == pair[:-1]).all(axis=1)
    is_flat = np.zeros(len(pair), np.bool_)
    dot = np.abs((normal[owner[1:]] * normal[owner[:-1]]).sum(axis=1))
    is_flat[1:] = is_twin & (dot > _FLAT)
    is_flat[:-1] |= is_flat[1:]
    is_first = np.r_[True, ~is_twin]
    found: FloatArray = corners[pair[is_first & ~is_flat]]
    return found


def drawn(
    name: str,
    corners: FloatArray,
    triangles: IntArray,
    color: Color,
    *,
    opacity: float,
    visible: bool = True,
    far_only: bool = False,
    faces_visible: bool = True,
) -> list[Part]:
    """Faces of a mesh and its edges, as two parts under one name; none for an empty mesh.

    Args:
        corners: shape (V, 3) [m].
        triangles: shape (T, 3).
        color: of the faces; edges are darker.
        far_only: as of `Faces`.
    """
    if not len(triangles):
        return []
    faces = Faces(
        name=f"{name}/faces",
        corners=corners,
        triangles=triangles,
        color=color,
        opacity=opacity,
        far_only=far_only,
        visible=visible and faces_visible,
    )
    lines = edges(corners, triangles)
    if not len(lines):
        return [faces]
    dark = (color[0] * 5 // 8, color[1] * 5 // 8, color[2] * 5 // 8)  # seen on white and on black
    return [faces, Lines(name=f"{name}/edges", segments=lines, color=dark, width_px=1.0, visible=visible)]


def surface_points(corners: FloatArray, triangles: IntArray, spacing_m: float) -> FloatArray:
    """Points on triangles, at most `spacing_m` apart, but not more than 400 on each, shape (n, 3)."""
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    longest = np.maximum(np.linalg.norm(b - a, axis=1), np.linalg.norm(c - a, axis=1))
    count = np.clip(np.ceil(longest / spacing_m), 1, 28).astype(np.int64)
    found = [np.empty((0, 3))]
    for k in np.unique(count).tolist():
        own = count == k
        i, j = (axis.ravel() for axis in np.meshgrid(np.arange(k + 1), np.arange(k + 1)))
        u, v = (axis[i + j <= k] / k for axis in (i, j))
        points = a[own, None] + u[:, None] * (b - a)[own, None] + v[:, None] * (c - a)[own, None]
        found.append(points.reshape(-1, 3))
    return np.concatenate(found)


def voxel_surface(
    index: IntArray, edge_m: float, maximum: int = MOST_TRIANGLES
) -> tuple[FloatArray, IntArray, int]:
    """Outer faces of a set of voxels, as triangles.

    While there are too many, eight voxels are joined into one that covers them.

    Args:
        index: lower corners, shape (M, 3) [voxels].
        maximum: number of triangles.

    Returns:
        Corners, shape (V, 3) [m], triangles, shape (T, 3), and the edge of what is drawn, in voxels.
    """
    index, step = np.asarray(index, np.int64), 1
    while True:
        quads = _outer_quads(index)
        if 2 * len(quads) <= maximum or not len(index):
            break
        index, step = np.unique(index // 2, axis=0), 2 * step
    corner, inverse = np.unique(quads.reshape(-1, 3), axis=0, return_inverse=True)
    four = inverse.reshape(-1, 4)
    triangles = np.concatenate([four[:, [0, 1, 2]], four[:, [0, 2, 3]]])
    return (edge_m * step) * corner.astype(np.float64), triangles.astype(np.int64), step


def _outer_quads(index: IntArray) -> IntArray:
    """Corners of the faces that no other voxel touches, shape (Q, 4, 3)."""
    if not len(index):
        return np.empty((0, 4, 3), np.int64)
    low = index.min(axis=0) - 1
    size = index.max(axis=0) - low + 2

    def number(cells: IntArray) -> IntArray:
        a, b, c = (cells - low).T
        found: IntArray = (a * size[1] + b) * size[2] + c
        return found

    if np.prod(size.astype(np.float64)) > 2.0**62:  # far apart: their numbers would not be distinct
        taken = set(map(tuple, index.tolist()))
        far = [
            index[[tuple(cell) not in taken for cell in (index + side).tolist()]][:, None, :] + quad
            for side, quad in zip(_SIDES, _QUADS, strict=True)
        ]
        return np.concatenate(far)
    known = np.sort(number(index))
    found = []
    for side, quad in zip(_SIDES, _QUADS, strict=True):
        other = number(index + side)
        at = np.minimum(np.searchsorted(known, other), len(known) - 1)
        found.append(index[known[at] != other][:, None, :] + quad)
    return np.concatenate(found)
