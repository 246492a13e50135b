"""Tiles of an onboard map: one whole map per tile, in which all that is not loaded is an obstacle."""

from __future__ import annotations

import hashlib
import math
import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.parts import Parts
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.artifacts.tiles import (
    MOST_TILES,
    TILES_SCHEMA,
    TILES_VERSION,
    Tile,
    TilesIndex,
    merkle_root,
)
from alula.schemas.errors import InfeasibleError
from alula.stages.compression.onboard.cost import ASSUMED
from alula.stages.compression.onboard.hull_records import HullRecords
from alula.stages.compression.onboard.image import (
    HEADER,
    HEADER_BYTES,
    HULL_BYTES,
    KDOP,
    KDOP_PLANE_BYTES,
    PLANE_BYTES,
    MapImage,
    decode_map,
)
from alula.stages.compression.onboard.layout import with_records

_WALL = struct.Struct("<6h2B")
_Rows = NDArray[np.int64]


def voxels_up(length_m: float, voxel_size_m: float) -> int:
    """Number of voxels that are at least as long as a length, at least one."""
    return max(1, math.ceil(round(length_m / voxel_size_m, 6)))


def cut_tiles(
    cover: Parts,
    keep: Callable[[bytes], object],
    *,
    tile_m: float,
    reach_m: float,
    hysteresis_m: float,
    largest_normal: int,
    cover_sha256: str = "",
    jobs: int = 0,
) -> dict[str, Any]:
    """Cut the onboard map of a cover into columns along x and y.

    Lengths are rounded up to whole voxels. The region of a tile is the tile grown by the hysteresis; at the
    rim it has no end. Its image holds, with the bytes and in the order of the whole map, each hull with a box
    that meets the region grown by the reach along x and y, and after these at most four walls: the box of all
    hulls without the region grown by the reach.

    Guarantee: each hull of the cover lies in a hull or a wall of each image, exactly, in integers, so each
    image alone is an onboard map of the whole cover. At a position in the region, psi_h > reach for hulls
    that are not in the image and for walls.

    Memory holds 16 bytes per hull of the whole, the parts within reach of the tile at work, and no image but
    its own.

    Args:
        cover: an `alula/cover`, alone or in parts.
        keep: called with the image of each tile, in the order of the index.
        hysteresis_m: see above; at most half of a tile [m].

    Returns:
        The index without `key_id` and `provenance`, see `TilesIndex`.

    Raises:
        InfeasibleError: there would be too many tiles, or as `encode_map`.
        InputError, ArtifactError: as `encode_map`; or the cover has no hulls.
    """
    hulls = HullRecords(cover, largest_normal, cover_sha256, jobs)
    size = hulls.frame.voxel_size_m
    edge, reach = voxels_up(tile_m, size), voxels_up(reach_m, size)
    hysteresis = voxels_up(hysteresis_m, size)
    if 2 * hysteresis > edge:
        raise InfeasibleError(
            f"a tile of {edge} voxels is too small for a hysteresis of {hysteresis} on each side; take larger"
            " tiles"
        )
    lower, upper = hulls.frame.low, hulls.frame.high
    first = [int(low) // edge for low in lower[:2]]
    count = [(int(high) - 1) // edge - start + 1 for start, high in zip(first, upper[:2], strict=True)]
    if count[0] * count[1] > MOST_TILES:
        raise InfeasibleError(f"{count[0]} x {count[1]} tiles are more than {MOST_TILES}; take larger tiles")
    tiles = []
    for j in range(first[1], first[1] + count[1]):
        for i in range(first[0], first[0] + count[0]):
            low = np.array([edge * i, edge * j], np.int64) - hysteresis - reach
            high = low + edge + 2 * (hysteresis + reach)
            kept = hulls.within(low, high)
            walls = walls_around(low, high, lower, upper)
            boxes = (wall - np.tile(hulls.frame.origin, 2) for wall in walls)
            parts = [*kept, *(_WALL.pack(*box.tolist(), 0, 0) for box in boxes)]
            raw = with_records(hulls.empty, parts, indexed=True)
            keep(raw)
            tiles.append(
                Tile(
                    i=i,
                    j=j,
                    bytes=len(raw),
                    crc32=zlib.crc32(raw),
                    sha256=hashlib.sha256(raw).hexdigest(),
                    hulls=len(kept),
                    walls=len(walls),
                )
            )
    return {
        "schema": TILES_SCHEMA,
        "version": TILES_VERSION,
        "voxel_size_m": size,
        "tile": edge,
        "reach": reach,
        "hysteresis": hysteresis,
        "first": first,
        "count": count,
        "lower": lower.tolist(),
        "upper": upper.tolist(),
        "cover_hash": (bytes.fromhex(cover_sha256)[:8].ljust(8, b"\0")).hex(),
        "merkle_root": merkle_root(tiles),
        "tiles": tiles,
    }


def sealed(cut: dict[str, Any], *, key_id: str, provenance: Provenance) -> TilesIndex:
    """Complete the index of a map that was cut.

    Args:
        cut: index of the map that was cut, see `cut_tiles`.
        key_id: of the key that signs it; empty without a signature.
    """
    open_index = TilesIndex(**cut, sha256=64 * "0", key_id=key_id, provenance=provenance)
    digest = hashlib.sha256(open_index.binary()).hexdigest()
    return TilesIndex(**cut, sha256=digest, key_id=key_id, provenance=provenance)


def walls_around(low: _Rows, high: _Rows, lower: _Rows, upper: _Rows) -> _Rows:
    """The box of all hulls without a column, as boxes; those of x and of y overlap at the corners.

    A hull with a box that does not meet the column lies beyond one of its four sides, and so in one wall.

    Args:
        low: lower ends of the column along x and y, shape (2,); it meets the box.
        high: upper ends, shape (2,).
        lower: lower corner of the box, shape (3,).
        upper: upper corner, shape (3,).

    Returns:
        Lower and upper corners, shape (n, 6) with n at most 4.
    """
    walls = []
    for axis in (0, 1):
        if low[axis] > lower[axis]:
            end = upper.copy()
            end[axis] = low[axis]
            walls.append(np.concatenate([lower, end]))
        if high[axis] < upper[axis]:
            start = lower.copy()
            start[axis] = high[axis]
            walls.append(np.concatenate([start, upper]))
    return np.array(walls, np.int64).reshape(-1, 6)


def tiles_facts(index: TilesIndex) -> dict[str, Any]:
    """Summary figures of a map in tiles."""
    sizes = [tile.bytes for tile in index.tiles]
    return {
        "tiles": len(index.tiles),
        "tiles_x": index.count[0],
        "tiles_y": index.count[1],
        "tile_m": index.tile_m,
        "reach_m": index.reach_m,
        "hysteresis_m": index.hysteresis_m,
        "most_hulls": max(tile.hulls for tile in index.tiles),
        "largest_image_bytes": max(sizes),
        "two_images_bytes": 2 * max(sizes),
        "image_bytes": sum(sizes),
        "index_bytes": len(index.binary()),
        "merkle_root": index.merkle_root,
        "key_id": index.key_id or None,
    }


def fastest_m_s(image: bytes, reach_m: float) -> float:
    """Highest speed at which commands of polytope-cbf do not depend on hulls beyond a reach [m/s].

    The parameters are `ASSUMED`, apart from the speed.

    Args:
        reach_m: reach of the tiles [m].

    Returns:
        The speed; 0 where there is none.
    """
    extent_m = decode_map(image).extent_m

    def needed_m(speed_m_s: float) -> float:
        return _core.PolytopeCbf.from_image(
            image, extent_m=extent_m, **ASSUMED | {"v_max": speed_m_s}
        ).reach_m

    slow, fast = needed_m(1.0), needed_m(2.0)  # affine in the speed
    return max(0.0, 1.0 + (reach_m - slow) / (fast - slow))


def _records(raw: bytes, image: MapImage) -> list[bytes]:
    """Bytes of each hull's record."""
    is_kdop = bool(HEADER.unpack_from(raw)[4] & KDOP)
    sizes = HULL_BYTES + (KDOP_PLANE_BYTES if is_kdop else PLANE_BYTES) * np.diff(image.plane_start)
    ends = HEADER_BYTES + np.cumsum(sizes)
    return [raw[end - size : end] for size, end in zip(sizes.tolist(), ends.tolist(), strict=True)]
