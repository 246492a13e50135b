"""Splat files in pieces of bounded length, each of which is decoded without the others."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from alula.schemas.errors import ArtifactError, InputError, UsageError
from alula.stages.reconstruction.formats.registry import SOG, STREAMED_SOG, SplatFile, formats
from alula.stages.reconstruction.formats.splats import Level, Loss, Splats
from alula.stages.reconstruction.formats.streamed_sog import (
    chosen_level,
    decode_level_file,
    level_files,
    part_of_capture,
)

SUFFIXES = (".splat", ".ksplat", ".ply", ".spz", ".sog", ".glb", ".gltf")  # of the splats in a folder


@dataclass(frozen=True, slots=True)
class Piece:
    """Some Gaussians of a file that are decoded at once.

    Attributes:
        file: number of the file among all files.
        number: of the piece in its file.
        found: the file.
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

    Args:
        path: the folder.

    Raises:
        InputError: there is none.
    """
    found = sorted(file for file in path.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file())
    if not found:
        raise InputError(f"{path}: is a folder without a splat; the suffixes are {', '.join(SUFFIXES)}")
    return found


def find_splats(paths: Sequence[Path], name: str = "auto", level: int | None = None) -> list[SplatFile]:
    """Find splats; a folder that is no splat itself stands for all splats in it.

    Args:
        paths: files, folders of trainers and of formats of several files, and folders of splats.
        name: `auto`, or the name of a format.
        level: level of detail to read; None is the finest.

    Raises:
        UsageError, ArtifactError, InputError: as `SplatFile.find`; also if a file is named twice.
    """
    found: list[SplatFile] = []
    for path in paths:
        try:
            found.append(SplatFile.find(path, name, level).fresh())
        except ArtifactError:
            if not path.is_dir() or name not in ("auto", *(known.name for known in formats())):
                raise
            found += [SplatFile.find(file, name, level).fresh() for file in splats_in(path)]
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
        files: that `find_splats` found.
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

    Args:
        piece: one of `pieces_of`.

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

    Args:
        files: that `find_splats` found.

    Raises:
        UsageError, ArtifactError: an index is damaged, or a file of a level is missing.
    """
    found: dict[tuple[str, int | None], Level] = {}
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
            key = level.index, level.number
            names = dict.fromkeys((*(found[key].files if key in found else ()), *level.files))
            found[key] = dataclasses.replace(level, files=tuple(names))
    return tuple(found.values())


def sliced(splats: Splats, most: int) -> Iterator[Splats]:
    """Consecutive rows of Gaussians, at most a number at a time.

    Args:
        splats: the Gaussians.
        most: maximum number of rows.
    """
    if len(splats) <= most:
        yield splats
        return
    for first in range(0, len(splats), most):
        rows = slice(first, first + most)
        loss = splats.loss
        yield dataclasses.replace(
            splats,
            mean=splats.mean[rows],
            scale=splats.scale[rows],
            quat_wxyz=splats.quat_wxyz[rows],
            opacity=splats.opacity[rows],
            color=splats.color[rows],
            loss=None if loss is None else Loss(loss.bound[rows], loss.opacity, loss.unbounded),
        )
