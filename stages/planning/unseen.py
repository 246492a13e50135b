"""Space that was not seen, as boxes: obstacles for what must stay in seen space."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import SeenManifest
from alula.schemas.errors import InfeasibleError
from alula.stages.compression.hulls import Hulls
from alula.stages.planning.reach import Mask

_OUTWARD = 8 * np.finfo(np.float64).eps  # more than the roundings of a bound and of a plane
_CORNERS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


def unseen_hulls(seen: Artifact, lower_m: ArrayLike | None = None, upper_m: ArrayLike | None = None) -> Hulls:
    """Cover all space that is not seen, near the seen voxels, by boxes.

    Boxes fill the box around the seen voxels as far as they are not seen, and surround it one voxel thick. So
    a continuous path that begins in a seen voxel and keeps away from every box stays in seen voxels: the
    distance to the boxes is that to unseen space. A path must be tested for where it begins, with `is_seen`,
    because beyond the surrounding layer there are no boxes.

    Args:
        lower_m: leave out boxes that lie wholly below it along an axis, shape (3,) [m].
        upper_m: leave out boxes that lie wholly above it.

    Returns:
        The boxes, in the frame of the seen voxels [m]; their bounds are rounded outward.
    """
    manifest = seen.manifest
    assert isinstance(manifest, SeenManifest)
    index = np.asarray(seen["index"], np.int64)
    first = index.min(axis=0) - 1
    unseen = np.ones(tuple((index.max(axis=0) + 2 - first).tolist()), np.bool_)
    unseen[tuple((index - first).T)] = False
    low, high = (np.array(side) + first for side in boxes_of(unseen))
    lower, upper = low * manifest.voxel_size_m, high * manifest.voxel_size_m
    keep = np.ones(len(lower), np.bool_)
    if lower_m is not None:
        keep &= (upper >= np.asarray(lower_m)).all(axis=1)
    if upper_m is not None:
        keep &= (lower <= np.asarray(upper_m)).all(axis=1)
    return hulls_of_boxes(lower[keep], upper[keep])


def is_seen(seen: Artifact, points: ArrayLike) -> NDArray[np.bool_]:
    """Test whether points lie in seen voxels.

    Args:
        points: shape (n, 3), frame of the seen voxels [m].
    """
    manifest: Any = seen.manifest
    voxel = np.floor(np.asarray(points, np.float64) / manifest.voxel_size_m).astype(np.int64)
    index = np.asarray(seen["index"], np.int64)
    lower = np.minimum(index.min(axis=0), voxel.min(axis=0))
    size = tuple((np.maximum(index.max(axis=0), voxel.max(axis=0)) - lower + 1).tolist())
    return np.isin(*(np.ravel_multi_index(tuple((each - lower).T), size) for each in (voxel, index)))


def require_seen(seen: Artifact, named: Sequence[tuple[str, Sequence[float]]]) -> None:
    """Refuse points of a flight that are not in seen space.

    Args:
        named: names and positions of the points [m].

    Raises:
        InfeasibleError: names the first such point.
    """
    for (name, point), good in zip(named, is_seen(seen, [point for _, point in named]), strict=True):
        if not good:
            where = f"the {name} ({' '.join(f'{x:g}' for x in point)})"
            raise InfeasibleError(f"{where} is not in the space that was seen (--within)")


def boxes_of(mask: Mask) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Partition marked voxels into boxes: runs along z, joined where they are equal along y, then along x.

    Args:
        mask: shape (X, Y, Z).

    Returns:
        First voxel of each box, and one past its last voxel, each of shape (n, 3).
    """
    padded = np.pad(mask, ((0, 0), (0, 0), (1, 1))).astype(np.int8)
    change = np.diff(padded, axis=2)
    x, y, begin = np.nonzero(change == 1)
    end = np.nonzero(change == -1)[2]
    low, high = np.column_stack([x, y, begin]), np.column_stack([x + 1, y + 1, end])
    for axis in (1, 0):
        others = [i for i in range(3) if i != axis]
        keys = np.column_stack([*(low[:, i] for i in others), *(high[:, i] for i in others), low[:, axis]])
        order = np.lexsort(keys.T[::-1])
        low, high, keys = low[order], high[order], keys[order]
        joins = (keys[1:, :-1] == keys[:-1, :-1]).all(axis=1) & (low[1:, axis] == high[:-1, axis])
        first = np.flatnonzero(np.concatenate([[True], ~joins])[: len(low)])
        last = np.concatenate([first[1:], [len(low)]]) - 1
        top = high[last, axis] if len(low) else high[:, axis]
        low, high = low[first], high[first]
        high[:, axis] = top
    return low.astype(np.int64), high.astype(np.int64)


def hulls_of_boxes(lower: NDArray[np.float64], upper: NDArray[np.float64]) -> Hulls:
    """Boxes as polytopes, with planes rounded outward.

    Args:
        lower: smallest corners, shape (n, 3) [m].
        upper: largest corners, shape (n, 3) [m].
    """
    count = len(lower)
    slack = _OUTWARD * (np.abs(np.concatenate([lower, upper])).max(initial=0.0) + 1)
    normal = np.tile(np.concatenate([np.eye(3), -np.eye(3)]), (count, 1))
    corner = np.where(_CORNERS[None] == 1, upper[:, None], lower[:, None])
    return Hulls(
        normal_world=normal,
        offset_m=np.concatenate([upper, -lower], axis=1).reshape(-1) + slack,
        plane_start=np.arange(count + 1, dtype=np.int64) * 6,
        vertices_world=np.ascontiguousarray(corner.reshape(-1, 3)),
        vertex_start=np.arange(count + 1, dtype=np.int64) * 8,
    )


def joined(parts: Iterable[Hulls]) -> Hulls:
    """All polytopes of several sets, in their order.

    Args:
        parts: the sets, in one frame.
    """
    each = list(parts)
    planes = np.cumsum([0, *(len(part.offset_m) for part in each)])
    vertices = np.cumsum([0, *(len(part.vertices_world) for part in each)])
    zero = np.zeros(1, np.int64)
    return Hulls(
        normal_world=np.concatenate([part.normal_world for part in each]),
        offset_m=np.concatenate([part.offset_m for part in each]),
        plane_start=np.concatenate(
            [zero, *(p.plane_start[1:] + n for p, n in zip(each, planes, strict=False))]
        ),
        vertices_world=np.concatenate([part.vertices_world for part in each]),
        vertex_start=np.concatenate(
            [zero, *(p.vertex_start[1:] + n for p, n in zip(each, vertices, strict=False))]
        ),
    )
