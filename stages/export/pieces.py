"""Hulls of a cover as triangle meshes, with the names and colours that all formats share."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.stages.compression.facets import Mesh, mesh

ROUNDED = (
    "Rounded coordinates: the exact guarantee of the cover does not carry over to this file; "
    "the cover itself and its JSON export keep it."
)
_COLORS = np.array(
    [[143, 166, 191], [169, 184, 160], [194, 174, 148], [167, 155, 189], [147, 181, 181], [191, 156, 156]],
    np.uint8,
)


def hull_name(number: int) -> str:
    """Name of a hull, the same in every format."""
    return f"hull-{number:05d}"


def hull_color(number: int) -> list[int]:
    """Colour of a hull, red, green and blue of 255."""
    return [int(c) for c in _COLORS[number % len(_COLORS)]]


def pieces(cover: Artifact) -> Iterator[tuple[str, FloatArray, NDArray[np.int64]]]:
    """Name, corners (k, 3) [m] and triangles (t, 3), counter-clockwise from outside, of each hull."""
    solid: Mesh = mesh(cover)
    edge = float(cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
    for hull in range(len(solid)):
        points = slice(solid.point_start[hull], solid.point_start[hull + 1])
        faces = slice(solid.triangle_start[hull], solid.triangle_start[hull + 1])
        yield (
            hull_name(hull),
            solid.points_voxel[points] * edge,
            solid.triangles[faces] - solid.point_start[hull],
        )


def obj_object(name: str, points: FloatArray, faces: NDArray[np.int64], first: int = 1) -> bytes:
    """An object of an OBJ file, whose first corner has a number."""
    lines = [f"o {name}"]
    lines += [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (faces + first).tolist()]
    return ("\n".join(lines) + "\n").encode()
