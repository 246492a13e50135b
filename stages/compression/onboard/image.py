"""Image of an onboard map: decodes its header and records, without the code that encodes them.

The layout is that of native/onboard/include/alula_map.h.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError, DamagedError, VersionError, WrongKindError

SCHEMA, VERSION = "alula/onboard-map", "1.0"
MAGIC = b"ALMP"
# magic, major, minor, header bytes, flags, largest normal, zero, hulls, image bytes, CRC-32 of the body,
# origin, g in single and double precision, margin, hash of the cover; then the CRC-32 of all these.
HEADER = struct.Struct("<4s2B2H2B3I3ifdf8s")
HEADER_BYTES, HULL_BYTES, PLANE_BYTES, KDOP_PLANE_BYTES = 64, 14, 5, 2
KDOP, INDEXED = 1, 2
NODE_BYTES, FANOUT = 12, 4  # of the index
MARGIN_OF_EXTENT = 2.0**-18  # 64 roundings; derived in alula_map.h
DIRECTIONS = np.array([n for n in product((-1, 0, 1), repeat=3) if np.count_nonzero(n) >= 2], np.int32)

_RECORD = struct.Struct("<6h2B")


@dataclass(frozen=True, slots=True)
class MapImage:
    """A decoded map: hull h is {x : lower <= x <= upper, normal . x <= offset}, in units of g.

    Attributes:
        voxel_size_m: edge of a voxel g [m].
        voxel_size_f32_m: g in single precision, as the onboard reader uses it [m].
        margin_m: distance that the reader subtracts from its result within `extent_m` [m].
        is_kdop: planes are stored as numbers of directions.
        cover_hash: first 8 bytes of the SHA-256 of the cover's file; zeros when unknown.
        image_bytes: length of the image; further bytes of a file are not part of it.
        index_bytes: length of the index after the records.
        lower: lower corners of the boxes, shape (n, 3).
        upper: upper corners of the boxes, shape (n, 3).
        normal: normals of the oblique planes, shape (K, 3).
        offset: offsets of the oblique planes, shape (K,).
        plane_start: first oblique plane of each hull and the end, shape (n + 1,).
    """

    voxel_size_m: float
    voxel_size_f32_m: float
    margin_m: float
    is_kdop: bool
    cover_hash: bytes
    image_bytes: int
    index_bytes: int
    lower: NDArray[np.int32]
    upper: NDArray[np.int32]
    normal: NDArray[np.int32]
    offset: NDArray[np.int64]
    plane_start: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.lower)

    @property
    def extent_m(self) -> float:
        """Maximum absolute coordinate for which the margin is sufficient [m]."""
        return self.margin_m / MARGIN_OF_EXTENT

    @property
    def half_planes(self) -> int:
        """Number of half-spaces: six faces of each box, and the oblique planes."""
        return 6 * len(self) + len(self.offset)


def is_map(raw: bytes) -> bool:
    """Test whether a file begins like an onboard map.

    Args:
        raw: at least its first 4 bytes.
    """
    return raw.startswith(MAGIC)


def decode_map(raw: bytes) -> MapImage:
    """Decode an image.

    Args:
        raw: the image; other bytes may follow it.

    Raises:
        WrongKindError: these are not the bytes of an onboard map.
        VersionError: the layout is newer than this version.
        DamagedError: the image is truncated, or a CRC-32, a length or a record is wrong.
    """
    if not is_map(raw):
        raise WrongKindError("is not an onboard map")
    if len(raw) < HEADER_BYTES:
        raise DamagedError("truncated in the header of an onboard map")
    _, major, minor, header_bytes, flags, largest, zero, hulls, total, body_crc, *rest = HEADER.unpack_from(
        raw
    )
    origin, (size_f32, size, margin, cover_hash) = rest[:3], rest[3:]
    if major != 1:
        raise VersionError(f"{SCHEMA} version {major}.{minor} is newer than {VERSION}; update alula")
    if zlib.crc32(raw[: HEADER.size]) != int.from_bytes(raw[HEADER.size : HEADER_BYTES], "little"):
        raise DamagedError("the header of the onboard map does not match its CRC-32")
    if flags & ~(KDOP | INDEXED):
        raise VersionError(f"the onboard map needs features {flags:#x} that this version lacks; update alula")
    limit = 1 if flags & KDOP else 127
    if header_bytes != HEADER_BYTES or total < HEADER_BYTES or zero != 0 or not 1 <= largest <= limit:
        raise DamagedError("the header of the onboard map contradicts itself")
    if total > len(raw):
        raise DamagedError(f"truncated: {len(raw)} bytes of an onboard map of {total}")
    if zlib.crc32(raw[HEADER_BYTES:total]) != body_crc:
        raise DamagedError("the onboard map does not match its CRC-32")
    plausible = 1e-6 <= size <= 1e5 and size_f32 == np.float32(size)
    if not plausible or not size_f32 <= margin / MARGIN_OF_EXTENT <= 1e12:
        raise DamagedError("the onboard map has an impossible voxel size or margin")
    boxes, counts, shifts, starts, end = _records(raw, hulls, total, bool(flags & KDOP))
    if flags & INDEXED:
        _check_index(raw[end:total], boxes.reshape(-1, 2, 3), starts - HULL_BYTES)
    elif end != total:
        raise DamagedError(f"the onboard map has {total - end} bytes after its records")
    lower, upper = (boxes.reshape(-1, 2, 3)[:, i] + np.array(origin, np.int64) for i in (0, 1))
    if (lower >= upper).any() or max(abs(lower).max(initial=0), abs(upper).max(initial=0)) > 2**23:
        raise DamagedError("a hull of the onboard map has an impossible box")
    normal, depth = _planes(raw, counts, starts, bool(flags & KDOP))
    plane_start = np.concatenate([[0], np.cumsum(counts)])
    hull = np.repeat(np.arange(hulls), counts)
    depth <<= shifts[hull]
    # {x : normal . (x - corner) <= -depth}, corner the farthest of the box along the normal
    reach = (normal * np.where(normal > 0, upper[hull], lower[hull])).sum(axis=1)
    span = (np.abs(normal) * (upper - lower)[hull]).sum(axis=1)
    oblique = np.count_nonzero(normal, axis=1) >= 2
    if not (
        oblique & (np.abs(normal).max(axis=1, initial=0) <= largest) & (depth > 0) & (depth < span)
    ).all():
        raise DamagedError("a plane of the onboard map has an impossible normal or depth")
    return MapImage(
        voxel_size_m=size,
        voxel_size_f32_m=size_f32,
        margin_m=margin,
        is_kdop=bool(flags & KDOP),
        cover_hash=cover_hash,
        image_bytes=total,
        index_bytes=total - end,
        lower=lower.astype(np.int32),
        upper=upper.astype(np.int32),
        normal=normal.astype(np.int32),
        offset=reach - depth,
        plane_start=plane_start,
    )


def _records(
    raw: bytes, hulls: int, total: int, is_kdop: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], int]:
    """Boxes, counts of planes, shifts, first byte of the planes of each hull, and the end of the records."""
    per_plane = KDOP_PLANE_BYTES if is_kdop else PLANE_BYTES
    if hulls * HULL_BYTES > total - HEADER_BYTES:
        raise DamagedError(f"the onboard map is too short for {hulls} hulls")
    rows, starts, at = [], [], HEADER_BYTES
    for _ in range(hulls):
        if at + HULL_BYTES > total:
            raise DamagedError("a hull of the onboard map reaches beyond its end")
        row = _RECORD.unpack_from(raw, at)
        rows.append(row)
        starts.append(at + HULL_BYTES)
        at += HULL_BYTES + per_plane * row[6]
    if at > total:
        raise DamagedError("a hull of the onboard map reaches beyond its end")
    table = np.array(rows, np.int64).reshape(-1, 8)
    if (table[:, 7] > 16).any():
        raise DamagedError("a hull of the onboard map has an impossible shift")
    return table[:, :6], table[:, 6], table[:, 7], np.array(starts, np.int64), at


def _check_index(raw: bytes, boxes: NDArray[np.int64], starts: NDArray[np.int64]) -> None:
    """Check that each node is the union of its children, and that each leaf has the offset of its records."""
    wrong = DamagedError("the index of the onboard map does not fit its records")
    if len(boxes) == 0 or len(raw) < 4 or raw[0] == 0 or raw[2:4] != b"\0\0":
        raise wrong
    leaf_hulls, levels, depth, at, below, width = raw[0], raw[1], 0, 4, boxes, raw[0]
    while depth == 0 or len(below) > 1:
        depth += 1
        first = np.arange(0, len(below), width)
        low = np.minimum.reduceat(below[:, 0], first, axis=0)
        high = np.maximum.reduceat(below[:, 1], first, axis=0)
        end = at + NODE_BYTES * len(first)
        if end > len(raw):
            raise wrong
        below = np.frombuffer(raw[at:end], "<i2").reshape(-1, 2, 3).astype(np.int64)
        if (below[:, 0] != low).any() or (below[:, 1] != high).any():
            raise wrong
        at, width = end, FANOUT
    listed = starts[::leaf_hulls]
    if levels != depth or raw[at:] != listed.astype("<u4").tobytes():
        raise wrong


def _planes(
    raw: bytes, counts: NDArray[np.int64], starts: NDArray[np.int64], is_kdop: bool
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Stored normals and depths of all planes, in order."""
    per_plane = KDOP_PLANE_BYTES if is_kdop else PLANE_BYTES
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    at = np.repeat(starts, counts) + per_plane * number
    byte = np.frombuffer(raw, np.uint8)[at[:, None] + np.arange(per_plane)].astype(np.int64)
    word = byte[:, -2] | byte[:, -1] << 8
    if not is_kdop:
        return byte[:, :3] - 256 * (byte[:, :3] >= 128), word
    if (word & 31 >= len(DIRECTIONS)).any():
        raise DamagedError("a plane of the onboard map has an impossible direction")
    return DIRECTIONS[word & 31].astype(np.int64), word >> 5


def read_map(raw: bytes, name: object) -> MapImage:
    """Decode an image as `decode_map` does, with the file's name in front of every error message.

    Raises:
        ArtifactError: as `decode_map`.
    """
    try:
        return decode_map(raw)
    except ArtifactError as error:
        raise error.reworded(f"{name}: {error}") from error
