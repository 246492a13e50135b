"""Polytopes of a cover in metres, the form that all later stages use."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifact import Artifact
from alula.schemas.errors import ArtifactError

_OUTWARD_ULPS = 8.0  # more than the roundings of offset * g / |normal| and of the unit normal together


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

        Args:
            cover: an `alula/cover`.

        Raises:
            ArtifactError: the planes of an outer polytope bound no solid.
        """
        g = float(cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
        integer = np.asarray(cover["plane_normal"], np.float64)
        length = np.sqrt((integer * integer).sum(axis=1))
        offset = np.asarray(cover["plane_offset"], np.float64) * (g / length)
        lattice, vertex_start = _corners(cover)
        vertices = lattice * g
        extent = float(np.abs(vertices).max(initial=0.0)) + g
        return cls(
            normal_world=integer / length[:, None],
            offset_m=offset + _OUTWARD_ULPS * np.finfo(np.float64).eps * extent,
            plane_start=np.asarray(cover["plane_start"], np.int64),
            vertices_world=vertices,
            vertex_start=vertex_start,
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


def outer_solids(cover: Artifact, *, jobs: int = 0) -> dict[str, NDArray[Any]]:
    """Corners and triangles of the polytopes that the planes of a cover bound, in voxel edges.

    They are computed exactly in 128-bit integers and rounded at the end; see
    native/core/include/alula/cover/outer_solid.hpp.

    Args:
        cover: an `alula/cover`.
        jobs: threads, 0 for all processors; the result does not depend on it.

    Returns:
        `point` (P, 3), `point_start` (n + 1,), `triangle` (T, 3), counter-clockwise from outside,
        `triangle_start` (n + 1,) and `is_lattice` (n,): no corner of that hull was rounded.

    Raises:
        ArtifactError: the planes of a hull bound no solid within the lattice's range.
    """
    names = ("plane_normal", "plane_offset", "plane_start")
    normal, offset, start = (np.ascontiguousarray(cover[name], np.int64) for name in names)
    try:
        found: dict[str, NDArray[Any]] = _core.outer_solids(normal, offset, start, jobs)
    except ValueError as error:
        raise ArtifactError(f"the cover is not sound: {error}") from error
    return found


def is_outer(cover: Artifact) -> bool:
    """Test whether a cover has outer polytopes, which contain the hulls of `vertex` but may be larger.

    Args:
        cover: an `alula/cover`.
    """
    return bool(cover.manifest.polytopes == "outer")  # type: ignore[attr-defined]


def _corners(cover: Artifact) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Corners of the polytopes in voxel edges, and the first of each."""
    if not is_outer(cover):
        return np.asarray(cover["vertex"], np.float64), np.asarray(cover["vertex_start"], np.int64)
    found = outer_solids(cover)
    return found["point"], found["point_start"]
