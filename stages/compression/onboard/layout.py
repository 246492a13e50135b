"""Layout of an onboard map: encodes a cover as an image that a microcontroller reads in place from flash."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import Manifest
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.errors import ArtifactError, InfeasibleError, InputError
from alula.schemas.progress import Progress
from alula.stages.compression.onboard.image import (
    FANOUT,
    HEADER,
    HEADER_BYTES,
    HULL_BYTES,
    INDEXED,
    KDOP,
    KDOP_PLANE_BYTES,
    MAGIC,
    MARGIN_OF_EXTENT,
    PLANE_BYTES,
    MapImage,
)

LARGEST_NORMAL = 127
_SMALLEST_M, _LARGEST_M = 1e-6, 1e5
_MAX_BYTES, _MAX_HULLS = 2**32 - 1, 2**24
LEAF_HULLS = 4


def encode_map(
    cover: Artifact,
    *,
    largest_normal: int = LARGEST_NORMAL,
    cover_sha256: str = "",
    indexed: bool = False,
    jobs: int = 0,
    progress: Progress | None = None,
) -> bytes:
    """Encode a cover as the image of an onboard map.

    The image has 64 + sum(14 + 5 k) bytes for hulls with k oblique planes; 2 k instead of 5 k where all
    normals are of the 26-DOP family.

    Guarantee: each hull of the map contains the vertices of its hull of the cover, exactly, in integers. The
    boxes are equal, and a plane with a normal that must change gets the integer support over the vertices,
    rounded outward. Layout: native/onboard/include/alula_map.h.

    Args:
        largest_normal: bound of the components of normals; with 1 all planes are of the 26-DOP family.
        cover_sha256: hash of the cover's file, in hexadecimal; its first 8 bytes go into the header.
        indexed: add the tree of boxes that lets a search near a position skip most hulls; it takes
            `index_bytes` more.

    Returns:
        The image.

    Raises:
        InfeasibleError: the cover is wider than 65,535 voxels, or too large for 32-bit lengths.
        InputError: its voxels are smaller than a micrometre or larger than 100 km.
        ArtifactError: a hull has no volume.
    """
    vertex = np.ascontiguousarray(cover["vertex"], np.int32)
    none = np.zeros(3, np.int64)
    low, high = (vertex.min(axis=0), vertex.max(axis=0)) if len(vertex) else (none, none)
    frame = MapFrame.of(cover.manifest, low.astype(np.int64), high.astype(np.int64))
    records, is_kdop, largest = encode_records(cover.arrays, frame, largest_normal, jobs, progress)
    hulls = len(cover["vertex_start"]) - 1
    return frame.image(records, hulls, is_kdop, largest, cover_sha256, indexed=indexed)


def encode_records(
    hulls: Mapping[str, NDArray[Any]],
    frame: MapFrame,
    largest_normal: int,
    jobs: int,
    progress: Progress | None = None,
) -> tuple[bytes, bool, int]:
    """Encode hulls as records, in the order of their centres along a Z-order curve.

    Returns:
        The records, whether all normals are of the 26-DOP family, and the largest component of a normal.

    Raises:
        ArtifactError: a hull has no volume.
    """
    try:
        records, _, is_kdop, largest, _ = _core.encode_map_records(
            np.ascontiguousarray(hulls["vertex"], np.int32),
            np.ascontiguousarray(hulls["vertex_start"], np.int64),
            np.ascontiguousarray(hulls["plane_normal"], np.int64),
            np.ascontiguousarray(hulls["plane_start"], np.int64),
            tuple(frame.origin.tolist()),
            largest_normal,
            jobs,
            progress,
        )
    except ValueError as error:
        raise ArtifactError(f"the cover cannot be encoded: {error}") from error
    return records, is_kdop, largest


@dataclass(frozen=True, slots=True)
class MapFrame:
    """What all records of a map have in common.

    Attributes:
        voxel_size_m: edge of a voxel [m].
        low: lower corner of all hulls [voxels].
        high: upper corner.
    """

    voxel_size_m: float
    low: NDArray[np.int64]
    high: NDArray[np.int64]

    @classmethod
    def of(cls, cover: Manifest, low: NDArray[np.int64], high: NDArray[np.int64]) -> MapFrame:
        """Frame of the map of a cover.

        Args:
            low: lower corner of all hulls [voxels].
            high: upper corner.

        Raises:
            InfeasibleError, InputError: see `encode_map`.
        """
        size = float(cover.voxel_size_m)  # type: ignore[attr-defined]
        if not _SMALLEST_M <= size <= _LARGEST_M:
            raise InputError(f"an onboard map needs voxels of 1e-6 m to 1e5 m, not {size:g} m")
        if (high - low).max() >= 2**16:
            raise InfeasibleError(
                f"the cover is {int((high - low).max())} voxels wide, an onboard map at most {2**16 - 1};"
                " crop the scene or take larger voxels"
            )
        return cls(size, low, high)

    @property
    def origin(self) -> NDArray[np.int64]:
        """Origin of the coordinates of records, so that both ends fit into 16 bits."""
        return (self.low + self.high + 1) // 2

    def image(
        self, records: bytes, hulls: int, is_kdop: bool, largest: int, cover_sha256: str, *, indexed: bool
    ) -> bytes:
        """Image of a map with these records.

        Raises:
            InfeasibleError: there are too many records.
        """
        flags = KDOP * is_kdop
        if indexed and hulls > 0:
            flags |= INDEXED
            records += _index(records, hulls, is_kdop=is_kdop)
        total = HEADER_BYTES + len(records)
        if total > _MAX_BYTES or hulls > _MAX_HULLS:
            raise InfeasibleError(
                f"{hulls} hulls in {total} bytes are too many for an onboard map; merge more"
            )
        extent = max(int(np.abs([self.low, self.high]).max()), 1) * self.voxel_size_m
        head = HEADER.pack(
            MAGIC,
            *(1, 0, HEADER_BYTES, flags, largest, 0),
            *(hulls, total, zlib.crc32(records), *self.origin.tolist()),
            *(np.float32(self.voxel_size_m), self.voxel_size_m, _margin_m(extent)),
            bytes.fromhex(cover_sha256)[:8].ljust(8, b"\0"),
        )
        return head + zlib.crc32(head).to_bytes(4, "little") + records


def with_records(image: bytes, records: Sequence[bytes], *, indexed: bool) -> bytes:
    """Encode a map of other records, with origin, voxel size, margin and kind of planes of a given one.

    Args:
        records: of the hulls, as in an image with its origin and kind of planes.
        indexed: add the tree of boxes.
    """
    fields = list(HEADER.unpack_from(image))
    is_kdop = bool(fields[4] & KDOP)
    body = b"".join(records)
    fields[4] = KDOP * is_kdop
    if indexed and records:
        fields[4] |= INDEXED
        body += _index(body, len(records), is_kdop=is_kdop)
    fields[7:10] = [len(records), HEADER_BYTES + len(body), zlib.crc32(body)]
    head = HEADER.pack(*fields)
    return head + zlib.crc32(head).to_bytes(4, "little") + body


def _index(records: bytes, hulls: int, *, is_kdop: bool) -> bytes:
    """Encode the tree of boxes over the records, in the layout of alula_map.h."""
    per_plane = KDOP_PLANE_BYTES if is_kdop else PLANE_BYTES
    start = np.empty(hulls, np.int64)
    at = 0
    for hull in range(hulls):
        start[hull] = at
        at += HULL_BYTES + per_plane * records[at + 12]
    box = np.frombuffer(records, np.uint8)[start[:, None] + np.arange(12)].copy().view("<i2")
    levels, width = [], LEAF_HULLS
    while True:
        first = np.arange(0, len(box), width)
        lower = np.minimum.reduceat(box[:, :3], first, axis=0)
        box = np.hstack([lower, np.maximum.reduceat(box[:, 3:], first, axis=0)])
        levels.append(box.tobytes())
        width = FANOUT
        if len(box) == 1:
            break
    head = bytes([LEAF_HULLS, len(levels), 0, 0])
    return head + b"".join(levels) + (start[::LEAF_HULLS] + HEADER_BYTES).astype("<u4").tobytes()


def index_bytes(hulls: int) -> int:
    """Size of the index of a map [bytes]; it never decreases with more hulls."""
    size, total = -(-hulls // LEAF_HULLS), 0
    if hulls == 0:
        return 0
    total = 4 + 4 * size + 12 * size
    while size > 1:
        size = -(-size // FANOUT)
        total += 12 * size
    return total


def _margin_m(extent_m: float) -> np.float32:
    """Margin for an extent, rounded up by more than the reader's own rounding errors."""
    margin = np.float32(extent_m * MARGIN_OF_EXTENT)
    for _ in range(4):
        margin = np.nextafter(margin, np.float32(np.inf))
    return margin


def _image(cover: Artifact, provenance: Provenance) -> bytes:
    made_from = [ref.sha256 for ref in provenance.inputs if ref.schema == cover.manifest.schema]
    return encode_map(
        cover,
        largest_normal=int(provenance.parameters.get("largest_normal", LARGEST_NORMAL)),
        cover_sha256=made_from[0] if made_from else "",
        indexed="target" in provenance.parameters,
    )


def map_binary(cover: Artifact, provenance: Provenance) -> Iterator[bytes]:
    """Content of a .bin file: the image, then a line with the provenance, which flash does not need.

    Args:
        provenance: of the file; its parameters set the encoding.
    """
    yield _image(cover, provenance)
    yield f"\n{provenance.line()}\n".encode()


def map_c_header(cover: Artifact, provenance: Provenance) -> Iterator[bytes]:
    """Content of a C header with the image of a cover (see `image_c_header`).

    Args:
        provenance: of the file; its parameters set the encoding and the array's name.
    """
    yield from image_c_header(_image(cover, provenance), provenance)


def image_c_header(image: bytes, provenance: Provenance) -> Iterator[bytes]:
    """Content of a guarded C header with an image as a constant array, aligned to 8 bytes.

    Args:
        provenance: of the file; `name` of its parameters is the array's name.
    """
    name = str(provenance.parameters.get("name", "map"))
    guard, (hulls,) = f"{name.upper()}_H", struct.unpack_from("<I", image, 12)
    yield (
        f"/* An onboard map of {hulls} hulls, {len(image)} bytes; read it with"
        f" alula_map_open(). */\n// {provenance.line()}\n#ifndef {guard}\n#define {guard}\n\n"
        f"#include <stdint.h>\n\n#define {name.upper()}_BYTES {len(image)}U\n\n"
        "#if defined(__GNUC__)\n__attribute__((aligned(8)))\n#endif\n"
        f"static const uint8_t {name}[{name.upper()}_BYTES] = {{\n"
    ).encode()
    for begin in range(0, len(image), 16):
        yield ("    " + ", ".join(f"0x{byte:02X}" for byte in image[begin : begin + 16]) + ",\n").encode()
    yield f"}};\n\n#endif /* {guard} */\n".encode()


def map_facts(image: MapImage) -> dict[str, Any]:
    """Summary figures of a map."""
    return {
        "hulls": len(image),
        "half_planes": image.half_planes,
        "oblique_planes": len(image.offset),
        "image_bytes": image.image_bytes,
        "bytes_per_half_plane": image.image_bytes / max(image.half_planes, 1),
        "directions_only": image.is_kdop,
        "margin_m": image.margin_m,
    }
