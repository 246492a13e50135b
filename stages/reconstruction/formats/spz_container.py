"""Container of SPZ files: all arrays in one gzip stream, or each in a zstd frame of its own."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import ArtifactError

MAGIC = b"NGSP"
GZIP_MAGIC = b"\x1f\x8b"
HEADER_SIZE, LONG_HEADER_SIZE = 16, 32  # versions 1 to 3, and 4
HARMONICS = (0, 3, 8, 15, 24)  # higher coefficients of degree 0 to 4
FRAME_RECORD = 0xADBE0003
FRAMES = (
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LFD", "RFD", "LFU", "RFU", "LBD", "RBD", "LBU", "RBU"),
)  # from 1
HAS_EXTENSIONS = 2
COMMENT_RECORD = 0x414C0001  # a line of text; "AL" is nobody's vendor number
_KNOWN_RECORDS = (0xADBE0001, 0xADBE0002, FRAME_RECORD, COMMENT_RECORD)  # of harmonics, and of a camera

_PIECE = 2**20
_READ = 2**16  # bytes of a gzip stream at once; so many are copied at the end of each member
_MEMBERS = 2**16
_NAME_LIMIT = 2**20  # the header of a gzip stream may hold a name and comments of any length
_EXPANSION = 1100  # deflate makes at most 1032 bytes of one
_EXTRA = 2**20  # maximum bytes of extensions that are kept
_GZIP_LEVEL, _ZSTD_LEVEL = 6, 12  # as Niantic's
_WINDOW = 2**27  # maximum memory that a zstd frame may require of a reader


@dataclass(frozen=True, slots=True)
class Header:
    """Fields that versions 1 to 4 share, checked."""

    version: int
    count: int
    degree: int
    fractional_bits: int
    flags: int

    @property
    def arrays(self) -> dict[str, int]:
        """Bytes of one Gaussian in each array, in the order of the file; 0 for none."""
        return {
            "positions": 6 if self.version == 1 else 9,
            "alphas": 1,
            "colors": 3,
            "scales": 3,
            "rotations": 3 if self.version < 3 else 4,
            "sh": 3 * HARMONICS[self.degree],
        }


@dataclass(frozen=True, slots=True)
class Packed:
    """Inflated arrays of a file, without the higher harmonics.

    Attributes:
        frame: name of the frame; None where the file does not name it.
        unknown: names of extensions of unknown meaning.
    """

    header: Header
    array: dict[str, memoryview]
    frame: str | None
    notes: list[str] = field(default_factory=list)
    unknown: tuple[str, ...] = ()

    def rows(self, name: str, part: slice) -> NDArray[np.uint8]:
        """Rows of an array, one per Gaussian."""
        width = self.header.arrays[name]
        return np.frombuffer(self.array[name][part.start * width : part.stop * width], np.uint8).reshape(
            -1, width
        )


def is_spz(head: memoryview, suffix: str) -> bool:
    """Test whether a file has the magic number of this format; the decoder reports further damage."""
    if bytes(head[:2]) != GZIP_MAGIC:
        return bytes(head[:4]) == MAGIC
    try:
        start = zlib.decompressobj(31).decompress(head[:_NAME_LIMIT], 4)
    except zlib.error:
        start = b""
    return start == MAGIC or suffix == ".spz"


def unpack(buffer: memoryview) -> Packed:
    """Find and inflate the arrays of an SPZ file.

    Raises:
        ArtifactError: the file is not SPZ, of another version, truncated, damaged, or implausibly large.
    """
    if bytes(buffer[:2]) == GZIP_MAGIC:
        return _stream(buffer, _inflated(buffer))
    if bytes(buffer[:4]) != MAGIC:
        raise ArtifactError("SPZ: not an SPZ file: it begins with neither gzip nor NGSP")
    if len(buffer) < HEADER_SIZE:
        raise ArtifactError(f"SPZ: truncated: {len(buffer)} bytes hold no header")
    if struct.unpack_from("<I", buffer, 4)[0] < 4:
        packed = _stream(buffer, iter([(buffer, 0)]))
        packed.notes.append("not compressed, as files of this version are")
        return packed
    return _frames(buffer)


def _header(raw: bytes | bytearray | memoryview, size: int) -> Header:
    magic, version, count, degree, bits, flags = struct.unpack_from("<4sIIBBB", raw)
    if magic != MAGIC:
        raise ArtifactError("SPZ: what is compressed with gzip does not begin with NGSP")
    if not 1 <= version <= 4:
        raise ArtifactError(f"SPZ: version {version}; this program reads 1 to 4")
    if degree >= len(HARMONICS):
        raise ArtifactError(f"SPZ: spherical harmonics of degree {degree}; the format has 0 to 4")
    if count == 0:
        raise ArtifactError("SPZ: has no Gaussians")
    if version > 1 and bits > 24:
        raise ArtifactError(f"SPZ: centres with {bits} fractional bits of 24")
    header = Header(version, count, degree, bits, flags)
    least = 9 * count if version == 4 else sum(header.arrays.values()) * count
    if least > (1024 if version == 4 else _EXPANSION) * size:
        raise ArtifactError(f"SPZ: truncated: a file of {size} bytes does not hold {count} Gaussians")
    return header


def _inflated(buffer: memoryview) -> Iterator[tuple[bytes, int | None]]:
    """Inflated pieces of gzip members; with the last piece of each, the bytes that follow it, else None."""
    at = members = 0
    while bytes(buffer[at : at + 2]) == GZIP_MAGIC:
        members += 1
        if members > _MEMBERS:
            raise ArtifactError(f"SPZ: more than {_MEMBERS} gzip members")
        inflater = zlib.decompressobj(31)
        while not inflater.eof:
            if at >= len(buffer):
                raise ArtifactError("SPZ: truncated: the gzip stream has no end")
            raw: bytes | memoryview = buffer[at : at + _READ]
            at += len(raw)
            more = True
            while more and not inflater.eof:
                try:
                    piece = inflater.decompress(raw, _PIECE)
                except zlib.error as error:
                    reason = str(error).partition("data: ")[2] or str(error)
                    raise ArtifactError(f"SPZ: damaged gzip stream: {reason}") from error
                raw = inflater.unconsumed_tail
                more = bool(raw) or len(piece) == _PIECE
                if not inflater.eof:
                    yield piece, None
        at -= len(inflater.unused_data)
        yield piece, len(buffer) - at


def _stream(buffer: memoryview, pieces: Iterator[tuple[bytes | memoryview, int | None]]) -> Packed:
    """Unpack versions 1 to 3: a header and the arrays one after another, then extensions."""
    header: Header | None = None
    begun, kept, extra = bytearray(), bytearray(), bytearray()
    done = wanted = need = trailing = 0  # `wanted` ends before the harmonics, `need` behind them
    for fresh, rest in pieces:
        piece = fresh
        if header is None:
            begun += piece
            if len(begun) >= HEADER_SIZE:
                header = _header(begun, len(buffer))
                if header.version == 4:
                    raise ArtifactError("SPZ: version 4 inside gzip, which compresses versions 1 to 3")
                widths = header.arrays
                need = HEADER_SIZE + header.count * sum(widths.values())
                wanted = need - header.count * widths["sh"]
                piece = bytes(begun)
        if header is not None:
            kept += piece[: max(0, wanted - done)]
            behind = max(0, need - done)
            extra += piece[behind : behind + max(0, _EXTRA - len(extra))]
            done += len(piece)
            if done > 2 * need + _EXTRA:
                raise ArtifactError(f"SPZ: more than {need + _EXTRA} bytes follow the data")
        if rest is not None and header is not None and done >= need:
            trailing = rest
            break
    if header is None:
        raise ArtifactError(f"SPZ: truncated: {len(begun)} bytes hold no header")
    if done < need:
        raise ArtifactError(
            f"SPZ: truncated: {header.count} Gaussians of degree {header.degree} need {need} bytes, "
            f"there are {done}"
        )
    frame, unread = None, done - need
    notes: list[str] = []
    unknown: tuple[str, ...] = ()
    if header.flags & HAS_EXTENSIONS:
        frame, notes, unread, unknown = _extensions(bytes(extra), unread)
    if unread + trailing:
        notes.append(
            f"{unread + trailing} bytes follow the data that the header announces; they were not read"
        )
    array, at, view = {}, HEADER_SIZE, memoryview(kept)
    for name, width in header.arrays.items():
        if name != "sh":
            array[name] = view[at : at + width * header.count]
            at += width * header.count
    return Packed(header, array, frame, notes, unknown)


def _frames(buffer: memoryview) -> Packed:
    """Unpack version 4: a header, extensions, a table of sizes, and a zstd frame per non-empty array."""
    header = _header(buffer, len(buffer))
    if len(buffer) < LONG_HEADER_SIZE:
        raise ArtifactError(f"SPZ: truncated: {len(buffer)} bytes hold no header of version 4")
    streams, table = struct.unpack_from("<BI", buffer, 15)
    sizes = {name: width * header.count for name, width in header.arrays.items() if width}
    if streams != len(sizes):
        raise ArtifactError(f"SPZ: {streams} streams; degree {header.degree} has {len(sizes)}")
    at = table + 16 * streams
    if table < LONG_HEADER_SIZE or at > len(buffer):
        raise ArtifactError(f"SPZ: truncated: the table of streams at byte {table} is not within the file")
    array = {}
    for number, (name, size) in enumerate(sizes.items()):
        compressed, inflated = struct.unpack_from("<QQ", buffer, table + 16 * number)
        if inflated != size:
            raise ArtifactError(
                f"SPZ: {header.count} Gaussians need {size} bytes of {name}, not {inflated} as announced"
            )
        if compressed > len(buffer) - at:
            raise ArtifactError(
                f"SPZ: truncated: {compressed} bytes of {name} announced, there are {len(buffer) - at}"
            )
        frame_bytes = buffer[at : at + compressed]
        _check_frame(frame_bytes, name, size)
        if name != "sh":
            array[name] = _unzstd(frame_bytes, name, size)
        at += compressed
    frame, notes, unread, unknown = _extensions(
        bytes(buffer[LONG_HEADER_SIZE : min(table, LONG_HEADER_SIZE + _EXTRA)]), table - LONG_HEADER_SIZE
    )
    if unread:
        notes.append(f"{unread} bytes of extensions are no records; they were not read")
    if at < len(buffer):
        notes.append(f"{len(buffer) - at} bytes follow the data; they were not read")
    return Packed(header, array, frame, notes, unknown)


def _check_frame(raw: memoryview, name: str, size: int) -> None:
    import zstandard

    try:
        found = zstandard.get_frame_parameters(raw).content_size
    except zstandard.ZstdError as error:
        raise ArtifactError(f"SPZ: damaged: {name} is no zstd frame") from error
    if found not in (size, zstandard.CONTENTSIZE_UNKNOWN):
        raise ArtifactError(f"SPZ: damaged: the frame of {name} holds {found} bytes, not {size}")


def _unzstd(raw: memoryview, name: str, size: int) -> memoryview:
    import zstandard

    out = bytearray()
    try:
        with zstandard.ZstdDecompressor(max_window_size=_WINDOW).stream_reader(raw) as reader:
            while len(out) <= size and (piece := reader.read(min(_PIECE, size + 1 - len(out)))):
                out += piece
    except zstandard.ZstdError as error:
        raise ArtifactError(f"SPZ: damaged zstd frame of {name}: {error}") from error
    if len(out) != size:
        what = "more than" if len(out) > size else f"{len(out)} bytes, not"
        raise ArtifactError(f"SPZ: damaged: the frame of {name} inflates to {what} {size} bytes")
    return memoryview(out)


def _extensions(raw: bytes, size: int) -> tuple[str | None, list[str], int, tuple[str, ...]]:
    """Frame that a record names, notes, number of bytes of `size` that are no records, unknown records."""
    at, frame = 0, None
    unknown: dict[str, None] = {}
    notes: list[str] = []
    while at + 8 <= len(raw):
        kind, length = struct.unpack_from("<II", raw, at)
        if length > size - at - 8:
            break
        if kind == FRAME_RECORD:
            payload = raw[at + 8 : at + 8 + length]
            value = int.from_bytes(payload, "little") if len(payload) == 4 else 0
            if 1 <= value <= len(FRAMES):
                frame = FRAMES[value - 1]
            else:
                notes.append("names a frame that the format does not have")
        elif kind not in _KNOWN_RECORDS:
            unknown[f"extension {kind:#010x}"] = None
        at += 8 + length
    return frame, notes, size - at, tuple(unknown)


def pack(header: Header, arrays: Mapping[str, Iterator[bytes]], comment: str = "") -> Iterator[bytes]:
    """Pack an SPZ file, in parts; equal arguments give equal bytes.

    Args:
        header: header of the file, without higher harmonics.
        comment: one line of text without a zero byte that readers ignore: the comment of the gzip header, or
            from version 4 on an extension of alula's own kind.
    """
    text = comment.encode() + b"\n" if comment else b""
    record = struct.pack("<II", COMMENT_RECORD, len(text)) + text if text and header.version == 4 else b""
    short = struct.pack(
        "<4sIIBBB", MAGIC, header.version, header.count, header.degree, header.fractional_bits, header.flags
    )
    if header.version == 4:
        import zstandard

        frames, table = [], b""
        for name, parts in arrays.items():
            raw = b"".join(parts)
            frames.append(zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress(raw))
            table += struct.pack("<QQ", len(frames[-1]), header.count * header.arrays[name])
        flags = bytes([header.flags | (HAS_EXTENSIONS if record else 0)])
        yield short[:-1] + flags + struct.pack("<BI12x", len(frames), LONG_HEADER_SIZE + len(record))
        yield record + table
        yield from frames
        return
    # The time in the header of gzip is 0, the system unknown.
    yield GZIP_MAGIC + bytes([8, 16 if text else 0, 0, 0, 0, 0, 0, 255])
    if text:
        yield text + b"\0"
    deflater = zlib.compressobj(_GZIP_LEVEL, zlib.DEFLATED, -zlib.MAX_WBITS)
    check = size = 0
    for part in chain([short + b"\0"], *arrays.values()):
        check, size = zlib.crc32(part, check), size + len(part)
        yield deflater.compress(part)
    yield deflater.flush() + struct.pack("<II", check, size % 2**32)
