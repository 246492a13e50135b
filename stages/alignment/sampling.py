"""Thinning of points and their grouping into blocks of space, for robust estimates and their uncertainty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError

_PART = 2**16  # points whose temporary arrays stay in the cache
BLOCKS = 30  # minimum number of groups for an estimate of uncertainty


def thinned(points: FloatArray, edge: float) -> FloatArray:
    """Mean of the points in each occupied cube, sorted by cube.

    Args:
        points: shape (n, 3), any units.
        edge: edge of the cubes, same units.

    Returns:
        Shape (m, 3), one row per occupied cube.
    """
    label = _cells(points, edge)
    if label.max(initial=0) > len(points):  # else their cubes can be counted without sorting
        _, label = np.unique(label, return_inverse=True)
    count = np.bincount(label)
    filled = np.flatnonzero(count)
    sums = [np.bincount(label, weights=points[:, axis])[filled] for axis in range(3)]
    mean: FloatArray = np.stack(sums, axis=1) / count[filled, None]
    return mean


def thinned_to(points: FloatArray, edge: float, max_points: int) -> tuple[FloatArray, float]:
    """Points thinned with the first of edge, 1.25 edge, ... that leaves at most `max_points`.

    Args:
        points: shape (n, 3), any units.
        edge: smallest edge of the cubes, same units.
        max_points: maximum number of points that remain.

    Returns:
        The thinned points, shape (m, 3), and the edge that was used.
    """
    found = thinned(points, edge)
    while len(found) > max_points:
        edge *= 1.25
        found = thinned(points, edge)
    return found, edge


def blocks(
    points: FloatArray, min_edge: float, min_blocks: int = BLOCKS
) -> tuple[NDArray[np.intp], int, float]:
    """Group points into the largest cubes that leave at least `min_blocks` occupied cubes.

    Errors of neighbouring points are correlated; errors of large blocks are nearly independent. So
    uncertainty is estimated from the disagreement of blocks, not of points.

    Args:
        points: shape (n, 3), any units.
        min_edge: minimum edge of a cube, same units; fewer cubes may be occupied at this edge.
        min_blocks: number of occupied cubes that is enough.

    Returns:
        The block of each point, shape (n,), the number of blocks, and the edge of the cubes.
    """
    edge = max(float(np.ptp(points, axis=0).max()) / 2, min_edge)
    while True:
        found, label = np.unique(_cells(points, edge), return_inverse=True)
        if len(found) >= min_blocks or edge <= min_edge:
            return label, len(found), edge
        edge = max(edge / 1.25, min_edge)


def _cells(points: FloatArray, edge: float) -> NDArray[np.int64]:
    """Number of the cube that each point lies in, increasing by x, y, z."""
    low = points.min(axis=0)
    size = np.floor((points.max(axis=0) - low) / edge) + 1
    if size.prod() >= 2.0**62:
        raise InputError(f"points spread too far for cubes of {edge:g} m; remove outliers with --crop")
    _, ny, nz = size.astype(np.int64).tolist()
    numbers = np.empty(len(points), np.int64)
    for start in range(0, len(points), _PART):
        part = slice(start, start + _PART)
        cell = np.floor((points[part] - low) / edge).astype(np.int64)
        numbers[part] = (cell[:, 0] * ny + cell[:, 1]) * nz + cell[:, 2]
    return numbers


def jackknife(information: FloatArray, score: FloatArray) -> FloatArray:
    """Block-jackknife covariance of the root of a sum of scores.

    Without block b the solution moves by inv(sum of all H - H_b) g_b. The covariance is (B - 1) / B times
    the sum of these moves' squares, whatever the correlation of the errors within a block.
    Source: Efron and Tibshirani 1993, eq. 11.5, with one Newton step.

    Args:
        information: information matrix H_b of each block, shape (B, k, k).
        score: gradient g_b of each block, shape (B, k).

    Returns:
        Shape (k, k).
    """
    count = len(score)
    move = np.linalg.solve(information.sum(axis=0) - information, score[:, :, None])[:, :, 0]
    move = move - move.mean(axis=0)
    covariance: FloatArray = (count - 1) / count * move.T @ move
    return covariance
