"""Readable parts of a damaged artifact."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from alula.schemas.decode import MalformedError, decode_json
from alula.schemas.files import reading

_HEADER = struct.Struct("<4s5H3I2H")
_STEP = 2**22
_MAX_MANIFEST = 2**26


@dataclass(frozen=True, slots=True)
class Salvage:
    """The readable parts of an artifact file.

    Attributes:
        manifest: as stored, not validated; None if it cannot be read.
        whole: names of members that match their checksum.
        damaged: names of members that do not match it.
        cut: name of the member in which the file ends; empty if it ends after all members.
    """

    manifest: dict[str, Any] | None
    whole: tuple[str, ...]
    damaged: tuple[str, ...]
    cut: str

    def words(self) -> str:
        """Describe the damage in words."""
        parts = []
        if self.cut:
            parts.append(f"the file ends inside {self.cut}")
        if self.damaged:
            parts.append(f"{', '.join(self.damaged)} does not match its checksum")
        if self.whole:
            parts.append(f"whole: {', '.join(self.whole)}")
        return "; ".join(parts) or "no part of it can be read"


def is_artifact_like(path: Path) -> bool:
    """Return True if a file begins like an artifact, whatever follows.

    Raises:
        InputError: the file cannot be read.
    """
    with reading(path), path.open("rb") as file:
        raw = file.read(_HEADER.size + len("manifest.json"))
    if not raw.startswith(b"PK\x03\x04"):
        return False
    return len(raw) < _HEADER.size + 13 or raw[_HEADER.size :] == b"manifest.json"


def salvage(path: Path) -> Salvage:
    """Read the members of an artifact from its start, without the directory at its end.

    Raises:
        InputError: the file cannot be read at all.
    """
    manifest: dict[str, Any] | None = None
    whole: list[str] = []
    damaged: list[str] = []
    cut = ""
    with reading(path):
        size = path.stat().st_size
        with path.open("rb") as file:
            while True:
                raw = file.read(_HEADER.size)
                if not raw.startswith(b"PK\x03\x04") or len(raw) < _HEADER.size:
                    break
                fields = _HEADER.unpack(raw)
                checksum, length, name_length, extra_length = fields[6], fields[8], fields[9], fields[10]
                name = file.read(name_length).decode("ascii", errors="replace")
                extra = file.read(extra_length)
                if length == 0xFFFFFFFF and len(extra) >= 20 and extra[:2] == b"\x01\x00":
                    length = struct.unpack_from("<Q", extra, 4)[0]
                if file.tell() + length > size:
                    cut = name
                    break
                keep = name == "manifest.json" and length <= _MAX_MANIFEST
                text, found = bytearray(), 0
                for begin in range(0, length, _STEP):
                    block = file.read(min(_STEP, length - begin))
                    found = zlib.crc32(block, found)
                    if keep:
                        text += block
                (whole if found == checksum else damaged).append(name.removesuffix(".npy"))
                if keep:
                    manifest = _decode(bytes(text))
    return Salvage(manifest, tuple(whole), tuple(damaged), cut.removesuffix(".npy"))


def _decode(raw: bytes) -> dict[str, Any] | None:
    try:
        return decode_json(raw, dict[str, Any])
    except MalformedError:
        return None
