"""Meshes and clouds in random encodings, against the triangles that were written, in whole numbers."""

from __future__ import annotations

import random
import tempfile
import time
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor, lcm
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from support.attack.outcome import Outcome
from support.files.mesh_files import WRITERS, Written

CLAIM = "`import-voxels` marks every voxel that a triangle or point of its file touches, and no others"
SIZES = ("0.2", "0.25", "0.5", "1", "2.5", "10", "50")
ACROSS = 20  # voxels along the longest axis of the shapes at most, for the judge's sake
SLACK = Fraction(1, 10**4)  # of a voxel that is marked: far above the rounding, far below a feature
Point = list[Fraction]
Cell = tuple[int, ...]


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
    from alula.schemas.errors import AlulaError, InfeasibleError
    from alula.schemas.parameters.configs.import_voxels import ImportVoxelsConfig
    from alula.stages.compression.import_voxels import import_voxels
    from alula.stages.compression.imported_files import read_imported

    rng = random.Random(name)
    written: Written = WRITERS[rng.choice(sorted(WRITERS))](rng)
    size, scale, radius = (
        rng.choice(SIZES),
        rng.choice(("1", "1", "0.5", "0.1")),
        rng.choice(("0", "0", "0.1")),
    )
    solid = is_tetrahedra(written.triangles) and rng.random() < 0.8
    crop = (-0.3, -5.0, -0.5, 5.0, 0.5, 1.1) if rng.random() < 0.2 else None
    path = folder / f"a{written.suffix}"
    path.write_bytes(written.raw)
    config = ImportVoxelsConfig(
        size_m=float(size), scale=float(scale), margin_m=float(radius), solid=solid, crop=crop
    )
    try:
        source = read_imported(path)
        artifact = import_voxels(config, source, jobs=1)
    except InfeasibleError as error:
        return "nothing in the crop", "" if crop else str(error)
    except AlulaError as error:
        if written.refused:
            return "refused, as they must be", ""
        return "refused", f"{path.suffix} is valid, but: {str(error)[:200]}"
    if written.refused:
        return "accepted", f"{path.suffix} with {written.refused} is accepted"
    index = artifact.arrays["index"]
    level = Level(Fraction(size), Fraction(scale), Fraction(radius), solid, crop)
    wrong, wanted = compared(written, index, level)
    if not wrong and wanted:
        wrong = _proof(artifact, source, rng.choice(sorted(wanted)))
    return written.suffix.removeprefix(".") + " solids" * solid, wrong


@dataclass(frozen=True)
class Level:
    """What is an obstacle: in metres, after the scale."""

    size: Fraction
    scale: Fraction
    radius: Fraction
    solid: bool
    crop: tuple[float, ...] | None


def _proof(artifact: Any, source: Any, one: Cell) -> str:
    """What is wrong with the proof: it must hold, and fail without a voxel that is touched."""
    from alula.stages.compression.verify_imported import imported_checks

    index = artifact.arrays["index"]
    if any(check.failed for check in imported_checks(artifact.manifest, source, index, jobs=1)):
        return "the proof of its own voxels fails"
    less = np.ascontiguousarray(index[(index != one).any(axis=1)])
    if not any(check.failed for check in imported_checks(artifact.manifest, source, less, jobs=1)):
        return f"the proof holds without the voxel {one}"
    return ""


def compared(written: Written, index: NDArray[np.int32], level: Level) -> tuple[str, set[Cell]]:
    """Voxels that are missing, or touch nothing, in words; and those that must be marked.

    For a thick triangle those within the radius of its corners and of the middle of its edges must be marked,
    and those that it touches; more than the radius along an axis must not be.
    """
    marked = set(map(tuple, index.tolist()))
    turn, size, radius = written.suffix == ".glb", level.size, level.radius
    shapes = [[world(p, level.scale, turn) for p in shape] for shape in written.triangles]
    wanted: set[Cell] = set()
    allowed: set[Cell] = set()
    for point in (world(p, level.scale, turn) for p in written.points):
        wanted |= near(point, size, radius)
        allowed |= near(point, size, radius + SLACK)
    for a, b, c in shapes:
        wanted |= touched([a, b, c], size, Fraction(0))
        allowed |= touched([a, b, c], size, radius + SLACK)
        for p, q in ((a, b), (b, c), (c, a)) if radius else ():
            wanted |= near(p, size, radius) | near(
                [(x + y) / 2 for x, y in zip(p, q, strict=True)], size, radius
            )
    if level.solid:
        inner = inside(shapes, size)
        wanted |= inner
        allowed |= inner
    if level.crop:
        wanted = {v for v in wanted if meets(v, level, Fraction(0))}
        allowed = {v for v in allowed if meets(v, level, SLACK)}
    if missing := sorted(wanted - marked):
        return f"{len(missing)} of {len(wanted)} voxels are missing, the first {missing[0]}", wanted
    if more := sorted(marked - allowed):
        return f"{len(more)} of {len(marked)} voxels touch nothing, the first {more[0]}", wanted
    return "", wanted


def meets(voxel: Cell, level: Level, grown: Fraction) -> bool:
    """Whether a cube shares more than its surface with the crop, grown on all sides.

    Whether faces that agree in decimals touch is decided by the size as a double, and loses no point of the
    crop: the voxel on the other side of the face is marked.
    """
    assert level.crop is not None
    low, high = map(Fraction, level.crop[:3]), map(Fraction, level.crop[3:])
    ends = zip(voxel, low, high, strict=True)
    return all(i * level.size < b + grown and (i + 1) * level.size > a - grown for i, a, b in ends)


def is_tetrahedra(triangles: list[list[Point]]) -> bool:
    """Whether every four triangles are the surface of a tetrahedron."""
    groups = [triangles[k : k + 4] for k in range(0, len(triangles), 4)]
    for group in groups:
        edges = [(tuple(t[i]), tuple(t[(i + 1) % 3])) for t in group for i in range(3)]
        if len(group) < 4 or sorted(edges) != sorted((b, a) for a, b in edges):
            return False
    return bool(groups)


def inside(shapes: list[list[Point]], size: Fraction) -> set[Cell]:
    """Voxels that no triangle touches and around whose centre the tetrahedra wind, each once."""
    corners = [p for shape in shapes for p in shape]
    surface: set[Cell] = set().union(*(touched(shape, size, Fraction(0)) for shape in shapes))
    unit = 2 * lcm(size.denominator, *(c.denominator for p in corners for c in p))
    voxels = np.array(sorted(cells(box(corners, size, Fraction(0))) - surface), np.int64).reshape(-1, 3)
    centre = (2 * voxels.astype(object) + 1) * int(size * unit / 2)
    winding = np.zeros(len(voxels), int)
    for k in range(0, len(shapes), 4):
        sides = []
        for shape in shapes[k : k + 4]:
            a, b, c = ([int(x * unit) - centre[:, i] for i, x in enumerate(p)] for p in shape)
            sides.append(sum(x * y for x, y in zip(a, cross(b, c), strict=True)))
        winding += np.all([side > 0 for side in sides], axis=0)
        winding -= np.all([side < 0 for side in sides], axis=0)
    return cells(voxels[winding != 0])


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


def touched(shape: list[Point], size: Fraction, grown: Fraction) -> set[Cell]:
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
    return cells(voxels[keep])


def near(point: Point, size: Fraction, radius: Fraction) -> set[Cell]:
    """Voxels within a distance of a point."""
    unit = lcm(size.denominator, radius.denominator, *(c.denominator for c in point))
    voxels = box([point], size, radius)
    low, place = voxels.astype(object) * int(size * unit), np.array([int(c * unit) for c in point], object)
    gap = np.maximum(np.maximum(low - place, place - low - int(size * unit)), 0)
    return cells(voxels[((gap * gap).sum(axis=1) <= int(radius * unit) ** 2).astype(bool)])


def cells(voxels: NDArray[np.int64]) -> set[Cell]:
    """Rows as a set."""
    return set(map(tuple, voxels.tolist()))


def cross(a: list[Any], b: list[Any]) -> list[Any]:
    """The cross product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
