"""Proof of one part of a cover, in its cube of the lattice; and of the space around all parts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifact import Artifact
from alula.schemas.manifest import LevelManifest, Manifest
from alula.schemas.parts import PartRef
from alula.stages.compression.ellipsoids import unproven_voxels
from alula.stages.compression.level import require_sigma
from alula.stages.compression.verify import LISTED, Certificate, Check, Offence, certificate_of, verify

SCENE_CHECK = "every ellipsoid lies in the voxels"
VOXEL_CHECK = "every voxel is a member"
_SLACK = 1e-6  # relative; more than all roundings of a box around an ellipsoid

Index = NDArray[np.int64]
Place = tuple[int, ...]
_AT_ONCE = 2**20  # rows of a scene that are looked at together
_FAR, _KEY = 2**20, np.array([2**42, 2**21, 1])  # one number for each cell that is nearer
_LEAST_EDGE = 16  # of a cell around the parts [voxels]
_RING = np.array([[-1, -1, -1], [1, 1, 1]])


class Parted(Protocol):
    """An artifact in parts; `alula.schemas.parts.Parts` is one."""

    manifest: Manifest
    refs: tuple[PartRef, ...]

    def __len__(self) -> int: ...

    def __getitem__(self, number: int) -> Artifact: ...

    def touching(
        self, lower: Sequence[float], upper: Sequence[float], *, sigma: float = 0.0, inflation: float = 0.0
    ) -> list[int]:
        """Numbers of the parts whose content may touch a box."""
        ...


@dataclass(frozen=True, slots=True)
class CubeTask:
    """The part, and what lies in its cube and next to it: all that its proof depends on."""

    level: LevelManifest
    domain: Index  # lowest and highest voxel, shape (2, 3)
    cover: Artifact | None  # None for space without a part
    voxels: Artifact | None
    near: NDArray[np.int32]  # occupied voxels in the cube and around it
    scene: Artifact | None
    rows: NDArray[np.int64]  # of the whole scene, for each row of `scene`


def task_of(
    level: LevelManifest,
    domain: Index,
    part: Artifact | None,
    occupied: Parted,
    voxels: Parted | None,
    scene: Parted | None,
) -> CubeTask:
    """Gather what the proof of a cube depends on.

    Args:
        level: definition of an obstacle.
        domain: lowest and highest voxel of the cube, shape (2, 3).
        part: of the cover; None for space without a part.
        occupied: voxels, or a cover whose members they are.
        voxels: of the whole, if given.
        scene: of the whole, if given.
    """
    near = np.empty((0, 3), np.int32)
    if voxels is not None or scene is not None:
        near = _occupied(level, domain + _RING, occupied)
    mine = None
    if voxels is not None and part is not None:
        here = near[((near >= domain[0]) & (near <= domain[1])).all(axis=1)]
        mine = Artifact(msgspec.structs.replace(voxels.manifest, arrays={}), {"index": here})
    rows, some = _rows(level, domain, scene)
    return CubeTask(level, domain, part, mine, near, some, rows)


def proof_of(task: CubeTask) -> Certificate:
    """Proof of a part, or of a cell of the space around all; runs in a worker.

    Args:
        task: see `task_of`.

    Raises:
        InputError: see `verify`.
    """
    files = {"cover": task.cover, "voxels": task.voxels, "scene": task.scene}
    checks = []
    if task.cover is not None:
        checks = [_in_cube(task), *verify(task.cover, voxels=task.voxels, jobs=1).checks]
    if task.scene is not None:
        checks.append(_scene_check(task))
    proven = "members in hulls" if task.voxels is None else "every voxel in a hull"
    return certificate_of(task.level, files, checks, proven, [])


def _occupied(level: LevelManifest, cube: Index, source: Parted) -> NDArray[np.int32]:
    """Sorted voxels of a cube: those of a file, or the members of a cover."""
    lower, upper = cube[0] * level.voxel_size_m, (cube[1] + 1) * level.voxel_size_m
    found = [np.empty((0, 3), np.int32)]
    for number in source.touching(lower.tolist(), upper.tolist()):
        part = source[number]
        index = part.arrays["index"] if "index" in part.arrays else part["member_index"]
        found.append(index[((index >= cube[0]) & (index <= cube[1])).all(axis=1)])
    rows = np.concatenate(found)
    return np.ascontiguousarray(rows[np.lexsort(rows.T[::-1])])


def _rows(level: LevelManifest, cube: Index, scene: Parted | None) -> tuple[Index, Artifact | None]:
    """Rows of a scene whose ellipsoids may touch a cube, with their numbers; none may be missing."""
    if scene is None:
        return np.empty(0, np.int64), None
    lower, upper = cube[0] * level.voxel_size_m, (cube[1] + 1) * level.voxel_size_m
    first = np.cumsum([0, *(ref.count for ref in scene.refs)])
    near = scene.touching(
        lower.tolist(), upper.tolist(), sigma=require_sigma(level), inflation=level.inflation_m
    )
    numbers, kept = [np.empty(0, np.int64)], []
    for number in near or [0]:
        for begin, some in _slices(scene[number]):
            low, high = boxes(level, some)
            rows = np.flatnonzero(((low <= upper) & (high >= lower)).all(axis=1))
            kept.append({name: array[rows] for name, array in some.arrays.items()})
            numbers.append(first[number] + begin + rows)
    arrays = {}
    for name in sorted({name for part in kept for name in part}):
        like = next(part[name] for part in kept if name in part)
        none = [np.zeros((len(part["mean"]), *like.shape[1:]), like.dtype) for part in kept]
        arrays[name] = np.concatenate([part.get(name, zero) for part, zero in zip(kept, none, strict=True)])
    return np.concatenate(numbers), Artifact(
        msgspec.structs.replace(scene.manifest, arrays={}, requires=[]), arrays
    )


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
        scene: an `alula/scene`.

    Returns:
        Each of shape (N, 3) [m].
    """
    mean, scale = scene["mean"].astype(np.float64), scene["scale"].astype(np.float64)
    longest, shortest = scale.max(axis=1), scale.min(axis=1)
    sigma, grown = np.full(len(mean), level.sigma), np.full(len(mean), level.inflation_m)
    if "loss" in scene.arrays and not level.ignore_loss:
        moved, stretched, turned = scene["loss"].astype(np.float64).T
        sigma = sigma * (1 + stretched)
        grown = grown + moved + turned * sigma * (longest - shortest)
    radius = (sigma * longest + grown)[:, None]
    slack = _SLACK * (radius + np.abs(mean) + level.voxel_size_m)
    return mean - radius - slack, mean + radius + slack


def _scene_check(task: CubeTask) -> Check:
    """Check that the ellipsoids touch no voxel of the cube that is not occupied."""
    level, scene, size = task.level, task.scene, task.level.voxel_size_m
    assert scene is not None
    crop = [*(task.domain[0] * size).tolist(), *((task.domain[1] + 1) * size).tolist()]
    if level.crop is not None:
        crop = [
            *(max(a, b) for a, b in zip(crop[:3], level.crop[:3], strict=True)),
            *(min(a, b) for a, b in zip(crop[3:], level.crop[3:], strict=True)),
        ]
        # A crop that only touches the cube: a thin box around its face touches the same voxels.
        thin = [a == b for a, b in zip(crop[:3], crop[3:], strict=True)]
        if any(a > b for a, b in zip(crop[:3], crop[3:], strict=True)) or len(scene["mean"]) == 0:
            crop = []
        else:
            crop = [c - t * size / 4 for c, t in zip(crop[:3], thin, strict=True)] + [
                c + t * size / 4 for c, t in zip(crop[3:], thin, strict=True)
            ]
    if not crop or len(scene["mean"]) == 0:
        return check_of(SCENE_CHECK, 0, [], 0, "separating planes")
    missing = unproven_voxels(
        scene,
        task.near,
        voxel_size_m=size,
        sigma=require_sigma(level),
        inflation_m=level.inflation_m,
        crop=crop,
        min_overlap=level.min_overlap,
        min_opacity=level.min_opacity,
        ignore_loss=level.ignore_loss,
        jobs=1,
        progress=None,
    )
    first = []
    for voxel, row in zip(missing.voxel[:LISTED].tolist(), missing.ellipsoid[:LISTED].tolist(), strict=True):
        x, y, z = voxel
        place = ((x + 0.5) * size, (y + 0.5) * size, (z + 0.5) * size)
        fault, gaussian = "an ellipsoid may touch an unmarked voxel", int(task.rows[row])
        first.append(Offence(fault=fault, gaussian=gaussian, voxel=(x, y, z), place_m=place))
    return check_of(SCENE_CHECK, len(scene["mean"]), first, missing.total, "separating planes")


def outside_cells(level: LevelManifest, domains: Sequence[Index], scene: Parted) -> Iterator[Index]:
    """Cells that do not lie in one of the cubes, and that the box of an ellipsoid touches.

    Args:
        level: definition of an obstacle.
        domains: cubes of all parts, each as `CubeTask.domain`.
        scene: in parts.
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


def _in_cube(task: CubeTask) -> Check:
    """Check that the hulls of a part, and so its members, lie in its cube."""
    assert task.cover is not None
    vertex = task.cover["vertex"]
    wrong = np.flatnonzero(((vertex < task.domain[0]) | (vertex > task.domain[1] + 1)).any(axis=1))
    hull = np.searchsorted(task.cover["vertex_start"], wrong[:LISTED], side="right") - 1
    first = [
        Offence(fault="vertex lies outside of the part's cube", hull=int(h), vertex=int(v))
        for h, v in zip(hull, wrong[:LISTED], strict=True)
    ]
    return check_of("hulls lie in the part's cube", len(vertex), first, len(wrong), "vertices")


def check_of(name: str, checked: int, first: list[Offence], failed: int, detail: str) -> Check:
    """Result of a check.

    Args:
        name: of the check.
        checked: number of items.
        first: offences to list.
        failed: number of all offences.
        detail: a few words.
    """
    return Check(name=name, ok=failed == 0, checked=checked, failed=failed, detail=detail, first=first)
