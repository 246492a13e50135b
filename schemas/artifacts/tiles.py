"""A map in tiles: a folder with an onboard map per tile, an index of them, and its signature.

`tiles.bin` is the index that a microcontroller reads, in the layout of native/onboard/include/alula_tiles.h.
`tiles.json` says the same in words, with the provenance; it is written last. `tiles.sig` is the HMAC-SHA-256
of `tiles.bin`. `whole.cover.npz` is the cover, against which a host judges flights.
"""

from __future__ import annotations

import hashlib
import hmac
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, overload

import msgspec

from alula.schemas.artifacts import merkle
from alula.schemas.artifacts.artifact import file_hash
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.decode import MalformedError, decode_json
from alula.schemas.errors import CheckError, DamagedError, VersionError, WrongKindError
from alula.schemas.files import read_small

TILES_SCHEMA, TILES_VERSION = "alula/tiles", "1.0"
TILES, BINARY, SIGNATURE, WHOLE = "tiles.json", "tiles.bin", "tiles.sig", "whole.cover.npz"
MEMBERS = r"tiles\.(bin|sig)|whole\.cover\.npz|tile_-?[0-9]{1,7}_-?[0-9]{1,7}\.bin"
"""Regular expression of the names of the files beside `tiles.json`."""
MOST_TILES = 2**16
_MAGIC = b"ALTI"
# magic, major, minor, header bytes, first i and j, tiles along x and y, edge, reach, hysteresis, bytes of the
# largest image, g, box of all hulls, bytes of the index, g in single precision, hash of the cover, CRC-32 of
# the rows, Merkle root; then the CRC-32 of all these.
_HEADER = struct.Struct("<4s2BH2i2I3IId6iIf8sI32s")
_ROW = struct.Struct("<2I32s")
_MOST_BYTES = 2**28
_KEY_ID = b"alula/tiles: which key"

_Hash = Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{64}$")]
_Whole = Annotated[int, msgspec.Meta(ge=1, le=2**22)]
_Lattice = Annotated[int, msgspec.Meta(ge=-(2**23), le=2**23)]
_Corner = Annotated[list[_Lattice], msgspec.Meta(min_length=3, max_length=3)]
_Pair = Annotated[list[_Lattice], msgspec.Meta(min_length=2, max_length=2)]


class Tile(msgspec.Struct, frozen=True, kw_only=True):
    """One tile.

    Attributes:
        i: number along x: the tile has the positions with i tile <= x < (i + 1) tile.
        j: number along y.
        bytes: length of its image.
        crc32: of its image.
        sha256: of its image.
        hulls: number of hulls of the cover in it.
        walls: number of boxes after them, which stand for all that is not in it.
    """

    i: _Lattice
    j: _Lattice
    bytes: Annotated[int, msgspec.Meta(ge=64, lt=2**32)]
    crc32: Annotated[int, msgspec.Meta(ge=0, lt=2**32)]
    sha256: _Hash
    hulls: Annotated[int, msgspec.Meta(ge=0, le=2**24)]
    walls: Annotated[int, msgspec.Meta(ge=0, le=4)]

    @property
    def file(self) -> str:
        """Name of the file with its image."""
        return f"tile_{self.i}_{self.j}.bin"


class TilesIndex(msgspec.Struct, frozen=True, kw_only=True):
    """Contents of `tiles.json`; lengths are in voxels unless the name has a unit.

    Attributes:
        schema: `alula/tiles`.
        version: of this format.
        voxel_size_m: edge of a voxel [m].
        tile: edge of a tile.
        reach: hulls with a box within this distance of the region of a tile, along x and y, are in its image.
        hysteresis: length by which the region is larger than the tile on each side.
        first: the lowest i and j.
        count: numbers of tiles along x and y.
        lower: lower corner of the box of all hulls.
        upper: upper corner.
        cover_hash: first 8 bytes of the SHA-256 of the cover's file, in hexadecimal.
        merkle_root: of the tiles' SHA-256, see `merkle_root`.
        sha256: of `tiles.bin`.
        key_id: tells which key signed the index; empty without a signature.
        tiles: in their order in `tiles.bin`: by j, then by i.
        provenance: of the folder.
    """

    schema: str
    version: str
    voxel_size_m: Annotated[float, msgspec.Meta(ge=1e-6, le=1e5)]
    tile: _Whole
    reach: _Whole
    hysteresis: _Whole
    first: _Pair
    count: Annotated[
        list[Annotated[int, msgspec.Meta(ge=1, le=MOST_TILES)]], msgspec.Meta(min_length=2, max_length=2)
    ]
    lower: _Corner
    upper: _Corner
    cover_hash: Annotated[str, msgspec.Meta(pattern="^[0-9a-f]{16}$")]
    merkle_root: _Hash
    sha256: _Hash
    key_id: str
    tiles: Annotated[list[Tile], msgspec.Meta(min_length=1, max_length=MOST_TILES)]
    provenance: Provenance

    @property
    def tile_m(self) -> float:
        """Edge of a tile [m]."""
        return self.tile * self.voxel_size_m

    @property
    def reach_m(self) -> float:
        """Reach [m]."""
        return self.reach * self.voxel_size_m

    @property
    def hysteresis_m(self) -> float:
        """Hysteresis [m]."""
        return self.hysteresis * self.voxel_size_m

    def loaded(self, tile: Tile) -> tuple[list[int], list[int]]:
        """Lower and upper ends along x and y of what a tile's image has without walls: region and reach."""
        beyond = self.hysteresis + self.reach
        low = [self.tile * number - beyond for number in (tile.i, tile.j)]
        return low, [start + self.tile + 2 * beyond for start in low]

    def binary(self) -> bytes:
        """Encode as `tiles.bin`."""
        rows = b"".join(_ROW.pack(one.bytes, one.crc32, bytes.fromhex(one.sha256)) for one in self.tiles)
        size = self.voxel_size_m
        head = _HEADER.pack(
            *(_MAGIC, 1, 0, _HEADER.size + 4, *self.first, *self.count),
            *(self.tile, self.reach, self.hysteresis, max(one.bytes for one in self.tiles)),
            *(size, *self.lower, *self.upper, _HEADER.size + 4 + len(rows), size),
            *(bytes.fromhex(self.cover_hash), zlib.crc32(rows), bytes.fromhex(self.merkle_root)),
        )
        return head + zlib.crc32(head).to_bytes(4, "little") + rows


@dataclass(frozen=True, slots=True)
class TileFiles:
    """A map in tiles that was read and checked.

    Attributes:
        index: see `TilesIndex`.
        binary: contents of `tiles.bin`.
        signature: of it; empty without one.
        images: of all tiles, in the order of the index.
        cover: path of the cover in the folder.
        is_verified: the signature was checked with a key.
    """

    index: TilesIndex
    binary: bytes
    signature: bytes
    images: Sequence[bytes]
    cover: Path
    is_verified: bool


def merkle_root(tiles: Sequence[Tile]) -> str:
    """Root of the hash tree over the SHA-256 of the images, in hexadecimal; see `merkle.root`.

    With the root alone and a path of log2(n) hashes, one tile can be checked without the index.
    """
    return merkle.root([merkle.leaf(bytes.fromhex(tile.sha256)) for tile in tiles])


def key_id(key: bytes | None) -> str:
    """Short name of a key that does not reveal it; empty without a key."""
    return "" if key is None else hmac.digest(key, _KEY_ID, "sha256")[:8].hex()


def sign(binary: bytes, key: bytes) -> bytes:
    """Signature of an index: its HMAC-SHA-256.

    Args:
        key: shared by the exporting and the flying machine.
    """
    return hmac.digest(key, binary, "sha256")


def is_tiles(path: Path) -> bool:
    """Test whether a path is the folder of a map in tiles."""
    return (path / TILES).is_file()


def read_tiles_index(folder: Path) -> TilesIndex:
    """Read `tiles.json`, and check that its numbers fit each other.

    Raises:
        InputError: it cannot be read.
        WrongKindError: it is of another kind.
        VersionError: it is newer than this version.
        DamagedError: it is malformed.
    """
    path = folder / TILES
    try:
        index = decode_json(read_small(path, _MOST_BYTES), TilesIndex)
    except MalformedError as error:
        raise DamagedError(f"{path}: {error}") from error
    if index.schema != TILES_SCHEMA:
        raise WrongKindError(f"{path}: is {index.schema!r}, not {TILES_SCHEMA}")
    if index.version.split(".")[0] != TILES_VERSION.split(".")[0]:
        raise VersionError(f"{path}: version {index.version} is newer than {TILES_VERSION}; update alula")
    grid = [
        (index.first[0] + i, index.first[1] + j) for j in range(index.count[1]) for i in range(index.count[0])
    ]
    if [(one.i, one.j) for one in index.tiles] != grid:
        raise DamagedError(f"{path}: its tiles are not those of its grid")
    if 2 * index.hysteresis > index.tile:
        raise DamagedError(f"{path}: its hysteresis is more than half of a tile")
    if merkle_root(index.tiles) != index.merkle_root:
        raise DamagedError(f"{path}: its Merkle root is not that of its tiles")
    return index


class _Images(Sequence[bytes]):
    """Images in a folder, each read and checked when it is used."""

    def __init__(self, folder: Path, index: TilesIndex) -> None:
        self._folder, self._index = folder, index

    def __len__(self) -> int:
        return len(self._index.tiles)

    @overload
    def __getitem__(self, at: int) -> bytes: ...

    @overload
    def __getitem__(self, at: slice) -> tuple[bytes, ...]: ...

    def __getitem__(self, at: int | slice) -> bytes | tuple[bytes, ...]:
        if isinstance(at, slice):
            return tuple(self[number] for number in range(*at.indices(len(self))))
        tile = self._index.tiles[at]
        raw = read_small(self._folder / tile.file, _MOST_BYTES)
        if (
            len(raw) != tile.bytes
            or hashlib.sha256(raw).hexdigest() != tile.sha256
            or zlib.crc32(raw) != tile.crc32
        ):
            raise DamagedError(f"{self._folder / tile.file}: is not the image that {TILES} lists")
        return raw


def open_tiles(folder: Path, key: bytes | None = None) -> TileFiles:
    """Read the index of a map in tiles, and check it; each image is read and checked when it is used.

    Args:
        key: that must have signed the index; None for any index.

    Raises:
        as `read_tiles`; those for an image when it is used.
    """
    index, binary, signature = _read_index(folder, key)
    return TileFiles(index, binary, signature, _Images(folder, index), folder / WHOLE, key is not None)


def read_tiles(folder: Path, key: bytes | None = None) -> TileFiles:
    """Read a map in tiles, and check every byte of it against the index.

    Args:
        key: that must have signed the index; None for any index.

    Raises:
        InputError: a file cannot be read.
        ArtifactError: the index is malformed or of a newer version, or a file is not the one that it lists.
        CheckError: the index is not signed with the key.
    """
    found = open_tiles(folder, key)
    return replace(found, images=tuple(found.images))


def _read_index(folder: Path, key: bytes | None) -> tuple[TilesIndex, bytes, bytes]:
    """Index, its bytes and its signature, after the checks of all but the images."""
    index = read_tiles_index(folder)
    binary = read_small(folder / BINARY, _MOST_BYTES)
    if binary != index.binary() or hashlib.sha256(binary).hexdigest() != index.sha256:
        raise DamagedError(f"{folder / BINARY}: is not the index that {TILES} describes")
    signature = read_small(folder / SIGNATURE, 1000) if (folder / SIGNATURE).is_file() else b""
    if key is not None:
        if not signature:
            raise CheckError(f"{folder}: its index is not signed; export it with --sign")
        if not hmac.compare_digest(signature, sign(binary, key)):
            raise CheckError(f"{folder}: the signature of its index does not match the key")
    whole = file_hash(folder / WHOLE)
    made_from = [ref.sha256 for ref in index.provenance.inputs if ref.role == "cover"]
    listed = index.provenance.summary.get("cover_sha256", *made_from)  # of a cover in parts: joined
    if whole != listed or whole[:16] != index.cover_hash:
        raise DamagedError(f"{folder / WHOLE}: is not the cover that {TILES} lists")
    return index, binary, signature
