"""Maps without Gaussians: triangles, points, or the octree of OctoMap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError

OCTREE_HALF = 2**15  # voxels of OctoMap's tree on each side of its origin


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles of a mesh.

    Attributes:
        corners: shape (T, 3, 3), units and axes of the file.
        up: axis that points up, by the file's format.
        bent: triangles of all other ways to cut polygons that are not flat, shape (B, 3, 3).
        loose: points of the file that belong to no triangle.
    """

    corners: FloatArray
    up: Literal["y", "z"] = "z"
    bent: FloatArray = field(default_factory=lambda: np.empty((0, 3, 3)))
    loose: int = 0

    @property
    def surface(self) -> FloatArray:
        """All triangles that can be a part of the surface, shape (T + B, 3, 3)."""
        return np.concatenate([self.corners, self.bent])


@dataclass(frozen=True, slots=True)
class Cloud:
    """Points of a cloud.

    Attributes:
        points: shape (N, 3), units and axes of the file.
    """

    points: FloatArray


@dataclass(frozen=True, slots=True)
class Octree:
    """OctoMap's tree, as its file has it.

    Attributes:
        body: the nodes, depth first.
        is_binary: they have the two bits of a .bt file for each child, not the occupancy of an .ot file.
        payload: bytes of a node of an .ot file between its occupancy and its children.
        nodes: their number, by the file.
        edge: of the smallest voxel, as the file has it [file units].
    """

    body: NDArray[np.uint8]
    is_binary: bool
    payload: int
    nodes: int
    edge: Fraction


ImportedSource = Mesh | Cloud | Octree
NAMES = {Mesh: "mesh", Cloud: "cloud", Octree: "octree"}


def in_world(
    points: FloatArray, scale: float, up: Literal["y", "z"], map_origin_m: Sequence[float] = (0.0, 0.0, 0.0)
) -> FloatArray:
    """Points in metres with z up, from the map's origin; two roundings, which the voxels allow for.

    Args:
        points: shape (..., 3), file units.
        scale: metres per unit.
        up: axis of the file that becomes z; y turns about x by 90 degrees.
        map_origin_m: position of the map's origin [m]; subtracted before the scale, in units of the file.

    Raises:
        InputError: a point is too far away for voxels.
    """
    turned = points if up == "z" else np.stack([points[..., 0], -points[..., 2], points[..., 1]], axis=-1)
    if any(map_origin_m):
        turned = turned - np.array(map_origin_m) / scale
    found = np.ascontiguousarray(turned * scale, np.float64)
    if np.abs(found).max(initial=0.0) > 1e9:
        raise InputError("a point lies more than 1e9 m from the origin; is --scale right?")
    return found


def open_edges(corners: FloatArray) -> tuple[int, FloatArray]:
    """Edges of a mesh that its triangles do not use as often in one direction as in the other.

    Without any, the surface is closed and its triangles are oriented alike: the winding number around each
    point off the surface is a whole number. Corners are equal when their coordinates are.

    Args:
        corners: shape (T, 3, 3).

    Returns:
        Their number, and the ends of the first, shape (2, 3).
    """
    vertices, number = np.unique(corners.reshape(-1, 3) + 0.0, axis=0, return_inverse=True)
    face = number.reshape(-1, 3)
    start, end = face.ravel(), np.roll(face, -1, axis=1).ravel()
    low, high = np.minimum(start, end).astype(np.int64), np.maximum(start, end)
    _, first, edge = np.unique(low * len(vertices) + high, return_index=True, return_inverse=True)
    sums = np.bincount(edge.ravel(), weights=np.sign(end - start))
    wrong = np.flatnonzero(sums)
    if len(wrong) == 0:
        return 0, np.empty((0, 3))
    at = first[wrong[0]]
    return len(wrong), vertices[[start[at], end[at]]]


def require_watertight(corners: FloatArray) -> None:
    """Refuse a mesh that encloses nothing definite.

    Args:
        corners: shape (T, 3, 3).

    Raises:
        InputError: an edge is open; the message has the number of such edges and the first.
    """
    count, ends = open_edges(corners)
    if count:
        first = " to ".join("(" + ", ".join(f"{c:.6g}" for c in end) + ")" for end in ends.tolist())
        raise InputError(
            f"the mesh is not watertight, as --solid needs it: {count} edges do not have as many triangles "
            f"on one side as on the other, the first from {first}"
        )


def lattice_range(
    lower: NDArray[np.int32], upper: NDArray[np.int32], ratio: Fraction
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Voxels of a lattice that share more than their surface with boxes of another one, exactly.

    Args:
        lower: lower corners of the boxes, in edges of their lattice, shape (N, 3).
        upper: upper corners.
        ratio: edge of their lattice over that of the voxels.

    Returns:
        The lowest and the highest voxel of each, shape (N, 3).

    Raises:
        InputError: an index exceeds 32 bits.
    """
    corners, number = np.unique(np.concatenate([lower, upper]), return_inverse=True)
    p, q = ratio.numerator, ratio.denominator
    floors = [k * p // q for k in corners.tolist()]
    ceilings = [-(-k * p // q) for k in corners.tolist()]
    if corners.size and max(-floors[0], ceilings[-1]) > 2**31 - 2:
        raise InputError("voxel indices would not fit 32 bits: the octree reaches too far for this --size")
    place = number.reshape(-1, 3)
    low = np.array(floors, np.int64)[place[: len(lower)]]
    high = np.array(ceilings, np.int64)[place[len(lower) :]] - 1
    return low.astype(np.int32), high.astype(np.int32)


def decimal(value: float) -> Fraction:
    """The shortest decimal that reads as a double: lengths that files and options state in decimals.

    With it 0.15 is 3 times 0.05, so lattices that fit by their decimals fit exactly.

    Args:
        value: finite.
    """
    return Fraction(repr(float(value)))
