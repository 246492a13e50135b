"""Triangles of polygons and of strips."""

from __future__ import annotations

from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.errors import InputError
from alula.stages.compression.imported import Mesh

_BENT_CORNERS = 32  # of a polygon that is not flat; it has 4,960 triangles
_BENT_TRIANGLES = 2**22  # of all such polygons with more than four corners


def mesh_of(points: FloatArray, lengths: IntArray, corner: IntArray) -> Mesh:
    """Cut polygons into triangles.

    A polygon becomes the fan from its first corner. Of a flat one the fan contains the polygon, concave or
    not, because the signed fan winds around each of its points. One that is not flat has no definite surface:
    all other triangles of three of its corners are added, so that each way to cut it is contained. Flat are
    polygons of three corners, and those whose corners agree in one coordinate to the bit.

    Args:
        points: shape (V, 3).
        lengths: corners of each polygon, at least 3, shape (F,).
        corner: indices of the points, one polygon after the other.

    Raises:
        InputError: a polygon that is not flat has too many corners.
    """
    fans: list[tuple[IntArray, FloatArray]] = []
    bent, room = [np.empty((0, 3, 3))], _BENT_TRIANGLES
    ends = np.cumsum(lengths)
    loose = loose_points(corner, len(points))
    if (lengths == 3).all():
        return Mesh(points[corner.reshape(-1, 3)], loose=loose)
    for n in np.unique(lengths).tolist():
        rows = np.flatnonzero(lengths == n)
        shape = points[corner[(ends[rows] - n)[:, None] + np.arange(n)]]
        fans.append((np.repeat(rows, n - 2), _triples(shape, [(0, k, k + 1) for k in range(1, n - 1)])))
        if n == 3:
            continue
        is_flat = (shape == shape[:, :1]).all(axis=1).any(axis=1)
        curved = shape[~is_flat]
        if not len(curved):
            continue
        room -= comb(n, 3) * len(curved) if n > 4 else 0
        if n > _BENT_CORNERS or room < 0:
            raise InputError(
                f"polygon {rows[np.argmin(is_flat)]} has {n} corners and is not flat, so its surface is not "
                "definite; triangulate the mesh"
            )
        others = [t for t in combinations(range(n), 3) if not (t[0] == 0 and t[2] == t[1] + 1)]
        bent.append(_triples(curved, others))
    order = np.argsort(np.concatenate([row for row, _ in fans]), kind="stable")
    corners = np.concatenate([found for _, found in fans])[order]
    return Mesh(corners, bent=np.concatenate(bent), loose=loose)


def _triples(shape: FloatArray, which: list[tuple[int, int, int]]) -> FloatArray:
    return shape[:, np.array(which, np.int64)].reshape(-1, 3, 3)


def strip(index: NDArray[np.integer]) -> IntArray:
    """Triangles of a strip: i, i + 1, i + 2, every second one turned, so that all face alike.

    Args:
        index: shape (N,), N at least 3.

    Returns:
        Shape (N - 2, 3).
    """
    place = np.arange(len(index) - 2)
    turned = place % 2
    return np.asarray(index, np.int64)[np.stack([place, place + 1 + turned, place + 2 - turned], axis=1)]


def fan(index: NDArray[np.integer]) -> IntArray:
    """Triangles of a fan: i + 1, i + 2, 0.

    Args:
        index: shape (N,), N at least 3.

    Returns:
        Shape (N - 2, 3).
    """
    found = np.asarray(index, np.int64)
    return np.stack([found[1:-1], found[2:], np.broadcast_to(found[0], len(found) - 2)], axis=1)


def loose_points(corner: IntArray, count: int) -> int:
    """Number of points that are no corner."""
    is_loose = np.ones(count, np.bool_)
    is_loose[corner] = False
    return int(is_loose.sum())


def check_indices(corner: IntArray, count: int) -> None:
    """Check that all corners exist.

    Args:
        corner: indices, from 0.

    Raises:
        InputError: an index is negative or too large.
    """
    wrong = (corner < 0) | (corner >= count)
    if wrong.any():
        first = corner[wrong][0]
        raise InputError(f"a face has the corner {first}, but the {count} points count from 0")
