"""PlayCanvas's streamed SOG: levels of detail, each spread over several SOG files, behind `lod-meta.json`."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from alula.schemas.errors import AlulaError, ArtifactError, UsageError
from alula.schemas.progress import Progress
from alula.stages.progress import WHOLE, share
from alula.stages.reconstruction.formats.capture import joined
from alula.stages.reconstruction.formats.sog import META, decode_sog, sog_members
from alula.stages.reconstruction.formats.sog_meta import parse_json
from alula.stages.reconstruction.formats.source import Source, relative_name
from alula.stages.reconstruction.formats.splats import Level, Splats

INDEX = "lod-meta.json"
INDEX_LIMIT = 2**24  # bytes
_DEPTH = 4  # folders above a SOG file in which its index may lie
_LISTED = 4


@dataclass(frozen=True, slots=True)
class LevelIndex:
    """Checked contents of `lod-meta.json`.

    Attributes:
        files: names of the SOG files, relative to the index.
        ranges: level to file number to ranges (first row, row after the last).
        environment: file of the environment; empty without one.
    """

    levels: int
    files: tuple[str, ...]
    ranges: dict[int, dict[int, list[tuple[int, int]]]]
    environment: str

    def of_level(self, number: int) -> tuple[str, ...]:
        """Names of the files of a level, in the order of the index."""
        return tuple(self.files[at] for at in sorted(self.ranges.get(number, {})))

    def level(self, number: int | None, files: Sequence[str], index: str) -> Level:
        """Description of files of one level; None is the environment."""
        of = tuple(files) if number is None else self.of_level(number)
        return Level(number, self.levels, tuple(files), of, self.environment, index)


def is_streamed_sog(source: Source) -> bool:
    """Test whether a source is an index of levels of detail, or a folder with one and no `meta.json`."""
    if source.is_folder:
        return source.has(INDEX) and not source.has(META)
    if source.suffix not in (".json", "") or not source.head.lstrip().startswith(b"{"):
        return False
    try:
        if len(source.data) > INDEX_LIMIT:
            return source.path.name == INDEX
        found = parse_json(bytes(source.data))
    except ArtifactError:
        return source.path.name == INDEX
    return {"lodLevels", "filenames"} <= set(found) and "means" not in found


def streamed_members(source: Source) -> Sequence[str]:
    """Names of all files to read: the index, and the files of the chosen level.

    Raises:
        UsageError: the capture has no such level.
        ArtifactError: the index is damaged, or a file of the level is missing.
    """
    index = _index(source)
    names = [INDEX if source.is_folder else source.path.name]
    for name in index.of_level(_chosen(source, index)):
        own = Source(source.folder / name)
        folder = relative_name(name).parent
        try:
            names += [str(folder / member) for member in sog_members(own)]
        except ArtifactError as error:
            raise ArtifactError(f"{name}: {error}") from error
    return names


def decode_streamed_sog(source: Source, progress: Progress | None = None) -> Splats:
    """Decode all files of one level of detail, the finest unless the source names one.

    A file may hold rows of several levels: those that only other levels list are left out. The environment
    belongs to no level and is not read.

    Args:
        source: a `lod-meta.json`, or its folder; `source.level` is the level to read.

    Raises:
        UsageError: the capture has no such level.
        ArtifactError: the index or a file is damaged, or a file of the level is missing.
    """
    names = level_files(source)
    parts = []
    for done, name in enumerate(names):
        of_file = share(progress, done / len(names), (done + 1) / len(names))
        parts.append((name, decode_level_file(source, name, of_file)))
    if progress is not None:
        progress(WHOLE, WHOLE)
    return joined(parts)


def level_files(source: Source) -> tuple[str, ...]:
    """Names of the files of the chosen level, relative to the index.

    Raises:
        UsageError: the capture has no such level.
        ArtifactError: the index is damaged, or a file of the level is missing.
    """
    index = _index(source)
    return index.of_level(_chosen(source, index))


def decode_level_file(source: Source, name: str, progress: Progress | None = None) -> Splats:
    """Decode one file of the chosen level; `levels` of the result names all files of the level.

    Raises:
        UsageError, ArtifactError: as `decode_streamed_sog`.
    """
    index = _index(source)
    number = _chosen(source, index)
    try:
        splats = decode_sog(Source(source.folder / name), progress)
        mine = _rows_of_level(index, number, index.files.index(name), splats)
    except ArtifactError as error:
        raise ArtifactError(f"{name}: {error}") from error
    return dataclasses.replace(mine, levels=(chosen_level(source, index),))


def chosen_level(source: Source, index: LevelIndex | None = None) -> Level:
    """Description of the chosen level with all of its files.

    Args:
        index: contents of the index; None reads them.

    Raises:
        UsageError, ArtifactError: as `level_files`.
    """
    index = _index(source) if index is None else index
    number = _chosen(source, index)
    path = source.folder / (INDEX if source.is_folder else source.path.name)
    return index.level(number, index.of_level(number), str(path.resolve()))


def part_of_capture(source: Source) -> tuple[Level | None, str]:
    """Level of detail that a SOG file belongs to, None where no index names it; and a note, usually empty.

    Args:
        source: a SOG file, or its folder.
    """
    of_folder = source.is_folder or source.path.name == META
    shown = (source.folder / META if of_folder else source.path).absolute()
    for places in (shown, shown.resolve()):
        for folder in list(places.parents)[:_DEPTH]:
            if not (folder / INDEX).is_file():
                continue
            name = places.relative_to(folder).as_posix()
            try:
                index = _index(Source(folder / INDEX))
            except AlulaError as error:
                words = str(error).removeprefix("SOG: ").removeprefix(f"{INDEX}: ")
                return None, f"{INDEX} cannot be read ({words}): this file may be a part of a level of detail"
            key = str((folder / INDEX).resolve())
            if name == index.environment:
                return index.level(None, (name,), key), ""
            if name in index.files:
                at = index.files.index(name)
                numbers = [number for number in sorted(index.ranges) if at in index.ranges[number]]
                if numbers:
                    return index.level(numbers[0], (name,), key), ""
    folder_name = shown.parent.name
    if of_folder and re.fullmatch(r"[0-9]+_[0-9]+", folder_name):
        return None, (
            f"the folder {folder_name} is named like a part of a level of detail, but there is no {INDEX}: "
            "if it is one, the scene lacks the other parts"
        )
    return None, ""


def decode_sog_file(source: Source, progress: Progress | None = None) -> Splats:
    """Decode a SOG file that may be a part of a capture; see `decode_sog`.

    Args:
        source: a `.sog` archive, a `meta.json`, or the folder of one.

    Raises:
        ArtifactError: a file is missing or damaged, or `meta.json` or the index is not valid.
    """
    splats = decode_sog(source, progress)
    part, note = part_of_capture(source)
    if note:
        splats = dataclasses.replace(splats, notes=(*splats.notes, note))
    return splats if part is None else dataclasses.replace(splats, levels=(part,))


def _rows_of_level(index: LevelIndex, number: int, at: int, splats: Splats) -> Splats:
    """Rows of a file without those that only other levels list."""
    keep = np.ones(len(splats), np.bool_)
    for level in (*(other for other in index.ranges if other != number), number):
        for first, end in index.ranges[level].get(at, ()):
            if end > len(splats):
                raise ArtifactError(
                    f"SOG: has {len(splats)} Gaussians, but the index lists rows {first} to {end - 1}"
                )
            keep[first:end] = level == number
    return splats if keep.all() else splats.part(keep)


def _chosen(source: Source, index: LevelIndex) -> int:
    """Level to read, after a check that all of its files are there."""
    number = 0 if source.level is None else source.level
    if not 0 <= number < index.levels:
        raise UsageError(f"--lod must be between 0 and {index.levels - 1}, not {number}")
    names = index.of_level(number)
    if not names:
        raise ArtifactError(f"SOG: level of detail {number} has no files{_whole_levels(source, index)}")
    missing = [name for name in names if not source.has(name)]
    if missing:
        some = ", ".join(missing[:_LISTED]) + (", ..." if len(missing) > _LISTED else "")
        raise ArtifactError(
            f"SOG: {len(missing)} of the {len(names)} files of level of detail {number} are missing ({some})"
            f"{_whole_levels(source, index)}"
        )
    return number


def _whole_levels(source: Source, index: LevelIndex) -> str:
    whole = [
        str(number)
        for number in range(index.levels)
        if (names := index.of_level(number)) and all(source.has(name) for name in names)
    ]
    return (
        f"; levels with all files: {', '.join(whole)} (--lod {whole[0]})"
        if whole
        else "; no level has all files"
    )


def _index(source: Source) -> LevelIndex:
    raw = source.member(INDEX) if source.is_folder else source.data
    if len(raw) > INDEX_LIMIT:
        raise ArtifactError(f"SOG: {INDEX} has {len(raw)} bytes, more than {INDEX_LIMIT}")
    return parse_index(bytes(raw))


def parse_index(raw: bytes) -> LevelIndex:
    """Check and read `lod-meta.json`.

    Args:
        raw: the text in UTF-8.

    Raises:
        ArtifactError: a value is wrong; the message names it.
    """
    found = parse_json(raw, INDEX)
    version = found.get("version", 1)
    if type(version) is not int or version != 1:
        raise ArtifactError(f"SOG: {INDEX}: version {str(version)[:20]} is not supported, only 1")
    levels = _whole(found.get("lodLevels"), "lodLevels", 1, 64)
    names = found.get("filenames")
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise ArtifactError(f"SOG: {INDEX}: filenames must be a list of names")
    files = tuple(str(relative_name(name)) for name in names)
    if len(set(files)) < len(files):
        raise ArtifactError(f"SOG: {INDEX}: filenames names a file twice")
    environment = found.get("environment") or ""
    if not isinstance(environment, str):
        raise ArtifactError(f"SOG: {INDEX}: environment is no name of a file")
    environment = str(relative_name(environment)) if environment else ""
    return LevelIndex(levels, files, _ranges(found.get("tree"), levels, len(files)), environment)


def _ranges(tree: Any, levels: int, files: int) -> dict[int, dict[int, list[tuple[int, int]]]]:
    """Ranges of rows by level and file, from the leaves of the tree."""
    ranges: dict[int, dict[int, list[tuple[int, int]]]] = {number: {} for number in range(levels)}
    left = [tree]
    while left:
        node = left.pop()
        if not isinstance(node, dict) or not isinstance(node.get("children") or [], list):
            raise ArtifactError(
                f"SOG: {INDEX}: tree has a node that is no object, or whose children are no list"
            )
        left += node.get("children") or []
        lods = node.get("lods") or {}
        if not isinstance(lods, dict):
            raise ArtifactError(f"SOG: {INDEX}: lods of a node of the tree is no object")
        for key, entry in lods.items():
            number = _whole(
                int(key) if key.isdecimal() and len(key) < 4 else None, "a level of lods", 0, levels - 1
            )
            if not isinstance(entry, dict):
                raise ArtifactError(f"SOG: {INDEX}: level {number} of a node of the tree is no object")
            at = _whole(entry.get("file"), "lods.file", 0, files - 1)
            first = _whole(entry.get("offset"), "lods.offset", 0, 2**32)
            count = _whole(entry.get("count"), "lods.count", 0, 2**32)
            if count:
                ranges[number].setdefault(at, []).append((first, first + count))
    return ranges


def _whole(value: object, where: str, lowest: int, highest: int) -> int:
    if type(value) is not int or not lowest <= value <= highest:
        raise ArtifactError(f"SOG: {INDEX}: {where} must be a whole number from {lowest} to {highest}")
    return value
