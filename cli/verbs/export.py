"""`export`: covers, scenes, voxels and runs in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from alula.cli.shell.options import Common
from alula.cli.shell.runner import check_output, current, run
from alula.cli.verbs.export_run import export_bag, export_layout
from alula.cli.verbs.export_tiles import export_tiles
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.kinds import COVER, SCENE
from alula.schemas.artifacts.parts_join import read_whole
from alula.schemas.artifacts.provenance import Provenance, read_provenance
from alula.schemas.atomic import atomic_folder, atomic_output, atomic_outputs
from alula.schemas.errors import InputError, UsageError
from alula.schemas.parameters.configs.export import FOLDERS, ExportConfig
from alula.schemas.parameters.targets import TARGETS
from alula.schemas.progress import Progress
from alula.stages.compression.onboard.cost import require_fit, require_memory, require_rate, target_facts
from alula.stages.compression.onboard.image import decode_map
from alula.stages.compression.onboard.layout import image_c_header, map_facts
from alula.stages.export.bodies import gazebo, urdf
from alula.stages.export.export import export as stage
from alula.stages.export.export import located
from alula.stages.export.scene import SCENE_ENCODERS, written_losses

MEMBERS = r"hull-\d+\.obj|model\.config"
MAIN = {"urdf": "map.urdf", "gazebo": "model.sdf"}  # the file that holds the provenance


def export(artifact: Path | None, config: ExportConfig, key_path: Path | None, common: Common) -> None:
    """Write an artifact, or the log of a run, in the format that the configuration or the output's name says.

    Args:
        artifact: None for a layout for all runs.
        key_path: of the key that signs a map in tiles.

    Raises:
        UsageError: options contradict one another, or the format is not for the artifact.
        InputError: the artifact cannot be read.
        InfeasibleError: the map, or the obstacles, do not fit the target.
        CheckError: a tick of the filter takes longer than the target's period.
        OutputError: a file cannot be written, or has other contents.
    """
    if config.foxglove_layout:
        export_layout(artifact, common)
        return
    if artifact is None:
        raise UsageError("INPUT is missing: a cover, a scene or a run")
    if config.ros2:
        export_bag(artifact, common)
        return
    if config.tiles_m is not None:
        export_tiles(artifact, config, key_path, common)
        return
    if key_path is not None:
        raise UsageError("--sign goes with --tiles")
    if artifact.name.endswith(".mcap"):
        raise UsageError(
            f"{artifact}: a run is exported with --ros2, or a layout for it with --foxglove-layout"
        )
    parameters = config.parameters(common.output)
    name = str(parameters["format"])
    if name in FOLDERS:
        _export_model(artifact, name, parameters, common)
        return
    header = common.output.with_suffix(".h")

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        found = read_whole(artifact)
        try:
            parts = list(stage(found, name, provenance))
        except InputError as error:
            raise error.reworded(f"{artifact}: {error}") from error

        if config.target != "none":
            image, target = decode_map(parts[0]), TARGETS[config.target]
            require_fit(parts[0], image, target)
            require_memory(target, config.obstacles)
            facts = target_facts(parts[0], image, target, config.obstacles)
            require_rate(facts, len(image), target, config.rate_hz, config.obstacles)
            check_output(header, {"input": artifact})
            current(header, provenance, force=common.force)

        def write() -> None:
            targets = [common.output] if config.target == "none" else [common.output, header]
            with atomic_outputs(*targets) as files:
                files[0].writelines(parts)
                if len(files) > 1:
                    files[1].write(_header_of(b"".join(parts), located(provenance, found)))

        what = {"hulls": "plane_start", "gaussians": "mean", "voxels": "index"}
        counts: dict[str, Any] = {
            word: len(found[array]) for word, array in what.items() if array in found.arrays
        }
        if "hulls" in counts:
            counts["hulls"] -= 1
        if name == "onboard":
            image = decode_map(parts[0])
            counts |= map_facts(image)
            if config.target != "none":
                counts |= {"header": str(header), **facts}
        if found.manifest.schema == SCENE.name and name in SCENE_ENCODERS:
            counts |= written_losses(found, name, b"".join(parts))
            if "loss" in found.arrays:
                counts["notes"] = ["this file does not record the loss of the scene's own source"]
        origin = located(provenance, found).summary
        return write, {"format": name, **counts, **origin, "bytes": sum(map(len, parts))}

    run(common, "alula/export", "1.0", parameters, {"input": artifact}, make)
    if config.target != "none" and not common.dry_run:
        _write_header(common.output, header, force=common.force)


def _header_of(raw: bytes, provenance: Provenance) -> bytes:
    return b"".join(image_c_header(raw[: decode_map(raw).image_bytes], provenance))


def _write_header(output: Path, header: Path, *, force: bool) -> None:
    """Write the C header of an existing map, unless the header is up to date."""
    provenance = read_provenance(output)
    assert provenance is not None
    wanted = _header_of(output.read_bytes(), provenance)
    if header.exists() and header.read_bytes() == wanted:
        return
    current(header, provenance, force=force)
    with atomic_output(header) as file:
        file.write(wanted)


def _export_model(source: Path, name: str, parameters: dict[str, Any], common: Common) -> None:
    """Write a cover as a folder: a model, and the mesh of each hull."""
    encode = {"urdf": urdf, "gazebo": gazebo}[name]

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        cover = read_artifact(source, COVER)
        placed = located(provenance, cover)
        files = list(encode(cover, placed))

        def write() -> None:
            with atomic_folder(common.output) as folder:
                folder.mkdir()
                for path, text in files:
                    (folder / path).write_bytes(text)

        hulls = len(cover["plane_start"]) - 1
        size = sum(len(text) for _, text in files)
        return write, {"format": name, "hulls": hulls, **placed.summary, "bytes": size}

    run(common, "alula/export", "1.0", parameters, {"input": source}, make, mark=MAIN[name], members=MEMBERS)
