"""Verification of a map in tiles: proves of each tile, from its bytes, that it contains every voxel."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.certificate import Certificate, Check, Offence
from alula.schemas.artifacts.manifest import LevelManifest
from alula.schemas.artifacts.parts import Parts
from alula.schemas.artifacts.tiles import Tile, TileFiles, TilesIndex
from alula.schemas.errors import ArtifactError
from alula.schemas.progress import Progress
from alula.stages.compression.cover_checks import scene_check
from alula.stages.compression.onboard.columns import Columns, voxels_of
from alula.stages.compression.onboard.image import MapImage, decode_map
from alula.stages.compression.onboard.verify import files_agree, margin_holds, notes_of, occupied_by
from alula.stages.compression.verify import certificate_of
from alula.stages.compression.verify_cubes import scene_proof
from alula.stages.progress import share
from alula.stages.proof import LISTED, check, position_m, sum_of

_Boxes = NDArray[np.int64]


def verify_tiles(
    tiles: TileFiles,
    *,
    cover: Artifact | None = None,
    voxels: Parts | None = None,
    scene: Parts | None = None,
    sha256: Mapping[str, str] | None = None,
    jobs: int = 0,
    progress: Progress | None = None,
) -> Certificate:
    """Check every image of a map in tiles against the voxels, the cover and the scene behind it.

    All checks use integers, without tolerance and without the code that cut. Of each tile, with the column
    that is its region grown by the reach:

    - each voxel that meets the column lies in one of the tile's hulls, and each other voxel in a wall: so the
      image is a map of the whole, and in the column it is one without walls. Where a wall contains the box
      of all voxels beyond a side of the column, they are not looked at one by one;
    - no wall reaches into the column;
    - with a cover, each of its hulls with a box that meets the column is contained in a hull with that box.

    Time is proportional to the map. Of voxels and scenes in parts, memory holds a few parts and cells.

    Args:
        tiles: that were read; every byte is compared with the index.
        cover: the `alula/cover` that the tiles were cut from.
        voxels: the `alula/voxels` that every tile must contain; without it, the members of the cover.

    Returns:
        The certificate; `covered` when every check holds.

    Raises:
        UsageError: neither cover nor voxels are given.
        DamagedError: an image is not the one of the index.
        InputError: see `verify`.
    """
    (level, source), index = _occupied_by(cover, voxels), tiles.index
    columns = Columns(source, level.voxel_size_m)
    hulls = None if cover is None else _CoverRows(cover)
    held = 1.0 if scene is None else 0.5
    reports = share(progress, 0, held)
    found: list[list[Check]] = []
    first: MapImage | None = None
    for number, (tile, raw) in enumerate(zip(index.tiles, tiles.images, strict=True)):
        try:
            image = decode_map(raw)
        except ArtifactError as error:
            raise error.reworded(f"{tile.file}: {error}") from error
        first = first or image
        found.append(_tile_checks(index, tile, image, columns, hulls, jobs))
        if reports is not None:
            reports(number + 1, len(index.tiles))
    assert first is not None
    whole = {"cover": cover, "voxels": voxels, "scene": scene}
    checks = [files_agree(first, cover, voxels, scene)]
    checks += [_joined(index, same) for same in zip(*found, strict=True)]
    below = None
    if scene is not None:
        ellipsoids, below = _ellipsoids(level, source, scene, jobs, share(progress, held, 1))
        checks.append(ellipsoids)
    what = "member of the cover" if voxels is None else "voxel"
    certificate = certificate_of(
        level,
        whole,
        checks,
        f"every {what} in a hull or a wall of each of {len(index.tiles)} tiles",
        notes_of(first, (sha256 or {}).get("cover")) + _signature_note(tiles),
        below,
    )
    return msgspec.structs.replace(certificate, given=["tiles", *certificate.given])


def _occupied_by(cover: Artifact | None, voxels: Parts | None) -> tuple[LevelManifest, Parts]:
    """Level and voxels that the tiles must contain: see `occupied_by`; a folder may have any number."""
    if voxels is None or not voxels.is_folder:
        level, _ = occupied_by(cover, None if voxels is None else voxels[0])
        return level, Parts.of(cover) if voxels is None else voxels  # type: ignore[arg-type]
    assert isinstance(voxels.manifest, LevelManifest)
    return voxels.manifest, voxels


def _ellipsoids(
    level: LevelManifest, occupied: Parts, scene: Parts, jobs: int, progress: Progress | None
) -> tuple[Check, int]:
    """Check that the voxels contain the ellipsoids, and count the Gaussians below the minimum opacity."""
    if scene.is_folder or occupied.is_folder:
        return scene_proof(level, occupied, scene, jobs, progress)
    found = scene_check(level, scene[0], voxels_of(occupied[0]), jobs, progress)
    return found, len(scene[0]["mean"]) - found.checked


def _signature_note(tiles: TileFiles) -> list[str]:
    if tiles.is_verified:
        return []
    signed = "was not checked; give --key" if tiles.signature else "does not exist"
    return [f"the signature of the index {signed}"]


class _CoverRows:
    """Hulls of a cover: those within reach of a tile are found among those within reach of its row."""

    def __init__(self, cover: Artifact) -> None:
        self.cover = cover
        vertex, start = np.asarray(cover["vertex"]), np.asarray(cover["vertex_start"])
        self._lower = np.minimum.reduceat(vertex[:, :2], start[:-1], axis=0)
        self._upper = np.maximum.reduceat(vertex[:, :2], start[:-1], axis=0)
        self._row: tuple[int, int, NDArray[np.int64]] = (0, -1, np.empty(0, np.int64))

    def within(self, low: _Boxes, high: _Boxes) -> NDArray[np.int64]:
        """Numbers of the hulls whose boxes meet a column."""
        ends = int(low[1]), int(high[1])
        if self._row[:2] != ends:
            is_near = (self._lower[:, 1] <= ends[1]) & (self._upper[:, 1] >= ends[0])
            self._row = (*ends, np.flatnonzero(is_near))
        rows = self._row[2]
        is_near = (self._lower[rows, 0] <= high[0]) & (self._upper[rows, 0] >= low[0])
        return np.asarray(rows[is_near], np.int64)


def _tile_checks(
    index: TilesIndex,
    tile: Tile,
    image: MapImage,
    columns: Columns,
    hulls: _CoverRows | None,
    jobs: int,
) -> list[Check]:
    low, high = (np.array(ends, np.int64) for ends in index.loaded(tile))
    # At the rim the region has no end, and no hull lies beyond: there the column reaches as far as the hulls.
    count = len(image) - tile.walls
    kept = image.plane_start[count] if count >= 0 else 0
    inside = (
        *(image.lower[:count], image.upper[:count], image.normal[:kept], image.offset[:kept]),
        image.plane_start[: count + 1],
    )
    walls = np.hstack([image.lower[count:], image.upper[count:]]).astype(np.int64)
    checks = [margin_holds(image), _fits_index(index, tile, image)]
    near = np.ascontiguousarray(columns.near(low, high))
    outside = near[_core.check_map_voxels(*inside, near, jobs, None)]
    size, total = index.voxel_size_m, columns.count
    checks.append(_voxels("voxels within reach in hulls", size, total, outside, len(near)))
    outside = _beyond_walls(columns, walls, low, high)
    checks.append(_voxels("all other voxels in walls", size, total, outside, total - len(near)))
    apart = (walls[:, 3:5] <= low).any(axis=1) | (walls[:, :2] >= high).any(axis=1)
    offences = [
        Offence(fault="a wall reaches into the column", hull=count + int(w)) for w in np.flatnonzero(~apart)
    ]
    checks.append(check("walls beyond the reach", len(walls), offences, "of each tile"))
    if hulls is not None:
        checks.append(_hulls_within(hulls.cover, inside, hulls.within(low, high)))
    return checks


def _beyond_walls(columns: Columns, walls: _Boxes, low: _Boxes, high: _Boxes) -> NDArray[np.int32]:
    """Voxels that neither touch the column nor lie in a wall, shape (M, 3).

    A wall contains the box of all voxels beyond a side exactly if it contains them all.
    """
    sides = columns.beyond(low, high)
    if all(((walls[:, :3] <= box[0]) & (box[1] <= walls[:, 3:])).all(axis=1).any() for box in sides):
        return np.empty((0, 3), np.int32)
    found = [np.empty((0, 3), np.int32)]
    for index in columns:
        far = index[~((index[:, :2] <= high) & (index[:, :2] + 1 >= low)).all(axis=1)]
        in_wall = np.zeros(len(far), bool)
        for wall in walls:
            in_wall |= ((far >= wall[:3]) & (far + 1 <= wall[3:])).all(axis=1)
        found.append(far[~in_wall])
    return np.concatenate(found)


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
    return check("images fit the index", 1, faults, "lattice, cover, numbers of hulls")


def _voxels(name: str, size_m: float, total: int, outside: NDArray[np.int32], checked: int) -> Check:
    first = [
        Offence(fault="voxel is in none", place_m=position_m(voxel + 0.5, size_m))
        for voxel in outside[:LISTED]
    ]
    if total == 0:  # an empty set proves nothing
        return check(name, 0, [Offence(fault="there is no voxel")], "integers")
    return check(name, checked, first, "integer containment, after quantisation", failed=len(outside))


def _hulls_within(
    cover: Artifact,
    inside: tuple[
        NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]
    ],
    rows: NDArray[np.int64],
) -> Check:
    """Check that the hulls of the cover within reach are contained in hulls of the image with their boxes."""
    vertex, start = np.asarray(cover["vertex"]), np.asarray(cover["vertex_start"])
    sizes = np.diff(start)[rows]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    picked = np.arange(starts[-1]) + np.repeat(start[rows] - starts[:-1], sizes)
    missing = _core.check_map_polytopes(*inside, np.ascontiguousarray(vertex[picked]), starts)
    first = [
        Offence(fault="hull of the cover is in no hull with its box", hull=int(rows[m]))
        for m in missing[:LISTED].tolist()
    ]
    name, detail = "hulls within reach contain the cover's", "all vertices, integers"
    return check(name, len(rows), first, detail, failed=len(missing))


def _joined(index: TilesIndex, same: tuple[Check, ...]) -> Check:
    """One check of all tiles; its offences name their tiles."""
    named = [
        msgspec.structs.replace(
            one, first=[msgspec.structs.replace(at, fault=f"{tile.file}: {at.fault}") for at in one.first]
        )
        for tile, one in zip(index.tiles, same, strict=True)
    ]
    return sum_of(named)
