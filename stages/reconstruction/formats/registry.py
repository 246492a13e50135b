"""Registry of the splat formats: their recognition, and the function that opens a splat."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

from alula.schemas.errors import ArtifactError, InputError, UsageError
from alula.schemas.progress import Progress
from alula.stages.reconstruction.formats.compressed_ply import decode_compressed_ply, is_compressed_ply
from alula.stages.reconstruction.formats.containers import check_unpacked
from alula.stages.reconstruction.formats.gltf import decode_gltf, is_gltf, members_of_gltf
from alula.stages.reconstruction.formats.ksplat import decode_ksplat, is_ksplat
from alula.stages.reconstruction.formats.means_json import decode_means_json, is_means_json
from alula.stages.reconstruction.formats.nerfstudio import (
    decode_nerfstudio,
    is_nerfstudio,
    members_of_nerfstudio,
)
from alula.stages.reconstruction.formats.ply import count_ply, decode_ply
from alula.stages.reconstruction.formats.properties import FILES, judged
from alula.stages.reconstruction.formats.sog import is_sog, sog_members
from alula.stages.reconstruction.formats.source import Source, find_source
from alula.stages.reconstruction.formats.splat import count_splat, decode_splat
from alula.stages.reconstruction.formats.splat_content import is_splat
from alula.stages.reconstruction.formats.splats import Splats
from alula.stages.reconstruction.formats.spz import decode_spz
from alula.stages.reconstruction.formats.spz_container import is_spz
from alula.stages.reconstruction.formats.streamed_sog import (
    decode_sog_file,
    decode_streamed_sog,
    is_streamed_sog,
    streamed_members,
)


def _itself(source: Source) -> Sequence[str]:
    if source.is_folder:
        raise ArtifactError("is a folder, but that format is a file; name the file in it")
    return (source.path.name,)


@dataclass(frozen=True, slots=True)
class Windows:
    """Decoding of some rows of a file without the others.

    Attributes:
        count: function from a source to its number of rows; raises ArtifactError.
        decode: function from a source and a slice of rows to their Gaussians; raises ArtifactError.
    """

    count: Callable[[Source], int]
    decode: Callable[[Source, slice], Splats]


@dataclass(frozen=True, slots=True)
class SplatFormat:
    """One format; other packages add theirs as entry points of the group `alula.formats`.

    Attributes:
        name: the value of `--format`.
        matches: test of a source by its content; where there is no magic number, also by its suffix.
        decode: function from a source to its Gaussians; raises ArtifactError.
        members: function from a source to the names of all files to read, relative to its folder, the main
            one first.
        windows: of a format with rows of known places, the number of rows and the decoder of some of them.
    """

    name: str
    matches: Callable[[Source], bool]
    decode: Callable[[Source, Progress | None], Splats]
    members: Callable[[Source], Sequence[str]] = _itself
    windows: Windows | None = None


def _of_file(
    decode: Callable[[memoryview, Progress | None], Splats],
) -> Callable[[Source, Progress | None], Splats]:
    return lambda source, progress: decode(source.data, progress)


def _ply(source: Source) -> memoryview:
    """Bytes of a PLY file, after a check that no network is beside it, without which rows mean nothing."""
    of_run = source.folder.parent.name == "point_cloud"
    names = (name for known in FILES for name in known.names if of_run or not name.startswith(".."))
    judged((name for name in names if (source.folder / name).exists()), "beside it", FILES)
    return source.data


PLY = SplatFormat(
    "ply",
    lambda source: re.match(rb"ply\s", source.head) is not None,
    lambda source, progress: decode_ply(_ply(source), progress),
    windows=Windows(
        lambda source: count_ply(_ply(source)), lambda source, rows: decode_ply(_ply(source), window=rows)
    ),
)
COMPRESSED_PLY = SplatFormat("compressed-ply", is_compressed_ply, _of_file(decode_compressed_ply))
SOG = SplatFormat("sog", is_sog, decode_sog_file, sog_members)
STREAMED_SOG = SplatFormat("streamed-sog", is_streamed_sog, decode_streamed_sog, streamed_members)
KSPLAT = SplatFormat("ksplat", is_ksplat, _of_file(decode_ksplat))
SPLAT = SplatFormat(
    "splat",
    is_splat,
    _of_file(decode_splat),
    windows=Windows(
        lambda source: count_splat(source.data), lambda source, rows: decode_splat(source.data, window=rows)
    ),
)
SPZ = SplatFormat(
    "spz", lambda source: not source.is_folder and is_spz(source.data, source.suffix), _of_file(decode_spz)
)
GLTF = SplatFormat("gltf", is_gltf, decode_gltf, members_of_gltf)
NERFSTUDIO = SplatFormat("nerfstudio", is_nerfstudio, decode_nerfstudio, members_of_nerfstudio)
MEANS_JSON = SplatFormat("json", is_means_json, _of_file(decode_means_json))

_WITH_MAGIC = (
    COMPRESSED_PLY,  # before PLY, which matches these files too
    PLY,
    SPZ,
    SOG,
    STREAMED_SOG,
    GLTF,
    NERFSTUDIO,
    MEANS_JSON,
)
_WITHOUT_MAGIC = (
    KSPLAT,
    SPLAT,  # by the suffix, or by records that are plausible
)


def formats() -> Iterator[SplatFormat]:
    """All formats: those with a magic number, those of other packages, and those without one."""
    yield from _WITH_MAGIC
    for entry in sorted(entry_points(group="alula.formats"), key=lambda entry: entry.name):
        found = entry.load()
        if not isinstance(found, SplatFormat):
            raise InputError(f"entry point {entry.name} ({entry.value}) is not a SplatFormat")
        yield found
    yield from _WITHOUT_MAGIC


def recognise(source: Source, name: str = "auto") -> SplatFormat:
    """Recognise the format of a source by its content first and its suffix second.

    Args:
        name: the name of a format, which is then taken without a test, or `auto`.

    Raises:
        UsageError: no format has that name.
        ArtifactError: the source is of no format that can be read, or an archive around one.
    """
    if name != "auto":
        known = {candidate.name: candidate for candidate in formats()}
        if name not in known:
            raise UsageError(f"--format must be auto, {', '.join(known)}, not {name!r}")
        if known[name] in _WITHOUT_MAGIC:
            check_unpacked(source)
        return known[name]
    for candidate in formats():  # entry points are loaded only if no magic number matches
        if candidate in _WITHOUT_MAGIC:
            check_unpacked(source)
        if candidate.matches(source):
            return candidate
    if source.is_folder:
        raise ArtifactError("is a folder, but of no kind that this version recognises; name a file in it")
    unmarked = " or ".join(f"--format {one.name}" for one in _WITHOUT_MAGIC)
    raise ArtifactError(
        f"not a splat file that this version recognises; --format forces one ({unmarked} for those without a "
        "magic number)"
    )


@dataclass(frozen=True, slots=True)
class SplatFile:
    """A splat that was found but not decoded yet.

    Attributes:
        path: the path that the user gave.
    """

    path: Path
    source: Source
    format: SplatFormat

    @classmethod
    def find(cls, path: Path, name: str = "auto", level: int | None = None) -> SplatFile:
        """Find a splat and recognise its format.

        Args:
            path: a file, or the folder of a trainer or of a format of several files.
            name: `auto`, or the name of a format.
            level: level of detail to read, for a format with levels; None is the finest.

        Raises:
            UsageError: no format has that name.
            ArtifactError: the splat is of no format that can be read.
            InputError: it cannot be opened.
        """
        source = find_source(path, level)
        try:
            found = cls(path, source, recognise(source, name))
        except ArtifactError as error:
            raise error.reworded(f"{path}: {error}") from error
        return found

    def fresh(self) -> SplatFile:
        """The same splat without the bytes that have been read of it, which a source keeps."""
        source = Source(self.source.path, self.source.notes, self.source.level)
        return dataclasses.replace(self, source=source)

    def files(self) -> dict[str, Path]:
        """All files to read, by role.

        Raises:
            ArtifactError: the file that names the others is damaged.
        """
        try:
            names = self.format.members(self.source)
        except ArtifactError as error:
            raise ArtifactError(f"{self.path}: {error}") from error
        roles = ["splat", *(f"splat {name}" for name in names[1:])]
        return {role: self.source.folder / name for role, name in zip(roles, names, strict=True)}

    def decode(self, progress: Progress | None = None) -> Splats:
        """Read the Gaussians.

        Raises:
            ArtifactError: the splat is damaged, or not of that format.
            InputError: it cannot be read.
        """
        try:
            splats = self.format.decode(self.source, progress)
        except ArtifactError as error:
            raise ArtifactError(f"{self.path}: {error}") from error
        return dataclasses.replace(splats, notes=(*self.source.notes, *splats.notes))


def read_splats(path: Path, name: str = "auto", progress: Progress | None = None) -> Splats:
    """Find and decode a splat.

    Args:
        path: a file, or a folder (see `SplatFile.find`).
        name: `auto`, or the name of a format.

    Raises:
        UsageError, ArtifactError, InputError: as `SplatFile.find` and `SplatFile.decode`.
    """
    return SplatFile.find(path, name).decode(progress)
