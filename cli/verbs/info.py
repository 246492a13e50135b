"""`info`: the facts of any file that alula reads, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from alula.cli.shell.runner import INDEX
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.parts import open_parts
from alula.schemas.artifacts.provenance import read_provenance
from alula.schemas.artifacts.salvage import is_artifact_like, salvage
from alula.schemas.artifacts.tiles import is_tiles, read_tiles, read_tiles_index
from alula.schemas.errors import AlulaError, ArtifactError, DamagedError
from alula.schemas.files import check_no_stream, reading
from alula.stages.compression.onboard.image import SCHEMA, VERSION, is_map, read_map
from alula.stages.reporting.inspect import (
    about,
    artifact_facts,
    manifest_facts,
    map_image_facts,
    parts_facts,
    provenance_facts,
    run_facts,
    splat_facts,
    tiles_index_facts,
)

Explained = tuple[dict[str, Any], AlulaError | None]


def explain(path: Path) -> Explained:
    """Read the facts of a file, and the error of reading all of it; None without an error.

    Raises:
        InputError: the file cannot be opened, or its kind is unknown.
    """
    if is_tiles(path):
        return _tiles(path)
    if path.is_dir():
        return _parts(path) if (path / INDEX).is_file() else _splat(path)
    check_no_stream(path)
    with reading(path), path.open("rb") as file:
        head = file.read(4096)
    if not head:
        raise ArtifactError(f"{path}: is empty")
    if head.startswith(b"\x89MCAP0\r\n"):
        return _run(path)
    if is_map(head):
        return _map(path)
    if is_artifact_like(path):
        return _artifact(path)
    if path.suffix == ".toml":
        return _toml(path)
    if head.startswith(b"ply") or (made := read_provenance(path)) is None:
        return _splat(path)
    return provenance_facts(made), None


def _parts(path: Path) -> Explained:
    """Read the index of an artifact in parts, and check all parts."""
    try:
        parts = open_parts(path)
    except ArtifactError as error:
        return {"kind": "alula/parts", "damage": str(error)}, error
    try:
        parts.check()
    except ArtifactError as error:
        return {"damage": str(error), **parts_facts(parts)}, error
    return parts_facts(parts), None


def _artifact(path: Path) -> Explained:
    try:
        return artifact_facts(read_artifact(path)), None
    except DamagedError as error:
        left = salvage(path)
        facts = manifest_facts(left.manifest) if left.manifest is not None else {"kind": "unknown"}
        return {"damage": left.words(), **facts}, DamagedError(f"{error}; {left.words()}")
    except ArtifactError as error:
        left = salvage(path)
        return (manifest_facts(left.manifest) if left.manifest is not None else {}), error


def _run(path: Path) -> Explained:
    from alula.schemas.log.cut import salvage_run
    from alula.schemas.log.flights import count_messages
    from alula.schemas.log.run import read_run

    messages, complete = count_messages(path)
    try:
        facts = run_facts(read_run(path), messages)
    except ArtifactError as error:
        if (cut := salvage_run(path)) is not None:
            facts = {"damage": cut.damage, **run_facts(cut.record, messages)}
            return facts, DamagedError(f"{path}: {cut.damage}")
        if not isinstance(error, DamagedError):
            raise
        readable = f"{sum(messages.values())} messages can still be read"
        facts = {"damage": readable, **about("alula/run", ""), "messages": dict(sorted(messages.items()))}
        return facts, DamagedError(f"{error}; {readable}")
    if not complete:
        return facts, DamagedError(f"{path}: truncated or corrupt MCAP log; its summary is readable")
    return facts, None


def _map(path: Path) -> Explained:
    made = read_provenance(path)
    written = {"written by": provenance_facts(made)} if made is not None else {}
    try:
        return map_image_facts(read_map(path.read_bytes(), path)) | written, None
    except ArtifactError as error:
        return {**about(SCHEMA, VERSION), **written}, error


def _tiles(path: Path) -> Explained:
    facts = tiles_index_facts(read_tiles_index(path))
    try:
        read_tiles(path)
    except AlulaError as error:
        return facts, error
    return facts, None


def _toml(path: Path) -> Explained:
    """Read a vehicle, recognised by its `model`, or else a scenario."""
    import msgspec

    from alula.schemas.scenarios.scenario import plain, read_scenario
    from alula.schemas.scenarios.tables import SCENARIO_SCHEMA
    from alula.schemas.scenarios.vehicle import VEHICLE_SCHEMA, read_vehicle
    from alula.schemas.toml_file import read_tree

    if "model" in read_tree(path):
        vehicle = msgspec.to_builtins(read_vehicle(path))
        return {**about(VEHICLE_SCHEMA, vehicle.pop("version", "")), **vehicle}, None
    whole = plain(read_scenario(path))
    del whole["schema"]
    return {**about(SCENARIO_SCHEMA, whole.pop("version")), **whole}, None


def _splat(path: Path) -> Explained:
    from alula.stages.reconstruction.formats.containers import ContainerError
    from alula.stages.reconstruction.formats.registry import SplatFile

    try:
        found = SplatFile.find(path)
    except ArtifactError as error:
        if path.is_dir() or isinstance(error, ContainerError):
            raise
        known = "an artifact, a run, a scenario, a vehicle, or a splat or other file of a known format"
        raise ArtifactError(f"{path}: is not {known}") from error
    try:
        facts = splat_facts(found.decode())
    except ArtifactError as error:
        if foreign := _foreign(str(error).removeprefix(f"{path}: ")):
            return foreign, None
        return {"kind": f"splat file: {found.format.name}", "damage": str(error)}, error
    made = read_provenance(path) if path.is_file() else None
    return facts | ({"written by": provenance_facts(made)} if made is not None else {}), None


def _foreign(words: str) -> dict[str, Any] | None:
    """Facts about a file that the readers recognise but cannot read."""
    for mark in ("recognised as ", "PLY: an ordinary "):
        if words.startswith(mark):
            name = words.removeprefix("recognised as ").removeprefix("PLY: ")
            return {"kind": name.split(";")[0], "version": "", "what": f"{name}."}
    return None
