"""Polytopes of a cover in metres, the form that all later stages use."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import ArtifactError
from alula.stages.compression.onboard.image import MapImage

ROWS = {
    "vertex_start": ("vertex",),
    "plane_start": ("plane_normal", "plane_offset"),
    "member_start": ("member_index",),
}
"""Arrays of a cover by the array with the first row of each hull."""
_OUTWARD_ULPS = 8.0  # more than the roundings of offset * g / |normal| and of the unit normal together


class Planes(NamedTuple):
    """Integer half-spaces {x : normal . x <= offset} of polytopes on a lattice.

    Attributes:
        normal: outward, shape (F, 3).
        offset: shape (F,).
        start: first plane of each polytope and the end, shape (n + 1,).
    """

    normal: NDArray[np.int64]
    offset: NDArray[np.int64]
    start: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Hulls:
    """Convex polytopes {x : normal . x <= offset} in the world frame, row-compressed by hull.

    The planes are rounded outward: each double-precision half-space contains the exact one inside
    a ball around the origin that holds all vertices. Vertices are rounded to nearest: those of hulls
    once; those of outer polytopes, which are off the lattice, to within 4 units in the last place of
    the largest coordinate.

    Attributes:
        normal_world: outward unit normals, shape (F, 3).
        offset_m: shape (F,) [m].
        plane_start: first plane of each hull and the end, shape (n + 1,).
        vertices_world: shape (V, 3) [m].
        vertex_start: first vertex of each hull and the end, shape (n + 1,).
    """

    normal_world: NDArray[np.float64]
    offset_m: NDArray[np.float64]
    plane_start: NDArray[np.int64]
    vertices_world: NDArray[np.float64]
    vertex_start: NDArray[np.int64]

    @classmethod
    def from_cover(cls, cover: Artifact) -> Self:
        """Convert the polytopes of an `alula/cover`, hulls or outer ones, to metres.

        Raises:
            ArtifactError: the planes of an outer polytope bound no solid.
        """
        edge = float(cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
        return cls.from_lattice(edge, _planes(cover), *_corners(cover))

    @classmethod
    def from_lattice(
        cls,
        voxel_size_m: float,
        planes: Planes,
        corner: NDArray[np.float64],
        corner_start: NDArray[np.int64],
    ) -> Self:
        """Convert polytopes with integer planes to metres.

        Args:
            voxel_size_m: unit of the lattice [m].
            planes: in units of the lattice.
            corner: corners in units of the lattice, shape (V, 3).
            corner_start: first corner of each polytope and the end, shape (n + 1,).
        """
        integer = planes.normal.astype(np.float64)
        length = np.sqrt((integer * integer).sum(axis=1))
        vertices = corner * voxel_size_m
        extent = float(np.abs(vertices).max(initial=0.0)) + voxel_size_m
        offset = planes.offset.astype(np.float64) * (voxel_size_m / length)
        return cls(
            normal_world=integer / length[:, None],
            offset_m=offset + _OUTWARD_ULPS * np.finfo(np.float64).eps * extent,
            plane_start=planes.start,
            vertices_world=vertices,
            vertex_start=corner_start,
        )

    def __len__(self) -> int:
        return len(self.plane_start) - 1

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Axis-aligned bounds of each hull: lower and upper, each of shape (n, 3) [m]."""
        if len(self) == 0:
            return np.empty((0, 3)), np.empty((0, 3))
        starts = self.vertex_start[:-1]
        return (
            np.minimum.reduceat(self.vertices_world, starts, axis=0),
            np.maximum.reduceat(self.vertices_world, starts, axis=0),
        )


def image_hulls(image: MapImage) -> Hulls:
    """Polytopes of an onboard map in metres, each with its six box planes first.

    Raises:
        ArtifactError: the planes of a hull bound no solid.
    """
    count, faces = len(image), np.concatenate([np.eye(3, dtype=np.int64), -np.eye(3, dtype=np.int64)])
    box = np.concatenate([image.upper, -image.lower.astype(np.int64)], axis=1).astype(np.int64)
    order = np.concatenate([np.repeat(np.arange(count), 6), _hull_of(image.plane_start)])
    by_hull = np.argsort(order, kind="stable")
    normal = np.concatenate([np.tile(faces, (count, 1)), image.normal.astype(np.int64)])[by_hull]
    offset = np.concatenate([box.reshape(-1), image.offset])[by_hull]
    start = image.plane_start + 6 * np.arange(count + 1)
    planes = Planes(*(np.ascontiguousarray(each, np.int64) for each in (normal, offset, start)))
    try:
        found = _core.outer_solids(planes.normal, planes.offset, planes.start, 0)
    except ValueError as error:
        raise ArtifactError(f"the onboard map is not sound: {error}") from error
    return Hulls.from_lattice(image.voxel_size_m, planes, found["point"], found["point_start"])


def _planes(cover: Artifact) -> Planes:
    names = ("plane_normal", "plane_offset", "plane_start")
    return Planes(*(np.ascontiguousarray(cover[name], np.int64) for name in names))


def _hull_of(start: NDArray[np.int64]) -> NDArray[np.int64]:
    """Hull of each row, from the first row of each hull and the end."""
    return np.repeat(np.arange(len(start) - 1), np.diff(start))


def outer_solids(cover: Artifact, *, jobs: int = 0) -> dict[str, NDArray[Any]]:
    """Corners and triangles of the polytopes that the planes of a cover bound, in voxel edges.

    They are computed exactly in 128-bit integers and rounded at the end; see
    native/core/include/alula/cover/outer_solid.hpp.

    Returns:
        `point` (P, 3), `point_start` (n + 1,), `triangle` (T, 3), counter-clockwise from outside,
        `triangle_start` (n + 1,) and `is_lattice` (n,): no corner of that hull was rounded.

    Raises:
        ArtifactError: the planes of a hull bound no solid within the lattice's range.
    """
    planes = _planes(cover)
    try:
        found: dict[str, NDArray[Any]] = _core.outer_solids(planes.normal, planes.offset, planes.start, jobs)
    except ValueError as error:
        raise ArtifactError(f"the cover is not sound: {error}") from error
    return found


def is_outer(cover: Artifact) -> bool:
    """Test whether a cover has outer polytopes, which contain the hulls of `vertex` but may be larger."""
    return bool(cover.manifest.polytopes == "outer")  # type: ignore[attr-defined]


def _corners(cover: Artifact) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Corners of the polytopes in voxel edges, and the first of each."""
    if not is_outer(cover):
        return np.asarray(cover["vertex"], np.float64), np.asarray(cover["vertex_start"], np.int64)
    found = outer_solids(cover)
    return found["point"], found["point_start"]


def some_hulls(
    cover: Artifact, numbers: NDArray[np.int64], starts: Sequence[str]
) -> tuple[dict[str, NDArray[Any]], dict[str, NDArray[np.int64]]]:
    """Arrays of some hulls alone.

    Args:
        numbers: of the hulls, in ascending order.
        starts: which arrays, by those with their first rows, such as `vertex_start`.

    Returns:
        The arrays; and for each of `starts` the rows in `cover` minus those here, one number per hull.
    """
    arrays: dict[str, NDArray[Any]] = {}
    shift: dict[str, NDArray[np.int64]] = {}
    for start in starts:
        begin = np.asarray(cover[start])
        size = np.diff(begin)[numbers]
        arrays[start] = np.concatenate([[0], np.cumsum(size)]).astype(np.int64)
        shift[start] = begin[:-1][numbers] - arrays[start][:-1]
        rows = np.arange(arrays[start][-1]) + np.repeat(shift[start], size)
        arrays |= {name: np.ascontiguousarray(cover[name][rows]) for name in ROWS[start]}
    return arrays, shift
