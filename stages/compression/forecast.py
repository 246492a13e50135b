"""Estimate of the number of voxels before `voxelize` marks them, and what would reduce it."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.stages.compression.tiles import Ellipsoids, mark, tile_at

TILE = 64  # voxels
_TILES, _FEWEST = 160, 40  # numbers of tiles that are counted, at most and where ellipsoids overlap much
_MARKS = 1.5e9  # voxels of overlapping ellipsoids that are marked in all counted tiles
_FEW = (1, 10, 100)  # numbers of the largest Gaussians that are left out to try
_NAMED = 5  # maximum number of rows that a message names
_ROOM = 0.8  # fraction of the limit that a remedy aims at, as estimates have an error
_SIZES = 5  # maximum number of sizes of voxels that are tried
_LONGEST_M = 1e3
_CHUNK = 2**18


@dataclass(frozen=True, slots=True)
class Dominant:
    """The largest Gaussians, which alone make the number of voxels too large.

    Attributes:
        rows: their rows among the ellipsoids, the largest first.
        longest: longest one-sigma semi-axis of the first of them [m].
        limit: longest semi-axis between theirs and those of all others [m].
    """

    rows: tuple[int, ...]
    longest: float
    limit: float
    voxels: int


def most_voxels(ellipsoids: Ellipsoids) -> float:
    """Upper bound of the number of voxels: the sum of the voxels of the ellipsoids' cubes."""
    total = 0.0
    for start in range(0, len(ellipsoids.mean), _CHUNK):
        part = slice(start, start + _CHUNK)
        x, y, z = _extent(ellipsoids.part(part)).T
        total += float((x * y * z).sum())
    return total


def _extent(ellipsoids: Ellipsoids) -> NDArray[np.float64]:
    """Edges of a cube around each ellipsoid, as far as it touches the crop [voxels], rounded up."""
    size, sigma = ellipsoids.voxel_size_m, ellipsoids.sigma
    mean = ellipsoids.mean.astype(np.float64)
    x, y, z = ellipsoids.scale.T  # columns are several times as fast as the maximum along an axis
    reach = sigma * np.maximum(np.maximum(x, y), z).astype(np.float64)
    if ellipsoids.loss is not None:
        position, scale, rotation = ellipsoids.loss.astype(np.float64).T
        reach = reach * (1 + scale) * (1 + rotation) + position
    reach = (reach + ellipsoids.inflation_m)[:, None]
    low, high = mean - reach, mean + reach
    if ellipsoids.crop is not None:
        low, high = np.maximum(low, ellipsoids.crop[:3]), np.minimum(high, ellipsoids.crop[3:])
    edges: NDArray[np.float64] = np.clip(np.floor(high / size) - np.floor(low / size) + 1, 0, None)
    return edges


def may_exceed(ellipsoids: Ellipsoids, limit: int, jobs: int) -> bool:
    """Test cheaply whether there may be more than `limit` voxels; False is certain.

    The bounds are the cubes around the ellipsoids, and 4^3 times the number of voxels of four times the edge.
    """
    if most_voxels(ellipsoids) <= limit:
        return False
    coarse = dataclasses.replace(ellipsoids, voxel_size_m=4 * ellipsoids.voxel_size_m, min_overlap=1)
    if most_voxels(coarse) > 64 * limit:  # the estimate is cheaper
        return True
    try:
        return 64 * len(mark(coarse, jobs).index) > limit
    except OverflowError:
        return True


def estimated_voxels(ellipsoids: Ellipsoids) -> float:
    """Estimate the number of voxels from an even sample of tiles, which are counted exactly.

    At most 160 tiles of 64^3 voxels are counted, and fewer, at least 40, where ellipsoids overlap so much
    that this would take long. The estimate is exact when these are all; else its error is about a tenth, and
    about a third with fewer tiles. It does not depend on the number of threads. More than 2^20 tiles count as
    infinitely many voxels.
    """
    edge = TILE
    try:
        tile, start, row = _core.tiles_of(**ellipsoids.level(), edge=edge)
    except OverflowError:
        return math.inf
    if len(tile) == 0:
        return 0.0
    affordable = int(_MARKS * len(tile) / max(most_voxels(ellipsoids), 1.0))
    count = min(max(_FEWEST, min(_TILES, affordable)), len(tile))
    chosen = ((np.arange(count) + 0.5) * len(tile) / count).astype(int)
    found = 0
    for at in chosen.tolist():
        mine = ellipsoids.part(row[start[at] : start[at + 1]])
        try:
            found += len(mark(mine, 0, tile=tile_at(tile[at].astype(np.int64) * edge, edge)).index)
        except OverflowError:
            return math.inf
    return found * len(tile) / count


def fitting_size(ellipsoids: Ellipsoids, limit: int) -> tuple[float, float] | None:
    """Find a larger size of the voxels at which they are about `limit` at most.

    Sizes that certainly suffice come first, so that no estimate takes longer than marking `limit` voxels.

    Returns:
        The size [m], with two digits, and the estimated number of voxels; None when no size was found.
    """
    aim, size = _ROOM * limit, _two_digits(ellipsoids.voxel_size_m)
    while most_voxels(dataclasses.replace(ellipsoids, voxel_size_m=size)) > aim:
        size = _two_digits(2 * size)
        if size > _LONGEST_M:
            return None
    found: tuple[float, float] | None = None
    for _ in range(_SIZES):
        voxels = estimated_voxels(dataclasses.replace(ellipsoids, voxel_size_m=size))
        if voxels > aim:
            break
        found = size, voxels
        finer = _two_digits(size * max((max(voxels, 1.0) / aim) ** (1 / 3), 0.25))
        if finer >= 0.95 * size or finer <= ellipsoids.voxel_size_m:
            break
        size = finer
    return found


def _two_digits(value: float) -> float:
    """Round up to two digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit - 1e-9) * unit:.2g}")


def dominant(ellipsoids: Ellipsoids, voxels: float, limit: int) -> Dominant | None:
    """Find a few of the largest Gaussians without which there are about `limit` voxels at most.

    Args:
        voxels: estimated number of voxels with all Gaussians.

    Returns:
        The fewest of 1, 10 and 100; None when even 100 do not suffice.
    """
    longest, aim = ellipsoids.scale.max(axis=1), _ROOM * limit
    order = np.argsort(-longest, kind="stable")[: _FEW[-1] + 1]
    alone = np.prod(_extent(ellipsoids.part(order)), axis=1)  # upper bounds
    for few in _FEW:
        if few >= len(order) or longest[order[few]] == longest[order[few - 1]]:
            continue
        if math.isfinite(voxels) and voxels - alone[:few].sum() > aim:
            continue
        keep = np.ones(len(longest), np.bool_)
        keep[order[:few]] = False
        rest = ellipsoids.part(np.flatnonzero(keep))
        count = estimated_voxels(rest)
        if count <= min(aim, _ROOM * voxels):
            between = math.sqrt(float(longest[order[few - 1]]) * float(longest[order[few]]))
            return Dominant(tuple(order[:few].tolist()), float(longest[order[0]]), between, round(count))
    return None


def largest_share(ellipsoids: Ellipsoids, voxels: int) -> tuple[int, float] | None:
    """Row of the largest ellipsoid and the fraction of the voxels that its volume alone fills.

    Args:
        ellipsoids: the sets and the lattice; with a crop nothing is found, as it cuts the volume.
    """
    if ellipsoids.crop is not None or voxels == 0:
        return None
    row, volume = largest_volume(ellipsoids)
    return row, min(volume / voxels, 1.0)


def largest_volume(ellipsoids: Ellipsoids) -> tuple[int, float]:
    """Row of the largest ellipsoid and its volume [voxels]."""
    found = 0, -math.inf
    for start in range(0, len(ellipsoids.scale), _CHUNK):
        scale = ellipsoids.scale[start : start + _CHUNK].astype(np.float64)
        x, y, z = ((scale * ellipsoids.sigma + ellipsoids.inflation_m) / ellipsoids.voxel_size_m).T
        volume = 4 / 3 * math.pi * (x * y * z)
        row = int(np.argmax(volume))
        if volume[row] > found[1]:
            found = start + row, float(volume[row])
    return found


def named(rows: tuple[int, ...]) -> str:
    """Rows in words, at most five of them."""
    more = ", ..." if len(rows) > _NAMED else ""
    return ", ".join(map(str, rows[:_NAMED])) + more
