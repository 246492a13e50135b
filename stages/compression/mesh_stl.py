"""STL, binary or text: triangles. Every byte belongs to one, or the file is refused."""

from __future__ import annotations

import re
from array import array

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import ArtifactError

_HEAD, _RECORD = 84, np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_N = rb"\s+(\S+)"
_SOLID = re.compile(rb"\s*solid(?:[ \t][^\r\n]*)?[\r\n]", re.IGNORECASE)
_FACET = re.compile(
    rb"\s*facet\s+normal" + _N * 3 + rb"\s+outer\s+loop" + (rb"\s+vertex" + _N * 3) * 3
    + rb"\s+endloop\s+endfacet(?=\s)", re.IGNORECASE
)  # fmt: skip
_CORNER = re.compile(rb"\bvertex\b", re.IGNORECASE)
_END = re.compile(rb"\s*endsolid(?:[ \t][^\r\n]*)?(?:[\r\n]+|$)", re.IGNORECASE)


def read_stl(raw: bytes) -> FloatArray:
    """Read the triangles of an STL file, shape (T, 3, 3).

    It is binary when its length is that of the number of triangles at byte 80, which no text fits. The two
    bytes behind a triangle, often a colour, and the normals are ignored.

    Raises:
        ArtifactError: it is neither binary nor text to the last byte.
    """
    count = int.from_bytes(raw[80:84], "little")
    if len(raw) >= _HEAD and len(raw) == _HEAD + count * _RECORD.itemsize:
        return np.frombuffer(raw, _RECORD, count, _HEAD)["corners"].astype(np.float64)
    text = raw.removeprefix(b"\xef\xbb\xbf")
    if text.lstrip()[:5].lower() != b"solid":
        need = _HEAD + count * _RECORD.itemsize
        raise ArtifactError(
            f"states {count} triangles, which are {need} bytes, but has {len(raw)}, and it is no text"
            if len(raw) >= _HEAD
            else "is too short for an STL file"
        )
    return _text(text)


def _text(text: bytes) -> FloatArray:
    found, at = array("d"), 0
    while (solid := _SOLID.match(text, at)) is not None:
        _check_name(text, solid)
        at = solid.end()
        while (facet := _FACET.match(text, at)) is not None:
            try:
                found.extend(map(_number, facet.groups()[3:]))
            except ValueError:
                raise _wrong(text, at) from None
            at = facet.end()
        end = _END.match(text, at)
        if end is None:
            raise _wrong(text, at)
        _check_name(text, end)
        at = end.end()
    if text[at:].strip():
        raise _wrong(text, at)
    numbers: NDArray[np.float64] = np.array(found, np.float64)
    return numbers.reshape(-1, 3, 3)


def _check_name(text: bytes, line: re.Match[bytes]) -> None:
    """Refuse a name of a solid that may be a facet without a line of its own."""
    if _CORNER.search(line[0]):
        raise _wrong(text, line.start())


def _number(word: bytes) -> float:
    if b"_" in word:  # Python's own digits
        raise ValueError
    return float(word)


def _wrong(text: bytes, at: int) -> ArtifactError:
    at += len(text[at:]) - len(text[at:].lstrip())
    line = text.count(b"\n", 0, at) + 1
    words = text[at : at + 60].split(b"\n")[0].decode("ascii", "replace").strip()
    return ArtifactError(
        f"line {line}: no facet of a text STL, and no end of its solid: {words!r}"
        if words
        else f"ends in line {line} before 'endsolid'"
    )
