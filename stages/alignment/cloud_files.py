"""Reading of surveyed clouds from files: every point that a file states, or a refusal."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import ArtifactError, InputError
from alula.stages.alignment.cloud_counts import check_member
from alula.stages.alignment.cloud_pcd import read_pcd
from alula.stages.reconstruction.formats.ply_rows import ply_points
from alula.stages.reconstruction.formats.text_rows import number_rows, text_lines

TEXTS = (".xyz", ".xyzn", ".xyzrgb", ".pts")
SUFFIXES = (".ply", ".pcd", *TEXTS, ".npz")
_KEYS = ("points", "xyz", "positions")


def read_cloud(path: Path) -> FloatArray:
    """Read the points of a cloud.

    A text has a point in each line, with numbers between spaces or tabs. Those behind the first three, as
    many in each line, are ignored. `#` begins a comment. The first line of a PTS file is the number of
    points. In an .npz the points are the array `points`, `xyz` or `positions`.

    Returns:
        Shape (n, 3), in the file's units.

    Raises:
        InputError: the file cannot be read, has no points, or has something that is no point.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError(f"{path}: clouds end in {', '.join(SUFFIXES)}, not {suffix!r}")
    try:
        if suffix == ".npz":
            with path.open("rb") as file:
                file.read(1)
            points = _npz(path)
        else:
            with np.errstate(invalid="ignore"):  # of numbers that are none, refused below
                points = points_of(path.read_bytes(), suffix)
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error
    except ArtifactError as error:
        raise InputError(f"{path}: {error}") from error
    if points.ndim != 2 or points.shape[1] != 3:
        raise InputError(f"{path}: points must have the shape (n, 3), not {points.shape}")
    if not len(points):
        raise InputError(f"{path}: holds no points")
    if not np.isfinite(points).all():
        row = int(np.argwhere(~np.isfinite(points))[0][0])
        raise InputError(f"{path}: point {row} is not finite")
    return points


def points_of(raw: bytes, suffix: str) -> FloatArray:
    """Points of a cloud that is no .npz, shape (n, 3).

    Args:
        suffix: of its name, in lower case.

    Raises:
        ArtifactError: it has something that is no point, or not as many points as it states.
    """
    if suffix == ".ply":
        return ply_points(raw)
    return read_pcd(raw) if suffix == ".pcd" else _text(raw, suffix)


def _text(raw: bytes, suffix: str) -> FloatArray:
    lines = text_lines(raw, comments=True)
    first, stated = 0, None
    if suffix == ".pts":
        first = next((i for i, line in enumerate(lines) if line.strip()), 0)
        word = lines[first].strip()
        if not (word.isdigit() and len(word) <= 18):
            raise ArtifactError(
                f"line {first + 1}: a PTS file begins with its number of points, not {word[:40]!r}"
            )
        stated, lines = int(word), lines[first + 1 :]
        first += 1
    table = number_rows(lines, "a point", first + 1)
    if stated is not None and stated != len(table):
        raise ArtifactError(f"states {stated} points, but {len(table)} lines follow")
    if len(table) and table.shape[1] < 3:
        raise ArtifactError(f"its lines have {table.shape[1]} numbers, and a point needs three")
    return table[:, :3].copy() if len(table) else np.empty((0, 3))


def _npz(path: Path) -> FloatArray:
    try:
        with np.load(path, allow_pickle=False) as found:
            keys = [key for key in _KEYS if key in found.files]
            if not keys:
                raise InputError(f"{path}: has no array {' or '.join(_KEYS)}, only {', '.join(found.files)}")
            if len(keys) > 1:
                raise InputError(f"{path}: has the arrays {' and '.join(keys)}; keep the one with the points")
            check_member(found.zip, keys[0], path)
            points = found[keys[0]]
            if points.dtype.kind not in "fiu":
                raise InputError(f"{path}: array {keys[0]} is of {points.dtype}, not of real numbers")
            return np.asarray(points, np.float64)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path}: is no readable .npz file: {str(error)[:200]}") from error
