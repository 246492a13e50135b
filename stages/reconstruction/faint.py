"""Volume that Gaussians of a low opacity mark: what a limit of the opacity would remove."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.parameters.configs.import_splat import DRAWN

FAINT = 0.1
LIMITS = (DRAWN, 0.02, 0.05, FAINT, 0.2, 0.5)
_CELLS = 128  # along the longest side of the box
_MARGIN = 8  # cells around the box
_QUANTILE = 0.01  # of centres outside the box, at each side
_SAMPLE = 2**18  # at most, of centres


@dataclass(frozen=True, slots=True)
class OpacityLimit:
    """Effect of one limit of the opacity.

    Attributes:
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
    ascending = sorted({float(limit) for limit in limits})
    gaussians, cells = _core.tally_opacity(
        mean, scale, quat_wxyz, opacity, np.array(ascending, np.float32), tuple(origin), edge, tuple(size)
    )
    return MarkedVolume(
        edge,
        sum(cells),
        tuple(
            OpacityLimit(limit, sum(gaussians[: k + 1]), sum(cells[: k + 1]))
            for k, limit in enumerate(ascending)
        ),
    )
