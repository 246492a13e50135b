"""Meshes and clouds in random encodings, against the triangles that were written, in whole numbers."""

from __future__ import annotations

import random
import tempfile
import time
from fractions import Fraction
from math import ceil, floor, lcm
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from support.attack.outcome import Outcome
from support.mesh_files import WRITERS, Written

CLAIM = "`import-voxels` marks every voxel that a triangle or point of its file touches, and no others"
SIZES = ("0.25", "0.2", "0.5")
SLACK = Fraction(1, 10**7)  # of a voxel that is marked: far above the rounding, far below a feature
Point = list[Fraction]


def search(seconds: float, seed: int) -> Outcome:
    """Draw files until the time is over, and compare their voxels with those that their shapes touch.

    Args:
        seconds: time.
        seed: of the cases; a contradiction names the number that `case` needs to repeat it.
    """
    found = Outcome(CLAIM)
    end = time.monotonic() + seconds
    with tempfile.TemporaryDirectory(prefix="alula-meshes-") as scratch:
        for number in range(2**31):
            if time.monotonic() > end:
                break
            outcome, wrong = case(f"{seed}/{number}", Path(scratch))
            found.tried += 1
            found.counts[outcome] += 1
            if wrong:
                found.contradictions.append(f"case {seed}/{number}: {wrong}")
    return found


def case(name: str, folder: Path) -> tuple[str, str]:
    """Write one file, import it and prove the voxels, and what is wrong, empty for nothing.

    Args:
        name: seed of the case.
        folder: for the file.
    """
    from alula.schemas.configs.import_voxels import ImportVoxelsConfig
    from alula.schemas.errors import AlulaError
    from alula.stages.compression.import_voxels import import_voxels
    from alula.stages.compression.imported_files import read_imported

    rng = random.Random(name)
    written: Written = WRITERS[rng.choice(sorted(WRITERS))](rng)
    size, scale = rng.choice(SIZES), rng.choice(("1", "1", "0.5", "0.1"))
    radius = rng.choice(("0", "0.1")) if written.points else "0"
    path = folder / f"a{written.suffix}"
    path.write_bytes(written.raw)
    config = ImportVoxelsConfig(size_m=float(size), scale=float(scale), margin_m=float(radius))
    try:
        source = read_imported(path)
        artifact = import_voxels(config, source, jobs=1)
    except AlulaError as error:
        if written.refused:
            return "refused, as they must be", ""
        return "refused", f"{path.suffix} is valid, but: {str(error)[:200]}"
    if written.refused:
        return "accepted", f"{path.suffix} with {written.refused} is accepted"
    index = artifact.arrays["index"]
    wrong, wanted = compared(written, index, Fraction(size), Fraction(scale), Fraction(radius))
    return written.suffix.removeprefix("."), wrong or _proof(artifact, source, rng.choice(sorted(wanted)))


def _proof(artifact: Any, source: Any, one: tuple[int, ...]) -> str:
    """What is wrong with the proof: it must hold, and fail without a voxel that is touched."""
    from alula.stages.compression.verify_imported import imported_checks

    index = artifact.arrays["index"]
    if any(check.failed for check in imported_checks(artifact.manifest, source, index, jobs=1)):
        return "the proof of its own voxels fails"
    less = np.ascontiguousarray(index[(index != one).any(axis=1)])
    if not any(check.failed for check in imported_checks(artifact.manifest, source, less, jobs=1)):
        return f"the proof holds without the voxel {one}"
    return ""


def compared(
    written: Written, index: NDArray[np.int32], size: Fraction, scale: Fraction, radius: Fraction
) -> tuple[str, set[tuple[int, ...]]]:
    """Voxels that are missing, or touch nothing, in words; and those that must be marked."""
    marked = set(map(tuple, index.tolist()))
    turn = written.suffix == ".glb"
    shapes = [[world(p, scale, turn) for p in shape] for shape in written.triangles]
    shapes += [[world(p, scale, turn)] * 3 for p in written.points]
    wanted: set[tuple[int, ...]] = set()
    allowed: set[tuple[int, ...]] = set()
    for shape in shapes:
        wanted |= near(shape, size, radius) if written.points else touched(shape, size, Fraction(0))
        allowed |= near(shape, size, radius + SLACK) if written.points else touched(shape, size, SLACK)
    if missing := sorted(wanted - marked):
        return f"{len(missing)} of {len(wanted)} voxels are missing, the first {missing[0]}", wanted
    if more := sorted(marked - allowed):
        return f"{len(more)} of {len(marked)} voxels touch nothing, the first {more[0]}", wanted
    return "", wanted


def world(p: Point, scale: Fraction, turn: bool) -> Point:
    """A point in metres with z up."""
    x, y, z = (scale * c for c in p)
    return [x, -z, y] if turn else [x, y, z]


def box(shape: list[Point], size: Fraction, grown: Fraction) -> NDArray[np.int64]:
    """Voxels near a shape: those whose closed cube, grown on all sides, meets its box."""
    axes = []
    for k in range(3):
        low, high = min(p[k] for p in shape) - grown, max(p[k] for p in shape) + grown
        axes.append(np.arange(ceil(low / size) - 1, floor(high / size) + 1))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def touched(shape: list[Point], size: Fraction, grown: Fraction) -> set[tuple[int, ...]]:
    """Voxels whose closed cube, grown on all sides, a triangle touches: no axis separates them.

    All lengths become whole numbers, of any length, so nothing is rounded.
    """
    unit = lcm(size.denominator, grown.denominator, *(c.denominator for p in shape for c in p))
    corner = [[int(c * unit) for c in p] for p in shape]
    edge = [[b - a for a, b in zip(corner[i], corner[(i + 1) % 3], strict=True)] for i in range(3)]
    axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    normals = [cross(edge[0], edge[1]), *(cross(a, e) for a in axes for e in edge)]
    side, more = int(size * unit), int(grown * unit)
    voxels = box(shape, size, grown)
    low = voxels.astype(object) * side - more
    keep = np.ones(len(voxels), bool)
    for n in [*axes, *normals]:
        shadow = [sum(a * c for a, c in zip(n, p, strict=True)) for p in corner]
        begin = low @ np.array(n, object) + sum(min(c, 0) for c in n) * (side + 2 * more)
        length = sum(abs(c) for c in n) * (side + 2 * more)
        keep &= ~((begin > max(shadow)) | (begin + length < min(shadow))).astype(bool)
    return set(map(tuple, voxels[keep].tolist()))


def near(shape: list[Point], size: Fraction, radius: Fraction) -> set[tuple[int, ...]]:
    """Voxels within a distance of a point."""
    found = set()
    for voxel in box(shape, size, radius).tolist():
        gap = [max(i * size - c, c - (i + 1) * size, 0) for i, c in zip(voxel, shape[0], strict=True)]
        if sum(g * g for g in gap) <= radius * radius:
            found.add(tuple(voxel))
    return found


def cross(a: list[int], b: list[int]) -> list[int]:
    """The cross product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
