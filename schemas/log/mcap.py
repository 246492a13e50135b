"""Records of an MCAP log in the order of the file, with bounds on what a log can make its reader allocate.

The index at the end of the file is not used: it could point anywhere, and say other things than the file.
"""

from __future__ import annotations

import io
import os
import zlib
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from alula.schemas.errors import AlulaError, ArtifactError, DamagedError, InputError
from alula.schemas.files import check_no_stream, what_it_is

if TYPE_CHECKING:
    from mcap.records import Chunk, Message

MAGIC = b"\x89MCAP0\r\n"
# Uncompressed bytes that a log may have: logs of flights have at most about 20 times their compressed size.
_MOST_EXPANSION = 64
_LEAST_BUDGET = 2**26
_FOOTER, _CHANNEL, _CHUNK, _METADATA, _MESSAGE = 2, 4, 6, 12, 5
_NAMES = {_FOOTER: "the footer", _CHUNK: "a chunk", _METADATA: "metadata", _MESSAGE: "a message"}


@contextmanager
def open_log(log: Path) -> Iterator[BinaryIO]:
    """Open an MCAP log; any other error of its reader or codecs within the block means that it is damaged.

    Raises:
        InputError: the log cannot be read.
        ArtifactError: it is not an MCAP log.
        DamagedError: truncated or corrupt.
    """
    if log.is_dir():
        raise InputError(f"{log}: is a folder, not a run")
    check_no_stream(log)
    try:
        with log.open("rb") as file:
            magic = file.read(8)
            if not magic:
                raise ArtifactError(f"{log}: is empty")
            if magic != MAGIC:
                raise ArtifactError(f"{log}: is not an MCAP log{what_it_is(log)}")
            file.seek(0)
            yield file
    except AlulaError:
        raise
    except OSError as error:
        raise InputError(f"{log}: cannot read: {error.strerror or error}") from error
    except Exception as error:
        what = str(error) or type(error).__name__
        raise DamagedError(f"{log}: truncated or corrupt MCAP log ({what})") from error


def messages(file: BinaryIO, topics: Collection[str] | None = None) -> Iterator[tuple[str, bytes]]:
    """Topic and contents of each message of a whole log.

    Args:
        file: the log, at its start.
        topics: those that are wanted; None for all.

    Raises:
        ValueError: the log is truncated or damaged.
    """
    for kind, name, data in entries(file):
        if kind == "message" and (topics is None or name in topics):
            assert isinstance(data, bytes)
            yield name, data


def timed_messages(file: BinaryIO) -> Iterator[tuple[str, int, bytes]]:
    """Topic, log time [ns] and contents of each message of a whole log.

    Raises:
        ValueError: as `messages`.
    """
    for kind, topic, data, time_ns in _records(file, chunks=True):
        if kind == "message":
            assert isinstance(data, bytes)
            yield topic, time_ns, data


def metadata(file: BinaryIO, name: str) -> list[dict[str, str]]:
    """Metadata of one name in a whole log, without reading its chunks.

    Raises:
        ValueError: as `messages`.
    """
    found = []
    for kind, own_name, data in entries(file, chunks=False):
        if kind == "metadata" and own_name == name:
            assert isinstance(data, dict)
            found.append(data)
    return found


def entries(file: BinaryIO, *, chunks: bool = True) -> Iterator[tuple[str, str, bytes | dict[str, str]]]:
    """Messages and metadata in the order of the file, then an entry `end` at the footer of a whole log.

    Args:
        chunks: also read messages in chunks, and check their CRC.

    Yields:
        `message`, its topic and contents; `metadata`, its name and values; `end`.

    Raises:
        ValueError: as `messages`, after all entries before the damage.
    """
    for kind, name, data, _ in _records(file, chunks=chunks):
        yield kind, name, data


def _records(file: BinaryIO, *, chunks: bool) -> Iterator[tuple[str, str, bytes | dict[str, str], int]]:
    """As `entries`, with the log time [ns] of messages."""
    try:
        yield from _read(file, chunks=chunks)
    except ValueError:
        raise
    except Exception as error:  # the reader of MCAP and the codecs raise anything
        raise ValueError(str(error) or type(error).__name__) from error


def _read(file: BinaryIO, *, chunks: bool) -> Iterator[tuple[str, str, bytes | dict[str, str], int]]:
    from mcap.data_stream import ReadDataStream
    from mcap.records import Channel, Chunk, Message, Metadata
    from mcap.stream_reader import breakup_chunk

    size = os.fstat(file.fileno()).st_size
    budget = _LEAST_BUDGET + _MOST_EXPANSION * size
    topics: dict[int, str] = {}

    def of_message(record: Message) -> tuple[str, str, bytes, int]:
        return "message", topics.get(record.channel_id, "?"), record.data, record.log_time

    if file.read(len(MAGIC)) != MAGIC:
        raise ValueError("it does not begin like an MCAP log")
    while True:
        start = file.tell()
        head = file.read(9)
        if len(head) < 9:
            raise ValueError(f"it ends at byte {size}, without a footer")
        opcode, length = head[0], int.from_bytes(head[1:], "little")
        if length > size - start - 9:
            what = _NAMES.get(opcode, "a record")
            raise ValueError(
                f"it is cut or damaged: {what} at byte {start} reaches beyond its end, byte {size}"
            )
        if opcode == 0:
            raise ValueError(f"there is no record at byte {start}")
        if opcode not in (_CHANNEL, _MESSAGE, _METADATA, _FOOTER) and not (chunks and opcode == _CHUNK):
            file.seek(length, os.SEEK_CUR)
            continue
        if opcode == _FOOTER:
            file.seek(length, os.SEEK_CUR)
            if file.read(len(MAGIC)) != MAGIC:
                raise ValueError("it does not end like an MCAP log")
            yield "end", "", b"", 0
            return
        body = ReadDataStream(io.BytesIO(file.read(length)))
        if opcode == _CHANNEL:
            channel = Channel.read(body)
            topics[channel.id] = channel.topic
        elif opcode == _MESSAGE:
            yield of_message(Message.read(body, length))
        elif opcode == _METADATA:
            record = Metadata.read(body)
            yield "metadata", record.name, record.metadata, 0
        else:
            chunk = Chunk.read(body)
            budget -= _unpack(chunk, budget)
            for inner in breakup_chunk(chunk, validate_crc=True):
                if isinstance(inner, Channel):
                    topics[inner.id] = inner.topic
                elif isinstance(inner, Message):
                    yield of_message(inner)


def _unpack(chunk: Chunk, budget: int) -> int:
    """Decompress a chunk in place; return its length."""
    if chunk.uncompressed_size > budget:
        raise ValueError(f"a chunk of {chunk.uncompressed_size} bytes is too large for a log of this size")
    most: int = chunk.uncompressed_size
    if chunk.compression == "zstd":
        import zstandard

        if zstandard.frame_content_size(chunk.data) > most:
            raise ValueError("a chunk is longer than it says")
        chunk.data = zstandard.ZstdDecompressor().decompress(chunk.data, max_output_size=most)
    elif chunk.compression == "lz4":
        import lz4.frame

        chunk.data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most + 1)
    elif chunk.compression:
        raise ValueError(f"the compression {chunk.compression!r} is unknown")
    if len(chunk.data) != most:
        raise ValueError(f"a chunk has {len(chunk.data)} bytes, not {most} as it says")
    if chunk.uncompressed_crc and zlib.crc32(chunk.data) != chunk.uncompressed_crc:
        raise ValueError("a chunk does not match its CRC-32")
    chunk.compression = ""
    return most
