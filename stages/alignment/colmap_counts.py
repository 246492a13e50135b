"""Counts in the files of a binary COLMAP model, checked against the files' sizes before a library allocates.

COLMAP's readers reserve memory for as many entries as a file states: 100 kB could take gigabytes.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable, Mapping
from pathlib import Path
from struct import Struct
from struct import error as StructError

from alula.schemas.errors import InputError
from alula.schemas.files import reading

_COUNT = Struct("<Q")
_SENSORS = Struct("<I")
_CAMERA_BYTES = 48  # number, model, width, height and at least three parameters
_IMAGE_HEAD, _IMAGE_POINT = 64, 24  # number, pose, camera; then x, y and the point's number
_POINT_HEAD, _TRACK_ENTRY = 43, 8  # number, position, colour, error; then image and index
_FRAME_HEAD, _FRAME_DATUM = 64, 16  # number, rig, pose; then sensor and datum
_RIG_REFERENCE, _RIG_SENSOR, _RIG_POSE = 8, 9, 56


def check_counts(files: Mapping[str, Path]) -> None:
    """Refuse a binary model with a count that its file cannot hold.

    Args:
        files: the files by their role (see `model_files`); files of text are not checked.

    Raises:
        InputError: a file is shorter than its counts say, or cannot be read.
    """
    for role, path in files.items():
        if path.suffix != ".bin":
            continue
        with reading(path), path.open("rb") as file:
            if not path.stat().st_size:
                raise InputError(f"{path}: is empty")
            with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
                _check(data, _ENTRIES[role], path)


def _check(data: mmap.mmap, entry: Callable[[mmap.mmap, int], int], path: Path) -> None:
    size = len(data)
    if size < _COUNT.size:
        raise InputError(f"{path}: has {size} bytes, too few for a COLMAP file")
    (count,) = _COUNT.unpack_from(data)
    at = _COUNT.size
    for number in range(count):
        try:
            at = entry(data, at)
        except (StructError, IndexError):
            at = size + 1
        if at > size:
            raise InputError(
                f"{path}: states {count} entries, but its {size} bytes end within entry {number + 1}; it is "
                "damaged or cut"
            )


def _camera(data: mmap.mmap, at: int) -> int:
    return at + _CAMERA_BYTES


def _image(data: mmap.mmap, at: int) -> int:
    end = data.find(b"\0", at + _IMAGE_HEAD) + 1
    if not end:
        return len(data) + 1
    return end + _COUNT.size + _IMAGE_POINT * int(_COUNT.unpack_from(data, end)[0])


def _point(data: mmap.mmap, at: int) -> int:
    return at + _POINT_HEAD + _COUNT.size + _TRACK_ENTRY * int(_COUNT.unpack_from(data, at + _POINT_HEAD)[0])


def _frame(data: mmap.mmap, at: int) -> int:
    return (
        at + _FRAME_HEAD + _SENSORS.size + _FRAME_DATUM * int(_SENSORS.unpack_from(data, at + _FRAME_HEAD)[0])
    )


def _rig(data: mmap.mmap, at: int) -> int:
    (sensors,) = _SENSORS.unpack_from(data, at + _SENSORS.size)
    at += 2 * _SENSORS.size
    if sensors:
        at += _RIG_REFERENCE
    for _ in range(sensors - 1):
        at += _RIG_SENSOR + (_RIG_POSE if data[at + _RIG_SENSOR - 1] else 0)
    return at


_ENTRIES: dict[str, Callable[[mmap.mmap, int], int]] = {
    "cameras": _camera,
    "images": _image,
    "points3D": _point,
    "frames": _frame,
    "rigs": _rig,
}
