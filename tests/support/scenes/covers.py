"""Voxel scenes, covers of them, what must hold for a cover, in plain Python integers, and damaged ones."""

import dataclasses
from math import gcd

import msgspec
import numpy as np

from alula.schemas.artifacts.artifact import Artifact, make_artifact
from alula.schemas.artifacts.kinds import COVER, VOXELS
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.stages.compression.merge import merge

SIZE_M = 0.1


def voxels_of(index, **fields) -> Artifact:
    """An alula/voxels of the given rows, in any order."""
    index = np.unique(np.asarray(index, np.int32).reshape(-1, 3), axis=0)
    level = {"voxel_size_m": SIZE_M, "sigma": 1.0, "min_overlap": 1} | fields
    arrays = {"index": index, "overlap": np.ones(len(index))}
    return make_artifact(VOXELS, arrays, frame="world", unit="m", parameters={}, summary={}, **level)


def boxes_cover(boxes):
    """A cover of axis-aligned boxes, six lattice numbers each."""
    rows = np.asarray(boxes, np.int64).reshape(-1, 6)
    n = len(rows)
    pick = np.array([[3 * (corner >> axis & 1) + axis for axis in range(3)] for corner in range(8)])
    offset = np.concatenate([rows[:, 3:], -rows[:, :3]], axis=1)
    return make_artifact(
        COVER,
        {
            "vertex": rows[:, pick].reshape(-1, 3),
            "vertex_start": 8 * np.arange(n + 1),
            "plane_normal": np.tile(np.vstack([np.eye(3), -np.eye(3)]), (n, 1)),
            "plane_offset": offset.reshape(-1),
            "plane_start": 6 * np.arange(n + 1),
            "member_index": rows[:, :3],
            "member_start": np.arange(n + 1),
            "history": np.empty((0, 3)),
        },
        frame="world",
        unit="m",
        parameters={},
        summary={},
        voxel_size_m=SIZE_M,
        sigma=1.0,
        min_overlap=1,
        conservativeness=0.0,
        certificate={},
    )


def furniture(seed: int = 0, extent: int = 24) -> np.ndarray:
    """A floor, two walls, boxes, a slanted sheet, a hoop and a few single voxels far from all else."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(*3 * [np.arange(extent)], indexing="ij"), -1).reshape(-1, 3)
    x, y, z = grid.T
    solid = (z == 0) | (x == 0) | (y == extent - 1)
    for _ in range(4):
        low = rng.integers(2, extent - 6, 3)
        solid |= ((grid >= low) & (grid < low + rng.integers(1, 6, 3))).all(axis=1)
    solid |= (np.abs(x + 2 * y - z - extent // 2) <= 1) & (z < 9)
    ring = np.hypot(y - extent / 2, z - extent / 2)
    solid |= (np.abs(ring - 6) < 0.8) & (x == extent // 2)
    return np.concatenate([grid[solid] - extent // 2, rng.integers(60, 90, (5, 3))])


def cover_of(voxels: Artifact, **config) -> Artifact:
    return merge(MergeConfig(**config), voxels, jobs=1)


def rows(cover: Artifact, hull: int, name: str) -> list[tuple[int, ...]]:
    """Rows of one array of one hull, as Python integers."""
    starts = {"vertex": "vertex_start", "member_index": "member_start"}.get(name, "plane_start")
    begin, end = cover[starts][hull : hull + 2]
    return [tuple(np.atleast_1d(row).tolist()) for row in cover[name][begin:end]]


def planes(cover: Artifact, hull: int) -> list[tuple[tuple[int, ...], int]]:
    offsets = [offset for (offset,) in rows(cover, hull, "plane_offset")]
    return list(zip(rows(cover, hull, "plane_normal"), offsets, strict=True))


def holds_voxel(half_spaces, voxel) -> bool:
    """Whether all eight corners of a voxel satisfy all half-spaces: of each the corner farthest along it."""
    x, y, z = voxel
    return all(
        a * (x + (a > 0)) + b * (y + (b > 0)) + c * (z + (c > 0)) <= offset
        for (a, b, c), offset in half_spaces
    )


def assert_covers(cover: Artifact, voxels: Artifact) -> None:
    """Every voxel is a member of a hull that holds it; the arrays are sorted and primitive."""
    members = set()
    for hull in range(len(cover["plane_start"]) - 1):
        half_spaces = planes(cover, hull)
        mine = rows(cover, hull, "member_index")
        assert mine == sorted(set(mine))
        assert all(holds_voxel(half_spaces, voxel) for voxel in mine)
        assert all(gcd(*normal) == 1 for normal, _ in half_spaces)
        assert len(set(half_spaces)) == len(half_spaces)
        members |= set(mine)
    assert members == {tuple(row) for row in voxels["index"].tolist()}


def excess(cover: Artifact) -> float:
    return float(cover.manifest.conservativeness) - 1


def changed(cover, **arrays):
    """The cover with some arrays replaced, as a file with a matching manifest could hold them."""
    return dataclasses.replace(cover, arrays={**cover.arrays, **arrays})


def with_row(cover, name, row, value):
    array = cover[name].copy()
    array[row] = value
    return changed(cover, **{name: array})


def failing(certificate) -> list[str]:
    assert certificate.covered == all(check.ok for check in certificate.checks)
    return [check.name for check in certificate.checks if not check.ok]


def offences(certificate):
    return [offence for check in certificate.checks for offence in check.first]


def with_manifest(artifact, **fields):
    return dataclasses.replace(artifact, manifest=msgspec.structs.replace(artifact.manifest, **fields))


def is_covered_by_brute_force(cover, voxels) -> bool:
    """Every voxel has its eight corners in one polytope of the cover's planes."""
    hulls = [planes(cover, hull) for hull in range(len(cover["plane_start"]) - 1)]
    hulls = [half_spaces for half_spaces in hulls if half_spaces]
    left = voxels["index"].astype(object)
    for half_spaces in hulls:
        held = np.ones(len(left), bool)
        for normal, offset in half_spaces:
            far = left @ np.array(normal, object) + sum(max(n, 0) for n in normal)
            held &= np.array(far <= offset, bool)
        left = left[~held]
    return len(left) == 0


def box_distance(points, boxes):
    """Independent: distance of points to axis-aligned boxes, 0 inside."""
    low, high = SIZE_M * np.asarray(boxes)[:, :3], SIZE_M * np.asarray(boxes)[:, 3:]
    gap = np.maximum(np.maximum(low - points[:, None], points[:, None] - high), 0)
    return np.linalg.norm(gap, axis=2).min(axis=1)


def random_boxes(seed, count=12):
    rng = np.random.default_rng(seed)
    boxes = []
    while len(boxes) < count:
        low = rng.integers(0, 26, 3)
        high = low + rng.integers(1, 9, 3)
        box = np.concatenate([low, high])
        if box_distance(np.array([[-0.5, -0.5, -0.5], [3.5, 3.5, 3.5]]), [box]).min() > 0.4:
            boxes.append(box)
    return boxes
