"""Whether two files are maps of the same place: the hashes of what they were made from, in metres."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import msgspec

from alula.schemas.artifacts.artifact import file_hash
from alula.schemas.artifacts.manifest import CoverManifest, InputRef, PlanManifest, VoxelsManifest
from alula.schemas.artifacts.parts import INDEX, manifest_of
from alula.schemas.artifacts.provenance import read_provenance
from alula.schemas.errors import InputError

MAPS = ("cover", "scene", "image")
"""Roles of the maps that a plan is made in."""
_LEVELS = ("alula/voxels", "alula/cover", "alula/seen", "alula/onboard-map", "alula/tiles")
_DEPTH = 16
_MOST_FILES = 64  # of a kind in a folder, among which one that was renamed is looked for

Relation = Literal["same", "derived", "other"]


def ancestors(refs: Iterable[InputRef], folders: Iterable[Path]) -> set[str]:
    """Hashes of maps and their origins in one metric frame, as far as their files are found.

    A hash of voxels, a cover or an aligned scene stands for one frame in metres. What an aligned scene was
    made from has another frame and does not count; the mesh or cloud of imported voxels counts with the
    scale and the axis that it was read with.

    Args:
        refs: files that something was made from, or that are flown in.
        folders: where files may lie, by the names that the manifests record.
    """
    places = tuple(dict.fromkeys(folders))
    found: set[str] = set()
    waiting = [(ref, 0) for ref in refs]
    while waiting:
        ref, depth = waiting.pop()
        if ref.sha256 in found:
            continue
        found.add(ref.sha256)
        if depth < _DEPTH and (path := _file_of(ref, places)) is not None:
            known, keys = _made_from(path)
            found |= keys
            waiting += [(each, depth + 1) for each in known]
    return found


def origins_of(manifest: CoverManifest) -> list[str]:
    """Keys of what the voxels of a cover were made from; equal keys mean one place in one frame."""
    how = ""
    if manifest.imported is not None:  # of a mesh or a cloud the same file may be read in other metres
        how = " " + msgspec.json.encode((manifest.frame, manifest.imported), order="sorted").decode()
    return sorted(ref.sha256 + how for ref in manifest.made_from)


def relation(
    made: Iterable[InputRef], flown: Iterable[InputRef], folders: Iterable[Path], origins: Iterable[str] = ()
) -> Relation:
    """How the maps that a plan was made in are related to those that it is flown in.

    Args:
        made: maps of the plan.
        flown: maps of the flight.
        folders: where their files and those that they were made from may lie.
        origins: of the plan's covers, see `origins_of`.

    Returns:
        `same` where a file is the same; `derived` where both were made from the same aligned scene, voxels or
        cover; `other` where that is not so, or the files that would show it are not found.
    """
    made, flown, places = list(made), list(flown), tuple(folders)
    if {ref.sha256 for ref in made} & {ref.sha256 for ref in flown}:
        return "same"
    older = ancestors(made, places) | set(origins)
    return "derived" if older & ancestors(flown, places) else "other"


def require_own_map(
    plan: Path,
    manifest: PlanManifest,
    flown: Iterable[InputRef],
    folders: Iterable[Path],
    *,
    allow_other: bool,
    insist: str,
) -> str | None:
    """Refuse a map that a plan was not made in.

    Args:
        plan: its file; notes name it without its folder, so that logs do not depend on where they are made.
        manifest: of the plan, with its inputs.
        flown: maps of the flight, and what is known of their origins; other roles do not count.
        folders: see `relation`.
        allow_other: only note it.
        insist: option that sets this, for the message.

    Returns:
        A note where the map is not the very file that the plan was made in; None also without a map.

    Raises:
        InputError: it is another map, or nothing shows that it is of the same scene.
    """
    made, maps = ([ref for ref in refs if ref.role in MAPS] for refs in (manifest.inputs, flown))
    covers = [each["cover_hash"] for each in manifest.maps if isinstance(each.get("cover_hash"), str)]
    is_image = any(short.strip("0") and ref.sha256.startswith(short) for short in covers for ref in maps)
    origins = [key for each in manifest.maps for key in each.get("made_from", ()) if isinstance(key, str)]
    how = "same" if is_image else relation(made, maps, folders, origins)
    if how == "same" or not maps:
        return None
    was = " and ".join(map(_known_as, made)) or "a map that it does not name"
    now = " and ".join(map(_known_as, maps))
    if how == "derived":
        return f"{plan.name} was made in {was}; {now} is of the same scene"
    words = f"was made in {was}, and nothing shows that {now} is of the same scene"
    if not allow_other:
        raise InputError(f"{plan} {words}; plan in the map that is flown in, or insist with {insist}")
    return f"{plan.name} {words}"


def _known_as(ref: InputRef) -> str:
    return f"{ref.name or f'an unsaved {ref.role}'} ({ref.sha256[:8]})"


def _file_of(ref: InputRef, folders: Iterable[Path]) -> Path | None:
    """The file of a reference by its name, or another of its kind with its hash; None where there is none."""
    suffix = f".{ref.schema.removeprefix('alula/')}.npz"
    for folder in folders:
        named = [folder / ref.name] if ref.name else []
        others = sorted(folder.glob(f"*{suffix}"))[:_MOST_FILES]
        for path in dict.fromkeys([*named, *others]):
            index = path / INDEX if (path / INDEX).is_file() else path
            try:
                if index.is_file() and file_hash(index) == ref.sha256:
                    return path
            except (OSError, InputError):
                continue
    return None


def _made_from(path: Path) -> tuple[list[InputRef], set[str]]:
    """References of the same frame that a file was made from, and keys of origins without a frame."""
    known = read_provenance(path)
    if known is None or known.schema not in _LEVELS:
        return [], set()
    keys: set[str] = set()
    if known.schema in ("alula/voxels", "alula/cover"):
        manifest = manifest_of(path)
        keys |= set(origins_of(manifest)) if isinstance(manifest, CoverManifest) else set()
        if isinstance(manifest, VoxelsManifest) and manifest.imported is not None:
            how = msgspec.json.encode((manifest.frame, manifest.imported), order="sorted").decode()
            keys |= {f"{ref.sha256} {how}" for ref in known.inputs}
    return [ref for ref in known.inputs if ref.schema in _LEVELS or ref.schema == "alula/scene"], keys
