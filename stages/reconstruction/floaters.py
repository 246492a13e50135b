"""Detection of floaters: small groups of Gaussians far from everything else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SMALLEST_GROUP = 50
NEIGHBOUR = 8
REACH = 2.0  # standard deviations
_SAMPLE = 20_000
_BITS = 21
_HALF = 2 ** (_BITS - 1)


def floaters(
    mean: NDArray[np.float32], scale: NDArray[np.float32], axes: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], float]:
    """Mark the Gaussians of small, isolated groups.

    Space is divided into cubes with an edge of twice the median distance from a Gaussian to its
    8th nearest neighbour. A Gaussian touches the cubes of its centre and of the six points 2 standard
    deviations along its axes. Two Gaussians are connected when a cube that one touches equals or
    neighbours (26-neighbourhood) a cube that the other touches. A group is a connected component. Groups of
    fewer than 50 are floaters, except the largest group of all. So a sparse but large surface stays, and
    so does everything in contact with it.

    Args:
        mean: centres, shape (N, 3).
        scale: one-sigma semi-axes, shape (N, 3).
        axes: rotation matrices with the local axes as columns, shape (N, 3, 3).

    Returns:
        A mask of the floaters, shape (N,), and the edge of the cubes.
    """
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    count = len(mean)
    edge = _edge(mean)
    if edge == 0.0:
        return np.zeros(count, np.bool_), edge
    centred = mean.astype(np.float64)
    centred -= np.median(centred, axis=0)
    touched = [np.unique(_cells(centred, edge), return_inverse=True)]
    for axis in range(3):
        arm = axes[:, :, axis] * (REACH * scale[:, axis, None].astype(np.float64))
        touched += [np.unique(_cells(centred + s * arm, edge), return_inverse=True) for s in (1, -1)]
    cells = _distinct(np.concatenate([keys for keys, _ in touched]))
    home, *ends = (np.searchsorted(cells, keys)[number] for keys, number in touched)
    left, right = [], []
    for end in ends:  # one edge per pair of cubes, independent of the number of Gaussians that connect them
        pair = _distinct(home * len(cells) + end)
        left.append(pair // len(cells))
        right.append(pair % len(cells))
    for offset in _half_neighbourhood():
        at = np.searchsorted(cells, cells + offset)
        at[at == len(cells)] = 0
        found = np.flatnonzero(cells[at] == cells + offset)
        left.append(found)
        right.append(at[found])
    rows, columns = np.concatenate(left), np.concatenate(right)
    graph = coo_matrix((np.ones(len(rows), np.bool_), (rows, columns)), shape=(len(cells), len(cells)))
    group = connected_components(graph, directed=False)[1][home]
    size = np.bincount(group)
    small = size < SMALLEST_GROUP
    small[np.argmax(size)] = False
    return small[group], edge


def _edge(mean: NDArray[np.float32]) -> float:
    """Twice the median distance to the 8th neighbour, over at most 20,000 rows at equal steps."""
    from scipy.spatial import cKDTree

    if len(mean) <= NEIGHBOUR:
        return 0.0
    sample = mean[:: -(-len(mean) // _SAMPLE)]
    distance, _ = cKDTree(mean).query(sample, [NEIGHBOUR + 1])
    return 2.0 * float(np.median(distance))


def _cells(position: NDArray[np.float64], edge: float) -> NDArray[np.int64]:
    """One integer per cube; positions beyond a million cubes from the centre fall into the outermost ones."""
    cell = np.clip(np.floor(position / edge), 1 - _HALF, _HALF - 2).astype(np.int64) + _HALF
    key: NDArray[np.int64] = (cell[:, 0] << (2 * _BITS)) | (cell[:, 1] << _BITS) | cell[:, 2]
    return key


def _distinct(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sorted keys without repetitions; np.unique hashes first and is ten times slower on these keys."""
    ordered = np.sort(keys)
    distinct: NDArray[np.int64] = ordered[np.concatenate([[True], ordered[1:] != ordered[:-1]])]
    return distinct


def _half_neighbourhood() -> list[int]:
    """Differences of keys to 13 of the 26 neighbours; the other 13 are their negatives."""
    steps = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
    return [(i << (2 * _BITS)) + (j << _BITS) + k for i, j, k in steps if (i, j, k) > (0, 0, 0)]
