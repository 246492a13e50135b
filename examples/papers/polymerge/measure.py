"""Volume of a union of convex polytopes, exact up to rounding, and the voxels that it does not fill."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import InputError
from alula.schemas.progress import Progress

_SLIVER = 1e-9  # of a voxel's volume; the rounding of planes causes far smaller errors


@dataclass(frozen=True, slots=True)
class Measure:
    """Volumes of a union of polytopes, compared with occupied voxels [voxels].

    Attributes:
        voxels: number of occupied voxels.
        union: volume of the union.
        intersection: volume of the union inside occupied voxels.
        open_voxels: number of occupied voxels of which the union leaves out more than the allowed `sliver`.
        error: bound on the rounding error of each volume.
    """

    voxels: int
    union: float
    intersection: float
    open_voxels: int
    error: float

    @property
    def conservativeness(self) -> float:
        """Volume of the union over that of the voxels."""
        return self.union / self.voxels

    @property
    def filled(self) -> float:
        """Fraction of the voxels' volume that the union fills."""
        return self.intersection / self.voxels


def measure_cover(
    cover: Artifact,
    index: NDArray[np.integer[Any]] | None = None,
    *,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Measure:
    """Measure the polytopes that the planes of an `alula/cover` bound, and compare them with voxels.

    Args:
        cover: an `alula/cover`.
        index: occupied voxels, shape (M, 3), in any order; None: the cover's members.
        jobs: threads, 0 for all processors; the result does not depend on it.
        progress: called with (done, total) from time to time.

    Raises:
        InputError: there is no voxel, or a polytope has no facets along its bounding box.
    """
    integer = np.asarray(cover["plane_normal"], np.float64)
    length = np.sqrt((integer * integer).sum(axis=1))
    start = np.asarray(cover["plane_start"], np.int64)
    normal, offset = integer / length[:, None], np.asarray(cover["plane_offset"], np.float64) / length
    lower, upper = _boxes(normal, offset, start)
    voxels = cover["member_index"] if index is None else index
    return _measure(normal, offset, start, lower, upper, voxels, _SLIVER, jobs, progress)


def measure_points(
    parts: Sequence[FloatArray],
    index: NDArray[np.integer[Any]],
    *,
    sliver: float = _SLIVER,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Measure:
    """Measure the union of convex hulls of points, such as those of other tools, and compare it with voxels.

    Args:
        parts: the points of each hull, shape (k, 3) [voxel edges]; flat ones have no volume.
        index: occupied voxels, shape (M, 3), in any order.
        sliver: maximum fraction of a voxel that may be missing where it counts as filled.
        jobs: threads, 0 for all processors; the result does not depend on it.
        progress: called with (done, total) from time to time.

    Raises:
        InputError: a coordinate is not finite.
    """
    planes, boxes = [], []
    for points in parts:
        if len(found := half_spaces(points)):
            planes.append(found)
            boxes.append((points.min(axis=0), points.max(axis=0)))
    all_planes = np.concatenate([*planes, np.empty((0, 4))])
    start = np.concatenate([[0], np.cumsum([len(p) for p in planes], dtype=np.int64)]).astype(np.int64)
    lower, upper = (np.array([box[side] for box in boxes], np.float64).reshape(-1, 3) for side in (0, 1))
    return _measure(all_planes[:, :3], -all_planes[:, 3], start, lower, upper, index, sliver, jobs, progress)


def half_spaces(points: FloatArray) -> FloatArray:
    """Half-spaces of the facets of a convex hull.

    Args:
        points: shape (k, 3), any units.

    Returns:
        Rows (normal, -offset), shape (F, 4); F is 0 when the points are flat.

    Raises:
        InputError: a coordinate is not finite.
    """
    from scipy.spatial import ConvexHull, QhullError

    if not np.isfinite(points).all():
        raise InputError("a hull has a coordinate that is not finite")
    try:
        return np.unique(ConvexHull(points).equations, axis=0)
    except (QhullError, ValueError):
        return np.empty((0, 4))


def _boxes(normal: FloatArray, offset: FloatArray, start: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Bounding boxes of polytopes, from their axis-aligned facets: lower and upper, each of shape (n, 3)."""
    hull = np.repeat(np.arange(len(start) - 1), np.diff(start))
    sides = np.full((2, len(start) - 1, 3), np.nan)
    for axis in range(3):
        for side, sign in enumerate((-1.0, 1.0)):
            at = np.flatnonzero(normal[:, axis] == sign)
            sides[side, hull[at], axis] = sign * offset[at]
    if np.isnan(sides).any():
        raise InputError("a polytope of the cover has no facets along its bounding box")
    return sides[0], sides[1]


def _measure(
    normal: FloatArray,
    offset: FloatArray,
    start: NDArray[np.int64],
    lower: FloatArray,
    upper: FloatArray,
    index: NDArray[np.integer[Any]],
    sliver: float,
    jobs: int,
    progress: Progress | None,
) -> Measure:
    voxels = np.unique(np.asarray(index, np.int32).reshape(-1, 3), axis=0)
    if len(voxels) == 0:
        raise InputError("there is no occupied voxel to measure against")
    arrays = [np.ascontiguousarray(a, np.float64) for a in (normal, offset, lower, upper)]
    found = _core.union_measure(
        arrays[0], arrays[1], start, arrays[2], arrays[3], voxels, sliver, jobs, progress
    )
    return Measure(
        voxels=len(voxels),
        union=float(found["volume"]),
        intersection=float(found["intersection"]),
        open_voxels=len(voxels) - int(found["whole"]),
        error=float(found["error"]),
    )
