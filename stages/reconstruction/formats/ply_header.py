"""Headers of PLY files: elements, their properties, and the start of the data."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

from alula.schemas.errors import ArtifactError

HEADER_LIMIT = 2**20
_END = re.compile(rb"(?<=\n)end_header[ \t]*\r?\n")
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_BYTE_ORDER = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}


@dataclass(frozen=True, slots=True)
class Property:
    """One column; codes are NumPy's, without byte order.

    Attributes:
        name: as in the header.
        type: code of a value, empty for a list of values.
        length: code of a list's length, else empty.
        item: code of a list's values, else empty.
    """

    name: str
    type: str
    length: str = ""
    item: str = ""

    @property
    def size(self) -> int:
        """Bytes of one value."""
        return int(self.type[1])


@dataclass(frozen=True, slots=True)
class Element:
    """One table."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def has_lists(self) -> bool:
        """True when the size of a row varies."""
        return any(not p.type for p in self.properties)

    @property
    def row_size(self) -> int:
        """Bytes of one row of a binary file; only without lists."""
        return sum(p.size for p in self.properties)

    def column(self, name: str) -> Property | None:
        """The property of that name."""
        return next((p for p in self.properties if p.name == name), None)


@dataclass(frozen=True, slots=True)
class Header:
    """A parsed header; `order` is "<", ">" or, for ascii, empty."""

    order: str
    elements: tuple[Element, ...]
    comments: tuple[str, ...]
    data_start: int

    def element(self, name: str) -> Element | None:
        """The element of that name."""
        return next((e for e in self.elements if e.name == name), None)


def parse_header(start: bytes) -> Header:
    """Parse the header at the start of a PLY file.

    Args:
        start: the first `HEADER_LIMIT` bytes of the file, or all of it.

    Raises:
        ArtifactError: naming the line that is wrong.
    """
    if not re.match(rb"ply[ \t]*\r?\n", start):
        raise ArtifactError("not a PLY file: the first line is not 'ply'")
    end = _END.search(start)
    if end is None:
        raise ArtifactError("PLY: truncated, or no line 'end_header' in the first MiB")
    lines = start[: end.start()].decode("utf-8", "replace").split("\n")[1:-1]
    order: str | None = None
    elements: list[tuple[str, int, list[Property]]] = []
    comments, taken = [], set[str]()
    for number, line in enumerate((line.rstrip("\r") for line in lines), start=2):
        words = line.split()
        match words:
            case []:
                continue
            case ["comment" | "obj_info", *_]:
                comments.append(line.strip().partition(" ")[2].strip())
            case ["format", name, version]:
                if order is not None or name not in _BYTE_ORDER or version != "1.0":
                    raise _wrong(number, line)
                order = _BYTE_ORDER[name]
            case ["element", name, count]:
                if not re.fullmatch(r"[0-9]{1,18}", count) or name in taken:
                    raise _wrong(number, line)
                taken.add(name)
                elements.append((name, int(count), []))
            case ["property", *rest] if elements:
                columns = elements[-1][2]
                new = _property(rest)
                if new is None:
                    raise _wrong(number, line)
                columns.append(new)
            case _:
                raise _wrong(number, line)
    if order is None:
        raise ArtifactError("PLY header: no line 'format'")
    built = tuple(Element(name, count, tuple(columns)) for name, count, columns in elements)
    for element in built:
        names = [p.name for p in element.properties]
        if len(set(names)) < len(names):
            twice = Counter(names).most_common(1)[0][0]
            raise ArtifactError(f"PLY header: element {element.name} has property {twice} twice")
    return Header(order, built, tuple(comments), end.end())


def _property(words: list[str]) -> Property | None:
    match words:
        case ["list", count, item, name] if count in _TYPES and item in _TYPES:
            return Property(name, "", _TYPES[count], _TYPES[item])
        case [type_, name] if type_ in _TYPES:
            return Property(name, _TYPES[type_])
    return None


def _wrong(number: int, line: str) -> ArtifactError:
    text = line if len(line) <= 80 else line[:77] + "..."
    return ArtifactError(f"PLY header: line {number} makes no sense: {text!r}")
