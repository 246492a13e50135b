"""Surface of voxels as triangles, for programs that read meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import IntArray


def voxel_mesh(index: NDArray[np.integer[Any]]) -> tuple[IntArray, IntArray]:
    """Triangulate the faces between occupied and free voxels, two triangles each.

    Every edge occurs as often in one direction as in the other, so the mesh bounds the voxels. Where
    voxels meet in an edge only, four faces share that edge.

    Args:
        index: occupied voxels, shape (M, 3); voxel v is the cube [v, v + 1].

    Returns:
        Corners without repetitions, shape (V, 3) [voxel edges], and triangles as rows of the corners,
        counter-clockwise from outside, shape (T, 3).
    """
    cubes = np.unique(np.asarray(index, np.int64).reshape(-1, 3), axis=0)
    if len(cubes) == 0:
        return np.empty((0, 3), np.int64), np.empty((0, 3), np.int64)
    lower = cubes.min(axis=0) - 1
    size = cubes.max(axis=0) + 3 - lower

    def key(points: IntArray) -> IntArray:
        return np.asarray(np.ravel_multi_index(tuple((points - lower).T), tuple(size)), np.int64)

    occupied = key(cubes)
    quads = []
    for axis in range(3):
        step, u, v = np.roll(np.eye(3, dtype=np.int64), -axis, axis=0)
        for side, around in ((step, (0 * u, u, u + v, v)), (-step, (0 * u, v, u + v, u))):
            open_cubes = cubes[~np.isin(key(cubes + side), occupied, assume_unique=True)]
            base = open_cubes + np.maximum(side, 0)
            quads.append(np.stack([base + corner for corner in around], axis=1))
    faces = np.concatenate(quads)
    _, first, number = np.unique(key(faces.reshape(-1, 3)), return_index=True, return_inverse=True)
    corner = number.reshape(-1, 4)
    triangles = np.concatenate([corner[:, [0, 1, 2]], corner[:, [0, 2, 3]]]).astype(np.int64)
    return faces.reshape(-1, 3)[first], triangles
