"""Convex polytopes of any tool and their measures, in units of one voxel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from measure import FloatArray
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact

_MESH_TOLERANCE = 1e-6  # [voxels]; meshes come with rounding, covers of this library without
_GAP = 1e-3  # of an edge: the shortest uncovered piece of a line that counts
_SLIVER = 1e-6  # of a voxel: the minimum volume outside the union that counts
_TILE = 64  # columns after which the random lines repeat
_MAX_LINES = 5e5  # of all hulls together
_DRAWS = 4


@dataclass(frozen=True, slots=True)
class Solids:
    """Polytopes {x : normal . x <= offset}, row-compressed, in voxels; voxel v is the cube [v, v + 1]^3.

    Attributes:
        normal: outward, shape (F, 3); integers when exact.
        offset: shape (F,); integers when exact.
        plane_start: first plane of each polytope and the end, shape (n + 1,).
        vertex: points with the same bounding box as the polytope, such as its corners, shape (V, 3).
        vertex_start: first point of each polytope and the end, shape (n + 1,).
        flat: parts of a mesh that have no volume and are left out.
    """

    normal: NDArray[Any]
    offset: NDArray[Any]
    plane_start: NDArray[np.int64]
    vertex: NDArray[Any]
    vertex_start: NDArray[np.int64]
    flat: int = 0

    @classmethod
    def from_cover(cls, cover: Artifact) -> Self:
        """Read the exact polytopes of an `alula/cover`."""
        names = ("plane_normal", "plane_offset", "plane_start", "vertex", "vertex_start")
        return cls(*(np.asarray(cover[name], np.int64) for name in names))

    @classmethod
    def from_points(cls, parts: Sequence[FloatArray]) -> Self:
        """Make the convex hulls of points; coplanar facets are one half-plane."""
        from scipy.spatial import ConvexHull, QhullError

        planes, corners = [], []
        for points in parts:
            try:
                hull = ConvexHull(points)
            except (QhullError, ValueError):
                continue
            rows, first = np.unique(np.round(hull.equations, 6), axis=0, return_index=True)
            planes.append(hull.equations[first] if len(rows) else hull.equations)
            corners.append(points[hull.vertices])
        rows = np.vstack(planes) if planes else np.empty((0, 4))
        return cls(
            rows[:, :3],
            -rows[:, 3],
            np.cumsum([0, *map(len, planes)]),
            np.vstack(corners) if corners else np.empty((0, 3)),
            np.cumsum([0, *map(len, corners)]),
            len(parts) - len(planes),
        )

    def __len__(self) -> int:
        return len(self.plane_start) - 1

    def __iter__(self) -> Iterator[tuple[NDArray[Any], NDArray[Any], NDArray[Any]]]:
        """Normals, offsets and vertices of each polytope."""
        for h in range(len(self)):
            planes = slice(*self.plane_start[h : h + 2])
            yield self.normal[planes], self.offset[planes], self.vertex[slice(*self.vertex_start[h : h + 2])]

    @property
    def is_exact(self) -> bool:
        """Return whether the planes are integers."""
        return bool(np.issubdtype(self.normal.dtype, np.integer))


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """Volumes of a union of polytopes relative to that of voxels, V+.

    Attributes:
        union_ratio: union / V+.
        uncovered_volume: fraction of V+ outside the union.
        voxels_with_gap: number of voxels with more volume outside the union than rounding explains.
        error: of `union_ratio`.
    """

    union_ratio: float
    uncovered_volume: float
    voxels_with_gap: int
    error: float


def measure(solids: Solids, voxels: NDArray[np.int32]) -> Measured:
    """Measure exact volumes, up to a bound on rounding; a gap is more than a millionth of a voxel."""
    length = np.linalg.norm(solids.normal, axis=1)
    ends = [(vertex.min(axis=0), vertex.max(axis=0)) for _, _, vertex in solids]
    lower, upper = (np.array(column, np.float64).reshape(-1, 3) for column in zip(*ends, strict=True))
    found = _core.union_measure(
        solids.normal / length[:, None],
        solids.offset / length,
        np.asarray(solids.plane_start, np.int64),
        lower,
        upper,
        voxels[np.lexsort(voxels.T[::-1])],
        _SLIVER,
        0,
        None,
    )
    return Measured(
        union_ratio=found["volume"] / len(voxels),
        uncovered_volume=max(0.0, 1 - found["intersection"] / len(voxels)),
        voxels_with_gap=len(voxels) - found["whole"],
        error=found["error"] / len(voxels),
    )


def measure_along_lines(solids: Solids, voxels: NDArray[np.int32]) -> Measured:
    """Measure the same independently, exactly along about a million vertical lines at jittered positions.

    `error` is the standard error of repeated draws. A gap is uncovered length of more than a thousandth
    of an edge on a line. Gaps narrower than the distance of lines can be missed in the count of voxels,
    but not systematically in the volume.
    """
    area = sum(float(np.prod(np.ptp(vertex[:, :2], axis=0) + 1)) for _, _, vertex in solids)
    side = next((m for m in (4, 3, 2) if area * m * m <= _MAX_LINES), 1)
    draws = [_draw(solids, voxels.astype(np.int64), side, seed) for seed in range(_DRAWS)]
    ratio, uncovered, gaps = (np.array(column) for column in zip(*draws, strict=True))
    return Measured(
        union_ratio=float(ratio.mean()),
        uncovered_volume=float(uncovered.mean()),
        voxels_with_gap=int(gaps.max()),
        error=float(ratio.std(ddof=1) / np.sqrt(_DRAWS)),
    )


def _draw(solids: Solids, voxels: NDArray[np.int64], side: int, seed: int) -> tuple[float, float, int]:
    """Union / V+, uncovered fraction of V+ and number of voxels with a gap along one draw of lines."""
    jitter = np.random.default_rng(seed).random((_TILE, _TILE, side * side, 2))
    cell = np.stack(np.divmod(np.arange(side * side), side), axis=1)
    within = (jitter + cell) / side
    corners = (
        np.vstack([solids.vertex, voxels, voxels + 1]) if len(solids) else np.vstack([voxels, voxels + 1])
    )
    lower, upper = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int) + 1
    width, period = upper[1] - lower[1], float(upper[2] - lower[2] + 1)

    def line(x: NDArray[Any], y: NDArray[Any]) -> FloatArray:
        """Start of the lines of columns on one long axis that holds the intervals of all lines in turn."""
        column = (x - lower[0]) * width + (y - lower[1])
        return ((column[:, None] * side * side + np.arange(side * side)) * period).astype(np.float64)

    pieces = [np.empty((0, 2))]
    for normal, offset, vertex in solids:
        low = np.floor(vertex.min(axis=0)).astype(int)
        extent = np.ceil(vertex.max(axis=0)).astype(int) - low
        x, y = (low[i] + a.ravel() for i, a in enumerate(np.indices(extent[:2])))
        for some in np.array_split(np.arange(len(x)), 1 + len(x) * side * side * len(offset) // 2_000_000):
            at = np.stack([x[some], y[some]], axis=1)[:, None, :] + within[x[some] % _TILE, y[some] % _TILE]
            bounds = _z_interval(normal, offset, at.reshape(-1, 2)) - lower[2]
            bounds += line(x[some], y[some]).reshape(-1, 1)
            pieces.append(bounds[bounds[:, 0] < bounds[:, 1]])
    start, end = _disjoint(np.vstack(pieces))
    before = np.concatenate([[0.0], np.cumsum(end - start)])

    def covered(position: FloatArray) -> FloatArray:
        """Covered length before a position on the long axis."""
        if not len(start):
            return np.zeros_like(position)
        last = np.searchsorted(start, position, side="right") - 1
        inside = np.minimum(position, end[last]) - start[last]
        return np.where(last < 0, 0.0, before[last] + inside)

    foot = line(voxels[:, 0], voxels[:, 1]) + (voxels[:, 2:] - lower[2])
    inside = covered(foot + 1) - covered(foot)
    uncovered = 1 - float(inside.mean())
    gaps = int((inside < 1 - _GAP).any(axis=1).sum())
    return float(before[-1]) / (len(voxels) * side * side), max(uncovered, 0.0), gaps


def _z_interval(normal: NDArray[Any], offset: NDArray[Any], at: FloatArray) -> FloatArray:
    """Intervals of vertical lines at (x, y) inside one polytope, shape (n, 2); empty when low >= high."""
    bounds = np.empty((len(at), 2))
    bounds[:] = -np.inf, np.inf
    rest = offset - at @ normal[:, :2].T
    rise = normal[:, 2].astype(np.float64)
    up, down, upright = rise > 0, rise < 0, rise == 0
    bounds[:, 1] = (rest[:, up] / rise[up]).min(axis=1, initial=np.inf)
    bounds[:, 0] = (rest[:, down] / rise[down]).max(axis=1, initial=-np.inf)
    bounds[(rest[:, upright] < 0).any(axis=1)] = 0.0
    return bounds


def _disjoint(pieces: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Union of intervals as sorted disjoint intervals: starts and ends."""
    if not len(pieces):
        return np.empty(0), np.empty(0)
    low, high = pieces[np.argsort(pieces[:, 0])].T
    reach = np.maximum.accumulate(high)
    new = np.concatenate([[True], low[1:] > reach[:-1]])
    return low[new], reach[np.concatenate([new[1:], [True]])]


def outside_every_hull(solids: Solids, voxels: NDArray[np.int32]) -> int:
    """Count voxels that no single polytope contains as a whole.

    Voxel v is inside when normal . v + sum of positive normal components <= offset for all planes: in
    integers without tolerance for a cover, within a millionth of an edge for a mesh. Only the planes are
    used, not the members recorded in a cover.
    """
    cubes = voxels[np.lexsort(voxels.T[::-1])].astype(np.int64)
    found = np.zeros(len(cubes), np.bool_)
    for normal, offset, vertex in solids:
        lower, upper = np.floor(vertex.min(axis=0)), np.ceil(vertex.max(axis=0))
        run = slice(*np.searchsorted(cubes[:, 0], [lower[0], upper[0]]))
        near = ((cubes[run, 1:] >= lower[1:]) & (cubes[run, 1:] < upper[1:])).all(axis=1) & ~found[run]
        rows = run.start + np.flatnonzero(near)
        reach = cubes[rows] @ normal.T + np.maximum(normal, 0).sum(axis=1)
        tolerance = 0 if solids.is_exact else _MESH_TOLERANCE
        found[rows] = (reach <= offset + tolerance).all(axis=1)
    return int((~found).sum())


def mesh_bytes(solids: Solids) -> int:
    """Bytes of an onboard map if the planes were quantised like those of covers.

    A header of 64 bytes, 14 per hull with its box, 5 per oblique plane; planes along the axes are in the box.
    """
    unit = np.abs(solids.normal / np.linalg.norm(solids.normal, axis=1, keepdims=True)).max(axis=1)
    return 64 + 14 * len(solids) + 5 * int((unit < 1 - 1e-9).sum())
