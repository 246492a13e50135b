"""Provenance of outputs in all formats, and the test whether an output is current."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import re
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from alula.schemas.artifacts.manifest import InputRef, Manifest, Producer, producer
from alula.schemas.decode import MalformedError, decode_json, json_decoder
from alula.schemas.errors import InputError
from alula.schemas.files import is_special
from alula.schemas.log.mcap import MAGIC, metadata

MARK = "alula-provenance: "
RUN_METADATA = "alula/summary"
_SEARCHED_BYTES = 2**20
_MANIFEST_LIMIT = 2**26
_MOST_PDF = 2**28
_MOST_PICTURE = 2**30  # [B]
_MOST_JSON = 2**30  # [B], read at once
_MOST_MAP = 2**28  # [B]
_NOT_JSON = (msgspec.MsgspecError, ValueError, RecursionError)  # errors of skipping through arbitrary bytes


class Provenance(msgspec.Struct, frozen=True, kw_only=True):
    """Program, parameters and inputs of an output; equal provenance means an equal output.

    Text formats hold it as JSON behind `MARK` in one line, JSON files under the key `provenance`, GLB files
    under `asset.extras.provenance`, array artifacts in their manifest, MCAP logs in their metadata, and
    onboard maps in a line after the image.

    Attributes:
        schema: kind of the output.
        version: of the kind.
        producer: the program that wrote it.
        parameters: of the command, defaults included.
        seed: of the random numbers; null without any.
        inputs: the files that it was made from.
        summary: counts and sizes for people.
    """

    schema: str
    version: str
    producer: Producer
    parameters: dict[str, Any]
    seed: int | None
    inputs: list[InputRef]
    summary: dict[str, Any] = {}

    @classmethod
    def now(
        cls,
        schema: str,
        version: str,
        parameters: dict[str, Any],
        seed: int | None,
        inputs: Sequence[InputRef],
    ) -> Provenance:
        """Provenance of an output that this program makes now.

        Args:
            parameters: all parameters that the output depends on, as plain JSON values.
            inputs: all files that the output depends on, in any order.
        """
        return cls(
            schema=schema,
            version=version,
            producer=producer(),
            parameters=parameters,
            seed=seed,
            inputs=sorted(inputs),
        )

    def line(self, summary: dict[str, Any] | None = None) -> str:
        """Encode as one line of text, which `read_provenance` can read.

        Args:
            summary: figures of the output to record too.
        """
        record = msgspec.structs.replace(self, summary=self.summary | (summary or {}))
        return MARK + msgspec.json.encode(record, order="sorted").decode()


def in_ascii(line: str) -> str:
    """Escape all characters beyond ASCII in JSON text, for files whose metadata is ASCII."""
    return "".join(
        mark if ord(mark) < 128 else "".join(f"\\u{unit:04x}" for unit in _utf16(mark)) for mark in line
    )


def _utf16(mark: str) -> list[int]:
    raw = mark.encode("utf-16-be", "surrogatepass")
    return [int.from_bytes(raw[at : at + 2], "big") for at in range(0, len(raw), 2)]


def parameters_of(config: Any) -> dict[str, Any]:
    """Convert a configuration dataclass to the plain JSON values that a manifest records."""
    # A round trip through JSON turns tuples into lists, as they are when read back and compared.
    return msgspec.json.decode(msgspec.json.encode(dataclasses.asdict(config)), type=dict[str, Any])


def differences(recorded: Provenance, wanted: Provenance) -> list[str]:
    """Differences between two provenances, as short phrases; empty when the recorded output is current.

    The producer's version counts, its commit does not. Hashes of inputs count, file names do not.
    """
    found = []
    if recorded.schema != wanted.schema:
        return [f"it is {recorded.schema}, not {wanted.schema}"]
    if (recorded.version, recorded.producer.version) != (wanted.version, wanted.producer.version):
        found.append(f"it was written by version {recorded.producer.version}")
    for key in sorted(recorded.parameters.keys() | wanted.parameters.keys()):
        old, new = recorded.parameters.get(key), wanted.parameters.get(key)
        if old != new:
            found.append(f"{key} was {json.dumps(old)}, now {json.dumps(new)}")
    if recorded.seed != wanted.seed:
        found.append(f"seed was {recorded.seed}, now {wanted.seed}")
    old_inputs = [(ref.role, ref.sha256) for ref in recorded.inputs]
    if old_inputs != [(ref.role, ref.sha256) for ref in wanted.inputs]:
        found.append("its inputs were different")
    return found


class _Carrier(msgspec.Struct, frozen=True):
    """The provenance of a JSON file as text; the decoder skips everything else."""

    provenance: msgspec.Raw = msgspec.Raw(b"null")


class _Listed(msgspec.Struct, frozen=True):
    i: int
    j: int
    sha256: str


class _Listing(_Carrier, frozen=True, kw_only=True):
    sha256: str
    tiles: list[_Listed]


class _Asset(msgspec.Struct, frozen=True):
    extras: _Carrier = _Carrier()


class _Gltf(msgspec.Struct, frozen=True):
    """The same of a GLB file."""

    asset: _Asset = _Asset()


def read_provenance(path: Path, *, verify: bool = False) -> Provenance | None:
    """Read the provenance of a file; None when it has none that can be read.

    Args:
        path: the file, of any format, an artifact in parts, or a map in tiles.
        verify: also check the content of array artifacts, onboard maps and tiles; damaged ones give None.
    """
    if is_special(path):
        return None
    try:
        if path.is_dir():
            return _of_parts(path, verify)
        with path.open("rb") as file:
            head = file.read(8)
            if head.startswith(b"PK\x03\x04"):
                return _of_artifact(path, verify)
            if head == MAGIC:
                return _of_mcap(path)
            if head.startswith(b"glTF"):
                return _of_glb(path)
            if head.startswith(b"ALMP"):
                return _of_map(path, verify)
            rest = file.read(_SEARCHED_BYTES)
    except (OSError, InputError):
        return None
    raw = head + rest
    if head.startswith(b"%PDF"):
        return _of_pdf(path)
    if head == b"\x89PNG\r\n\x1a\n":
        return _of_png(raw)
    if head.startswith((b"GIF8", b"RIFF")):
        return _of_moving_picture(path)
    if path.suffix == ".json" or head.startswith(b"{"):
        return _of_tiles(path) if verify and path.name == "tiles.json" else _of_json(path)
    return _of_text(raw)


def _of_tiles(path: Path) -> Provenance | None:
    """Read from the index of a map in tiles, as of `schemas.artifacts.tiles`, if all its files are whole."""
    try:
        index = json_decoder(_Listing).decode(path.read_bytes())
        listed = {
            "tiles.bin": index.sha256,
            **{f"tile_{one.i}_{one.j}.bin": one.sha256 for one in index.tiles},
        }
        for name, sha256 in listed.items():
            if hashlib.sha256((path.parent / name).read_bytes()).hexdigest() != sha256:
                return None
    except (OSError, *_NOT_JSON):
        return None
    return _decode(bytes(index.provenance))


def _of_text(raw: bytes) -> Provenance | None:
    mark = raw.find(MARK.encode())
    if mark < 0:
        return None
    line = raw[mark + len(MARK) :].splitlines()[0]
    end = line.rfind(b"}") + 1
    return _decode(line[:end])


def _of_png(raw: bytes) -> Provenance | None:
    """Read from the text chunk of a PNG: its length, its kind, its contents."""
    mark = raw.find(MARK.encode())
    chunk = raw.rfind(b"tEXt", 0, max(mark, 0))
    if mark < 0 or chunk < 4:
        return None
    return _of_text(raw[mark : chunk + 4 + int.from_bytes(raw[chunk - 4 : chunk], "big")])


def _of_moving_picture(path: Path) -> Provenance | None:
    """Read from the comment of a GIF, or the XMP data of a WebP."""
    if path.stat().st_size > _MOST_PICTURE:
        return None
    raw = path.read_bytes()
    return _of_text(_gif_comment(raw) if raw.startswith(b"GIF8") else _webp_chunk(raw, b"XMP "))


def _gif_comment(raw: bytes) -> bytes:
    """Text of the comment before the first image; empty without one.

    Behind the header and its colours stand extensions: 21, a kind, and blocks, each after its length, the
    last one empty.
    """
    at = 13 + (3 * 2 ** (1 + raw[10] % 8) if len(raw) > 13 and raw[10] >= 0x80 else 0)
    while raw[at : at + 1] == b"\x21":
        is_comment, found, at = raw[at + 1 : at + 2] == b"\xfe", b"", at + 2
        while at < len(raw) and (length := raw[at]):
            found += raw[at + 1 : at + 1 + length]
            at += 1 + length
        if is_comment:
            return found
        at += 1
    return b""


def _webp_chunk(raw: bytes, kind: bytes) -> bytes:
    """Contents of the first chunk of a kind; empty without one."""
    at = 12
    while at + 8 <= len(raw):
        length = int.from_bytes(raw[at + 4 : at + 8], "little")
        if raw[at : at + 4] == kind:
            return raw[at + 8 : at + 8 + length]
        at += 8 + length + length % 2
    return b""


def _of_pdf(path: Path) -> Provenance | None:
    """Read from the keywords of a PDF, near its end; its strings escape backslashes and brackets."""
    if path.stat().st_size > _MOST_PDF:
        return None
    raw = path.read_bytes()
    mark = raw.rfind(MARK.encode())
    return None if mark < 0 else _of_text(re.sub(rb"\\(.)", rb"\1", raw[mark:]))


def _of_artifact(path: Path, verify: bool) -> Provenance | None:
    from alula.schemas.artifacts.artifact import read_artifact, read_manifest

    return of_manifest(read_artifact(path).manifest if verify else read_manifest(path))


def _of_parts(path: Path, verify: bool) -> Provenance | None:
    from alula.schemas.artifacts.parts import is_parts, open_parts

    if not is_parts(path):
        return None
    parts = open_parts(path)
    if verify:
        parts.check()
    return of_manifest(parts.manifest)


def of_manifest(manifest: Manifest) -> Provenance:
    """Provenance of an array artifact."""
    return Provenance(
        schema=manifest.schema,
        version=manifest.version,
        producer=manifest.producer,
        parameters=manifest.parameters,
        seed=manifest.seed,
        inputs=manifest.inputs,
        summary=manifest.summary,
    )


def _of_json(path: Path) -> Provenance | None:
    try:
        if path.stat().st_size > _MOST_JSON:
            return None
        return _decode(bytes(json_decoder(_Carrier).decode(path.read_bytes()).provenance))
    except (OSError, *_NOT_JSON):
        return None


def _of_glb(path: Path) -> Provenance | None:
    with path.open("rb") as file:
        length = int.from_bytes(file.read(20)[12:16], "little")
        if length > _MANIFEST_LIMIT:
            return None
        try:
            found = json_decoder(_Gltf).decode(file.read(length))
        except _NOT_JSON:
            return None
        return _decode(bytes(found.asset.extras.provenance))


def _of_map(path: Path, verify: bool) -> Provenance | None:
    """Read from behind the image of an onboard map; its header has its length and the CRC-32 of its parts."""
    if path.stat().st_size > _MOST_MAP:
        return None
    raw = path.read_bytes()
    total = int.from_bytes(raw[16:20], "little")
    if len(raw) < total or total < 64:
        return None
    parts = ((raw[:60], raw[60:64]), (raw[64:total], raw[20:24]))
    if verify and any(zlib.crc32(part) != int.from_bytes(crc, "little") for part, crc in parts):
        return None
    return _of_text(raw[total:])


def _of_mcap(path: Path) -> Provenance | None:
    try:
        with path.open("rb") as file:
            found = metadata(file, RUN_METADATA)
    except (OSError, ValueError):
        return None
    return _decode(found[0].get("provenance", "").encode()) if found else None


def _decode(raw: bytes) -> Provenance | None:
    try:
        return decode_json(raw, Provenance)
    except MalformedError:
        return None
