"""Which splat formats there are, how to tell them apart, and the one place that opens such a file."""

from __future__ import annotations

import io
import mmap
import re
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

from alula.schemas.errors import ArtifactError, InputError, UsageError
from alula.stages.reconstruction.ply import decode_ply
from alula.stages.reconstruction.splat import decode_splat
from alula.stages.reconstruction.splats import Progress, Splats

_HEAD = 4096


@dataclass(frozen=True, slots=True)
class SplatFormat:
    """One format; other packages add theirs as entry points of the group `alula.formats`.

    Attributes:
        name: the value of `--format`.
        matches: whether the first 4096 bytes and the lower-case suffix are this format's.
        decode: from the whole file to its Gaussians; raises ArtifactError.
    """

    name: str
    matches: Callable[[bytes, str], bool]
    decode: Callable[[memoryview, Progress | None], Splats]


PLY = SplatFormat("ply", lambda head, suffix: re.match(rb"ply\s", head) is not None, decode_ply)
SPLAT = SplatFormat("splat", lambda head, suffix: suffix == ".splat", decode_splat)


def formats() -> Iterator[SplatFormat]:
    """All formats: those with a magic number, those of other packages, and `.splat`, which has none."""
    yield PLY
    for entry in sorted(entry_points(group="alula.formats"), key=lambda entry: entry.name):
        found = entry.load()
        if not isinstance(found, SplatFormat):
            raise InputError(f"entry point {entry.name} ({entry.value}) is not a SplatFormat")
        yield found
    yield SPLAT


def recognise(buffer: memoryview, suffix: str) -> SplatFormat:
    """The format of a file, by content first and suffix second.

    Raises:
        ArtifactError: it is of a format that cannot be read, which the message names, or of none.
    """
    head = bytes(buffer[:_HEAD])
    foreign = _foreign(head, suffix, buffer)
    for candidate in formats():
        if (candidate is not SPLAT or foreign is None) and candidate.matches(head, suffix):
            return candidate
    if foreign is not None:
        raise ArtifactError(foreign)
    raise ArtifactError("not a splat file that this version recognises; --format forces one")


def _foreign(head: bytes, suffix: str, buffer: memoryview) -> str | None:
    """Why a file of a known other format is refused."""
    name = None
    if head.startswith(b"NGSP") or _inflated(head).startswith(b"NGSP"):
        name = "SPZ"
    elif head.startswith(b"PK\x03\x04"):
        members = _members(buffer)
        if members[:1] == ["manifest.json"]:
            return "is an artifact of alula, not a splat file"
        name = "SOG" if any(Path(m).name == "meta.json" for m in members) else None
    elif head.startswith(b"glTF"):
        name = "GLB (glTF)"
    elif head.lstrip()[:1] == b"{":
        if b'"means"' in head:
            name = "SOG (meta.json)"
        elif b'"asset"' in head or suffix == ".gltf":
            name = "glTF"
    elif suffix == ".ksplat" and len(buffer) >= _HEAD and head[0] == 0 and head[1] >= 1:
        name = "KSPLAT"
    return (
        f"recognised as {name}; not supported by this version, convert it to .ply or .splat" if name else None
    )


def _inflated(head: bytes) -> bytes:
    if not head.startswith(b"\x1f\x8b"):
        return b""
    try:
        return zlib.decompressobj(wbits=31).decompress(head, 4)
    except zlib.error:
        return b""


def _members(buffer: memoryview) -> list[str]:
    try:
        with zipfile.ZipFile(io.BytesIO(buffer)) as archive:
            return archive.namelist()
    except (zipfile.BadZipFile, ValueError, NotImplementedError, OSError):
        return []


def read_splats(path: Path, name: str = "auto", progress: Progress | None = None) -> Splats:
    """Map a splat file into memory and decode it.

    The one function of the stages that opens a file: formats are foreign, and a file of many
    gigabytes must not be read as a whole to use a fifth of its columns.

    Args:
        path: the file.
        name: `auto`, or the name of a format.
        progress: called with the rows done and the rows in all.

    Raises:
        UsageError: no format has that name.
        ArtifactError: damaged, or not of a format that can be read.
        InputError: the file cannot be opened.
    """
    known = {candidate.name: candidate for candidate in formats()}
    if name != "auto" and name not in known:
        raise UsageError(f"--format must be auto, {', '.join(known)}, not {name!r}")
    try:
        with path.open("rb") as file:
            file.seek(0, io.SEEK_END)
            if file.tell() == 0:
                raise ArtifactError("is empty")
            buffer = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        chosen = recognise(buffer, path.suffix.lower()) if name == "auto" else known[name]
        return chosen.decode(buffer, progress)
    except ArtifactError as error:
        raise ArtifactError(f"{path}: {error}") from error
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error
