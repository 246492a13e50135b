"""Detection of floaters: small groups of Gaussians far from everything else."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula.stages.rotation import matrix_from_quat_wxyz

SMALLEST_GROUP = 50
NEIGHBOUR = 8
REACH = 2.0  # standard deviations
_SAMPLE = 20_000
_PART = 2**18  # rows, cubes or pairs that are processed at a time
_TREE = 2**20  # rows of one search tree
_BITS = 21
_HALF = 2 ** (_BITS - 1)


def floaters(
    mean: NDArray[np.float32],
    scale: NDArray[np.float32],
    quat_wxyz: NDArray[np.float32],
    rows: NDArray[np.intp],
) -> tuple[NDArray[np.bool_], float]:
    """Mark the Gaussians of small, isolated groups.

    Space is divided into cubes with an edge of twice the median distance from a Gaussian to its
    8th nearest neighbour. A Gaussian touches the cubes of its centre and of the six points 2 standard
    deviations along its axes. Two Gaussians are connected when a cube that one touches equals or
    neighbours (26-neighbourhood) a cube that the other touches. A group is a connected component. Groups of
    fewer than 50 are floaters, except the largest group of all. So a sparse but large surface stays, and
    so does everything in contact with it.

    Memory: rows are processed in parts, so the peak is about 60 bytes per touched cube and 13 per row.

    Args:
        mean: centres, shape (N, 3).
        scale: one-sigma semi-axes, shape (N, 3).
        quat_wxyz: rotations from local axes, of any length but zero, shape (N, 4).
        rows: numbers of the Gaussians that count, shape (M,).

    Returns:
        A mask of the floaters among these, shape (M,), and the edge of the cubes.
    """
    count = len(rows)
    edge = _edge(mean, rows)
    if edge == 0.0:
        return np.zeros(count, np.bool_), edge
    centre = np.array(
        [np.median(mean[rows, axis].astype(np.float64), overwrite_input=True) for axis in range(3)]
    )
    gaussians = _Rows(mean, scale, quat_wxyz, rows, centre, edge)
    cells = _all_cells(gaussians)
    groups = _Groups(len(cells))
    for offset in _half_neighbourhood():  # before the arms: then there are fewer groups to join
        for start in range(0, len(cells), _PART):
            near = cells[start : start + _PART] + offset
            at = np.searchsorted(cells, near)
            at[at == len(cells)] = 0
            found = np.flatnonzero(cells[at] == near)
            groups.join(start + found, at[found])
    home = np.empty(count, np.int32)
    for part in gaussians.parts():
        own, *ends = gaussians.touched(part)
        order = np.argsort(own)  # cubes are found several times as fast in their order
        home[part][order] = np.searchsorted(cells, own[order])
        for end in ends:
            apart = np.flatnonzero(_apart(own, end))  # neighbouring cubes are joined already
            groups.join(home[part][apart], np.searchsorted(cells, end[apart]))
    group = groups.number()[home]
    size = np.bincount(group)
    small = size < SMALLEST_GROUP
    small[np.argmax(size)] = False
    return small[group], edge


@dataclass(frozen=True, slots=True)
class _Rows:
    """Gaussians, and the cubes that parts of them touch."""

    mean: NDArray[np.float32]
    scale: NDArray[np.float32]
    quat_wxyz: NDArray[np.float32]
    rows: NDArray[np.intp]
    centre: NDArray[np.float64]
    edge: float

    def parts(self) -> Iterator[slice]:
        return (slice(start, start + _PART) for start in range(0, len(self.rows), _PART))

    def touched(self, part: slice) -> list[NDArray[np.int64]]:
        """Cubes of the centres and of both ends of each axis."""
        rows = self.rows[part]
        quat = self.quat_wxyz[rows].astype(np.float64)
        unit = (quat / np.linalg.norm(quat, axis=1, keepdims=True)).astype(np.float32)
        axes = matrix_from_quat_wxyz(unit)
        centred = self.mean[rows].astype(np.float64) - self.centre
        found = [_cells(centred, self.edge)]
        for axis in range(3):
            arm = axes[:, :, axis] * (REACH * self.scale[rows, axis, None].astype(np.float64))
            found += [_cells(centred + sign * arm, self.edge) for sign in (1, -1)]
        return found


def _all_cells(rows: _Rows) -> NDArray[np.int64]:
    """All touched cubes, sorted; lists are joined when they are as long as what they are joined to."""
    cells, waiting, length = np.empty(0, np.int64), [], 0
    for part in rows.parts():
        own, *ends = rows.touched(part)
        waiting.append(_distinct(np.concatenate([own, *(end[end != own] for end in ends)])))
        length += len(waiting[-1])
        if length > len(cells) + _PART:
            cells = _distinct(np.concatenate([cells, *waiting]))
            waiting, length = [], 0
    return _distinct(np.concatenate([cells, *waiting])) if waiting else cells


class _Groups:
    """Connected components of cubes; pairs are collected, and joined when there are many."""

    def __init__(self, count: int) -> None:
        self._group = np.arange(count, dtype=np.int32)
        self._groups = count
        self._pairs: list[NDArray[np.int64]] = []
        self._waiting = 0

    def join(self, left: NDArray[np.integer], right: NDArray[np.integer]) -> None:
        a, b = self._group[left].astype(np.int64), self._group[right].astype(np.int64)
        pair = _distinct((np.minimum(a, b) * self._groups + np.maximum(a, b))[a != b])
        self._pairs.append(pair)
        self._waiting += len(pair)
        if self._waiting > max(_PART, self._groups // 2):
            self._contract()

    def number(self) -> NDArray[np.int32]:
        """Group of each cube."""
        self._contract()
        return self._group

    def _contract(self) -> None:
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import connected_components

        if not self._waiting:
            return
        pair = _distinct(np.concatenate(self._pairs))
        left, right = (pair // self._groups).astype(np.int32), (pair % self._groups).astype(np.int32)
        shape = (self._groups, self._groups)
        graph = coo_matrix((np.ones(len(pair), np.bool_), (left, right)), shape=shape)
        self._groups, joined = connected_components(graph, directed=False)
        self._group = joined[self._group]
        self._pairs, self._waiting = [], 0


def _edge(mean: NDArray[np.float32], rows: NDArray[np.intp]) -> float:
    """Twice the median distance to the 8th neighbour, over at most 20,000 rows at equal steps."""
    from scipy.spatial import cKDTree

    if len(rows) <= NEIGHBOUR:
        return 0.0
    sample = mean[rows[:: -(-len(rows) // _SAMPLE)]]
    nearest = np.empty((len(sample), 0))
    for start in range(0, len(rows), _TREE):
        tree = cKDTree(mean[rows[start : start + _TREE]], compact_nodes=False, balanced_tree=False)
        distance, _ = tree.query(sample, NEIGHBOUR + 1)
        nearest = np.sort(np.hstack([nearest, distance]), axis=1)[:, : NEIGHBOUR + 1]
    return 2.0 * float(np.median(nearest[:, NEIGHBOUR]))


def _cells(position: NDArray[np.float64], edge: float) -> NDArray[np.int64]:
    """One integer per cube; positions beyond a million cubes from the centre fall into the outermost ones."""
    cell = np.clip(np.floor(position / edge), 1 - _HALF, _HALF - 2).astype(np.int64) + _HALF
    key: NDArray[np.int64] = (cell[:, 0] << (2 * _BITS)) | (cell[:, 1] << _BITS) | cell[:, 2]
    return key


def _apart(one: NDArray[np.int64], other: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Test whether cubes neither equal nor neighbour each other."""
    far = np.zeros(len(one), np.bool_)
    for shift in (0, _BITS, 2 * _BITS):
        mask = (1 << _BITS) - 1
        far |= np.abs(((one >> shift) & mask) - ((other >> shift) & mask)) > 1
    return far


def _distinct(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sorted keys without repetitions; np.unique hashes first and is ten times slower on these keys."""
    if not len(keys):
        return keys
    ordered = np.sort(keys)
    distinct: NDArray[np.int64] = ordered[np.concatenate([[True], ordered[1:] != ordered[:-1]])]
    return distinct


def _half_neighbourhood() -> list[int]:
    """Differences of keys to 13 of the 26 neighbours; the other 13 are their negatives."""
    steps = [(i, j, k) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)]
    return [(i << (2 * _BITS)) + (j << _BITS) + k for i, j, k in steps if (i, j, k) > (0, 0, 0)]
