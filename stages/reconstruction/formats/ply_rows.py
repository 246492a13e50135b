"""All rows of a PLY file, of lists too: every byte of the data belongs to a row, or the file is refused."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.errors import ArtifactError
from alula.stages.reconstruction.formats.ply_header import HEADER_LIMIT, Element, Header, parse_header
from alula.stages.reconstruction.formats.text_rows import number_rows, text_lines

_CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
_TEXT_VALUE_BYTES = 2  # a digit and what separates it


@dataclass(frozen=True, slots=True)
class Lists:
    """A column of lists.

    Attributes:
        lengths: of each row, shape (N,).
        values: of all rows, one after the other.
    """

    lengths: IntArray
    values: NDArray[Any]


@dataclass(frozen=True, slots=True)
class Rows:
    """Rows of one element.

    Attributes:
        values: columns of single values by name, shape (N,) each.
        lists: columns of lists by name.
    """

    values: dict[str, NDArray[Any]]
    lists: dict[str, Lists]


def ply_rows(header: Header, data: memoryview) -> dict[str, Rows]:
    """Read all elements.

    Raises:
        ArtifactError: rows are missing, malformed, or followed by something else.
    """
    for element in header.elements:
        _check_room(header, element, len(data) - header.data_start)
    return (_binary if header.order else _text)(header, data)


def positions(rows: Rows) -> FloatArray:
    """Coordinates of an element with x, y and z, shape (N, 3).

    Raises:
        ArtifactError: it has no such columns.
    """
    if lacking := [axis for axis in "xyz" if axis not in rows.values]:
        raise ArtifactError(f"PLY: element vertex has no property {lacking[0]} of single values")
    return np.stack([np.asarray(rows.values[axis], np.float64) for axis in "xyz"], axis=1)


def ply_points(raw: bytes) -> FloatArray:
    """Points of a PLY file, whatever they form, shape (N, 3).

    Raises:
        ArtifactError: it is damaged, or has no points.
    """
    header = parse_header(raw[:HEADER_LIMIT])
    if header.element("vertex") is None:
        raise ArtifactError("PLY: no element vertex")
    return positions(ply_rows(header, memoryview(raw))["vertex"])


def _check_room(header: Header, element: Element, room: int) -> None:
    sizes = [p.size if p.type else int(p.length[1]) for p in element.properties]
    least = sum(sizes) if header.order else _TEXT_VALUE_BYTES * len(sizes)
    if element.count and not least:
        raise ArtifactError(f"PLY header: element {element.name} has {element.count} rows and no columns")
    if element.count * least > room + 1:  # the last line of a text needs no end
        raise ArtifactError(
            f"PLY: truncated: states {element.count} rows of {element.name} of at least {least} bytes, but "
            f"{room} bytes follow"
        )
    if wrong := [p.name for p in element.properties if not p.type and p.length[0] == "f"]:
        raise ArtifactError(f"PLY header: the length of list {wrong[0]} is no whole number")


def _text(header: Header, data: memoryview) -> dict[str, Rows]:
    head = bytes(data[: header.data_start]).count(b"\n")
    lines = text_lines(bytes(data[header.data_start :]), comments=False)
    numbered = [(number, line) for number, line in enumerate(lines, start=head + 1) if line.strip()]
    total = sum(element.count for element in header.elements)
    if len(numbered) != total:
        raise ArtifactError(f"PLY: the header announces {total} rows, but {len(numbered)} lines follow")
    found, at = {}, 0
    for element in header.elements:
        part = numbered[at : at + element.count]
        at += element.count
        found[element.name] = (_text_lists if element.has_lists else _text_values)(element, part)
    return found


def _text_values(element: Element, part: list[tuple[int, str]]) -> Rows:
    width = len(element.properties)
    table = number_rows([line for _, line in part], f"a row of {element.name}", part[0][0] if part else 1)
    if part and table.shape != (len(part), width):
        raise ArtifactError(
            f"PLY: line {part[0][0]}: {element.name} has {width} properties, not {table.shape[1]}"
        )
    table = table.reshape(len(part), width)
    return Rows({p.name: table[:, i] for i, p in enumerate(element.properties)}, {})


def _text_lists(element: Element, part: list[tuple[int, str]]) -> Rows:
    return _text_of_equal_rows(element, part) or _text_row_by_row(element, part)


def _text_of_equal_rows(element: Element, part: list[tuple[int, str]]) -> Rows | None:
    """Rows of one list of whole numbers, all of one length; None for others."""
    column = element.properties[0]
    if len(element.properties) > 1 or column.item[0] == "f" or not part:
        return None
    try:
        table = number_rows([line for _, line in part], "a row")
    except ArtifactError:
        return None
    if (table[:, 0] != table.shape[1] - 1).any() or (table != np.rint(table)).any():
        return None
    if np.abs(table).max() > 2**53:
        return None
    values = table[:, 1:].astype(np.int64).reshape(-1)
    return Rows({}, {column.name: Lists(table[:, 0].astype(np.int64), values)})


def _text_row_by_row(element: Element, part: list[tuple[int, str]]) -> Rows:
    values: dict[str, list[float]] = {p.name: [] for p in element.properties}
    lengths: dict[str, list[int]] = {p.name: [] for p in element.properties if not p.type}
    whole = {p.name: p.item[0] != "f" for p in element.properties if not p.type}
    for number, line in part:
        words, at = line.split(), 0
        try:
            if "_" in line:  # Python's own digits
                raise ValueError
            for p in element.properties:
                if p.type:
                    values[p.name].append(float(words[at]))
                    at += 1
                    continue
                length = int(words[at])
                if length < 0 or at + 1 + length > len(words):
                    raise ValueError
                items = words[at + 1 : at + 1 + length]
                values[p.name] += map(int, items) if whole[p.name] else map(float, items)
                lengths[p.name].append(length)
                at += 1 + length
            if at != len(words):
                raise ValueError
        except (ValueError, IndexError):
            raise ArtifactError(
                f"PLY: line {number} is no row of {element.name}: {line.strip()[:60]!r}"
            ) from None
    try:
        return Rows(
            {p.name: np.array(values[p.name], np.float64) for p in element.properties if p.type},
            {
                name: Lists(
                    np.array(sizes, np.int64),
                    np.array(values[name], np.int64 if whole[name] else np.float64),
                )
                for name, sizes in lengths.items()
            },
        )
    except OverflowError:
        raise ArtifactError(f"PLY: a row of {element.name} has a number beyond 64 bits") from None


def _binary(header: Header, data: memoryview) -> dict[str, Rows]:
    found, at = {}, header.data_start
    for element in header.elements:
        found[element.name], at = _equal_rows(header, element, data, at) or _walked(header, element, data, at)
    if bytes(data[at : at + 2]) not in (b"", b"\n"):  # a line end after the data does no harm
        raise ArtifactError(f"PLY: {len(data) - at} bytes follow the rows that the header announces")
    return found


def _equal_rows(header: Header, element: Element, data: memoryview, start: int) -> tuple[Rows, int] | None:
    """Rows whose lists have the lengths of the first row; None when they have not."""
    if element.count == 0:
        empty = {p.name: np.empty(0) for p in element.properties if p.type}
        none = Lists(np.empty(0, np.int64), np.empty(0, np.int64))
        return Rows(empty, {p.name: none for p in element.properties if not p.type}), start
    ends = _row_ends(header, element, data, start)
    fields: list[tuple[str, str, tuple[int, ...]]] = []
    for i, (p, (begin, end)) in enumerate(zip(element.properties, pairwise([start, *ends]), strict=True)):
        if p.type:
            fields.append((str(i), header.order + p.type, ()))
            continue
        size = int(p.length[1])
        fields.append((f"{i} length", header.order + p.length, ()))
        fields.append((str(i), header.order + p.item, ((end - begin - size) // int(p.item[1]),)))
    row = np.dtype(fields)
    if start + element.count * row.itemsize > len(data):
        if element.has_lists:
            return None
        raise ArtifactError(
            f"PLY: truncated: states {element.count} rows of {element.name} of {row.itemsize} bytes, but "
            f"{len(data) - start} bytes follow"
        )
    table = np.frombuffer(data, row, element.count, start)
    values, lists = {}, {}
    for i, p in enumerate(element.properties):
        column = table[str(i)]
        if p.type:
            values[p.name] = column
            continue
        lengths = table[f"{i} length"].astype(np.int64)
        if (lengths != column.shape[1]).any():
            return None
        lists[p.name] = Lists(lengths, column.reshape(-1))
    return Rows(values, lists), start + element.count * row.itemsize


def _row_ends(header: Header, element: Element, data: memoryview, at: int) -> list[int]:
    """Ends of the columns of the row that begins at a byte."""
    ends = []
    for p in element.properties:
        if p.type:
            at += p.size
        else:
            try:
                (length,) = struct.unpack_from((header.order or "<") + _CODES[p.length], data, at)
            except struct.error:
                raise ArtifactError(f"PLY: truncated in a row of {element.name}") from None
            if length < 0:
                raise ArtifactError(f"PLY: list {p.name} of {element.name} has the length {length}")
            at += int(p.length[1]) + length * int(p.item[1])
        if at > len(data):
            raise ArtifactError(f"PLY: truncated in a row of {element.name}")
        ends.append(at)
    return ends


def _walked(header: Header, element: Element, data: memoryview, at: int) -> tuple[Rows, int]:
    """Rows of different lengths, one after the other."""
    starts = np.empty((element.count, len(element.properties) + 1), np.int64)
    for i in range(element.count):
        starts[i, 0] = at
        starts[i, 1:] = ends = _row_ends(header, element, data, at)
        at = ends[-1]
    raw = np.frombuffer(data, np.uint8)
    values, lists = {}, {}
    for i, p in enumerate(element.properties):
        kind = p.type or p.item
        size = int(kind[1])
        begin = starts[:, i] + (0 if p.type else int(p.length[1]))
        lengths = (starts[:, i + 1] - begin) // size
        first = np.cumsum(lengths) - lengths
        place = np.repeat(begin - first * size, lengths) + np.arange(lengths.sum()) * size
        column = raw[place[:, None] + np.arange(size)].reshape(-1).view(header.order + kind)
        if p.type:
            values[p.name] = column
        else:
            lists[p.name] = Lists(lengths, column)
    return Rows(values, lists), at
