"""Surface of a splat's density as triangles, for programs that read meshes."""

from __future__ import annotations

import math
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import InputError
from alula.stages.rotation import matrix_from_quat_wxyz

LEVEL = 0.3  # of the density, as in SuGaR
MAX_NODES = 2**27  # of the grid: half a gigabyte of densities
_NEAR = 1  # voxels around an occupied one in which the density counts
_REACH = 3.0  # standard deviations, beyond which a Gaussian adds nothing
_PAIRS = 4_000_000  # Gaussian-node pairs computed at a time

# The six tetrahedra of a cube around its diagonal, as numbers of corners 4 x + 2 y + z. Neighbouring cubes
# cut their common face along the same diagonal, so the surface has no gaps.
_TETRAHEDRA = np.array([[0, 4 >> a, (4 >> a) + (4 >> b), 7] for a, b, _ in permutations(range(3))], np.int64)
_CORNERS = np.array([[c >> 2 & 1, c >> 1 & 1, c & 1] for c in range(8)], np.int64)
_IS_MIRRORED = np.array(
    [np.linalg.det(np.diff(_CORNERS[t], axis=0).astype(np.float64)) < 0 for t in _TETRAHEDRA], np.bool_
)


def density_mesh(scene: Artifact, voxels: Artifact, *, level: float = LEVEL) -> tuple[FloatArray, IntArray]:
    """Triangulate the surface where the density of the Gaussians has a level, near occupied voxels.

    The density is d(p) = sum_i alpha_i exp(-(p - mu_i)' inv(Sigma_i + (g / 2)^2 I) (p - mu_i) / 2) with
    the voxel edge g, by which no Gaussian is too thin for a grid of the voxels' corners. Corners more than
    one voxel from every occupied one count as empty, so that what the voxels leave out does not come back.
    The surface bounds {d >= level} by marching tetrahedra: it is closed, and each edge belongs to as many
    triangles in one direction as in the other.

    Source: Guedon and Lepetit 2024, SuGaR (arXiv 2311.12775), for the density and its level. SuGaR takes
    points of that level set that its cameras see and reconstructs a surface from them.

    Args:
        level: of the density.

    Returns:
        Corners, shape (V, 3) [voxel edges], and triangles as rows of the corners, counter-clockwise from
        outside, shape (T, 3); see `voxel_mesh`.

    Raises:
        InputError: there is no voxel, or the grid has more than `MAX_NODES` nodes.
    """
    index = np.asarray(voxels["index"], np.int64)
    if len(index) == 0:
        raise InputError("there is no occupied voxel, so no surface")
    lower = index.min(axis=0) - _NEAR - 1
    shape = index.max(axis=0) + _NEAR + 3 - lower
    if math.prod(shape.tolist()) > MAX_NODES:
        raise InputError(
            f"a grid of {' x '.join(map(str, shape))} nodes is too large; at most {MAX_NODES} nodes fit"
        )
    density = _density(scene, float(voxels.manifest.voxel_size_m), lower, shape)  # type: ignore[attr-defined]
    near = np.zeros(density.shape, np.bool_)
    for step in product(range(-_NEAR, _NEAR + 2), repeat=3):
        near[tuple((index - lower + step).T)] = True
    density[~near] = 0.0
    corner, triangle = level_set(density, level)
    return corner + lower, triangle


def simplified(corner: FloatArray, triangle: IntArray, count: int) -> tuple[FloatArray, IntArray]:
    """Simplify a surface to at most about `count` triangles, by quadric errors, as SuGaR does.

    Args:
        corner: shape (V, 3).
        triangle: rows of the corners, shape (T, 3).
        count: number of triangles.
    """
    if len(triangle) <= count:
        return corner, triangle
    import open3d

    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(corner), open3d.utility.Vector3iVector(triangle.astype(np.int32))
    )
    mesh = mesh.simplify_quadric_decimation(count)
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.triangles, np.int64)


def _density(
    scene: Artifact, size: float, lower: NDArray[np.int64], shape: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Density at the nodes of a grid, shape `shape`; it is 0 on the grid's sides."""
    mean = scene["mean"].astype(np.float64) / size - lower
    scale = scene["scale"].astype(np.float64) / size
    rotation = matrix_from_quat_wxyz(scene["quat_wxyz"].astype(np.float64))
    variance = scale * scale + 0.25
    half = _REACH * np.sqrt(((rotation * rotation) * variance[:, None, :]).sum(axis=2))
    first = np.clip(np.ceil(mean - half).astype(np.int64), 1, shape - 1)
    count = np.clip(np.floor(mean + half).astype(np.int64), 0, shape - 2) - first + 1
    pairs = np.where((count > 0).all(axis=1), count.prod(axis=1), 0)
    density = np.zeros(math.prod(shape.tolist()), np.float32)
    ends = np.cumsum(pairs)
    begin = 0
    while begin < len(mean):
        done = ends[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(ends, done + _PAIRS, side="right")))
        row = np.repeat(np.arange(begin, end), pairs[begin:end])
        at = np.arange(len(row)) - np.repeat(ends[begin:end] - pairs[begin:end] - done, pairs[begin:end])
        wide = count[row]
        node = first[row] + np.column_stack(
            [at // (wide[:, 1] * wide[:, 2]), at // wide[:, 2] % wide[:, 1], at % wide[:, 2]]
        )
        local = np.einsum("nij,ni->nj", rotation[row], node - mean[row])
        value = scene["opacity"][row] * np.exp(-0.5 * (local * local / variance[row]).sum(axis=1))
        key = np.ravel_multi_index(tuple(node.T), tuple(shape))
        used, number = np.unique(key, return_inverse=True)
        density[used] += np.bincount(number, value, len(used)).astype(np.float32)
        begin = end
    return density.reshape(shape)


def level_set(values: NDArray[np.float32], level: float) -> tuple[FloatArray, IntArray]:
    """Triangulate the boundary of {values >= level} by marching tetrahedra.

    Args:
        values: at the nodes of a grid with spacing 1, shape (X, Y, Z); below `level` on the grid's sides.

    Returns:
        Corners, shape (V, 3), and triangles as rows of the corners, counter-clockwise from the side where
        values are below the level, shape (T, 3).
    """
    inside = values >= level
    shape = np.array(values.shape, np.int64)
    part = [inside[tuple(slice(o, n - 1 + o) for o, n in zip(c, shape, strict=True))] for c in _CORNERS]
    number = sum(p.astype(np.int8) for p in part)
    cube = np.argwhere((number > 0) & (number < 8))
    node = np.ravel_multi_index(tuple(np.moveaxis(cube[:, None, :] + _CORNERS, 2, 0)), tuple(shape.tolist()))
    flat = inside.ravel()
    edges = []
    for tetrahedron, is_mirrored in zip(_TETRAHEDRA, _IS_MIRRORED, strict=True):
        corners = node[:, tetrahedron]
        edges += [e[:, ::-1] if is_mirrored else e for e in _cut(corners, flat[corners])]
    ends = np.concatenate([*edges, np.empty((0, 3, 2), np.int64)])
    ends = np.sort(ends, axis=2)
    key, triangle = np.unique(ends.reshape(-1, 2), axis=0, return_inverse=True)
    value = values.ravel()[key].astype(np.float64)
    share = (level - value[:, 0]) / (value[:, 1] - value[:, 0])
    low, high = (np.column_stack(np.unravel_index(key[:, i], tuple(shape.tolist()))) for i in (0, 1))
    return low + share[:, None] * (high - low), triangle.reshape(-1, 3).astype(np.int64)


def _cut(corner: IntArray, inside: NDArray[np.bool_]) -> list[IntArray]:
    """Triangles that divide the corners of tetrahedra; each corner of a triangle is an edge (node, node).

    For a positively oriented tetrahedron the triangles are counter-clockwise from the side of the corners
    that are not inside.
    """
    found = []
    pattern = inside @ np.array([1, 2, 4, 8])
    for single in range(4):
        # An even permutation that begins with the corner that differs from the others.
        a, b, c, d = ((0, 1, 2, 3), (1, 0, 3, 2), (2, 3, 0, 1), (3, 2, 1, 0))[single]
        for bits, turned in ((1 << single, False), (15 - (1 << single), True)):
            rows = corner[pattern == bits]
            cut = np.stack([rows[:, [a, e]] for e in ((b, d, c) if turned else (b, c, d))], axis=1)
            found.append(cut)
    for a, b, c, d in ((0, 1, 2, 3), (0, 2, 3, 1), (0, 3, 1, 2)):  # a, b on one side; even permutations
        for bits, turned in (((1 << a) + (1 << b), True), ((1 << c) + (1 << d), False)):
            rows = corner[pattern == bits]
            around = [(a, c), (b, c), (b, d), (a, d)]
            around = around[::-1] if turned else around
            quad = np.stack([rows[:, list(e)] for e in around], axis=1)
            found += [quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]
    return found
