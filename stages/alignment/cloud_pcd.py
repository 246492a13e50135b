"""PCD files: every stated point is read, from every byte of the data, or the file is refused."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import ArtifactError
from alula.stages.alignment.cloud_counts import check_growth
from alula.stages.reconstruction.formats.text_rows import number_rows, text_lines

_HEADER_BYTES = 1 << 16
_TEXT_VALUE_BYTES = 2  # a digit and what separates it
_KEYS = frozenset(
    (
        "VERSION",
        "FIELDS",
        "COLUMNS",
        "SIZE",
        "TYPE",
        "COUNT",
        "WIDTH",
        "HEIGHT",
        "VIEWPOINT",
        "POINTS",
        "DATA",
    )
)
_TYPES = {"F": "f", "I": "i", "U": "u"}


@dataclass(frozen=True, slots=True)
class _Header:
    kinds: list[str]  # NumPy's codes of the fields
    counts: list[int]
    axes: list[int]  # fields x, y and z
    points: int
    data: str
    start: int

    @property
    def row(self) -> int:
        return sum(int(kind[1:]) * count for kind, count in zip(self.kinds, self.counts, strict=True))


def read_pcd(raw: bytes) -> FloatArray:
    """Points of a PCD file, shape (N, 3); the viewpoint of the sensor does not move them.

    Raises:
        ArtifactError: it is damaged, or has more or less data than it states.
    """
    header = _header(raw)
    body = memoryview(raw)[header.start :]
    if header.data == "ascii":
        return _text(header, raw)
    if header.data == "binary":
        _check_room(header.points, header.row, len(body))
        if len(body) != header.points * header.row:
            raise ArtifactError(
                f"PCD: {len(body)} bytes follow the header, but its points have {header.points * header.row}"
            )
        fields = [(str(i), kind, (n,)) for i, (kind, n) in enumerate(_columns(header))]
        table = np.frombuffer(body, np.dtype(fields), header.points)
        return np.stack([table[str(i)][:, 0].astype(np.float64) for i in header.axes], axis=1)
    if header.data != "binary_compressed":
        raise ArtifactError(f"PCD header: DATA {header.data[:40]!r} is not known")
    held, grown = (int.from_bytes(body[k : k + 4], "little") for k in (0, 4))
    if len(body) < 8 or held != len(body) - 8:
        follow = max(len(body) - 8, 0)
        raise ArtifactError(f"PCD: truncated: {held} compressed bytes are stated, {follow} follow")
    _check_room(header.points, header.row, grown)
    check_growth(grown, held)
    if grown != header.points * header.row:
        raise ArtifactError(f"PCD: states {grown} bytes of {header.points} points with {header.row} each")
    return _by_columns(header, _expanded(bytes(body[8:]), grown))


def _columns(header: _Header) -> list[tuple[str, int]]:
    return [(f"<{kind}", count) for kind, count in zip(header.kinds, header.counts, strict=True)]


def _text(header: _Header, raw: bytes) -> FloatArray:
    _check_room(header.points, _TEXT_VALUE_BYTES * sum(header.counts), len(raw) - header.start + 1)
    first = raw.count(b"\n", 0, header.start) + 1
    table = number_rows(text_lines(raw[header.start :], comments=False), "a point", first)
    if len(table) != header.points or (len(table) and table.shape[1] != sum(header.counts)):
        raise ArtifactError(
            f"PCD: states {header.points} points of {sum(header.counts)} numbers, but {len(table)} lines of "
            f"{table.shape[1]} follow"
        )
    ends = np.cumsum(header.counts)
    return table[:, [int(ends[i]) - 1 for i in header.axes]] if len(table) else np.empty((0, 3))


def _by_columns(header: _Header, raw: bytes) -> FloatArray:
    """Coordinates where the values of each field follow each other."""
    found: list[NDArray[np.float64]] = [np.empty(0)] * 3
    at = 0
    for i, (kind, count) in enumerate(_columns(header)):
        if i in header.axes:
            found[header.axes.index(i)] = np.frombuffer(raw, kind, header.points, at).astype(np.float64)
        at += np.dtype(kind).itemsize * count * header.points
    return np.stack(found, axis=1)


def _header(raw: bytes) -> _Header:
    found: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in found:
        end = raw.find(b"\n", at, _HEADER_BYTES)
        if end < 0:
            raise ArtifactError("PCD header: truncated, or no line DATA")
        words = raw[at:end].decode("ascii", "replace").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            if words[0] not in _KEYS or words[0] in found:
                raise ArtifactError(f"PCD header: {words[0][:40]!r} is not known, or is there twice")
            found[words[0]] = words[1:]
    names = found.get("FIELDS", found.get("COLUMNS", []))
    types, sizes = found.get("TYPE", []), _whole(found.get("SIZE", []))
    counts = _whole(found.get("COUNT", [])) or [1] * len(names)
    if not names or any(len(column) != len(names) for column in (types, sizes, counts)):
        raise ArtifactError("PCD header: FIELDS, SIZE, TYPE and COUNT do not have the same number of entries")
    kinds = [f"{_TYPES.get(kind, '?')}{size}" for kind, size in zip(types, sizes, strict=True)]
    for name, kind in zip(names, kinds, strict=True):
        if not re.fullmatch(r"[iu][1248]|f[48]", kind):
            raise ArtifactError(f"PCD header: field {name[:40]} has a type and a size that do not exist")
    axes = []
    for axis in "xyz":
        if names.count(axis) != 1 or counts[names.index(axis)] != 1:
            raise ArtifactError(f"PCD header: there is no field {axis} of one number")
        axes.append(names.index(axis))
    points, width, height = (_whole(found.get(key, []))[:1] or [0] for key in ("POINTS", "WIDTH", "HEIGHT"))
    if "POINTS" in found and points[0] != width[0] * height[0]:
        raise ArtifactError(f"PCD header: states {points[0]} points, but {width[0]} by {height[0]}")
    return _Header(kinds, counts, axes, width[0] * height[0], " ".join(found["DATA"]), at)


def _check_room(count: int, least: int, room: int) -> None:
    if count * least > room:
        raise ArtifactError(
            f"PCD: states {count} points of at least {least} bytes, but {max(room, 0)} bytes follow"
        )


def _whole(words: list[str]) -> list[int]:
    """Whole numbers; a word that is none, or has more than 18 digits, is refused."""
    for word in words:
        if not (word.isascii() and word.isdigit() and len(word) <= 18):
            raise ArtifactError(f"header: {word[:40]!r} is no count")
    return [int(word) for word in words]


def _expanded(raw: bytes, size: int) -> bytes:
    """Decompress LZF: runs of literal bytes, and copies of earlier ones.

    Raises:
        ArtifactError: they do not become as many bytes.
    """
    out, at = bytearray(), 0
    try:
        while at < len(raw) and len(out) <= size:
            control = raw[at]
            at += 1
            if control < 32:  # control + 1 literal bytes
                out += raw[at : at + control + 1]
                at += control + 1
                continue
            length = control >> 5
            if length == 7:
                length += raw[at]
                at += 1
            begin = len(out) - ((control & 31) << 8 | raw[at]) - 1
            at += 1
            if begin < 0:
                raise IndexError
            once = out[begin : begin + length + 2]
            out += (once * (-(-(length + 2) // len(once))))[: length + 2]  # a copy may run into itself
    except IndexError:
        raise ArtifactError("PCD: the compressed data is damaged") from None
    if at != len(raw) or len(out) != size:
        raise ArtifactError(f"PCD: the compressed data becomes {len(out)} bytes, not {size}")
    return bytes(out)
