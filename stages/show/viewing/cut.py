"""The ceiling and the near walls of a closed space, which would hide what is inside from the first camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray

_CELL_M = 0.5
_ABOVE_M = 0.3  # a roof is at least so far above what flies
_BESIDE_M = 0.2  # walls are at least so far beside it
_ROOFED = 0.5  # fraction of places under a roof, in a closed space
_FLOOR_M = 0.1
_CORE = (0.02, 0.98)  # quantiles of the extent of a space that nothing flies in
_INSIDE = 0.12  # of that extent, from each side to the inside
_HOLLOW = 0.35  # fraction of the matter that is inside, at most; of a full block it is 0.44


@dataclass(frozen=True, slots=True)
class Cut:
    """What to remove: above `top_m`, or on the camera's sides of `side_m` in x and y, but for the floor.

    The first camera looks towards +x and +y, so its sides are those of small x and y.
    """

    top_m: float
    side_m: tuple[float, float]
    floor_m: float

    def removes(self, low: FloatArray, high: FloatArray) -> NDArray[np.bool_]:
        """Mark boxes that lie in what is removed.

        Args:
            low: lower corners, shape (n, 3) [m].
            high: upper corners, shape (n, 3) [m].
        """
        is_near = (high[:, 0] < self.side_m[0]) | (high[:, 1] < self.side_m[1])
        found: NDArray[np.bool_] = (low[:, 2] > self.top_m) | (is_near & (high[:, 2] > self.floor_m))
        return found


def find_cut(solid: FloatArray, flown: FloatArray) -> Cut | None:
    """Find what hides the inside; None unless most of the places have a roof.

    With a flight or a plan the places are its points. Without, they are the cells of the ground plan, and the
    roof is matter in the upper part of the space; the inside must then be hollow.

    Args:
        solid: points of matter, shape (n, 3), z up [m].
        flown: points of flights and plans, shape (m, 3) [m].
    """
    if len(solid) < 8:
        return None
    floor = float(np.quantile(solid[:, 2], _CORE[0])) + _FLOOR_M
    if len(flown):
        roof = _tops(solid)
        above = np.array([roof.get(cell, -np.inf) for cell in map(tuple, _cells(flown))])
        if (above > flown[:, 2] + _ABOVE_M).mean() < _ROOFED:
            return None
        low, top = flown.min(axis=0) - _BESIDE_M, float(flown[:, 2].max()) + 0.5 * _ABOVE_M
        return Cut(top, (float(low[0]), float(low[1])), floor)
    low, high = np.quantile(solid, _CORE, axis=0)
    size = np.maximum(high - low, 1e-9)
    cell = np.floor((solid[:, :2] - low[:2]) / size[:2] * 12)
    inside = ((cell >= 0) & (cell < 12)).all(axis=1)
    number = (cell[:, 0] * 12 + cell[:, 1])[inside].astype(np.int64)
    is_high = solid[inside, 2] > high[2] - 0.15 * size[2]
    if len(np.unique(number[is_high])) < _ROOFED * 144:
        return None
    inner = low + _INSIDE * size
    if ((solid > inner) & (solid < high - _INSIDE * size)).all(axis=1).mean() > _HOLLOW:
        return None
    return Cut(float(high[2] - _INSIDE * size[2]), (float(inner[0]), float(inner[1])), floor)


def _cells(points: FloatArray) -> NDArray[np.int64]:
    return np.floor(points[:, :2] / _CELL_M).astype(np.int64)


def _tops(solid: FloatArray) -> dict[tuple[int, ...], float]:
    """Highest matter in each cell of the ground plan."""
    cells, inverse = np.unique(_cells(solid), axis=0, return_inverse=True)
    top = np.full(len(cells), -np.inf)
    np.maximum.at(top, inverse.ravel(), solid[:, 2])
    return dict(zip(map(tuple, cells), top.tolist(), strict=True))
