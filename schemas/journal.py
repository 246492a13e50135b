"""Journals: what an interrupted command had done, and which command that was."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import msgspec

from alula.schemas.errors import DamagedError, VersionError
from alula.schemas.provenance import Provenance, differences

SUFFIX = ".journal"
_VERSION = 1
_START = struct.Struct("<4sII")  # magic, version, CRC-32 of all that follows
_SIZES = struct.Struct("<IQ")  # bytes of JSON and of measurements
_HEAD = _START.size + _SIZES.size


@dataclass(frozen=True, slots=True)
class JournalKind:
    """Whose journal: the first bytes of the file, what is interrupted, and what it has done so far."""

    magic: bytes
    command: str
    done: str


MERGE = JournalKind(b"ALMJ", "merge", "measurements")
TRIALS = JournalKind(b"ALTJ", "run", "trials")
MAGIC = MERGE.magic


def pack(provenance: Provenance, measured: bytes, kind: JournalKind = MERGE) -> bytes:
    """The file: the provenance of the output that was being made, and what was done, as bytes."""
    record = msgspec.json.encode(provenance, order="sorted")
    rest = _SIZES.pack(len(record), len(measured)) + record + measured
    return _START.pack(kind.magic, _VERSION, zlib.crc32(rest)) + rest


def unpack(raw: bytes, kind: JournalKind = MERGE) -> tuple[Provenance, bytes]:
    """What `pack` was given.

    Raises:
        VersionError: it was written by another version of this format.
        DamagedError: it is no journal, or its bytes are not those that were written.
    """
    if not raw.startswith(kind.magic):
        raise DamagedError(f"it is no journal of a {kind.command}")
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
        provenance = msgspec.json.decode(raw[_HEAD : _HEAD + length], type=Provenance)
    except msgspec.MsgspecError as error:
        raise DamagedError("it is damaged") from error
    return provenance, raw[_HEAD + length :]


def strangeness(recorded: Provenance, wanted: Provenance) -> list[str]:
    """In a few words each, why a journal is not of the output that is wanted; empty when it is.

    Unlike an output, a journal is only of use to the very program that wrote it, commit included.
    """
    found = differences(recorded, wanted)
    if not found and recorded.producer != wanted.producer:
        found.append(f"it was written by commit {recorded.producer.commit}")
    return found
