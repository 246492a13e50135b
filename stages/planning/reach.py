"""Places that a ball can go to on a lattice of voxels, by steps of one voxel along an axis.

The ball is open and its centre moves along the lines between the centres of neighbouring voxels. A voxel at
the offset (a, b, c) from the voxel of the centre is at the squared distance sum max(|a| - 1/2, 0)^2 from it,
and along such a line each term is monotone. So a ball that touches no blocked voxel at both ends of a step
touches none on the way: the answers are exact, not sampled.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.parameters.configs.observe import LONGEST_RADIUS_VOXELS

Mask = NDArray[np.bool_]
_FAR = 30_000  # more than the largest limit; twice it fits into 16 bits


def limit_of(radius_voxels: float) -> int:
    """Smallest 4 d^2, d a distance in voxels between a centre and a cube, that an open ball does not reach.

    Args:
        radius_voxels: radius of the ball in voxel edges.
    """
    assert 0 < radius_voxels <= LONGEST_RADIUS_VOXELS * (1 + 1e-9)
    return math.ceil((2 * radius_voxels) ** 2 * (1 - 1e-12))


def layers_of(radius_voxels: float) -> int:
    """Number of voxels beyond its own that the ball touches along an axis.

    Args:
        radius_voxels: radius of the ball in voxel edges.
    """
    limit, count = limit_of(radius_voxels), 0
    while (2 * count + 1) ** 2 < limit:
        count += 1
    return count


def touched(centres: Mask, radius_voxels: float) -> Mask:
    """Mark the voxels that a ball around the centre of some voxel touches.

    Args:
        centres: voxels with such a ball, shape (X, Y, Z).
    """
    limit, layers = limit_of(radius_voxels), layers_of(radius_voxels)
    distance = np.where(centres, 0, _FAR).astype(np.uint16)
    for axis in range(3):
        source = np.moveaxis(distance, axis, 0)
        result = source.copy()
        for n in range(1, min(layers, len(source) - 1) + 1):
            cost = np.uint16((2 * n - 1) ** 2)
            np.minimum(result[n:], source[:-n] + cost, out=result[n:])
            np.minimum(result[:-n], source[n:] + cost, out=result[:-n])
        distance = np.moveaxis(np.minimum(result, _FAR), 0, axis)
    return np.ascontiguousarray(distance < limit)


def centres_of(free: Mask, radius_voxels: float, *, is_closed: bool = True) -> Mask:
    """Mark the voxels with a ball around their centre that touches free voxels alone.

    Args:
        free: shape (X, Y, Z).
        is_closed: voxels outside of the array are not free; otherwise they are.
    """
    found = ~touched(~free, radius_voxels)
    if is_closed:
        found &= ~rim(free.shape, layers_of(radius_voxels))
    return found


def rim(shape: tuple[int, ...], layers: int) -> Mask:
    """Mark the outermost layers of an array of voxels."""
    result = np.ones(shape, np.bool_)
    inner = tuple(slice(layers, max(size - layers, layers)) for size in shape)
    result[inner] = False
    return result


def components(centres: Mask) -> NDArray[np.int32]:
    """Number the sets of voxels that are connected by faces, from 1; 0 elsewhere.

    Args:
        centres: shape (X, Y, Z).
    """
    from scipy import ndimage

    label: Any = ndimage.label(centres, output=np.int32)[0]
    return np.asarray(label, np.int32)


def is_line_clear(blocked: Mask, start: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
    """Test whether no blocked voxel lies on a line, but for that of its start; outside nothing is blocked.

    Args:
        blocked: shape (X, Y, Z).
        start: first point, in voxel edges from the corner of the array, shape (3,).
        end: last point.
    """
    # Between the parameters where the line crosses a lattice plane it stays in one voxel.
    crossings = [np.array([0.0, 1.0])]
    for a, b in zip(start.tolist(), end.tolist(), strict=True):
        planes = np.arange(math.ceil(min(a, b)), math.floor(max(a, b)) + 1)
        if a != b:
            crossings.append((planes - a) / (b - a))
    at = np.unique(np.clip(np.concatenate(crossings), 0.0, 1.0))
    middle = start + ((at[1:] + at[:-1]) / 2)[:, None] * (end - start)
    voxel = np.floor(middle).astype(np.int64)
    inside = ((voxel >= 0) & (voxel < np.array(blocked.shape))).all(axis=1)
    inside &= (voxel != np.floor(start).astype(np.int64)).any(axis=1)
    return not blocked[tuple(voxel[inside].T)].any()
