"""Parts of a capture: levels of detail that are spread over several files."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from alula.schemas.errors import ArtifactError
from alula.stages.reconstruction.formats.splats import Level, Loss, Properties, Splats

_LISTED = 3  # maximum number of files, or of reasons, that a phrase names
_COMMENTS = 100


def level_facts(levels: Sequence[Level]) -> list[dict[str, object]]:
    """Facts about the levels of detail that Gaussians come from, for a manifest."""
    return [
        {"level": one.number, "levels": one.levels, "files": len(one.files), "files_of_level": len(one.of)}
        for one in levels
    ]


def missing_files(levels: Sequence[Level]) -> list[str]:
    """Phrases that name files of the same levels of detail that were not read; empty for whole levels."""
    words = []
    for one in levels:
        others = [name for name in one.of if name not in one.files]
        if one.number is None:
            if not any(two.index == one.index and two.number is not None for two in levels):
                words.append("everything but the environment of a capture")
        elif others:
            words.append(
                f"{len(others)} of the {len(one.of)} files of level of detail {one.number} ({_some(others)})"
            )
    return words


def lacking(levels: Sequence[Level]) -> list[str]:
    """Phrases that name what the Gaussians of some levels of detail lack of their capture."""
    words = missing_files(levels)
    for index in dict.fromkeys(one.index for one in levels):
        mine = [one for one in levels if one.index == index]
        numbers = [one.number for one in mine if one.number is not None]
        if numbers and (finest := min(numbers)) > 0:
            words.append(f"what levels of detail finer than {finest} show (0 is the finest)")
        environment = mine[0].environment
        if environment and all(one.number is not None for one in mine):
            words.append(f"the environment of the capture ({environment})")
    return words


def _some(names: Sequence[str]) -> str:
    more = ", ..." if len(names) > _LISTED else ""
    return ", ".join(names[:_LISTED]) + more


def joined(parts: Sequence[tuple[str, Splats]]) -> Splats:
    """Join the Gaussians of several files in order.

    Values do not change. A tag is kept where all files that state it agree; the frame of files that disagree
    becomes `several`, with a note. Loss bounds stay those of each file.

    Args:
        parts: name and Gaussians of each file, at least one.

    Raises:
        ArtifactError: there are too many Gaussians for the index of a row.
    """
    names, splats = [name for name, _ in parts], [one for _, one in parts]
    if len(splats) == 1:
        return splats[0]
    if sum(map(len, splats)) >= 2**32:
        raise ArtifactError(f"the {len(splats)} files have more than {2**32 - 1:,} Gaussians together")
    notes = [f"{name}: {note}" for name, one in parts for note in one.notes]
    tags: dict[str, str] = {}
    for key in sorted({key for one in splats for key in one.tags}):
        values = list(dict.fromkeys(one.tags.get(key, "unnamed") for one in splats))
        if len(values) == 1:
            tags[key] = values[0]
        elif key == "frame":
            tags[key] = "several"
            notes.append(f"the files state different frames ({', '.join(values)}); none was turned")
    comments = dict.fromkeys(text for one in splats for text in one.comments)
    return Splats(
        format=" + ".join(dict.fromkeys(one.format for one in splats)),
        mean=np.concatenate([one.mean for one in splats]),
        scale=np.concatenate([one.scale for one in splats]),
        quat_wxyz=np.concatenate([one.quat_wxyz for one in splats]),
        opacity=np.concatenate([one.opacity for one in splats]),
        color=np.concatenate([one.color for one in splats]),
        loss=_joined_loss(names, splats),
        comments=tuple(comments)[:_COMMENTS],
        tags=tags,
        notes=tuple(notes),
        levels=merged_levels(level for one in splats for level in one.levels),
        properties=_joined_properties(names, splats),
    )


def _joined_properties(names: Sequence[str], splats: Sequence[Splats]) -> Properties:
    """Properties of all files; a sentence that not all files share names its files."""
    applied: dict[str, list[str]] = {}
    for name, one in zip(names, splats, strict=True):
        for sentence in one.properties.applied:
            applied.setdefault(sentence, []).append(name)
    sentences = [
        sentence if len(of) == len(splats) else f"{_some(of)}: {sentence}" for sentence, of in applied.items()
    ]
    unknown = dict.fromkeys(name for one in splats for name in one.properties.unknown)
    return Properties(tuple(sentences), tuple(unknown))


def _joined_loss(names: Sequence[str], splats: Sequence[Splats]) -> Loss | None:
    if all(one.loss is None for one in splats):
        return None
    bound = np.concatenate(
        [np.zeros((len(one), 3), np.float32) if one.loss is None else one.loss.bound for one in splats]
    )
    whys: dict[str, list[str]] = {}
    for name, one in zip(names, splats, strict=True):
        for quantity, why in one.loss.unbounded.items() if one.loss is not None else ():
            whys.setdefault(quantity, []).append(f"{name}: {why}")
    return Loss(
        bound,
        max(0.0 if one.loss is None else one.loss.opacity for one in splats),
        {quantity: reasons(found) for quantity, found in whys.items()},
    )


def reasons(found: Sequence[str]) -> str:
    """The first reasons of a loss without a bound, in words."""
    return "; ".join(found[:_LISTED]) + ("; ..." if len(found) > _LISTED else "")


def merged_levels(levels: Iterable[Level]) -> tuple[Level, ...]:
    """Levels of several files; files of the same level of the same capture count together."""
    found: dict[tuple[str, int | None], Level] = {}
    for level in levels:
        key = level.index, level.number
        files = dict.fromkeys((*found[key].files, *level.files)) if key in found else level.files
        found[key] = dataclasses.replace(level, files=tuple(files))
    return tuple(found.values())
