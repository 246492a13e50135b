"""Files of a view: artifacts, runs, and splats of every format that can be imported."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from alula.schemas.artifacts.artifact import Artifact, read_artifact
from alula.schemas.artifacts.kinds import KINDS, SCENE
from alula.schemas.artifacts.parts import is_parts, open_parts
from alula.schemas.artifacts.parts_join import joined
from alula.schemas.artifacts.salvage import is_artifact_like
from alula.schemas.errors import ArtifactError, DamagedError, InputError
from alula.schemas.files import check_no_stream, printable, reading
from alula.schemas.log.cut import read_logged
from alula.schemas.log.mcap import MAGIC
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.stages.reporting.material import Run
from alula.stages.show.drawing.splat import thinned
from alula.stages.show.viewing.compose import Shown
from alula.stages.show.viewing.logged_map import LoggedMap, read_map

MOST_READ = 2**21  # Gaussians of a scene in parts; of larger ones a page gets those that contribute most

if TYPE_CHECKING:
    from alula.stages.reconstruction.formats.registry import SplatFile


def members(path: Path) -> list[Path]:
    """All files that one argument names: itself, or the files of a splat in several.

    Args:
        path: a file, or the folder of a splat or of an artifact in parts.

    Raises:
        InputError: it cannot be opened, or is of no known format.
    """
    if is_parts(path) or (not path.is_dir() and (_is_run(path) or is_artifact_like(path))):
        return [path]
    return list(_splat(path).files().values())


def read_files(paths: Sequence[Path], title: str = "") -> Shown:
    """Read the files of a view.

    Args:
        title: of the view; default: the names of the files.

    Raises:
        InputError: one cannot be read, is damaged, or of no known kind.
    """
    artifacts: dict[str, list[tuple[str, Artifact]]] = {name: [] for name in KINDS}
    runs: list[Run] = []
    maps: dict[str, LoggedMap] = {}
    for path in paths:
        name = _name(path)
        if not path.is_dir() and _is_run(path):
            run, logged = _run(path, [one.label for one in runs])
            runs.append(run)
            if logged is not None:
                maps[run.label] = logged
        elif is_parts(path):
            artifact = _parts(path)
            artifacts[artifact.kind.name].append((name, artifact))
        elif not path.is_dir() and is_artifact_like(path):
            artifact = read_artifact(path)
            artifacts[artifact.kind.name].append((name, artifact))
        else:
            artifacts["alula/scene"].append((name, _import(path)))
    names = list(dict.fromkeys(map(_name, paths)))
    heading = title or (", ".join(names[:3]) + (" …" if len(names) > 3 else ""))
    return Shown(
        title=heading,
        scenes=artifacts["alula/scene"],
        covers=artifacts["alula/cover"],
        voxels=artifacts["alula/voxels"],
        seen=artifacts["alula/seen"],
        plans=artifacts["alula/plan"],
        runs=runs,
        maps=maps,
    )


def _is_run(path: Path) -> bool:
    check_no_stream(path)
    with reading(path), path.open("rb") as file:
        head = file.read(len(MAGIC))
    if not head:
        raise ArtifactError(f"{path}: is empty")
    return head == MAGIC


def _name(path: Path) -> str:
    """Name without the suffixes that tell the kind."""
    name = printable(path.name)
    for suffix in (".npz", ".mcap", ".scene", ".cover", ".voxels", ".seen", ".plan", ".run"):
        name = name.removesuffix(suffix)
    return name or printable(str(path))


def _run(path: Path, taken: list[str]) -> tuple[Run, LoggedMap | None]:
    found = read_logged(path)
    label = _name(path)
    if label in taken:
        label = f"{label} ({len(taken) + 1})"
    label += " (cut)" if found.damage else ""
    try:
        logged = read_map(path)
    except DamagedError:
        if not found.damage:
            raise
        logged = None
    flights = found.flights
    return Run(label, found.record, flights.by_trial, flights.hulls, flights.course), logged


def _parts(path: Path) -> Artifact:
    """An artifact in parts as a whole; a scene that is too large to be drawn is thinned part by part."""
    parts = open_parts(path)
    if parts.kind is SCENE and parts.count > MOST_READ:
        return thinned(parts, MOST_READ)
    return joined(parts)


def _splat(path: Path) -> SplatFile:
    from alula.stages.reconstruction.formats.containers import ContainerError
    from alula.stages.reconstruction.formats.registry import SplatFile

    try:
        return SplatFile.find(path)
    except ArtifactError as error:
        if path.is_dir() or isinstance(error, ContainerError):
            raise
        raise ArtifactError(f"{path}: is not an artifact, a run, or a splat of a known format") from error


def _import(path: Path) -> Artifact:
    from alula.stages.reconstruction.import_splat import import_splat

    decoded = _splat(path).decode()
    try:
        return import_splat(ImportSplatConfig(), decoded)
    except InputError as error:
        raise error.reworded(f"{path}: {error}") from error
