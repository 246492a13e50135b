"""Verification of a map in tiles: proves of each tile, from its bytes, that it contains every voxel."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifact import Artifact
from alula.schemas.errors import ArtifactError
from alula.schemas.progress import Progress
from alula.schemas.tiles import Tile, TileFiles, TilesIndex
from alula.stages.compression.onboard.image import MapImage, decode_map
from alula.stages.compression.onboard.verify import files_agree, margin_holds, notes_of, occupied_by
from alula.stages.compression.verify import (
    LISTED,
    Certificate,
    Check,
    Offence,
    _check,
    _position_m,
    _scene_check,
    certificate_of,
)
from alula.stages.progress import share

_Boxes = NDArray[np.int64]


def verify_tiles(
    tiles: TileFiles,
    *,
    cover: Artifact | None = None,
    voxels: Artifact | None = None,
    scene: Artifact | None = None,
    sha256: Mapping[str, str] | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Certificate:
    """Check every image of a map in tiles against the voxels, the cover and the scene behind it.

    All checks use integers, without tolerance and without the code that cut. Of each tile, with the column
    that is its region grown by the reach:

    - each voxel that meets the column lies in one of the tile's hulls, and each other voxel in a wall: so the
      image is a map of the whole, and in the column it is one without walls;
    - no wall reaches into the column;
    - with a cover, each of its hulls with a box that meets the column is contained in a hull with that box.

    Args:
        tiles: that were read; `read_tiles` has compared every byte with the index.
        cover: the `alula/cover` that the tiles were cut from.
        voxels: the `alula/voxels` that every tile must contain; without it, the members of the cover.
        scene: the `alula/scene` that the voxels must contain.
        sha256: hash of the file "cover", see `verify_map`.
        jobs: threads, 0 for all processors; the result does not depend on it.
        progress: called with (done, total) from time to time.

    Returns:
        The certificate; `covered` when every check holds.

    Raises:
        UsageError: neither cover nor voxels are given.
    """
    (level, occupied), index = occupied_by(cover, voxels), tiles.index
    held = 1.0 if scene is None else 0.5
    reports = share(progress, 0, held)
    found: list[list[Check]] = []
    first: MapImage | None = None
    for number, (tile, raw) in enumerate(zip(index.tiles, tiles.images, strict=True)):
        try:
            image = decode_map(raw)
        except ArtifactError as error:
            raise type(error)(f"{tile.file}: {error}") from error
        first = first or image
        found.append(_tile_checks(index, tile, image, occupied, cover, jobs))
        if reports is not None:
            reports(number + 1, len(index.tiles))
    assert first is not None
    checks = [files_agree(first, cover, voxels, scene)]
    checks += [_joined(index, same) for same in zip(*found, strict=True)]
    if scene is not None:
        checks.append(_scene_check(level, scene, occupied, jobs, share(progress, held, 1)))
    what = "member of the cover" if voxels is None else "voxel"
    certificate = certificate_of(
        level,
        {"cover": cover, "voxels": voxels, "scene": scene},
        checks,
        f"every {what} in a hull or a wall of each of {len(index.tiles)} tiles",
        notes_of(first, (sha256 or {}).get("cover")) + _signature_note(tiles),
    )
    return msgspec.structs.replace(certificate, given=["tiles", *certificate.given])


def _signature_note(tiles: TileFiles) -> list[str]:
    if tiles.is_verified:
        return []
    signed = "was not checked; give --key" if tiles.signature else "does not exist"
    return [f"the signature of the index {signed}"]


def _tile_checks(
    index: TilesIndex,
    tile: Tile,
    image: MapImage,
    occupied: NDArray[np.int32],
    cover: Artifact | None,
    jobs: int,
) -> list[Check]:
    low, high = (np.array(ends, np.int64) for ends in index.loaded(tile))
    # At the rim the region has no end, and no hull lies beyond: there the column reaches as far as the hulls.
    hulls = len(image) - tile.walls
    kept = image.plane_start[hulls] if hulls >= 0 else 0
    inside = (
        *(image.lower[:hulls], image.upper[:hulls], image.normal[:kept], image.offset[:kept]),
        image.plane_start[: hulls + 1],
    )
    walls = np.hstack([image.lower[hulls:], image.upper[hulls:]]).astype(np.int64)
    checks = [margin_holds(image), _fits_index(index, tile, image)]
    near = ((occupied[:, :2] <= high) & (occupied[:, :2] + 1 >= low)).all(axis=1)
    rows = np.flatnonzero(near)
    outside = rows[_core.check_map_voxels(*inside, np.ascontiguousarray(occupied[rows]), jobs, None)]
    checks.append(_voxels("voxels within reach in hulls", index, occupied, outside, len(rows)))
    far = np.flatnonzero(~near)
    in_wall = np.zeros(len(far), bool)
    for wall in walls:
        in_wall |= ((occupied[far] >= wall[:3]) & (occupied[far] + 1 <= wall[3:])).all(axis=1)
    checks.append(_voxels("all other voxels in walls", index, occupied, far[~in_wall], len(far)))
    apart = (walls[:, 3:5] <= low).any(axis=1) | (walls[:, :2] >= high).any(axis=1)
    offences = [
        Offence(fault="a wall reaches into the column", hull=hulls + int(w)) for w in np.flatnonzero(~apart)
    ]
    checks.append(_check("walls beyond the reach", len(walls), offences, len(offences), "of each tile"))
    if cover is not None:
        checks.append(_hulls_within(cover, inside, low, high))
    return checks


def _fits_index(index: TilesIndex, tile: Tile, image: MapImage) -> Check:
    """Check that the image is on the lattice of the index and has at least the walls that it lists."""
    faults = []
    if image.voxel_size_m != index.voxel_size_m:
        faults.append(
            Offence(fault=f"voxel_size_m is {image.voxel_size_m}, of the index {index.voxel_size_m}")
        )
    if image.cover_hash.hex() != index.cover_hash:
        faults.append(Offence(fault="made from another cover than the index"))
    if len(image) != tile.hulls + tile.walls:
        faults.append(Offence(fault=f"{len(image)} hulls, in the index {tile.hulls} and {tile.walls} walls"))
    return _check("images fit the index", 1, faults, len(faults), "lattice, cover, numbers of hulls")


def _voxels(
    name: str, index: TilesIndex, occupied: NDArray[np.int32], outside: NDArray[np.int64], checked: int
) -> Check:
    first = [
        Offence(fault="voxel is in none", place_m=_position_m(occupied[row] + 0.5, index.voxel_size_m))
        for row in outside[:LISTED].tolist()
    ]
    if len(occupied) == 0:  # an empty set proves nothing
        return _check(name, 0, [Offence(fault="there is no voxel")], 1, "integers")
    return _check(name, checked, first, len(outside), "integer containment, after quantisation")


def _hulls_within(
    cover: Artifact,
    inside: tuple[
        NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]
    ],
    low: _Boxes,
    high: _Boxes,
) -> Check:
    """Check that the hulls of the cover within reach are contained in hulls of the image with their boxes."""
    vertex, start = np.asarray(cover["vertex"]), np.asarray(cover["vertex_start"])
    lower = np.minimum.reduceat(vertex[:, :2], start[:-1], axis=0)
    upper = np.maximum.reduceat(vertex[:, :2], start[:-1], axis=0)
    rows = np.flatnonzero(((lower <= high) & (upper >= low)).all(axis=1))
    sizes = np.diff(start)[rows]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    picked = np.arange(starts[-1]) + np.repeat(start[rows] - starts[:-1], sizes)
    missing = _core.check_map_polytopes(*inside, np.ascontiguousarray(vertex[picked]), starts)
    first = [
        Offence(fault="hull of the cover is in no hull with its box", hull=int(rows[m]))
        for m in missing[:LISTED].tolist()
    ]
    return _check(
        "hulls within reach contain the cover's", len(rows), first, len(missing), "all vertices, integers"
    )


def _joined(index: TilesIndex, same: tuple[Check, ...]) -> Check:
    """One check of all tiles; its offences name their tiles."""
    first = [
        msgspec.structs.replace(offence, fault=f"{tile.file}: {offence.fault}")
        for tile, check in zip(index.tiles, same, strict=True)
        for offence in check.first
    ]
    checked, failed = sum(check.checked for check in same), sum(check.failed for check in same)
    return _check(same[0].name, checked, first[:LISTED], failed, same[0].detail)
