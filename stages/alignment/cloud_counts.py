"""Counts in the headers of clouds, checked against the files' sizes before a library allocates."""

from __future__ import annotations

import zipfile
from math import prod
from pathlib import Path
from typing import BinaryIO

import numpy as np

from alula.schemas.errors import ArtifactError, InputError
from alula.stages.reconstruction.formats.ply_header import HEADER_LIMIT, parse_header

MAX_RATIO = 50  # of decompressed to compressed bytes; coordinates of real clouds compress 2 to 10 times
_ALWAYS_BYTES = 64 << 20  # decompressed arrays up to this size pass at any ratio
_PCD_HEADER_BYTES = 1 << 16
_TEXT_VALUE_BYTES = 2  # a digit and what separates it


def check_cloud(path: Path) -> None:
    """Refuse a PLY, PCD or PTS file that states more points than its bytes can hold.

    Args:
        path: the file; other suffixes state no count.

    Raises:
        InputError: the file is too short, or its header is damaged.
    """
    check = {".ply": _check_ply, ".pcd": _check_pcd, ".pts": _check_pts}.get(path.suffix.lower())
    if check is None:
        return
    try:
        with path.open("rb") as file:
            check(file, path.stat().st_size)
    except ArtifactError as error:
        raise InputError(f"{path}: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error


def check_member(archive: zipfile.ZipFile, name: str, path: Path) -> None:
    """Refuse an array of an .npz that is larger than its bytes can hold, or compressed beyond belief.

    Args:
        archive: the opened .npz.
        name: name of the array.
        path: the file, for messages.

    Raises:
        InputError: the array's shape does not fit its size, or it would grow more than `MAX_RATIO` times.
    """
    member = archive.getinfo(name if name in archive.namelist() else f"{name}.npy")
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = read(stream)
    need = prod(shape) * dtype.itemsize
    if need > member.file_size:
        raise InputError(f"{path}: array {name} states {need} bytes, its entry has {member.file_size}")
    try:
        _check_growth(need, member.compress_size)
    except ArtifactError as error:
        raise InputError(f"{path}: {error}") from error


def _check_growth(need: int, held: int) -> None:
    if need > max(_ALWAYS_BYTES, MAX_RATIO * held):
        raise ArtifactError(
            f"{held} compressed bytes would become {need}, more than {MAX_RATIO} times as many; store the "
            "points uncompressed if they are real"
        )


def _check_room(count: int, least: int, room: int) -> None:
    if count * least > room:
        raise ArtifactError(
            f"states {count} points of at least {least} bytes, but {max(room, 0)} bytes follow"
        )


def _check_ply(file: BinaryIO, size: int) -> None:
    header = parse_header(file.read(HEADER_LIMIT))
    room = size - header.data_start
    for element in header.elements:
        if header.order:  # a list has its length at least
            least = sum(p.size if p.type else 1 for p in element.properties)
        else:
            least = _TEXT_VALUE_BYTES * len(element.properties)
        if element.count and not least:
            raise ArtifactError(f"PLY header: element {element.name} has {element.count} rows and no columns")
        _check_room(element.count, least, room)
        room -= element.count * least


def _check_pcd(file: BinaryIO, size: int) -> None:
    start = file.read(_PCD_HEADER_BYTES)
    found: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in found:
        end = start.find(b"\n", at)
        if end < 0:
            raise ArtifactError("PCD header: truncated, or no line DATA")
        words = start[at:end].decode("ascii", "replace").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            found[words[0]] = words[1:]
    sizes, counts = _whole(found.get("SIZE", [])), _whole(found.get("COUNT", []))
    fields = len(found.get("FIELDS", []))
    counts = counts or [1] * fields
    if not fields or len(sizes) != fields or len(counts) != fields:
        raise ArtifactError("PCD header: FIELDS, SIZE and COUNT do not have the same number of entries")
    points, width, height = (sum(_whole(found.get(key, []))[:1]) for key in ("POINTS", "WIDTH", "HEIGHT"))
    points = max(points, width * height)
    row = sum(a * b for a, b in zip(sizes, counts, strict=True))
    kind = " ".join(found["DATA"])
    if kind != "binary_compressed":
        _check_room(points, row if kind == "binary" else _TEXT_VALUE_BYTES * sum(counts), size - at)
        return
    head = start[at : at + 8]
    held, grown = int.from_bytes(head[:4], "little"), int.from_bytes(head[4:], "little")
    if len(head) < 8 or held > size - at - 8:
        raise ArtifactError(f"PCD: truncated: {held} compressed bytes are stated, {size - at} follow")
    _check_room(points, row, grown)
    _check_growth(grown, held)


def _check_pts(file: BinaryIO, size: int) -> None:
    first = file.readline(1 << 16)
    words = first.decode("ascii", "replace").split()
    if len(words) == 1:
        counts = _whole(words)
        _check_room(counts[0], 3 * _TEXT_VALUE_BYTES, size - len(first) + 1)


def _whole(words: list[str]) -> list[int]:
    """Whole numbers; a word that is none, or has more than 18 digits, is refused."""
    for word in words:
        if not (word.isascii() and word.isdigit() and len(word) <= 18):
            raise ArtifactError(f"header: {word[:40]!r} is no count")
    return [int(word) for word in words]
