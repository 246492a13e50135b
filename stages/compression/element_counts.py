"""Numbers of triangles and points that files hold, counted from their bytes without the readers.

`import-voxels` and `verify --source` read with the same readers. These counts
share no code with them, so an element that a reader leaves out, or reads twice, shows.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from typing import Any

_COMMENT = re.compile(rb"#[^\r\n]*")
_FACE = re.compile(rb"(?:^|(?<=[\r\n]))[ \t]*f[ \t](?:\\(?:\r\n|\r|\n)|[^\r\n])*")
_SOLID = re.compile(rb"^\s*(end)?solid\b[^\r\n]*", re.IGNORECASE | re.MULTILINE)
_HEADER_END = re.compile(rb"\nend_header[ \t]*\r?\n")
_SIZES = {"char": 1, "uchar": 1, "short": 2, "ushort": 2, "int": 4, "uint": 4, "float": 4, "double": 8,
          "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "float32": 4,
          "float64": 8}  # fmt: skip
_STRIPS = (5, 6)  # modes of glTF


def count_elements(raw: bytes, suffix: str) -> int | None:
    """Triangles of a mesh, with n - 2 for a polygon of n corners, or points of a cloud.

    Args:
        raw: the file, which its reader accepted.
        suffix: of its name, in lower case.

    Returns:
        None where bytes alone do not tell: PLY with several lists in a row, strips, compressed clouds.
    """
    count = _COUNTS.get(suffix)
    return None if count is None else count(raw)


def _obj(raw: bytes) -> int:
    faces = _FACE.finditer(_COMMENT.sub(b"", raw))
    return sum(len(face[0].replace(b"\\", b" ").split()) - 3 for face in faces)


def _stl(raw: bytes) -> int:
    records, rest = divmod(len(raw) - 84, 50)
    if rest == 0 and records >= 0 and raw[80:84] == records.to_bytes(4, "little"):
        return records
    return len(re.findall(rb"\bendfacet\b", _SOLID.sub(b"", raw), re.IGNORECASE))


def _ply(raw: bytes) -> int | None:
    end = _HEADER_END.search(raw)
    assert end is not None
    head, body = raw[: end.start()], raw[end.end() :]
    lines = [line.split() for line in head.decode("utf-8", "replace").split("\n")]
    elements: list[tuple[str, int, list[list[str]]]] = []
    for words in lines:
        if words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append(words[1:])
    counts = {name: count for name, count, _ in elements}
    if not counts.get("face") and not counts.get("tristrips"):
        return counts["vertex"]
    lists = [
        (name, words) for name, count, rows in elements for words in rows if count and words[0] == "list"
    ]
    if len(lists) != 1 or lists[0][0] != "face":
        return None
    if ["format", "ascii"] in [words[:2] for words in lines]:
        values = len(body.split()) - sum(count * len(rows) for _, count, rows in elements)
        return values - 2 * counts["face"]
    if body.endswith(b"\n") and _SIZES[lists[0][1][2]] == 1:
        return None  # the last byte is a line end or a corner
    if _values(elements, len(body), lists[0][1]) is None:
        body = body.removesuffix(b"\n")
    values_in_bytes = _values(elements, len(body), lists[0][1])
    return None if values_in_bytes is None else values_in_bytes - 2 * counts["face"]


def _values(elements: list[tuple[str, int, list[list[str]]]], size: int, words: list[str]) -> int | None:
    """Values of the only column of lists, from the bytes that all else leaves; None for no whole number."""
    for _, count, rows in elements:
        size -= count * sum(_SIZES[row[1] if row[0] == "list" else row[0]] for row in rows)
    values, rest = divmod(size, _SIZES[words[2]])
    return None if rest else values


def _glb(raw: bytes) -> int:
    tree: Any = json.loads(raw[20 : 20 + int.from_bytes(raw[12:16], "little")])
    total = 0
    for node in tree.get("nodes", []):  # the reader refuses nodes that are outside of the scene
        if node.get("mesh") is None:
            continue
        for primitive in tree["meshes"][node["mesh"]].get("primitives", ()):
            where = primitive.get("indices")
            accessor = tree["accessors"][primitive["attributes"]["POSITION"] if where is None else where]
            is_strip = primitive.get("mode") in _STRIPS
            total += accessor["count"] - 2 if is_strip else accessor["count"] // 3
    return total


def _lines(raw: bytes) -> int:
    found = re.split(rb"[\r\n]+", _COMMENT.sub(b"", raw.removeprefix(b"\xef\xbb\xbf")))
    return sum(1 for line in found if line.strip())


_COUNTS: dict[str, Callable[[bytes], int | None]] = {
    ".obj": _obj,
    ".stl": _stl,
    ".ply": _ply,
    ".glb": _glb,
    ".xyz": _lines,
    ".xyzn": _lines,
    ".xyzrgb": _lines,
    ".pts": lambda raw: _lines(raw) - 1,
}
