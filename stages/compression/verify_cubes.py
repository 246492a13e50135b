"""Proof of a part of a cover, cell by cell of its cube of the lattice; and of the space around all parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.certificate import Check
from alula.schemas.artifacts.manifest import LevelManifest
from alula.schemas.artifacts.parts import Parts
from alula.schemas.progress import Progress
from alula.stages.compression.cell_hulls import CellHulls, HullProof, boxes_of, hull_proof, members_of_own
from alula.stages.compression.cover_checks import SCENE_CHECK, scene_check
from alula.stages.compression.level import require_sigma
from alula.stages.distribute import distribute
from alula.stages.proof import check, sum_of

CELL_VOXELS, CELL_ELLIPSOIDS = 2**18, 2**19  # a cell with more is halved
_MEMBERS = 2 * CELL_VOXELS  # of the hulls that count in a cell; hulls may share voxels
_LEAST_HALVED = 32  # edge of a cell that is not halved any more, whatever it has [voxels]
_SURE = 2.0  # a cell with so many times the limit by the boxes of the parts is halved without a look at them
_SLACK = 1e-6  # relative; more than all roundings of a box around an ellipsoid

Index = NDArray[np.int64]
Place = tuple[int, ...]
_AT_ONCE = 2**18  # rows of a scene or of voxels that are looked at together
_FAR, _KEY = 2**20, np.array([2**42, 2**21, 1])  # one number for each cell that is nearer
_LEAST_EDGE = 16  # of a cell around the parts [voxels]
_FARTHEST = 2**40  # of voxels, which have 32 bits
_RING = np.array([[-1, -1, -1], [1, 1, 1]])


@dataclass(frozen=True, slots=True)
class Sources:
    """What a cover is proven against.

    Attributes:
        occupied: voxels, or a cover whose members they are; None where neither voxels nor scene are given.
        voxels: of the whole, if given.
        scene: of the whole, if given.
    """

    level: LevelManifest
    occupied: Parts | None
    voxels: Parts | None
    scene: Parts | None


@dataclass(frozen=True, slots=True)
class CellTask:
    """A cell, and what lies in it and next to it: all that its proof depends on."""

    level: LevelManifest
    cube: Index  # lowest and highest voxel, shape (2, 3)
    hulls: CellHulls | None  # None for space without a part
    voxels: NDArray[np.int32] | None  # in the cell, if they were given
    near: NDArray[np.int32]  # occupied voxels in the cell and around it
    scene: Artifact | None
    rows: NDArray[np.int64]  # of the whole scene, for each row of `scene`
    ellipsoids: int  # that count here: each counts in one cell of its cube
    below: int  # of these, the ones below the minimum opacity


@dataclass(frozen=True, slots=True)
class CellProof:
    """Results for a cell: of its hulls and its ellipsoids, and how many of these are not opaque enough."""

    hulls: HullProof | None
    scene: Check | None
    below: int


def cells_of(sources: Sources, domain: Index, part: Artifact | None) -> Iterator[CellTask]:
    """Divide a cube into cells with few voxels and ellipsoids, and gather what the proof of each depends on.

    Memory does not depend on the cube: a cell with more than `CELL_VOXELS` voxels or `CELL_ELLIPSOIDS`
    ellipsoids is halved along its longest edge. The division depends on the files alone.

    Args:
        domain: lowest and highest voxel of the cube, shape (2, 3).
        part: of the cover, whose hulls are in the cube; None for space without a part.

    Yields:
        Tasks of the cells that have anything to prove.
    """
    boxes = None if part is None else boxes_of(part, domain)
    waiting = [domain]
    while waiting:
        cube = waiting.pop()
        may_halve = int((cube[1] - cube[0]).max()) >= 2 * _LEAST_HALVED - 1
        task = _task(sources, domain, cube, part, boxes, may_halve=may_halve)
        if task is None:
            waiting += reversed(_halves(cube))
        elif len(task.near) or len(task.rows) or (task.hulls is not None and len(task.hulls.numbers)):
            yield task


def _halves(cube: Index) -> list[Index]:
    axis = int(np.argmax(cube[1] - cube[0]))
    middle = int(cube[0][axis] + cube[1][axis]) // 2
    low, high = cube.copy(), cube.copy()
    low[1][axis], high[0][axis] = middle, middle + 1
    return [low, high]


def _task(
    sources: Sources,
    domain: Index,
    cube: Index,
    part: Artifact | None,
    boxes: Index | None,
    *,
    may_halve: bool,
) -> CellTask | None:
    """Task of a cell; None where it must be halved."""
    level, near = sources.level, np.empty((0, 3), np.int32)
    if may_halve and (
        (part is not None and boxes is not None and members_of_own(part, boxes, domain, cube) > _MEMBERS)
        or _expected(level, cube, sources.voxels) > _SURE * CELL_VOXELS
        or _expected(level, cube, sources.scene) > _SURE * CELL_ELLIPSOIDS
    ):
        return None
    if sources.occupied is not None and (sources.voxels is not None or sources.scene is not None):
        found = _occupied(level, cube + _RING, sources.occupied, CELL_VOXELS if may_halve else None)
        if found is None:
            return None
        near = found
    gathered = _rows(level, domain, cube, sources.scene, CELL_ELLIPSOIDS if may_halve else None)
    if gathered is None:
        return None
    here = None
    if sources.voxels is not None and part is not None:
        here = near[((near >= cube[0]) & (near <= cube[1])).all(axis=1)]
    hulls = None
    if part is not None and boxes is not None:
        hulls = CellHulls.of(part, boxes, domain, cube)
    return CellTask(level, cube, hulls, here, near, *gathered)


def proof_of(task: CellTask) -> CellProof:
    """Proof of a cell; runs in a worker.

    Raises:
        InputError: see `verify`.
    """
    hulls = None if task.hulls is None else hull_proof(task.hulls, task.voxels)
    return CellProof(hulls, None if task.scene is None else _scene_check(task), task.below)


def _expected(level: LevelManifest, cube: Index, source: Parts | None) -> float:
    """Number of elements in a cube if those of each part were spread evenly over its box."""
    if source is None:
        return 0.0
    lower, upper = cube[0] * level.voxel_size_m, (cube[1] + 1) * level.voxel_size_m
    total = 0.0
    for number in source.touching(lower.tolist(), upper.tolist()):
        ref = source.refs[number]
        low, high = np.array(ref.lower), np.array(ref.upper)
        inside = (np.minimum(high, upper) - np.maximum(low, lower)) / np.maximum(high - low, 1e-300)
        total += ref.count * float(np.clip(np.where(high > low, inside, 1.0), 0.0, 1.0).prod())
    return total


def _occupied(level: LevelManifest, cube: Index, source: Parts, most: int | None) -> NDArray[np.int32] | None:
    """Sorted voxels of a cube: those of a file, or the members of a cover; None where there are too many."""
    lower, upper = cube[0] * level.voxel_size_m, (cube[1] + 1) * level.voxel_size_m
    found, count = [np.empty((0, 3), np.int32)], 0
    for number in source.touching(lower.tolist(), upper.tolist()):
        part = source[number]
        is_cover = "index" not in part.arrays
        index = part["member_index" if is_cover else "index"]
        for begin in range(0, len(index), _AT_ONCE):
            some = index[begin : begin + _AT_ONCE]
            if not is_cover and (some[-1, 0] < cube[0, 0] or some[0, 0] > cube[1, 0]):  # sorted by x
                continue
            found.append(some[((some >= cube[0]) & (some <= cube[1])).all(axis=1)])
            count += len(found[-1])
            if most is not None and count > (2 if is_cover else 1) * most:  # hulls may share voxels
                return None
    rows = np.concatenate(found)
    return np.ascontiguousarray(rows[np.lexsort(rows.T[::-1])])


def _rows(
    level: LevelManifest, domain: Index, cube: Index, scene: Parts | None, most: int | None
) -> tuple[Artifact | None, Index, int, int] | None:
    """Rows of a scene whose ellipsoids may touch a cell, with their numbers; none may be missing.

    Returns:
        The rows, their numbers, how many of them count in this cell of the domain, and how many of those are
        below the minimum opacity; None where there are too many rows.
    """
    if scene is None:
        return None, np.empty(0, np.int64), 0, 0
    size, count, counted, below = level.voxel_size_m, 0, 0, 0
    lower, upper, start = cube[0] * size, (cube[1] + 1) * size, domain[0] * size
    first = np.cumsum([0, *(ref.count for ref in scene.refs)])
    near = scene.touching(
        lower.tolist(), upper.tolist(), sigma=require_sigma(level), inflation=level.inflation_m
    )
    numbers, kept = [np.empty(0, np.int64)], []
    for number in near or [0]:
        for begin, some in _slices(scene[number]):
            low, high = boxes(level, some)
            rows = np.flatnonzero(((low <= upper) & (high >= lower)).all(axis=1))
            # The lowest corner in the domain is in one cell, where the ellipsoid counts.
            corner = np.maximum(low[rows], start)
            is_here = ((corner >= lower) & ((corner < upper) | (cube[1] == domain[1]))).all(axis=1)
            counted += int(is_here.sum())
            below += int((some["opacity"][rows][is_here] < np.float32(level.min_opacity)).sum())
            kept.append({name: array[rows] for name, array in some.arrays.items()})
            numbers.append(first[number] + begin + rows)
            count += len(rows)
            if most is not None and count > most:
                return None
    arrays = {}
    for name in sorted({name for part in kept for name in part}):
        like = next(part[name] for part in kept if name in part)
        none = [np.zeros((len(part["mean"]), *like.shape[1:]), like.dtype) for part in kept]
        arrays[name] = np.concatenate([part.get(name, zero) for part, zero in zip(kept, none, strict=True)])
    manifest = msgspec.structs.replace(scene.manifest, arrays={}, requires=[])
    counted = counted if _crop(level, domain) else 0
    return Artifact(manifest, arrays), np.concatenate(numbers), counted, below


def _slices(scene: Artifact) -> Iterator[tuple[int, Artifact]]:
    """First row and arrays of a limited number of rows, until all rows were there."""
    names = [name for name in scene.arrays if name != "color"]
    for begin in range(0, len(scene["mean"]), _AT_ONCE):
        some = {name: scene[name][begin : begin + _AT_ONCE] for name in names}
        yield begin, Artifact(scene.manifest, some)


def boxes(level: LevelManifest, scene: Artifact) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Boxes around the balls around the ellipsoids of a scene, with their growth: lower and upper corners.

    Args:
        level: sigma, inflation and whether the loss counts.

    Returns:
        Each of shape (N, 3) [m].
    """
    mean, scale = scene["mean"].astype(np.float64), scene["scale"].astype(np.float64)
    longest, shortest = scale.max(axis=1), scale.min(axis=1)
    sigma, grown = np.full(len(mean), require_sigma(level)), np.full(len(mean), level.inflation_m)
    if "loss" in scene.arrays and not level.ignore_loss:
        moved, stretched, turned = scene["loss"].astype(np.float64).T
        sigma = sigma * (1 + stretched)
        grown = grown + moved + turned * sigma * (longest - shortest)
    radius = (sigma * longest + grown)[:, None]
    slack = _SLACK * (radius + np.abs(mean) + level.voxel_size_m)
    return mean - radius - slack, mean + radius + slack


def _crop(level: LevelManifest, cube: Index) -> list[float]:
    """Box in which the voxels of a cube and those next to it are checked; empty where a crop has none."""
    size = level.voxel_size_m
    crop = [*(cube[0] * size).tolist(), *((cube[1] + 1) * size).tolist()]
    if level.crop is None:
        return crop
    crop = [
        *(max(a, b) for a, b in zip(crop[:3], level.crop[:3], strict=True)),
        *(min(a, b) for a, b in zip(crop[3:], level.crop[3:], strict=True)),
    ]
    # A crop that only touches the cube: a thin box around its face touches the same voxels.
    thin = [a == b for a, b in zip(crop[:3], crop[3:], strict=True)]
    if any(a > b for a, b in zip(crop[:3], crop[3:], strict=True)):
        return []
    return [c - t * size / 4 for c, t in zip(crop[:3], thin, strict=True)] + [
        c + t * size / 4 for c, t in zip(crop[3:], thin, strict=True)
    ]


def _scene_check(task: CellTask) -> Check:
    """Check that the ellipsoids touch no voxel of the cell that is not occupied."""
    level, scene = task.level, task.scene
    assert scene is not None
    crop = _crop(level, task.cube)
    if not crop or len(scene["mean"]) == 0:
        return check(SCENE_CHECK, task.ellipsoids, [], "separating planes")
    return scene_check(level, scene, task.near, 1, None, crop=crop, rows=task.rows, checked=task.ellipsoids)


def outside_cells(level: LevelManifest, domains: Sequence[Index], scene: Parts) -> Iterator[Index]:
    """Cells that do not lie in one of the cubes, and that the box of an ellipsoid touches.

    Args:
        domains: cubes of all parts, each of shape (2, 3): lowest and highest voxel.
    """
    # Cells that fit into the cubes; others are sound too, but would be checked although a cube has them.
    corners = np.concatenate([np.stack([domain[0], domain[1] + 1]) for domain in domains])
    edge = max(_LEAST_EDGE, int(np.gcd.reduce(corners.ravel())))
    found: set[Place] = set()
    for number in range(len(scene)):
        for _, some in _slices(scene[number]):
            lower, upper = boxes(level, some)
            if level.crop is not None:
                lower, upper = np.maximum(lower, level.crop[:3]), np.minimum(upper, level.crop[3:])
            inside, length = (lower <= upper).all(axis=1), edge * level.voxel_size_m
            low = np.floor(lower[inside] / length - _SLACK).astype(np.int64)
            high = np.floor(upper[inside] / length + _SLACK).astype(np.int64)
            is_one = (low == high).all(axis=1) & (np.abs(low) < _FAR).all(axis=1)
            _, at = np.unique((low[is_one] + _FAR) @ _KEY, return_index=True)
            found.update(map(tuple, low[is_one][at].tolist()))
            spans = np.column_stack([low[~is_one], high[~is_one]])
            for a, b, c, d, e, f in np.unique(spans, axis=0).tolist():
                found.update(product(range(a, d + 1), range(b, e + 1), range(c, f + 1)))
    lows, highs = (np.array([domain[k] for domain in domains]) for k in (0, 1))
    for place in sorted(found):
        corner = np.array(place, np.int64) * edge
        if not ((corner >= lows) & (corner + edge - 1 <= highs)).all(axis=1).any():
            yield np.stack([corner, corner + edge - 1])


def scene_proof(
    level: LevelManifest, occupied: Parts, scene: Parts, jobs: int, progress: Progress | None
) -> tuple[Check, int]:
    """Check cell by cell that voxels contain all ellipsoids of a scene.

    Args:
        occupied: voxels, or a cover whose members they are.

    Returns:
        The check, whose number is that of the Gaussians of at least the minimum opacity, and the number of
        the others.
    """
    domain, below, total = _domain(level, scene)
    cells = cells_of(Sources(level, occupied, None, scene), domain, None)
    found = [check(SCENE_CHECK, 0, [], "separating planes")]
    for proof in distribute(proof_of, cells, jobs=jobs):
        assert proof.scene is not None
        found.append(proof.scene)
        if progress is not None:  # the number of cells is not known before
            progress(min(sum(one.checked for one in found), total), total)
    return msgspec.structs.replace(sum_of(found), checked=total - below), below


def _domain(level: LevelManifest, scene: Parts) -> tuple[Index, int, int]:
    """Cube with all ellipsoids, the number of those below the minimum opacity, and the number of all."""
    low, high, below, total = np.full(3, np.inf), np.full(3, -np.inf), 0, 0
    for number in range(len(scene)):
        for _, some in _slices(scene[number]):
            lower, upper = boxes(level, some)
            low, high = np.minimum(low, lower.min(axis=0)), np.maximum(high, upper.max(axis=0))
            below += int((some["opacity"] < np.float32(level.min_opacity)).sum())
            total += len(lower)
    size = level.voxel_size_m
    ends = [np.clip(np.floor(each / size), -_FARTHEST, _FARTHEST) for each in (low, high)]
    return np.array(ends, np.int64) + _RING, below, total
