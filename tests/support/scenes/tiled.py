"""Covers in tiles for tests: fields of hulls with oblique planes, and folders of them."""

import hashlib
import json
import zlib
from typing import Any, NamedTuple

import msgspec
import numpy as np

from alula import _core
from alula.schemas.artifacts.artifact import file_hash, write_artifact
from alula.schemas.artifacts.kinds import COVER
from alula.schemas.artifacts.manifest import InputRef
from alula.schemas.artifacts.parts import Parts
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.artifacts.tiles import (
    BINARY,
    SIGNATURE,
    TILES,
    TILES_SCHEMA,
    TILES_VERSION,
    WHOLE,
    key_id,
    merkle_root,
    read_tiles_index,
    sign,
)
from alula.stages.compression.onboard.tiles import cut_tiles, sealed
from support.scenes.fabricate import exact_hull, make_cover

KEY = bytes(range(32))


def posts(across=40, along=40, pitch=9, seed=1, offset=(0, 0, 0)):
    """Slanted posts on a jittered grid, each one hull of oblique planes; voxels of 0.1 m."""
    rng = np.random.default_rng(seed)
    hulls = []
    for i in range(-across, across + 1, pitch):
        for j in range(-along, along + 1, pitch):
            foot = np.array([i, j, -8]) + np.append(rng.integers(-1, 2, 2), 0)
            base = np.array([(0, 0, 0), (2, 0, 0), (2, 1, 0), (1, 2, 0), (0, 2, 0)]) + foot
            lean = np.array([*rng.integers(-2, 3, 2), 20])
            hulls.append(exact_hull(np.vstack([base, base + lean])))
    return make_cover(hulls, g=0.1, offset=offset)


class CutMap(NamedTuple):
    """A map cut into tiles: its index, and the images of all tiles."""

    index: dict[str, Any]
    images: list[bytes]


def cut(cover, tile_m=1.2, reach_m=1.6, hysteresis_m=0.2, **fields):
    images = []
    lengths = {"tile_m": tile_m, "reach_m": reach_m, "hysteresis_m": hysteresis_m}
    index = cut_tiles(Parts.of(cover), images.append, **lengths, largest_normal=127, **fields)
    return CutMap(index, images)


def sealed_binary(made, key=None):
    """The index of a map that was cut, as a microcontroller reads it."""
    provenance = Provenance.now(TILES_SCHEMA, TILES_VERSION, {}, None, [])
    return sealed(made.index, key_id=key_id(key), provenance=provenance).binary()


def native(made, key=None):
    """The native set of tiles of a map that was cut, signed with a key if there is one."""
    binary = sealed_binary(made, key)
    signature = b"" if key is None else sign(binary, key)
    return _core.TileSet(binary, made.images, key=key, signature=signature)


def folder_of(path, cover, key=KEY, **lengths):
    """Write a cover in tiles, as `alula export --tiles` does; returns the index."""
    path.mkdir()
    write_artifact(path / WHOLE, cover)
    digest = file_hash(path / WHOLE)
    made = cut(cover, cover_sha256=digest, **lengths)
    inputs = [InputRef("cover", COVER.name, COVER.version, digest, "a.cover.npz")]
    provenance = Provenance.now(TILES_SCHEMA, TILES_VERSION, {}, None, inputs)
    write_index(path, sealed(made.index, key_id=key_id(key), provenance=provenance), key)
    for tile, image in zip(made.index["tiles"], made.images, strict=True):
        (path / tile.file).write_bytes(image)
    return sealed(made.index, key_id=key_id(key), provenance=provenance)


def write_index(path, index, key=KEY):
    binary = index.binary()
    (path / BINARY).write_bytes(binary)
    (path / TILES).write_bytes(msgspec.json.encode(index))
    if key is not None:
        (path / SIGNATURE).write_bytes(sign(binary, key))


def with_image(path, number, image, key=KEY):
    """Replace the image of one tile, and make the index consistent with it."""
    index = read_tiles_index(path)
    old = index.tiles[number]
    (path / old.file).write_bytes(image)
    fresh = msgspec.structs.replace(
        old, bytes=len(image), crc32=zlib.crc32(image), sha256=hashlib.sha256(image).hexdigest()
    )
    tiles = [*index.tiles[:number], fresh, *index.tiles[number + 1 :]]
    root = merkle_root(tiles)
    index = msgspec.structs.replace(index, tiles=tiles, merkle_root=root)
    index = msgspec.structs.replace(index, sha256=hashlib.sha256(index.binary()).hexdigest())
    write_index(path, index, key)


def set_key(path, name, value):
    """Set one key of the index in words."""
    whole = json.loads((path / TILES).read_text())
    whole[name] = value
    (path / TILES).write_text(json.dumps(whole))
