"""PlayCanvas's compressed `.ply`: four words a Gaussian, scaled by the range of its chunk of 256."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifacts.provenance import MARK
from alula.schemas.errors import ArtifactError
from alula.schemas.progress import Progress
from alula.stages.reconstruction.formats.ply import COMMENT_LIMIT, check_harmonics, check_room, tags_of
from alula.stages.reconstruction.formats.ply_header import HEADER_LIMIT, Element, Header, parse_header
from alula.stages.reconstruction.formats.properties import ELEMENTS, judged
from alula.stages.reconstruction.formats.rotations import chart_rotation_error, smallest_three
from alula.stages.reconstruction.formats.source import Source
from alula.stages.reconstruction.formats.splats import (
    SH_C0,
    Loss,
    Properties,
    Splats,
    color_from_sh0,
    exp,
    growth,
    loss_bound,
)

CHUNK = 256  # Gaussians that share a range
_BLOCK = 2**8 * CHUNK  # Gaussians decoded at a time
_POSITION = ("x", "y", "z")
_SCALE = ("scale_x", "scale_y", "scale_z")
_COLOR = ("r", "g", "b")
_WORDS = ("packed_position", "packed_rotation", "packed_scale", "packed_color")
_SH_COLUMNS = (9, 24, 45)
_LEVELS = np.array([2047.0, 1023.0, 2047.0])  # 11, 10 and 11 bits
_LARGEST_LOG_SCALE = 20.0  # writers clamp larger values

# Writers round codes (PlayCanvas) or truncate them (early gsply), so the error of a value is up to a whole
# step; single precision of the codes adds up to 4e-4 of a step. Values inside a range below 1e-5 are written
# as its lower end.
_STEP = 1.001
_NO_RANGE = 1e-5
ROTATION_STEP = _STEP * math.sqrt(2.0) / 1023.0
OPACITY_LOSS = 1.0 / 255.0
_SINGLE = 2.0**-24  # half a unit in the last place: the rounding error of decoding


def is_compressed_ply(source: Source) -> bool:
    """Test whether a file has the header of a compressed PLY."""
    if not source.head.startswith(b"ply"):
        return False
    try:
        header = parse_header(bytes(source.data[:HEADER_LIMIT]))
    except ArtifactError:
        return False
    vertex = header.element("vertex")
    return vertex is not None and vertex.column("packed_position") is not None


def decode_compressed_ply(buffer: memoryview, progress: Progress | None = None) -> Splats:
    """Decode a compressed PLY file.

    Positions and log scales have 11, 10 and 11 bits within the ranges of the chunk, rotations three
    components of 10 bits, colours and alpha 8 bits each. With b bits in a range [l, h] a value is
    l (1 - t) + h t, t = code / (2^b - 1). So the error per axis of the chunk is at most
    d = (h - l) / (2^b - 1): |d| for the centre, exp(max d) - 1 for a semi-axis. The format clamps log scales
    above 20; Gaussians that may be affected are counted.

    Raises:
        ArtifactError: not a compressed PLY, truncated, or a range is invalid.
    """
    header = parse_header(bytes(buffer[:HEADER_LIMIT]))
    chunk, vertex = _elements(header)
    tables, trailing = _tables(header, buffer)
    words = {name: tables["vertex"][name] for name in _WORDS}
    position = _Range.read(tables["chunk"], _POSITION)
    scales = _Range.read(tables["chunk"], _SCALE)
    colors = _Range.read(tables["chunk"], _COLOR) if chunk.column("min_r") is not None else None

    count = vertex.count
    mean, scale = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    quat, color = np.empty((count, 4), np.float32), np.empty((count, 3), np.uint8)
    opacity, turn = np.empty(count, np.float32), np.empty(count)
    clamped = 0
    with np.errstate(over="ignore", under="ignore"):
        for start in range(0, count, _BLOCK):
            part = slice(start, min(start + _BLOCK, count))
            owner = np.arange(part.start, part.stop) // CHUNK
            mean[part] = position.values(words["packed_position"][part], owner)
            scale[part] = exp(scales.values(words["packed_scale"][part], owner))
            clamped += int(scales.at_limit(words["packed_scale"][part], owner).sum())
            stored, largest = _rotation(words["packed_rotation"][part])
            quat[part] = smallest_three(stored, largest)
            turn[part] = chart_rotation_error(stored, math.sqrt(3.0) * ROTATION_STEP)
            rgba = words["packed_color"][part, None] >> np.array([24, 16, 8, 0], np.uint32) & np.uint32(255)
            shade = rgba[:, :3] / 255.0
            if colors is not None:
                shade = colors.lower[owner] * (1.0 - shade) + colors.upper[owner] * shade
            color[part] = color_from_sh0((shade - 0.5) / SH_C0)
            opacity[part] = rgba[:, 3] / 255.0
            if progress is not None:
                progress(part.stop, count)
        per_chunk = np.repeat(
            np.stack([position.distance(), growth(scales.step().max(axis=1) + 4.0 * _SINGLE)], axis=1),
            CHUNK,
            axis=0,
        )[:count]
        bound = loss_bound(count, position=per_chunk[:, 0], scale=per_chunk[:, 1], rotation=turn)

    unknown = judged(item.name for item in vertex.properties if item.name not in _WORDS)
    notes, unbounded = [], {}
    if clamped:
        unbounded["scale"] = f"log scales are cut off at 20 in this format, which {clamped} Gaussians have"
    if trailing:
        notes.append(f"{trailing} bytes follow the data that the header announces; they were not read")
    comments = [c for c in header.comments if MARK not in c]
    return Splats(
        format="compressed-ply",
        mean=mean,
        scale=scale,
        quat_wxyz=quat,
        opacity=opacity,
        color=color,
        loss=Loss(bound, OPACITY_LOSS, unbounded),
        comments=tuple(c[:500] for c in comments[:COMMENT_LIMIT]),
        tags=tags_of(comments),
        notes=tuple(notes),
        properties=Properties(unknown=unknown),
    )


class _Range:
    """Ranges of three quantities, one row per chunk."""

    def __init__(self, lower: NDArray[np.float64], upper: NDArray[np.float64]) -> None:
        self.lower = lower
        self.upper = upper

    @classmethod
    def read(cls, rows: NDArray[np.void], names: tuple[str, ...]) -> _Range:
        with np.errstate(invalid="ignore"):  # signalling NaNs
            lower, upper = (
                np.stack([rows[f"{end}_{name}"].astype(np.float64) for name in names], axis=1)
                for end in ("min", "max")
            )
        wrong = ~(np.isfinite(lower) & np.isfinite(upper) & (lower <= upper))
        if wrong.any():
            row, axis = (int(i) for i in np.argwhere(wrong)[0])
            raise ArtifactError(
                f"compressed PLY: chunk {row} has {names[axis]} from {lower[row, axis]:g} to "
                f"{upper[row, axis]:g}, which is no range"
            )
        return cls(lower, upper)

    def values(self, words: NDArray[np.uint32], owner: NDArray[np.intp]) -> NDArray[np.float64]:
        """Quantities of packed words, shape (n, 3); `owner` holds the chunk of each word."""
        t = _codes(words) / _LEVELS
        values: NDArray[np.float64] = self.lower[owner] * (1.0 - t) + self.upper[owner] * t
        return values

    def at_limit(self, words: NDArray[np.uint32], owner: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Mask of the quantities with the largest code where that code means the largest log scale."""
        found: NDArray[np.bool_] = (
            (_codes(words) == _LEVELS) & (self.upper[owner] >= _LARGEST_LOG_SCALE)
        ).any(axis=1)
        return found

    def step(self) -> NDArray[np.float64]:
        """Error bounds of the quantities of each chunk, shape (C, 3)."""
        extent = self.upper - self.lower
        return np.where(extent < _NO_RANGE, extent, extent / _LEVELS * _STEP)

    def distance(self) -> NDArray[np.float64]:
        """Error bounds of the points of each chunk, with the rounding to single precision, shape (C,)."""
        largest = np.maximum(np.abs(self.lower), np.abs(self.upper))
        distance: NDArray[np.float64] = np.linalg.norm(self.step() + largest * _SINGLE, axis=1)
        return distance


def _codes(words: NDArray[np.uint32]) -> NDArray[np.uint32]:
    codes: NDArray[np.uint32] = np.stack([words >> 21, words >> 11 & 1023, words & 2047], axis=1)
    return codes


def _rotation(words: NDArray[np.uint32]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Three stored components, and the index of the missing one in w, x, y, z."""
    fields = words[:, None] >> np.array([20, 10, 0], np.uint32) & np.uint32(1023)
    return (fields / 1023.0 - 0.5) * math.sqrt(2.0), (words >> 30).astype(np.intp)


def _elements(header: Header) -> tuple[Element, Element]:
    """Elements of the chunks and of the Gaussians, after a check of their properties."""
    chunk, vertex, sh = (header.element(name) for name in ("chunk", "vertex", "sh"))
    if chunk is None or vertex is None or vertex.column("packed_position") is None:
        raise ArtifactError("compressed PLY: needs elements chunk and vertex with packed_position")
    if header.order != "<":
        raise ArtifactError("compressed PLY: must be binary_little_endian")
    colors = [f"{end}_{name}" for end in ("min", "max") for name in _COLOR]
    needed = [f"{end}_{name}" for end in ("min", "max") for name in (*_POSITION, *_SCALE)]
    if any(chunk.column(name) is not None for name in colors):
        needed += colors
    _check_columns(chunk, needed, "f4")
    _check_columns(vertex, _WORDS, "u4")
    judged((e.name for e in header.elements if e not in (chunk, vertex, sh)), "element", ELEMENTS)
    if vertex.count == 0:
        raise ArtifactError("compressed PLY: has no Gaussians (element vertex 0)")
    chunks = -(-vertex.count // CHUNK)
    if chunk.count != chunks:
        raise ArtifactError(
            f"compressed PLY: {vertex.count} Gaussians have {chunks} chunks of {CHUNK}, not {chunk.count}"
        )
    if sh is not None:
        if sh.count != vertex.count:
            raise ArtifactError(
                f"compressed PLY: {sh.count} rows of sh for {vertex.count} Gaussians; both must be as many"
            )
        names = [item.name for item in sh.properties]
        check_harmonics(names)
        if len(names) not in _SH_COLUMNS or any(item.type != "u1" for item in sh.properties):
            raise ArtifactError("compressed PLY: element sh must have 9, 24 or 45 properties uchar")
    return chunk, vertex


def _check_columns(element: Element, names: tuple[str, ...] | list[str], type_: str) -> None:
    for name in names:
        item = element.column(name)
        if item is None:
            raise ArtifactError(f"compressed PLY: property {name} of {element.name} is missing")
        if item.type != type_:
            words = {"f4": "float", "u4": "uint"}
            raise ArtifactError(
                f"compressed PLY: property {name} of {element.name} is not of type {words[type_]}"
            )


def _tables(header: Header, buffer: memoryview) -> tuple[dict[str, NDArray[np.void]], int]:
    """Rows of all elements by name, as views of the file, and the number of bytes after them."""
    tables: dict[str, NDArray[np.void]] = {}
    at = header.data_start
    for element in header.elements:
        if element.has_lists:
            raise ArtifactError(f"compressed PLY: element {element.name} has lists; its size is unknown")
        check_room(element, element.row_size, len(buffer) - at)
        if element.count and element.row_size:
            dtype = np.dtype([(item.name, header.order + item.type) for item in element.properties])
            tables[element.name] = np.frombuffer(buffer, dtype, element.count, at)
        at += element.count * element.row_size
    return tables, len(buffer) - at
