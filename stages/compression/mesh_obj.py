"""Wavefront OBJ: polygons. Every statement is known, or the file is refused."""

from __future__ import annotations

import io
import re
from array import array
from collections.abc import Iterator

import numpy as np

from alula.schemas.errors import ArtifactError, InputError
from alula.stages.compression.imported import Mesh
from alula.stages.compression.polygons import check_indices, mesh_of

_OTHER_SHAPES = {
    "p": "points", "l": "lines", "fo": "old faces", "curv": "curves", "curv2": "curves", "surf": "surfaces",
    "vp": "surfaces", "cstype": "surfaces", "deg": "surfaces", "bmat": "surfaces", "step": "surfaces",
    "parm": "surfaces", "trim": "surfaces", "hole": "surfaces", "scrv": "surfaces", "sp": "surfaces",
    "end": "surfaces", "con": "surfaces", "bsp": "patches", "bzp": "patches", "cdc": "curves",
    "cdp": "patches", "res": "patches", "call": "another file", "csh": "a command",
}  # fmt: skip
_NO_SHAPES = frozenset({
    "vt", "vn", "g", "o", "s", "mg", "bevel", "c_interp", "d_interp", "lod", "maplib", "usemap", "usemtl",
    "mtllib", "shadow_obj", "trace_obj", "ctech", "stech",
})  # fmt: skip
_CORNERS = re.compile(r"(?:[+-]?[0-9]{1,18}(?:/(?:[+-]?[0-9]+)?){0,2}(?: |$))+")
_TEXTURE = re.compile(r"/[^ ]*")
_CONTROL = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")


def read_obj(raw: bytes) -> Mesh:
    """Read the polygons of an OBJ file; see `polygons.mesh_of`.

    Indices count from 1 in the whole file, or backwards from the last vertex before the face. A backslash
    joins the next line to a vertex or a face. Colours behind a vertex are ignored, a weight must be 1.

    Raises:
        ArtifactError: a line is malformed.
        InputError: a statement is unknown, or stands for a shape that is no polygon.
    """
    points, corner, lengths = array("d"), array("q"), array("q")
    for number, line, joined in _statements(_text(raw)):
        words = (line.partition("#")[0] if "#" in line else line).split()
        if not words:
            continue
        try:
            if words[0] == "v":
                _check_vertex(words)
                points.extend(map(float, words[1:4]))
            elif words[0] == "f":
                corner.extend(_face(words, len(points) // 3))
                lengths.append(len(words) - 1)
            elif words[0] not in _NO_SHAPES:
                raise InputError(_unknown(words[0]))
            elif joined and words[0] not in ("vt", "vn"):
                raise InputError(f"{words[0]!r} ends in a backslash, which may hide the next line; join them")
        except InputError as error:
            raise InputError(f"line {number}: {error}") from None
        except ValueError:
            raise ArtifactError(f"line {number} is malformed: {line.strip()[:60]!r}") from None
    index = np.frombuffer(corner, np.int64) if corner else np.empty(0, np.int64)
    check_indices(index, len(points) // 3)
    where = np.frombuffer(points, np.float64) if points else np.empty(0)
    sizes = np.frombuffer(lengths, np.int64) if lengths else np.empty(0, np.int64)
    return mesh_of(where.reshape(-1, 3), sizes, index)


def _text(raw: bytes) -> str:
    plain = raw.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    wrong = _CONTROL.search(plain)
    if wrong is not None:
        line = plain.count(b"\n", 0, wrong.start()) + 1
        raise ArtifactError(f"line {line} holds the byte {wrong[0][0]:#04x}, so it is no text")
    return plain.decode("latin-1").replace("\x85", "?").replace("\xa0", "?")  # else taken for spaces


def _statements(text: str) -> Iterator[tuple[int, str, bool]]:
    """Number of the first line, text, and True when it is of several lines; comments end with their line."""
    begun, first = "", 0
    for number, ended in enumerate(io.StringIO(text, newline="\n"), start=1):
        line = ended.rstrip("\n")
        whole, start = (begun + line, first) if first else (line, number)
        if whole.endswith("\\") and "#" not in whole:
            begun, first = whole[:-1] + " ", start
            continue
        yield start, whole, first > 0
        begun, first = "", 0
    if first:
        yield first, begun, True


def _check_vertex(words: list[str]) -> None:
    if len(words) == 5 and float(words[4]) != 1:
        raise InputError(f"vertices with a weight of {words[4][:20]}, and only 1 is supported")
    if len(words) not in (4, 5, 7):  # 7: with a colour
        raise ValueError
    for word in words[5:]:
        float(word)
    if "_" in "".join(words):  # Python's own digits
        raise ValueError


def _face(words: list[str], before: int) -> list[int]:
    """Corners of a face, from 0."""
    text = " ".join(words[1:])
    if len(words) < 4 or not _CORNERS.fullmatch(text):
        raise ValueError
    found = list(map(int, (_TEXTURE.sub("", text) if "/" in text else text).split(" ")))
    low = min(found)
    if low < 0:
        found = [before + 1 + index if index < 0 else index for index in found]
    if low == 0 or min(found) < 1:
        raise InputError(f"a face has the corner {low}, and {before} vertices come before it")
    return [index - 1 for index in found]


def _unknown(word: str) -> str:
    if word in _OTHER_SHAPES:
        return f"has elements {word!r} ({_OTHER_SHAPES[word]}), and only faces can be marked"
    return f"the statement {word[:40]!r} is not known, so it may be a shape that would be missed"
