"""What a scene is aligned by: correspondences from tables and COLMAP models, or a given similarity."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from alula.schemas.errors import InputError
from alula.schemas.manifest import Similarity
from alula.stages.alignment.similarity import Array

MODEL_PARTS = ("cameras", "frames", "images", "points3D", "rigs")
_ORTHONORMAL = 1e-4


@dataclass(frozen=True, slots=True)
class Correspondences:
    """Points of the scene and of the world, row by row.

    `rows` says where each pair comes from; `unused` counts cameras without a reference.
    """

    rows: tuple[str, ...]
    scene: Array
    world: Array
    unused: int = 0


@dataclass(frozen=True, slots=True)
class Positions:
    """Named positions, shape (n, 3), and where each was read."""

    names: tuple[str, ...]
    position: Array
    rows: tuple[str, ...]


def parse_positions(text: str, name: str) -> Positions:
    """Rows `image,x,y,z` with a header; other columns are ignored.

    Raises:
        InputError: naming the row that is wrong.
    """
    table = _table(text, name, ("image", "x", "y", "z"))
    names, values, rows = [], [], []
    for where, (image, *numbers) in table:
        if not image:
            raise InputError(f"{where}: the image has no name")
        if image in names:
            raise InputError(f"{where}: image {image!r} occurs twice")
        names.append(image)
        values.append(_numbers(where, "xyz", numbers))
        rows.append(f"{where} ({image})")
    return Positions(tuple(names), np.array(values, np.float64).reshape(-1, 3), tuple(rows))


def parse_pairs(text: str, name: str) -> Correspondences:
    """Rows `sx,sy,sz,wx,wy,wz` with a header: a point in the scene and the same in the world [m].

    Raises:
        InputError: naming the row that is wrong.
    """
    columns = ("sx", "sy", "sz", "wx", "wy", "wz")
    rows, values = [], []
    for where, words in _table(text, name, columns):
        rows.append(where)
        values.append(_numbers(where, columns, words))
    table = np.array(values, np.float64).reshape(-1, 6)
    return _checked(Correspondences(tuple(rows), table[:, :3], table[:, 3:]))


def match(cameras: Positions, reference: Positions) -> Correspondences:
    """Pair positions by the names of the images.

    Raises:
        InputError: a reference names an unknown image, or two positions are equal.
    """
    index = {name: i for i, name in enumerate(cameras.names)}
    for name, row in zip(reference.names, reference.rows, strict=True):
        if name not in index:
            raise InputError(f"{row}: no camera has an image of that name")
    chosen = [index[name] for name in reference.names]
    scene = cameras.position[chosen]
    unused = len(cameras.names) - len(chosen)
    return _checked(Correspondences(reference.rows, scene, reference.position, unused))


def _checked(found: Correspondences) -> Correspondences:
    """Refuse equal points: they count twice but say nothing new, and come from mistakes."""
    for name, points in (("scene", found.scene), ("world", found.world)):
        seen: dict[tuple[float, ...], str] = {}
        for row, point in zip(found.rows, points.tolist(), strict=True):
            earlier = seen.setdefault(tuple(point), row)
            if earlier != row:
                raise InputError(f"{row}: the same point in the {name} as {earlier}")
    return found


def _table(text: str, name: str, columns: Sequence[str]) -> list[tuple[str, list[str]]]:
    """Where each row is, and its values of the wanted columns."""
    try:
        lines = list(csv.reader(io.StringIO(text.removeprefix("\ufeff"), newline=""), strict=True))
    except csv.Error as error:
        raise InputError(f"{name}: is not CSV ({error})") from error
    if not lines:
        raise InputError(f"{name}: is empty")
    header = [word.strip().lower() for word in lines[0]]
    missing = [column for column in columns if column not in header]
    if missing:
        gps = " (GPS positions are not supported by this version)" if "lat" in header else ""
        raise InputError(
            f"{name}: no column {missing[0]!r} in the first line; it must be {','.join(columns)}{gps}"
        )
    at = [header.index(column) for column in columns]
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        if not any(word.strip() for word in line):
            continue
        if len(line) <= max(at):
            raise InputError(f"{name} row {number}: has {len(line)} values, not {len(header)}")
        rows.append((f"{name} row {number}", [line[i].strip() for i in at]))
    if not rows:
        raise InputError(f"{name}: has no rows")
    return rows


def _numbers(where: str, names: Sequence[str], words: Sequence[str]) -> list[float]:
    values = []
    for name, word in zip(names, words, strict=True):
        try:
            value = float(word)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(f"{where}: {name} is {word!r}, not a finite number")
        values.append(value)
    return values


def model_files(folder: Path) -> dict[str, Path]:
    """The files of a COLMAP model by role; binary ones where both are there, as COLMAP reads them.

    Raises:
        InputError: there is no model.
    """
    suffix = ".bin" if (folder / "images.bin").is_file() else ".txt"
    files = {
        part: folder / f"{part}{suffix}" for part in MODEL_PARTS if (folder / f"{part}{suffix}").is_file()
    }
    lacking = [part for part in ("cameras", "images", "points3D") if part not in files]
    if lacking:
        where = "does not exist" if not folder.exists() else f"no {lacking[0]}.bin or {lacking[0]}.txt"
        raise InputError(f"{folder}: is no COLMAP model: {where}")
    return files


def read_model(folder: Path) -> Positions:
    """Centres of the registered cameras of a COLMAP model, binary or text, sorted by image name.

    Raises:
        InputError: it cannot be read, no image is registered, or pycolmap is not installed.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise InputError("reading COLMAP models needs pycolmap; --cameras takes a CSV instead") from error
    try:
        pycolmap.logging.minloglevel = 3
        model = pycolmap.Reconstruction(str(folder))
        found = {
            image.name: np.asarray(image.projection_center(), np.float64)
            for image in model.images.values()
            if image.has_pose
        }
    except Exception as error:
        reason = str(error).split("] ")[-1].splitlines()
        raise InputError(f"{folder}: is no readable COLMAP model: {' '.join(reason)[:200]}") from error
    if not found:
        raise InputError(f"{folder}: no image of the COLMAP model is registered")
    names = tuple(sorted(found))
    position = np.array([found[name] for name in names])
    for name, point in zip(names, position, strict=True):
        if not np.isfinite(point).all():
            raise InputError(f"{folder}: image {name!r} has a pose that is not finite")
    return Positions(names, position, tuple(f"{folder.name} ({name})" for name in names))


def parse_transform(text: str, name: str) -> Similarity:
    """A similarity from JSON: a 4x4 matrix, alone or as `matrix`, or scale, rotation, translation_m.

    Raises:
        InputError: not JSON, of another shape, not finite, or not a proper similarity.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name}: is not JSON ({error})") from error
    try:
        if isinstance(found, dict) and "matrix" not in found:
            linear = float(found["scale"]) * np.array(found["rotation"], np.float64)
            if not float(found["scale"]) > 0:
                raise InputError(f"{name}: the scale must be positive, not {found['scale']}")
            translation = np.array(found["translation_m"], np.float64)
        else:
            matrix = np.array(found["matrix"] if isinstance(found, dict) else found, np.float64)
            if matrix.shape != (4, 4) or matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
                raise InputError(f"{name}: needs a 4x4 matrix with the last row 0 0 0 1")
            linear, translation = matrix[:3, :3], matrix[:3, 3]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{name}: needs a 4x4 matrix, or scale, rotation (3x3) and translation_m (3)"
        ) from error
    if linear.shape != (3, 3) or translation.shape != (3,):
        raise InputError(f"{name}: rotation must be 3x3 and translation_m of length 3")
    if not (np.isfinite(linear).all() and np.isfinite(translation).all()):
        raise InputError(f"{name}: a value is not finite")
    determinant = float(np.linalg.det(linear))
    if determinant < 0:
        raise InputError(f"{name}: is a reflection (determinant {determinant:.3g}), not a similarity")
    scale = determinant ** (1 / 3)
    if not (1e-9 <= scale <= 1e9):
        raise InputError(f"{name}: the scale is {scale:.3g}, not between 1e-9 and 1e9")
    u, singular, vt = np.linalg.svd(linear / scale)
    if np.abs(singular - 1).max() > _ORTHONORMAL:
        raise InputError(f"{name}: is not a rotation times a scale (singular values {scale * singular})")
    return Similarity(scale=scale, rotation=(u @ vt).tolist(), translation_m=translation.tolist())
