"""The stage `import-splat` for scenes in parts: one piece of a file at a time, and the whole's manifest."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import SPLAT_LOSS, Manifest, SceneManifest
from alula.schemas.errors import InputError, UsageError
from alula.schemas.parameters.configs.import_splat import DRAWN, ImportSplatConfig
from alula.stages.reconstruction.faint import FAINT
from alula.stages.reconstruction.formats.capture import lacking, level_facts, reasons
from alula.stages.reconstruction.formats.splats import LOSSES, Level
from alula.stages.reconstruction.import_splat import (
    NOTABLE,
    SCALE_FLOOR,
    NothingLeftError,
    check_whole,
    cut_note,
    faint_note,
    import_splat,
    loss_notes,
    nothing_left,
    property_notes,
    scene_fields,
    zero_notes,
)
from alula.stages.reconstruction.pieces import Piece, decode_piece, sliced

_NOTES = 10  # maximum number of notes of the whole


def check_parted(config: ImportSplatConfig, levels: Sequence[Level]) -> None:
    """Refuse what an import in parts cannot do, before any work is done.

    Raises:
        UsageError: a rule needs the neighbours of a Gaussian, which may be in another part.
        InputError: files of a level of detail are lacking.
    """
    if config.drop_floaters:
        raise UsageError(
            "--drop-floaters compares each Gaussian with its neighbours, which may be in another part: it "
            "would remove obstacles at the border of a part; leave it out, or import into one .scene.npz"
        )
    check_whole(config, levels)


def import_piece(
    config: ImportSplatConfig, piece: Piece, levels: Sequence[Level], most: int
) -> Iterator[Artifact | NothingLeftError]:
    """Import a piece of a file; see `import_splat`.

    Args:
        config: see `ImportSplatConfig`; without `drop_floaters`.
        levels: see `levels_of`: levels of detail of all files.
        most: maximum number of Gaussians of a part.

    Yields:
        An `alula/scene` of at most `most` rows of the file, or the error where no Gaussian of them is left.

    Raises:
        ArtifactError, InputError: the file is damaged or cannot be read, or a value is not finite.
    """
    splats = decode_piece(piece)
    if levels and splats.levels:
        splats = dataclasses.replace(splats, levels=tuple(levels))
    for rows in sliced(splats, most):
        try:
            yield import_splat(config, rows)
        except NothingLeftError as error:
            yield error.with_traceback(None)  # which would keep the rows in memory
        except InputError as error:
            raise InputError(f"{piece.found.path}: {error}") from error


def whole_scene(
    config: ImportSplatConfig,
    manifests: Sequence[Manifest],
    nothing: Sequence[NothingLeftError],
    levels: Sequence[Level],
) -> dict[str, Any]:
    """Fields of the manifest of a whole scene, from those of its parts.

    Raises:
        InputError: no Gaussian is left.
    """
    sources = [manifest.source for manifest in manifests if isinstance(manifest, SceneManifest)]
    removed: Counter[str] = Counter()
    for table in (*(one["removed"] for one in sources), *(one.removed for one in nothing)):
        removed.update(table)
    if not sources:
        raise nothing_left(dict(removed))
    frames = _distinct(one["frame"]["file"] for one in sources)
    source = {
        "format": " + ".join(_distinct(one["format"] for one in sources)),
        "rows": sum(one["rows"] for one in sources) + sum(sum(one.removed.values()) for one in nothing),
        "kept": sum(one["kept"] for one in sources),
        "removed": dict(removed),
        "rules": {},
        "levels_of_detail": level_facts(levels),
        "lacks": lacking(levels) if levels else _distinct(what for one in sources for what in one["lacks"]),
        "applied": _distinct(what for one in sources for what in one["applied"]),
        "unknown_properties": _distinct(what for one in sources for what in one["unknown_properties"]),
        "scale_floor": SCALE_FLOOR,
        "scale_floored": sum(one["scale_floored"] for one in sources),
        "bounds": {
            "lower": [min(one["bounds"]["lower"][axis] for one in sources) for axis in range(3)],
            "upper": [max(one["bounds"]["upper"][axis] for one in sources) for axis in range(3)],
        },
        "loss": _loss([one["loss"] for one in sources]),
        "frame": {"file": frames[0] if len(frames) == 1 else "several", "turn": config.turn},
    }
    notes = [
        *zero_notes(source),
        *property_notes(source),
        *_notes(config, sources),
        *loss_notes(source["loss"]),
    ]
    if len(frames) > 1:
        notes.insert(0, f"the files state different frames ({', '.join(frames)}); none was turned")
    largest = {"scale_max": max(manifest.summary["scale_max"] for manifest in manifests)}
    is_lossy = any(SPLAT_LOSS in manifest.requires for manifest in manifests)
    fields = scene_fields(config, source, largest, notes, is_lossy=is_lossy, parts=len(sources))
    return fields | {"source": source | {"notes": fields["summary"].get("notes", [])}}


def _distinct(items: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(items))


def _loss(losses: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Maximum of each kind of loss, and all reasons of those without a bound."""
    found: dict[str, Any] = {key: max(one[key] for one in losses) for key in (*LOSSES, "opacity")}
    whys: dict[str, dict[str, None]] = {}
    for one in losses:
        for quantity, why in one["unbounded"].items():
            whys.setdefault(quantity, {})[why] = None
    found["unbounded"] = {quantity: reasons([*why]) for quantity, why in whys.items()}
    return found


def _notes(config: ImportSplatConfig, sources: Sequence[dict[str, Any]]) -> list[str]:
    """Notes about the whole; those of a file with the number of the first part that has it."""
    found: dict[str, list[int]] = {}
    for number, source in enumerate(sources):
        for note in source["notes"]:
            found.setdefault(note, []).append(number)
    words = [
        f"part {numbers[0]}{f' and {len(numbers) - 1} more' if len(numbers) > 1 else ''}: {note}"
        for note, numbers in found.items()
    ]
    if (more := len(words) - _NOTES) > 0:
        words = [*words[:_NOTES], f"{more} more notes are in the parts"]
    return [*_opacity_notes(config, sources), *words]


def _opacity_notes(config: ImportSplatConfig, sources: Sequence[dict[str, Any]]) -> list[str]:
    """Note about the volume that the minimum opacity removes; else about that of the faint Gaussians kept."""
    limit = config.min_opacity if config.min_opacity > DRAWN else FAINT
    volumes = [one["opacity"] for one in sources if one["opacity"] is not None]
    total = sum(one["cells"] * one["edge"] ** 3 for one in volumes)
    below = [(one, at) for one in volumes for at in one["limits"] if at["limit"] == limit]
    gaussians = sum(at["gaussians"] for _, at in below)
    share = sum(at["cells"] * one["edge"] ** 3 for one, at in below) / total if total else 0.0
    if not gaussians or (limit == FAINT and share < NOTABLE):
        return []
    rows = sum(one["rows"] for one in sources)
    words = (
        f"{gaussians} of {rows} Gaussians ({gaussians / rows:.0%}), which alone mark {share:.0%} of the "
        f"volume of the {len(volumes)} parts that have any"
    )
    return [cut_note(limit, words) if limit == config.min_opacity else faint_note(words)]
