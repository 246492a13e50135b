"""Geofences of flights: a box, a polytope and hulls to keep out of, as the native `Fence`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from alula._core import Fence
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import UsageError
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map

Point = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class KeepOut:
    """A cover to stay out of: the image of its onboard map for the filter, and its hulls for the judge."""

    image: bytes
    hulls: Hulls

    @classmethod
    def of(cls, cover: Artifact, *, indexed: bool = False, jobs: int = 0) -> Self:
        """Encode a cover.

        Args:
            cover: an `alula/cover`, in metres.
            indexed: add the tree of boxes to the map, see `encode_map`.

        Raises:
            InfeasibleError, InputError, ArtifactError: it has no onboard map, see `encode_map`.
        """
        return cls(encode_map(cover, indexed=indexed, jobs=jobs), Hulls.from_cover(cover))


def fence(
    *,
    box: tuple[Point, Point] | None = None,
    faces: NDArray[np.float64] | None = None,
    cover: Artifact | KeepOut | None = None,
) -> Fence:
    """Build the set to stay in: inside the box and the polytope, outside the hulls of the cover.

    Args:
        box: lower and upper corner, world frame [m].
        faces: shape (L, 4), rows (n, d) of the polytope {p : n . p <= d} with unit n, world frame [m].
        cover: an `alula/cover`, in metres, or one that is encoded already. The filter flies around its
            onboard map, which contains each hull; flights are judged by the hulls themselves.

    Raises:
        UsageError: there is nothing to stay in or out of.
        InfeasibleError, InputError, ArtifactError: the cover has no onboard map, see `encode_map`.
    """
    if box is None and faces is None and cover is None:
        raise UsageError("a fence needs a box, faces or a cover")
    keep_out = KeepOut.of(cover, indexed=True) if isinstance(cover, Artifact) else cover
    return Fence(
        box=box,
        faces=None if faces is None else np.ascontiguousarray(faces, np.float64),
        image=None if keep_out is None else keep_out.image,
        keep_out=None if keep_out is None else hull_obstacles(keep_out.hulls),
    )


def unit_faces(rows: Sequence[Sequence[float]]) -> FloatArray:
    """Faces of a polytope with unit normals.

    Args:
        rows: L rows (n, d) with n . p <= d inside, world frame [m]; n of any length above 0.

    Returns:
        Shape (L, 4), rows (n, d) with unit n.
    """
    faces = np.array(rows, np.float64).reshape(-1, 4)
    unit: FloatArray = faces / np.linalg.norm(faces[:, :3], axis=1, keepdims=True)
    return unit


def fence_faces(box: Sequence[float] | None, rows: Sequence[Sequence[float]]) -> FloatArray:
    """Faces of a box and of a polytope together.

    Args:
        box: XMIN YMIN ZMIN XMAX YMAX ZMAX, world frame [m].
        rows: those of the polytope, as `unit_faces` takes them.

    Returns:
        Shape (L, 4), as from `unit_faces`; the upper faces of the box, the lower ones, the polytope's.
    """
    faces = unit_faces(rows)
    if box is None:
        return faces
    axes = np.eye(3)
    upper = np.column_stack([axes, np.array(box[3:])])
    lower = np.column_stack([-axes, -np.array(box[:3])])
    return np.concatenate([upper, lower, faces])
