"""CSV tables of correspondences, positions and poses; every error message names the row."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.stages.alignment.evidence import Correspondences, Positions, distinct
from alula.stages.alignment.georeference import GEODETIC, Origin, enu_from_geodetic
from alula.stages.rotation import matrix_from_quat_wxyz

_XYZ = ("x", "y", "z")
_QUATERNION = ("qw", "qx", "qy", "qz")
LARGEST = 1e12  # coordinates beyond it overflow in the sums of squares of an alignment
_IMAGE = ("width", "height", "fx", "fy", "cx", "cy")
_UNIT = 0.01  # maximum difference of a quaternion's length from 1


def parse_positions(text: str, name: str, *, orientations: bool = False) -> Positions:
    """Parse rows `image,x,y,z`, with `orientations` also `qw,qx,qy,qz`; other columns are ignored.

    The quaternion turns the camera's axes (x right, y down, z forward, as in OpenCV and COLMAP) into
    the frame of the positions.

    Raises:
        InputError: a row is wrong; the message names it.
    """
    columns = (*_XYZ, *_QUATERNION) if orientations else _XYZ
    names, rows, values = _named(_table(text, name, ("image", *columns)), columns)
    axes = None
    if orientations:
        length = np.linalg.norm(values[:, 3:], axis=1)
        for row, found in zip(rows, length.tolist(), strict=True):
            if abs(found - 1) > _UNIT:
                raise InputError(f"{row}: the quaternion qw,qx,qy,qz has length {found:.4g}, not 1")
        axes = matrix_from_quat_wxyz(values[:, 3:] / length[:, None])
    return Positions(names, values[:, :3], rows, axes)


def parse_pinholes(text: str, name: str) -> tuple[Positions, FloatArray]:
    """Parse rows `image,x,y,z,qw,qx,qy,qz,width,height,fx,fy,cx,cy` of cameras without distortion.

    The poses are those of `parse_positions`; the rest is in pixels, with the corner of the image at 0, 0.

    Returns:
        The poses, and left, top, right and bottom of each image as x/z and y/z, shape (n, 4).

    Raises:
        InputError: a row is wrong; the message names it.
    """
    poses = parse_positions(text, name, orientations=True)
    _, rows, values = _named(_table(text, name, ("image", *_IMAGE)), _IMAGE)
    size, focal, middle = values[:, :2], values[:, 2:4], values[:, 4:]
    for row, least in zip(rows, values[:, :4].min(axis=1), strict=True):
        if least <= 0:
            raise InputError(f"{row}: width, height, fx and fy must be positive")
    return poses, np.concatenate([-middle / focal, (size - middle) / focal], axis=1)


def parse_reference(text: str, name: str, origin: Origin | None = None) -> Positions:
    """Parse rows `image,x,y,z` [m], or `image,lat,lon,alt` [deg, m] which become east, north, up [m].

    Args:
        origin: latitude, longitude [deg] and height [m] that become 0; default: the first row.

    Raises:
        InputError: a row is wrong; the message names it.
    """
    header = _header(text, name)
    geodetic = [column for column in GEODETIC if column in header]
    if geodetic and any(column in header for column in _XYZ):
        raise InputError(f"{name}: has both x,y,z and lat,lon,alt; remove the columns of one of them")
    if not geodetic:
        if origin is not None:
            raise InputError(f"{name}: has x,y,z; --origin is for lat,lon,alt")
        return parse_positions(text, name)
    names, rows, values = _named(_table(text, name, ("image", *GEODETIC)), GEODETIC)
    position, facts = enu_from_geodetic(values, rows, origin)
    return Positions(names, position, rows, facts=facts)


def parse_pairs(text: str, name: str) -> Correspondences:
    """Parse rows `sx,sy,sz,wx,wy,wz` with a header: a point in the scene and the same in the world [m].

    Raises:
        InputError: a row is wrong; the message names it.
    """
    columns = ("sx", "sy", "sz", "wx", "wy", "wz")
    rows, values = [], []
    for where, words in _table(text, name, columns):
        rows.append(where)
        values.append(_numbers(where, columns, words))
    table = np.array(values, np.float64).reshape(-1, 6)
    return distinct(Correspondences(tuple(rows), table[:, :3], table[:, 3:]))


def _named(
    table: list[tuple[str, list[str]]], columns: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...], np.ndarray[tuple[int, int], np.dtype[np.float64]]]:
    """Names of the images, file and row of each, and its numbers."""
    names, rows, values = [], [], []
    seen: set[str] = set()
    for where, (image, *words) in table:
        if not image:
            raise InputError(f"{where}: the image has no name")
        if image in seen:
            raise InputError(f"{where}: image {image!r} occurs twice")
        seen.add(image)
        names.append(image)
        rows.append(f"{where} ({image})")
        values.append(_numbers(where, columns, words))
    return tuple(names), tuple(rows), np.array(values, np.float64).reshape(-1, len(columns))


def _lines(text: str, name: str) -> list[list[str]]:
    try:
        lines = list(csv.reader(io.StringIO(text.removeprefix("\ufeff"), newline=""), strict=True))
    except csv.Error as error:
        raise InputError(f"{name}: is not CSV ({error})") from error
    if not lines:
        raise InputError(f"{name}: is empty")
    return lines


def _header(text: str, name: str) -> list[str]:
    return [word.strip().lower() for word in _lines(text, name)[0]]


def _table(text: str, name: str, columns: Sequence[str]) -> list[tuple[str, list[str]]]:
    """File and row of each line, and its values of the given columns."""
    lines = _lines(text, name)
    header = [word.strip().lower() for word in lines[0]]
    missing = [column for column in columns if column not in header]
    if missing:
        raise InputError(
            f"{name}: no column {missing[0]!r} in the first line; it must be {','.join(columns)}"
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
        if abs(value) > LARGEST and name not in GEODETIC:  # those have limits of their own
            raise InputError(f"{where}: {name} is {word!r}, beyond {LARGEST:g}")
        values.append(value)
    return values
