"""Points of a scene or a cloud, thinned and grouped in space."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError

BLOCKS = 30  # at least this many groups carry an estimate of uncertainty


def thinned(points: FloatArray, edge: float) -> FloatArray:
    """The mean of the points in each occupied cube of an edge, sorted by cube."""
    _, label, count = np.unique(_cells(points, edge), return_inverse=True, return_counts=True)
    sums = [np.bincount(label, weights=points[:, axis]) for axis in range(3)]
    mean: FloatArray = np.stack(sums, axis=1) / count[:, None]
    return mean


def thinned_to(points: FloatArray, edge: float, most: int) -> tuple[FloatArray, float]:
    """`thinned` with the first of edge, 1.25 edge, ... that leaves no more points than wanted."""
    found = thinned(points, edge)
    while len(found) > most:
        edge *= 1.25
        found = thinned(points, edge)
    return found, edge


def blocks(points: FloatArray, least: float, wanted: int = BLOCKS) -> tuple[NDArray[np.intp], int, float]:
    """Group points by the largest cubes of which enough are occupied.

    Errors of neighbours are alike; errors of large blocks are nearly independent, so uncertainty is
    estimated from how much blocks, not points, disagree.

    Args:
        points: shape (n, 3).
        least: no cube is smaller.
        wanted: how many occupied cubes are enough.

    Returns:
        The block of each point, how many there are, and the edge.
    """
    edge = max(float(np.ptp(points, axis=0).max()) / 2, least)
    while True:
        found, label = np.unique(_cells(points, edge), return_inverse=True)
        if len(found) >= wanted or edge <= least:
            return label, len(found), edge
        edge = max(edge / 1.25, least)


def _cells(points: FloatArray, edge: float) -> NDArray[np.int64]:
    """A number per point, equal for points in the same cube, increasing by x, y, z."""
    low = points.min(axis=0)
    size = np.floor((points.max(axis=0) - low) / edge) + 1
    if size.prod() >= 2.0**62:
        raise InputError(f"points spread too far for cubes of {edge:g} m; remove outliers with --crop")
    cell = np.floor((points - low) / edge).astype(np.int64)
    _, ny, nz = size.astype(np.int64).tolist()
    numbers: NDArray[np.int64] = (cell[:, 0] * ny + cell[:, 1]) * nz + cell[:, 2]
    return numbers


def jackknife(information: FloatArray, score: FloatArray) -> FloatArray:
    """Covariance of the root of a sum of scores, from leaving out each block of them.

    Without block b the solution moves by inv(sum of all H - H_b) g_b; the sum of these moves' squares,
    times (B - 1) / B, is the covariance, whatever the errors within a block have in common.
    Source: Efron and Tibshirani 1993, eq. 11.5, with one Newton step.

    Args:
        information: H_b, shape (B, k, k).
        score: g_b, shape (B, k).

    Returns:
        Shape (k, k).
    """
    count = len(score)
    move = np.linalg.solve(information.sum(axis=0) - information, score[:, :, None])[:, :, 0]
    move = move - move.mean(axis=0)
    covariance: FloatArray = (count - 1) / count * move.T @ move
    return covariance
