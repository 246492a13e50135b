"""Tables of a glTF file: its JSON, its buffers (in the file, in other files or data URIs) and accessors."""

from __future__ import annotations

import base64
import struct
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar
from urllib.parse import unquote, unquote_to_bytes

import msgspec
import numpy as np
from msgspec import Meta, Raw, Struct
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError
from alula.stages.reconstruction.formats.source import Source, relative_name

T = TypeVar("T")
Natural = Annotated[int, Meta(ge=0, le=2**48)]
_OBJECTS = 2**20  # of the JSON; each may become up to a kilobyte
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_WIDTH = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_INTEGERS = {5120: ("i1", 127, "i8"), 5121: ("u1", 255, "u8"), 5122: ("<i2", 32767, "i16"),
             5123: ("<u2", 65535, "u16"), 5125: ("<u4", 2**32 - 1, "u32")}  # fmt: skip
FLOAT = "f32"


class Asset(Struct):
    """Program that wrote the file."""

    generator: str = ""
    version: str = ""


class Buffer(Struct, rename="camel"):
    """A run of bytes."""

    byte_length: Natural
    uri: str | None = None


class BufferView(Struct, rename="camel"):
    """A part of a buffer."""

    buffer: Natural
    byte_length: Natural
    byte_offset: Natural = 0
    byte_stride: Natural | None = None
    extensions: dict[str, Raw] = {}


class SparseIndices(Struct, rename="camel"):
    """Rows that a sparse accessor replaces."""

    buffer_view: Natural
    component_type: Natural
    byte_offset: Natural = 0


class SparseValues(Struct, rename="camel"):
    """Values that a sparse accessor puts into these rows."""

    buffer_view: Natural
    byte_offset: Natural = 0


class Sparse(Struct, rename="camel"):
    """Rows that differ from those of the buffer view."""

    count: Natural
    indices: SparseIndices
    values: SparseValues


class Accessor(Struct, rename="camel"):
    """A table of numbers."""

    component_type: Natural
    count: Natural
    type: str
    buffer_view: Natural | None = None
    byte_offset: Natural = 0
    normalized: bool = False
    sparse: Sparse | None = None


class Primitive(Struct, rename="camel"):
    """Unit of drawing; `extensions` are read only where they are known."""

    attributes: dict[str, Natural] = {}
    extensions: dict[str, Raw] = {}
    indices: Natural | None = None
    mode: Natural = 4
    targets: list[Raw] = []


class Mesh(Struct):
    """Primitives."""

    primitives: list[Primitive] = []


class Node(Struct):
    """Transform in the scene: a matrix by columns, or translation, rotation x y z w and scale."""

    name: str = ""
    children: list[Natural] = []
    mesh: Natural | None = None
    skin: Natural | None = None
    matrix: list[float] | None = None
    translation: list[float] | None = None
    rotation: list[float] | None = None
    scale: list[float] | None = None
    extensions: dict[str, Raw] = {}


class Scene(Struct):
    """Root nodes of a scene."""

    nodes: list[Natural] = []


class Document(Struct, rename="camel"):
    """Parts of a glTF file that a splat or a mesh uses."""

    asset: Asset = msgspec.field(default_factory=Asset)
    extensions_required: list[str] = []
    scene: Natural | None = None
    scenes: list[Scene] = []
    nodes: list[Node] = []
    meshes: list[Mesh] = []
    accessors: list[Accessor] = []
    buffer_views: list[BufferView] = []
    buffers: list[Buffer] = []
    animations: list[Raw] = []


@dataclass(frozen=True, slots=True)
class Column:
    """A resolved accessor.

    Attributes:
        stored: shape (N, width), a view of the file wherever it can be.
        kind: `f32`, or the integer, with an `n` behind it when it is normalised.
        largest: the largest code of an integer; also what normalised ones are divided by.
    """

    stored: NDArray[Any]
    kind: str
    largest: int

    @property
    def step(self) -> float:
        """Error bound of a value for rounding or truncation.

        Normalised values are at most 1, so single precision adds an error of 2^-24 when they are written and
        again when they are read.
        """
        if self.kind == FLOAT:
            return 0.0
        return 1.0 / self.largest + 2.0**-23 if self.kind.endswith("n") else 1.0

    def values(self, rows: slice) -> NDArray[Any]:
        """Numbers of some rows: single precision as stored, integers in double."""
        part = self.stored[rows]
        if self.kind == FLOAT:
            return part
        exact = part.astype(np.float64)
        return np.maximum(exact / self.largest, -1.0) if self.kind.endswith("n") else exact

    def saturated(self, rows: slice) -> NDArray[np.bool_]:
        """Mask of the rows with the largest code, for which the true value may be larger."""
        if self.kind == FLOAT:
            return np.zeros(len(self.stored[rows]), np.bool_)
        return (self.stored[rows] == self.largest).any(axis=1)  # type: ignore[no-any-return]


class Tables:
    """A parsed file: its document and the tables in it.

    Attributes:
        document: what a splat or a mesh uses of it.
    """

    def __init__(self, source: Source) -> None:
        self._source = source
        self.notes: list[str] = []
        self.text, self._binary = self._container(source.data)
        text = self.text
        if text.count(b"{") > _OBJECTS:
            raise ArtifactError(f"glTF: more than {_OBJECTS} JSON objects")
        try:
            self.document = msgspec.json.decode(text, type=Document)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise ArtifactError(f"glTF: JSON: {error}") from error
        except RecursionError as error:
            raise ArtifactError("glTF: JSON: nested too deeply") from error
        self._buffers: dict[int, memoryview] = {}
        if not self.document.asset.version.startswith("2."):
            raise ArtifactError(
                f"glTF: version {self.document.asset.version[:20]!r} is not 2.0, the only one that is read"
            )

    def _container(self, data: memoryview) -> tuple[bytes, memoryview | None]:
        """Split the file into its JSON and the binary chunk of a GLB."""
        if bytes(data[:4]) != b"glTF":
            return bytes(data).removeprefix(b"\xef\xbb\xbf"), None
        if len(data) < 20:
            raise ArtifactError("glTF: truncated: a GLB has a header of 12 bytes and a chunk")
        version, length = struct.unpack_from("<2I", data, 4)
        if version != 2:
            raise ArtifactError(f"glTF: GLB of version {version}; only version 2 is read")
        if length > len(data):
            raise ArtifactError(
                f"glTF: truncated: the header announces {length} bytes, there are {len(data)}"
            )
        if length < len(data):
            self.notes.append(f"{len(data) - length} bytes follow the GLB; they were not read")
        chunks: list[tuple[int, memoryview]] = []
        at = 12
        while at + 8 <= length and len(chunks) < 2:
            size, kind = struct.unpack_from("<2I", data, at)
            if size > length - at - 8:
                raise ArtifactError(
                    f"glTF: truncated: a chunk announces {size} bytes, there are {length - at - 8}"
                )
            chunks.append((kind, data[at + 8 : at + 8 + size]))
            at += 8 + size
        if not chunks or chunks[0][0] != _JSON:
            raise ArtifactError("glTF: the first chunk of the GLB is not JSON")
        return bytes(chunks[0][1]), chunks[1][1] if len(chunks) > 1 and chunks[1][0] == _BIN else None

    @property
    def size(self) -> int:
        """Bytes of all buffers opened so far; a valid file has at least one byte per Gaussian."""
        return sum(map(len, self._buffers.values()))

    def external(self, index: int) -> str | None:
        """Name of the file that holds a buffer; None when the buffer is inside this file.

        Raises:
            ArtifactError: there is no such buffer, or its URI is not a file of the same folder.
        """
        uri = item(self.document.buffers, index, "buffer").uri
        if uri is None or uri[:5].lower() == "data:":
            return None
        try:
            return str(relative_name(unquote(uri)))
        except ArtifactError as error:
            raise ArtifactError(f"glTF: buffer {index}: {error}") from error

    def buffer(self, index: int) -> memoryview:
        """Bytes of a buffer.

        Raises:
            ArtifactError: the buffer is missing or shorter than announced.
        """
        if index not in self._buffers:
            announced = item(self.document.buffers, index, "buffer")
            name = self.external(index)
            if name is not None:
                try:
                    data = self._source.member(name)
                except ArtifactError as error:
                    raise ArtifactError(f"glTF: buffer {index}: {error}") from error
            elif announced.uri is not None:
                data = memoryview(_from_data_uri(announced.uri, index))
            elif index == 0 and self._binary is not None:
                data = self._binary
            else:
                raise ArtifactError(f"glTF: buffer {index} has no URI and there is no binary chunk")
            if len(data) < announced.byte_length:
                raise ArtifactError(
                    f"glTF: truncated: buffer {index} announces {announced.byte_length} bytes, "
                    f"there are {len(data)}"
                )
            self._buffers[index] = data[: announced.byte_length]
        return self._buffers[index]

    def views_of(self, index: int) -> list[int]:
        """Buffer views that an accessor reads."""
        accessor = item(self.document.accessors, index, "accessor")
        views = [] if accessor.buffer_view is None else [accessor.buffer_view]
        if accessor.sparse is not None:
            views += [accessor.sparse.indices.buffer_view, accessor.sparse.values.buffer_view]
        return views

    def column(self, index: int, what: str, types: tuple[str, ...], kinds: tuple[str, ...]) -> Column:
        """Table of an accessor.

        Args:
            types: allowed types, such as `VEC3`.
            kinds: allowed kinds of components, such as `f32` or `u8n`.

        Raises:
            ArtifactError: the table is of another type, out of range or damaged.
        """
        accessor = item(self.document.accessors, index, f"{what}: accessor")
        if accessor.type not in types:
            raise ArtifactError(f"glTF: {what} is {accessor.type[:20]!r}, not {' or '.join(types)}")
        if accessor.component_type == 5126:
            dtype, largest, kind = "<f4", 0, FLOAT
        else:
            dtype, largest, kind = _INTEGERS.get(accessor.component_type, ("", 0, ""))
            kind += "n" if accessor.normalized else ""
        if kind not in kinds:
            name = kind or f"component type {accessor.component_type}"
            raise ArtifactError(f"glTF: {what} is {name}, not {' or '.join(kinds)}")
        width = _WIDTH[accessor.type]
        if accessor.buffer_view is not None:
            place = (accessor.buffer_view, accessor.byte_offset)
            stored = self._rows(place, accessor.count, dtype, width, what)
        elif accessor.sparse is None:
            raise ArtifactError(f"glTF: {what}: accessor {index} has no buffer view (compressed?)")
        else:
            self._rows((accessor.sparse.values.buffer_view, 0), 0, dtype, width, what)  # opens its buffer
            if accessor.count > self.size:
                raise ArtifactError(f"glTF: {what}: {accessor.count} rows in {self.size} bytes")
            stored = np.zeros((accessor.count, width), dtype)
        if accessor.sparse is not None:
            stored = self._replaced(stored, accessor.sparse, dtype, what)
        return Column(stored, kind, largest)

    def _replaced(self, stored: NDArray[Any], sparse: Sparse, dtype: str, what: str) -> NDArray[Any]:
        code = _INTEGERS.get(sparse.indices.component_type, ("", 0, ""))[0]
        if code not in ("u1", "<u2", "<u4"):
            raise ArtifactError(f"glTF: {what}: sparse indices are not unsigned integers")
        place = (sparse.indices.buffer_view, sparse.indices.byte_offset)
        rows = self._rows(place, sparse.count, code, 1, what)[:, 0]
        place = (sparse.values.buffer_view, sparse.values.byte_offset)
        values = self._rows(place, sparse.count, dtype, stored.shape[1], what)
        if len(rows) and int(rows.max()) >= len(stored):
            raise ArtifactError(f"glTF: {what}: sparse index {rows.max()} of {len(stored)} rows")
        stored = stored.copy()
        stored[rows] = values
        return stored

    def _rows(self, place: tuple[int, int], count: int, dtype: str, width: int, what: str) -> NDArray[Any]:
        """Strided view of `count` rows at an offset in a buffer view, after a check of the bounds."""
        view = item(self.document.buffer_views, place[0], f"{what}: buffer view")
        packed = [name for name in view.extensions if "compression" in name]
        if packed:
            raise ArtifactError(f"glTF: {what}: compressed by {packed[0][:100]}, which is not supported")
        buffer = self.buffer(view.buffer)
        if view.byte_offset + view.byte_length > len(buffer):
            raise ArtifactError(
                f"glTF: truncated: buffer view {place[0]} ends at {view.byte_offset + view.byte_length} "
                f"of {len(buffer)} bytes"
            )
        size = np.dtype(dtype).itemsize * width
        stride = size if view.byte_stride is None else view.byte_stride
        if stride < size:
            raise ArtifactError(f"glTF: {what}: a stride of {stride} bytes for rows of {size}")
        end = place[1] + (count - 1) * stride + size if count else 0
        if end > view.byte_length:
            raise ArtifactError(
                f"glTF: truncated: {what}: {count} rows end at byte {end} of {view.byte_length}"
            )
        strides = (stride, np.dtype(dtype).itemsize)
        start = view.byte_offset + (place[1] if count else 0)
        return np.ndarray((count, width), dtype, buffer, start, strides)


def item(items: list[T], index: int, what: str) -> T:
    """Element of a list of the document.

    Raises:
        ArtifactError: the list has fewer elements.
    """
    if index >= len(items):
        raise ArtifactError(f"glTF: {what} {index} does not exist; there are {len(items)}")
    return items[index]


def _from_data_uri(uri: str, index: int) -> bytes:
    head, comma, body = uri.partition(",")
    if not comma:
        raise ArtifactError(f"glTF: buffer {index}: a data URI without a comma")
    if not head.lower().endswith(";base64"):
        return unquote_to_bytes(body)
    try:
        return base64.b64decode(body, validate=True)
    except ValueError as error:
        raise ArtifactError(f"glTF: buffer {index}: not base64: {error}") from error
