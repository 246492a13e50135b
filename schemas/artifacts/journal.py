"""Journals: results of an interrupted command and the provenance of its output."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import msgspec

from alula.schemas.artifacts.provenance import Provenance, differences
from alula.schemas.decode import MalformedError, decode_json
from alula.schemas.errors import DamagedError, VersionError

SUFFIX = ".journal"
_VERSION = 1
_START = struct.Struct("<4sII")  # magic, version, CRC-32 of all following bytes
_SIZES = struct.Struct("<IQ")  # bytes of JSON and of measurements
_HEAD = _START.size + _SIZES.size


@dataclass(frozen=True, slots=True)
class JournalKind:
    """Kind of a journal.

    Attributes:
        magic: first bytes of the file.
        command: name of the interrupted command, for messages.
        done: name of its results, for messages.
    """

    magic: bytes
    command: str
    done: str


MERGE = JournalKind(b"ALMJ", "merge", "measurements")
TRIALS = JournalKind(b"ALTJ", "run", "trials")
MAGIC = MERGE.magic


def pack(provenance: Provenance, measured: bytes, kind: JournalKind = MERGE) -> bytes:
    """Encode a journal.

    Returns:
        Contents of the file.
    """
    record = msgspec.json.encode(provenance, order="sorted")
    rest = _SIZES.pack(len(record), len(measured)) + record + measured
    return _START.pack(kind.magic, _VERSION, zlib.crc32(rest)) + rest


def unpack(raw: bytes, kind: JournalKind = MERGE) -> tuple[Provenance, bytes]:
    """Decode a journal.

    Returns:
        Provenance and results, as given to `pack`.

    Raises:
        VersionError: the file has another version of this format.
        DamagedError: the file is not a journal, is truncated, or does not match its checksum.
    """
    if not raw.startswith(kind.magic):
        raise DamagedError(f"it is not a journal of a {kind.command}")
    if len(raw) < _HEAD:
        raise DamagedError("it is cut off")
    _, version, crc = _START.unpack_from(raw)
    length, size = _SIZES.unpack_from(raw, _START.size)
    if version != _VERSION:
        raise VersionError(f"it has version {version} of its format, not {_VERSION}")
    if len(raw) != _HEAD + length + size:
        raise DamagedError("it is cut off")
    if zlib.crc32(memoryview(raw)[_START.size :]) != crc:
        raise DamagedError("it is damaged")
    try:
        provenance = decode_json(raw[_HEAD : _HEAD + length], Provenance)
    except MalformedError as error:
        raise DamagedError("it is damaged") from error
    return provenance, raw[_HEAD + length :]


def mismatches(recorded: Provenance, expected: Provenance) -> list[str]:
    """Reasons why a journal does not belong to an output, a few words each; empty if it does.

    Unlike an output, a journal can be used only by the commit of the program that wrote it.
    """
    found = differences(recorded, expected)
    if not found and recorded.producer != expected.producer:
        found.append(f"it was written by commit {recorded.producer.commit}")
    return found
