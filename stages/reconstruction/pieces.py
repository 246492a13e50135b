"""Splat files in pieces of bounded length, each of which is decoded without the others."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from alula.schemas.errors import ArtifactError, InputError, UsageError
from alula.stages.reconstruction.formats.capture import merged_levels
from alula.stages.reconstruction.formats.registry import SOG, STREAMED_SOG, SplatFile, formats
from alula.stages.reconstruction.formats.sog import META
from alula.stages.reconstruction.formats.source import Source
from alula.stages.reconstruction.formats.splats import Level, Splats
from alula.stages.reconstruction.formats.streamed_sog import (
    INDEX,
    chosen_level,
    decode_level_file,
    level_files,
    part_of_capture,
)

_DEPTH = 3  # folders below a folder of splats in which others are looked for
_LISTED = 4  # maximum number of folders that a note names
SUFFIXES = (".splat", ".ksplat", ".ply", ".spz", ".sog", ".glb", ".gltf")  # of the splats in a folder


@dataclass(frozen=True, slots=True)
class Piece:
    """Some Gaussians of a file that are decoded at once.

    Attributes:
        file: number of the file among all files.
        rows: rows of the file; None for all of them.
        member: name of the file of a streamed SOG; empty for other formats.
    """

    file: int
    number: int
    found: SplatFile
    rows: slice | None = None
    member: str = ""


def splats_in(path: Path) -> list[Path]:
    """Splat files directly in a folder, by their suffix and in the order of their names.

    Raises:
        InputError: there is none.
    """
    found = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())
    if not found:
        over = passed_over(path)
        raise InputError(
            f"{path}: is a folder without a splat; the suffixes are {', '.join(SUFFIXES)}"
            + (f"; {over}: name them" if over else "")
        )
    return found


def passed_over(path: Path) -> str:
    """Phrase about the folders in a folder of splats that hold splats too, which nobody reads; or nothing."""
    found = []
    for folder in sorted(child for child in path.iterdir() if child.is_dir()):
        depth = len(folder.parts)
        for place, folders, names in os.walk(folder):
            if len(Path(place).parts) - depth >= _DEPTH:
                folders.clear()
            if INDEX in names or META in names or any(Path(n).suffix.lower() in SUFFIXES for n in names):
                found.append(folder.name)
                break
    if not found:
        return ""
    more = f" and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
    several = "folders" if len(found) > 1 else "folder"
    return f"{len(found)} {several} with splats ({', '.join(found[:_LISTED])}{more}) were not read"


def find_splats(paths: Sequence[Path], name: str = "auto", level: int | None = None) -> list[SplatFile]:
    """Find splats; a folder that is no splat itself stands for all splats in it.

    A note of the first splat of such a folder names the folders with splats in it, which are not read.

    Args:
        paths: files, folders of trainers and of formats of several files, and folders of splats.
        name: `auto`, or the name of a format.
        level: level of detail to read of those with levels; None is the finest.

    Raises:
        UsageError, ArtifactError, InputError: as `SplatFile.find`; also if a file is named twice, or a level
            is given and no file has levels.
    """
    found: list[SplatFile] = []
    for path in paths:
        try:
            found.append(SplatFile.find(path, name, level).fresh())
        except ArtifactError:
            if not path.is_dir() or name not in ("auto", *(known.name for known in formats())):
                raise
            inside = [SplatFile.find(file, name, level).fresh() for file in splats_in(path)]
            if over := passed_over(path):
                first = inside[0]
                words = f"in the folder {path.name}, {over}; name them too if they belong to the scene"
                source = Source(first.source.path, (*first.source.notes, words), first.source.level)
                inside[0] = dataclasses.replace(first, source=source)
            found += inside
    if level is not None and not any(one.format is STREAMED_SOG for one in found):
        raise UsageError(
            f"{found[0].path}: --lod is for lod-meta.json; {found[0].format.name} has no levels of detail"
        )
    seen: set[Path] = set()
    for one in found:
        if (real := one.source.path.resolve()) in seen:
            raise UsageError(f"{one.path}: is named twice")
        seen.add(real)
    return found


def pieces_of(files: Sequence[SplatFile], most: int) -> Iterator[Piece]:
    """Divide files into pieces, in their order.

    Files whose rows have known places are divided into pieces of at most `most` rows, a streamed SOG into its
    files. Of other formats a file is one piece, however long it is.

    Args:
        most: maximum number of rows.

    Raises:
        ArtifactError: a header or an index is damaged.
    """
    for at, each in enumerate(files):
        found = each.fresh()
        try:
            if found.format is STREAMED_SOG:
                for number, member in enumerate(level_files(found.source)):
                    yield Piece(at, number, each, member=member)
            elif found.format.windows is not None:
                rows = found.format.windows.count(found.source)
                for number, first in enumerate(range(0, rows, most)):
                    yield Piece(at, number, each, slice(first, min(first + most, rows)))
            else:
                yield Piece(at, 0, each)
        except ArtifactError as error:
            raise ArtifactError(f"{found.path}: {error}") from error


def decode_piece(piece: Piece) -> Splats:
    """Decode a piece.

    Raises:
        ArtifactError: the file is damaged.
        InputError: it cannot be read.
    """
    found = piece.found.fresh()
    if piece.rows is None and not piece.member:
        return found.decode()
    try:
        if piece.member:
            splats = decode_level_file(found.source, piece.member)
        else:
            assert found.format.windows is not None
            splats = found.format.windows.decode(found.source, piece.rows or slice(None))
    except ArtifactError as error:
        raise ArtifactError(f"{found.path}: {error}") from error
    return dataclasses.replace(splats, notes=(*found.source.notes, *splats.notes))


def levels_of(files: Sequence[SplatFile]) -> tuple[Level, ...]:
    """Levels of detail that files belong to, without decoding them.

    Raises:
        UsageError, ArtifactError: an index is damaged, or a file of a level is missing.
    """
    found = []
    for one in files:
        source, level = one.fresh().source, None
        try:
            if one.format is SOG:
                level, _ = part_of_capture(source)
            elif one.format is STREAMED_SOG:
                level = chosen_level(source)
        except ArtifactError as error:
            raise ArtifactError(f"{one.path}: {error}") from error
        if level is not None:
            found.append(level)
    return merged_levels(found)


def sliced(splats: Splats, most: int) -> Iterator[Splats]:
    """Consecutive rows of Gaussians, at most a number at a time.

    Args:
        most: maximum number of rows.
    """
    if len(splats) <= most:
        yield splats
        return
    for first in range(0, len(splats), most):
        yield splats.part(slice(first, first + most))
