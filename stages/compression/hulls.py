"""The polytopes of a cover in metres, as every later stage reads them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifact import Artifact

_OUTWARD_ULPS = 8.0  # more than the roundings of offset * g / |normal| and of the unit normal together


@dataclass(frozen=True, slots=True)
class Hulls:
    """Convex polytopes {x : normal . x <= offset} in the world frame, row-compressed by hull.

    The planes are rounded outward: each double-precision half-space contains the exact one inside
    a ball of radius `extent_m` around the origin.

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
        """The hulls of an `alula/cover`."""
        g = float(cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
        integer = np.asarray(cover["plane_normal"], np.float64)
        length = np.sqrt((integer * integer).sum(axis=1))
        offset = np.asarray(cover["plane_offset"], np.float64) * (g / length)
        vertices = np.asarray(cover["vertex"], np.float64) * g
        extent = float(np.abs(vertices).max(initial=0.0)) + g
        return cls(
            normal_world=integer / length[:, None],
            offset_m=offset + _OUTWARD_ULPS * np.finfo(np.float64).eps * extent,
            plane_start=np.asarray(cover["plane_start"], np.int64),
            vertices_world=vertices,
            vertex_start=np.asarray(cover["vertex_start"], np.int64),
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
