"""Volume that Gaussians of a low opacity mark: what a limit of the opacity would remove."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.configs.import_splat import DRAWN

FAINT = 0.1
LIMITS = (DRAWN, 0.02, 0.05, FAINT, 0.2, 0.5)
_CELLS = 128  # along the longest side of the box
_MARGIN = 8  # cells around the box
_QUANTILE = 0.01  # of centres outside the box, at each side
_CHUNK = 2**17  # rows; their temporary arrays stay in the cache
_SAMPLE = 2**20
_LARGEST = 1e4  # cells; longer semi-axes reach across the box anyway
_FARTHEST = 1e6  # cells; centres beyond cannot reach the box


@dataclass(frozen=True, slots=True)
class OpacityLimit:
    """Effect of one limit of the opacity.

    Attributes:
        limit: minimum opacity.
        gaussians: number of Gaussians below it.
        cells: number of cells that no Gaussian of at least that opacity touches.
    """

    limit: float
    gaussians: int
    cells: int


@dataclass(frozen=True, slots=True)
class MarkedVolume:
    """Cells that the one-sigma ellipsoids of Gaussians touch, in the box of most of their centres.

    Attributes:
        edge: edge of a cell [file units]; 1/128 of the longest side of the box that has 98 % of the centres
            along each axis.
        cells: number of touched cells.
        limits: effect of each limit.
    """

    edge: float
    cells: int
    limits: tuple[OpacityLimit, ...]

    def share(self, limit: OpacityLimit) -> float:
        """Fraction of the touched cells that the limit would leave unmarked."""
        return limit.cells / self.cells if self.cells else 0.0


def marked_volume(
    mean: NDArray[np.float32],
    scale: NDArray[np.float32],
    quat_wxyz: NDArray[np.float32],
    opacity: NDArray[np.float32],
    limits: Sequence[float] = LIMITS,
) -> MarkedVolume | None:
    """Measure the volume that Gaussians mark and what limits of the opacity would remove of it.

    Rows with values that are not finite do not count. Voxels are far coarser than those of a map, so small
    Gaussians count too much on both sides; the fractions are for judging a limit, not for a guarantee.

    Args:
        mean: centres, shape (N, 3).
        scale: one-sigma semi-axes, shape (N, 3).
        quat_wxyz: rotations, not normalised, shape (N, 4).
        opacity: shape (N,).
        limits: minimum opacities.

    Returns:
        The volume; None when no row is finite or all centres coincide.
    """
    sample = mean[:: -(-len(mean) // _SAMPLE) or 1]
    sample = sample[np.isfinite(sample).all(axis=1)]
    if not len(sample):
        return None
    low, high = np.quantile(sample.astype(np.float64), [_QUANTILE, 1 - _QUANTILE], axis=0)
    edge = float((high - low).max()) / _CELLS
    if not 1e-30 < edge < 1e30:
        return None
    origin = low - _MARGIN * edge
    size = np.ceil((high - low) / edge).astype(int) + 2 * _MARGIN + 1
    steps = sorted({float(limit) for limit in limits}, reverse=True)
    ascending = np.array(steps[::-1], np.float32)
    # Of each cell: the number of limits above the opacity of the most opaque Gaussian that touches it.
    grid = np.full(size, len(steps), np.uint8)
    touched = np.zeros(size, np.bool_)
    counts = np.zeros(len(steps) + 1, np.int64)
    for start in range(0, len(mean), _CHUNK):
        part = slice(start, start + _CHUNK)
        centre, semi, quat, alpha = _finite(mean[part], scale[part], quat_wxyz[part], opacity[part])
        # Number of limits above the opacity, compared in single precision as the import does.
        band = (len(steps) - np.searchsorted(ascending, alpha, side="right")).astype(np.uint8)
        counts += np.bincount(band, minlength=len(steps) + 1)
        place = (centre - origin) / edge  # cells have the edge 1
        is_far = np.abs(place) >= _FARTHEST
        far = is_far.any(axis=1) if is_far.any() else None
        place = place.astype(np.float32)
        semi = np.clip(semi / edge, 1e-6, _LARGEST).astype(np.float32)
        for number in range(len(steps) + 1):
            mine = np.flatnonzero(band == number if far is None else (band == number) & ~far)
            if not len(mine):
                continue
            index = _touched(place[mine], semi[mine], quat[mine], size)
            at = tuple(index.T)
            touched[at] = True
            grid[at] = np.minimum(grid[at], number)
    bands = np.bincount(grid[touched], minlength=len(steps) + 1)
    return MarkedVolume(
        edge,
        int(touched.sum()),
        tuple(
            OpacityLimit(limit, int(counts[k + 1 :].sum()), int(bands[k + 1 :].sum()))
            for k, limit in reversed(list(enumerate(steps)))
        ),
    )


def _finite(*columns: NDArray[np.float32]) -> list[NDArray[Any]]:
    """Finite rows: centres and semi-axes in double precision, unit quaternions, opacities."""
    mean, scale, quat, opacity = columns
    length = np.sqrt(np.einsum("ij,ij->i", quat, quat, dtype=np.float64))
    good = np.isfinite(opacity) & (length > 0)
    for values in (mean, scale, quat):
        finite = np.isfinite(values)
        if not finite.all():
            good &= finite.all(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = (quat / length[:, None]).astype(np.float32)
    if good.all():
        return [mean.astype(np.float64), scale.astype(np.float64), unit, opacity]
    return [mean[good].astype(np.float64), scale[good].astype(np.float64), unit[good], opacity[good]]


def _touched(
    place: NDArray[np.float32], semi: NDArray[np.float32], quat: NDArray[np.float32], size: NDArray[np.intp]
) -> NDArray[np.int32]:
    """Cells of the grid that ellipsoids touch; all lengths in cells."""
    index, *_ = _core.voxelize(
        mean=place,
        scale=semi,
        quat_wxyz=quat,
        loss=None,
        sigma=1.0,
        inflation=0.0,
        voxel_size=1.0,
        crop=(0.5, 0.5, 0.5, *(size - 0.5).tolist()),
        min_overlap=1,
        jobs=0,
    )
    inside = (index >= 0) & (index < size)
    return index if inside.all() else index[inside.all(axis=1)]
