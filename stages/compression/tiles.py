"""Voxelization of ellipsoids tile by tile, to bound the memory and to use several machines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.progress import Progress
from alula.stages.distribute import distribute
from alula.stages.progress import WHOLE, share

Box = tuple[float, float, float, float, float, float]
Corner = tuple[int, int, int]
Cube = tuple[Corner, Corner]  # lowest and highest voxel
Floats = NDArray[np.float32]

LONGEST_EDGE = 2**20  # of a tile [voxels]
CHUNK = 1 << 16  # maximum number of ellipsoids of tiles that are sent together: 2.6 MB


@dataclass(frozen=True, slots=True, kw_only=True)
class Ellipsoids:
    """The sets to voxelize and the lattice: everything that the mark of a voxel depends on.

    Attributes:
        mean: shape (N, 3) [m].
        scale: one-sigma semi-axes, shape (N, 3) [m].
        quat_wxyz: shape (N, 4).
        sigma: level k of the ellipsoids.
        inflation_m: radius of the ball added to each [m].
        voxel_size_m: edge of a voxel g [m].
        crop: box that a marked voxel must touch [m].
        min_overlap: minimum number of ellipsoids that touch a marked voxel.
        loss: bounds of the error of each row, shape (N, 3): of the centre [m], of the semi-axes (relative),
            of the rotation [rad]; None where rows are exact.
    """

    mean: Floats
    scale: Floats
    quat_wxyz: Floats
    sigma: float
    inflation_m: float
    voxel_size_m: float
    crop: Box | None
    min_overlap: int
    loss: Floats | None = None

    def level(self) -> dict[str, Any]:
        """Arguments that the native functions share."""
        return {
            "mean": self.mean,
            "scale": self.scale,
            "quat_wxyz": self.quat_wxyz,
            "loss": self.loss,
            "sigma": self.sigma,
            "inflation": self.inflation_m,
            "voxel_size": self.voxel_size_m,
            "crop": self.crop,
        }

    def part(self, rows: NDArray[np.integer] | slice) -> Ellipsoids:
        """Ellipsoids of some rows, on the same lattice.

        Args:
            rows: indices of the rows, shape (K,), or a slice.
        """
        loss = None if self.loss is None else self.loss[rows]
        arrays = {name: getattr(self, name)[rows] for name in ("mean", "scale", "quat_wxyz")}
        return replace(self, **arrays, loss=loss)


@dataclass(frozen=True, slots=True)
class Marked:
    """Marked voxels, and the effect of each ellipsoid.

    Attributes:
        index: marked voxels, sorted, shape (M, 3).
        overlap: number of ellipsoids that touch each, shape (M,).
        reach: per ellipsoid 0 when it marks nothing, 2 when its box exceeds the crop, else 1; shape (N,).
        below: number of touched voxels left out because of `min_overlap`.
        max_overlap: maximum overlap of all touched voxels.
    """

    index: NDArray[np.int32]
    overlap: NDArray[np.uint32]
    reach: NDArray[np.uint8]
    below: int
    max_overlap: int


@dataclass(frozen=True, slots=True)
class _Chunk:
    """Some tiles with the ellipsoids that may touch them: tile t has rows start[t] ... start[t + 1] - 1."""

    ellipsoids: Ellipsoids
    start: NDArray[np.int64]
    lower: NDArray[np.int64]  # lowest voxel of each tile
    edge: int


def mark(
    ellipsoids: Ellipsoids,
    jobs: int,
    progress: Progress | None = None,
    tile: Cube | None = None,
) -> Marked:
    """Mark all voxels in one pass.

    Args:
        tile: lowest and highest voxel of the cube in which voxels are marked; None for all of space.

    Raises:
        OverflowError: there are too many voxels or bricks.
    """
    how: dict[str, Any] = {"min_overlap": ellipsoids.min_overlap, "jobs": jobs, "progress": progress}
    return Marked(*_core.voxelize(**ellipsoids.level(), **how, tile=tile))


def tile_at(lower: NDArray[np.int64], edge: int) -> Cube:
    """Lowest and highest voxel of a tile, in the range of 32 bits."""
    ends = np.iinfo(np.int32)
    low, high = np.clip([lower, lower + edge - 1], ends.min, ends.max).tolist()
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def mark_tiles(
    ellipsoids: Ellipsoids, edge: int, jobs: int, scheduler: str | None, progress: Progress | None
) -> Marked:
    """Mark the voxels tile by tile, on threads or on the workers of a scheduler.

    The test of an ellipsoid against a voxel does not depend on the tile, and tiles do not share voxels. So
    the result equals that of `mark` to the bit, for every edge and number of workers.

    Args:
        edge: edge of a tile [voxels]; tiles begin at multiples of it.
        jobs: threads; each holds the counters of one tile at a time.
        scheduler: address of a `dask.distributed` scheduler, instead of threads.
        progress: called with (done, total): assigning ellipsoids to tiles, then marking them.

    Raises:
        OverflowError: there are too many tiles, or too many voxels in a tile or in all.
        UsageError, LinkError: see `distribute`.
    """
    assigned, marked_all = share(progress, 0, 0.15), share(progress, 0.15, 0.85)
    tile, start, row = _core.tiles_of(**ellipsoids.level(), edge=edge, progress=assigned)
    parts: list[tuple[NDArray[np.int32], NDArray[np.uint32]]] = []
    reach = np.zeros(len(ellipsoids.mean), np.uint8)
    below = max_overlap = done = voxels = 0
    work = distribute(
        _mark_chunk, _chunks(ellipsoids, edge, tile, start, row), jobs=jobs, scheduler=scheduler
    )
    for marked in work:
        here = row[done : done + len(marked.reach)]
        np.maximum.at(reach, here, marked.reach)
        parts.append((marked.index, marked.overlap))
        below, max_overlap = below + marked.below, max(max_overlap, marked.max_overlap)
        done, voxels = done + len(here), voxels + len(marked.index)
        if voxels > _core.MAX_VOXELS:
            raise OverflowError(f"the scene would need more than {_core.MAX_VOXELS} voxels")
        if marked_all is not None:
            marked_all(done, len(row))
    index, overlap = joined_tiles(parts)
    if progress is not None:
        progress(WHOLE, WHOLE)
    return Marked(index, overlap, reach, below, max_overlap)


def _chunks(
    ellipsoids: Ellipsoids,
    edge: int,
    tile: NDArray[np.int32],
    start: NDArray[np.int64],
    row: NDArray[np.uint32],
) -> Iterator[_Chunk]:
    """Group tiles in order: each group has one tile, or several with at most CHUNK ellipsoids together."""
    first = 0
    while first < len(tile):
        end = int(np.searchsorted(start, start[first] + CHUNK, side="right")) - 1
        end = max(end, first + 1)
        rows = row[start[first] : start[end]]
        mine = ellipsoids.part(rows)
        yield _Chunk(
            mine, start[first : end + 1] - start[first], tile[first:end].astype(np.int64) * edge, edge
        )
        first = end


def _mark_chunk(chunk: _Chunk) -> Marked:
    """Mark the voxels of the tiles of one chunk; `reach` has one entry per tile and ellipsoid."""
    found = []
    for t, lower in enumerate(chunk.lower):
        rows = slice(int(chunk.start[t]), int(chunk.start[t + 1]))
        found.append(mark(chunk.ellipsoids.part(rows), 1, tile=tile_at(lower, chunk.edge)))
    index, overlap = joined_tiles([(one.index, one.overlap) for one in found])
    below, most = sum(one.below for one in found), max(one.max_overlap for one in found)
    return Marked(index, overlap, np.concatenate([one.reach for one in found]), below, most)


def joined_tiles(
    parts: list[tuple[NDArray[np.int32], NDArray[np.uint32]]],
) -> tuple[NDArray[np.int32], NDArray[np.uint32]]:
    """Join disjoint sorted lists of voxels into one sorted list, and empty the given one."""
    if len(parts) == 1:
        return parts[0]
    start = np.cumsum([0, *(len(overlap) for _, overlap in parts)], dtype=np.int64)
    index = np.concatenate([index for index, _ in parts] or [np.zeros((0, 3), np.int32)])
    overlap = np.concatenate([overlap for _, overlap in parts] or [np.zeros(0, np.uint32)])
    parts.clear()
    return _core.joined_voxels(index, overlap, start)
