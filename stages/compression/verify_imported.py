"""Proof that voxels contain a mesh, a cloud or an octree, without the algorithms of `import-voxels`."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import IntArray
from alula.schemas.artifacts.certificate import Check
from alula.schemas.artifacts.manifest import LevelManifest
from alula.schemas.errors import InputError, UsageError
from alula.schemas.progress import Progress
from alula.stages.compression.imported import (
    NAMES,
    OCTREE_HALF,
    ImportedSource,
    Mesh,
    Octree,
    decimal,
    in_world,
    open_edges,
)
from alula.stages.progress import share
from alula.stages.proof import LISTED, at_voxel, check

_DEPTH = 16  # of OctoMap's trees
_AT_ONCE = 2**20  # voxels that are looked up together
_FAR, _KEY = 2**20, np.array([2**42, 2**21, 1])  # one number for each voxel that is nearer


def imported_checks(
    level: LevelManifest,
    source: ImportedSource,
    index: NDArray[np.int32],
    *,
    jobs: int = 0,
    progress: Progress | None = None,
) -> list[Check]:
    """Check voxels against the map that they were made from.

    Triangles are halved until they are small, and a plane must separate each piece, grown by the ball, from
    each voxel near it that is not in the set (`touch_check.hpp`). Of a solid mesh, rays must leave each such
    voxel with as many crossings outwards as inwards. An octree is decoded again, its cubes are mapped to
    voxels in rational numbers, and each voxel must be in the set.

    Args:
        index: the voxels, shape (M, 3), in any order; repetitions are allowed.

    Raises:
        UsageError: the voxels are those of a scene.
        InputError: the source is of another kind than the voxels were made from, is damaged, or has nothing
            to do with the voxels.
    """
    imported = level.imported
    if imported is None:
        raise UsageError("the obstacles are those of a scene; give --scene instead of --source")
    if NAMES[type(source)] != imported.kind:
        raise InputError(
            f"the source is a {NAMES[type(source)]}, but the voxels are those of a {imported.kind}"
        )
    if isinstance(source, Octree):
        return [_octree_check(level, source, index)]
    points = source.surface if isinstance(source, Mesh) else np.repeat(source.points[:, None], 3, axis=1)
    corners = in_world(points, imported.scale, imported.up, imported.map_origin_m)
    crop = None if level.crop is None else tuple(level.crop)
    voxels = np.ascontiguousarray(index, np.int32)
    what = "triangle" if isinstance(source, Mesh) else "point"
    try:
        total, missing, row = _core.unproven_triangles(
            corners,
            level.inflation_m,
            level.voxel_size_m,
            crop,
            level.min_overlap,
            voxels,
            jobs,
            share(progress, 0, 0.8),
        )
    except OverflowError as error:
        raise InputError(f"the voxels are not those of this source: {error}") from error
    first = [
        at_voxel(f"{what} {number} may touch an unmarked voxel", voxel, level.voxel_size_m)
        for number, voxel in zip(row.tolist(), missing, strict=True)
    ]
    checks = [
        check(f"every {what} lies in the voxels", len(corners), first, "separating planes", failed=total)
    ]
    if isinstance(source, Mesh) and imported.solid:
        closed = in_world(source.corners, imported.scale, imported.up, imported.map_origin_m)
        checks.append(_solid_check(level, closed, voxels, jobs, share(progress, 0.8, 1)))
    return checks


def _solid_check(
    level: LevelManifest,
    corners: NDArray[np.float64],
    index: NDArray[np.int32],
    jobs: int,
    progress: Progress | None,
) -> Check:
    name, detail = "the inside lies in the voxels", "winding numbers along rays"
    if open_edges(corners)[0]:
        raise InputError("the source is not watertight, so it has no inside")
    crop = None if level.crop is None else tuple(level.crop)
    total, missing, _ = _core.unproven_outside(corners, level.voxel_size_m, crop, index, jobs, progress)
    first = [at_voxel("an unmarked voxel may lie inside", voxel, level.voxel_size_m) for voxel in missing]
    return check(name, len(corners), first, detail, failed=total)


def _octree_check(level: LevelManifest, source: Octree, index: NDArray[np.int32]) -> Check:
    assert level.imported is not None
    lower, edge, kind = _cubes(source)
    wanted = kind == 2
    if level.imported.unknown == "occupied" and (known := kind > 0).any():
        low, high = lower[known].min(axis=0), (lower + edge[:, None])[known].max(axis=0)
        upper = np.where(known[:, None], lower + edge[:, None], np.minimum(lower + edge[:, None], high))
        lower = np.where(known[:, None], lower, np.maximum(lower, low))
        wanted |= ~known & (lower < upper).all(axis=1)
    else:
        upper = lower + edge[:, None]
    lower, upper = lower[wanted], upper[wanted]
    ratio = source.edge * decimal(level.imported.scale) / decimal(level.voxel_size_m)
    first = np.array([[_floor(k * ratio) for k in row] for row in lower.tolist()], np.int64).reshape(-1, 3)
    end = np.array([[-_floor(-k * ratio) for k in row] for row in upper.tolist()], np.int64).reshape(-1, 3)
    if level.crop is not None:
        size = Fraction(level.voxel_size_m)
        low = [-_floor(-Fraction(c) / size) - 1 for c in level.crop[:3]]
        high = [_floor(Fraction(c) / size) + 1 for c in level.crop[3:]]
        first, end = np.maximum(first, low), np.minimum(end, high)
    occupied = np.sort(np.asarray(index, np.int64) @ _KEY)
    failed, first_missing = 0, [np.empty((0, 3), np.int64)]
    for voxels in _listed(first, end):
        if np.abs(voxels).max() >= _FAR:
            raise InputError(f"a leaf lies more than {_FAR} voxels from the origin")
        key = voxels @ _KEY
        at = np.minimum(np.searchsorted(occupied, key), max(len(occupied) - 1, 0))
        missing = voxels[occupied[at] != key] if len(occupied) else voxels
        failed += len(missing)
        first_missing.append(missing[:LISTED])
    found = np.concatenate(first_missing)[:LISTED]
    size_m = level.voxel_size_m
    offences = [at_voxel("a leaf reaches into an unmarked voxel", voxel, size_m) for voxel in found]
    return check("every leaf lies in the voxels", len(lower), offences, "rational numbers", failed=failed)


def _floor(value: Fraction) -> int:
    return value.numerator // value.denominator


def _listed(first: IntArray, end: IntArray) -> list[IntArray]:
    """Voxels of boxes first ... end - 1, in lists of about a million."""
    size = np.maximum(end - first, 0)
    lists = []
    for shape in np.unique(size, axis=0):
        if shape.prod() == 0:
            continue
        rows = first[(size == shape).all(axis=1)]
        steps = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
        many = max(_AT_ONCE // len(steps), 1)
        lists += [(rows[k : k + many, None] + steps).reshape(-1, 3) for k in range(0, len(rows), many)]
    return lists


def _cubes(source: Octree) -> tuple[IntArray, IntArray, IntArray]:
    """Cubes of a tree: lower corners (N, 3), edges (N,), and 0 unknown, 1 free or 2 occupied.

    The nodes have equal records, so their contents are decoded together; only their places follow from their
    order, with a stack.
    """
    width = 2 if source.is_binary else 5 + source.payload
    if len(source.body) % width:
        raise InputError("the octree ends in the middle of a node")
    records = source.body.reshape(-1, width)
    if source.is_binary:
        kinds = records[:, [0, 0, 0, 0, 1, 1, 1, 1]] >> np.array([0, 2, 4, 6] * 2, np.uint8) & 3
    else:
        kinds = (records[:, -1:] >> np.arange(8, dtype=np.uint8) & 1) * np.uint8(3)
    inner = [np.flatnonzero(row)[::-1].tolist() for row in (np.arange(256)[:, None] >> np.arange(8) & 1)]
    follows = (np.packbits(kinds == 3, axis=1, bitorder="little")[:, 0]).tolist()
    places, depths = [], []
    stack = [(0, 0)] if follows else []
    for record in follows:
        if not stack:
            raise InputError("bytes follow the last node of the octree")
        path_of_node, depth_of_node = stack.pop()
        places.append(path_of_node)
        depths.append(depth_of_node)
        stack += [(path_of_node * 8 + child, depth_of_node + 1) for child in inner[record]]
    if stack or max(depths, default=0) > _DEPTH:
        raise InputError("the octree ends in the middle, or is too deep")
    place, depth = np.array(places, np.int64), np.array(depths, np.int64)
    row, child = np.nonzero(kinds != 3)
    state = kinds[row, child].astype(np.int64)
    path, below = place[row] * 8 + child, depth[row] + 1
    if not source.is_binary:  # a node without children is a leaf itself
        is_leaf = records[:, -1] == 0
        odds = np.ascontiguousarray(records[:, :4]).view("<f4")[:, 0]
        inner_node = ~is_leaf[row]
        state = np.concatenate([state[inner_node], np.where(odds[is_leaf] >= 0, 2, 1)])
        path = np.concatenate([path[inner_node], place[is_leaf]])
        below = np.concatenate([below[inner_node], depth[is_leaf]])
    corner = np.zeros((len(path), 3), np.int64)
    for bit in range(_DEPTH):
        for axis in range(3):
            corner[:, axis] |= (path >> (3 * bit + axis) & 1) << bit
    edge = np.left_shift(1, _DEPTH - below)
    return corner * edge[:, None] - OCTREE_HALF, edge, state
