"""`alula export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.options import Common
from alula.schemas.parameters.configs.export import FOLDERS, ExportConfig

if TYPE_CHECKING:
    from alula.schemas.artifacts.provenance import Provenance
    from alula.schemas.progress import Progress

EXAMPLES = """\b
Examples:
  alula export room.cover.npz -o room.glb
  alula export room.scene.npz -o room.spz
  alula export room.cover.npz -o room.map.bin --target crazyflie
  alula export room.cover.npz -o room.xml
  alula export room.cover.npz -o room_model --format gazebo
  alula export room.voxels.npz -o room.bt
  alula export city.cover.npz -o city.tiles --tiles 20 --reach 5 --sign my.key
  alula export first.run.mcap -o first_bag --ros2
  alula export --foxglove-layout -o alula.layout.json
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("artifact", metavar="[INPUT]", required=False, type=options.input_path())
@options.from_config(ExportConfig)
@grouped.option(
    "--sign",
    "key_path",
    group="Maps in tiles",
    metavar="KEYFILE",
    type=options.input_path(),
    help="Tiles: sign the index with this key, a file of 32 bytes or of 64 hexadecimal digits.",
)
@options.output(".glb .obj .json .stl .bin .h .xml .usda .npz .geojson .ply .splat .spz .bt .pcd")
def command(artifact: Path | None, config: ExportConfig, key_path: Path | None, common: Common) -> None:
    """Convert a cover, a scene or a run for other programs.

    A cover becomes GLB, OBJ, STL (one mesh per hull), JSON (the exact integers), or an onboard map that
    a microcontroller reads in place (.bin; .h holds the same bytes as a C array). A scene becomes PLY, SPLAT
    or SPZ (Gaussians), GLB or OBJ (points). For Gaussians, export measures and prints the loss of the format.
    Coordinates are not rotated. A .splat has no room for provenance, so only -f replaces one.

    For simulators a cover becomes convex bodies: MJCF of MuJoCo (.xml), USD with the physics schema (.usda),
    and folders with meshes for URDF and Gazebo (--format urdf, gazebo). It also becomes a signed distance
    field (.npz) with the bound of its error, and a footprint on the map of the world (.geojson). Voxels
    become an OctoMap (.bt), or points at their centres (.ply, .pcd). docs/guide/exports.md has the details.

    A run becomes a bag of ROS 2 with --ros2: a folder with odometry, paths, transforms, commands, and markers
    of map and obstacles. --foxglove-layout writes a layout for the logs of runs, and needs no INPUT.

    With --target the map gets an index, and the C header is written beside it. Export prints the bytes of the
    map, and the instructions and time of a tick of polytope-cbf (0.1 m radius, 1 m/s, otherwise default
    parameters): the maximum over positions all over the map, its fraction of the period of each control rate,
    and a bound for any position (every hull counts). A map that does not fit ends with exit code 5 and the
    number of bytes that would fit. A map whose tick takes longer than the period of the control rate (--rate)
    ends with exit code 4. Neither writes a file.

    With --tiles the map becomes a folder of tiles, each a whole onboard map in which all that is not within
    --reach is an obstacle. docs/guide/tiles.md has the guarantee, and the reach that a speed needs.
    """
    from alula.cli.shell.runner import check_output, current, run
    from alula.cli.verbs.export_model import export_model
    from alula.cli.verbs.export_run import export_bag, export_layout
    from alula.cli.verbs.export_tiles import export_tiles
    from alula.schemas.artifacts.kinds import SCENE
    from alula.schemas.artifacts.parts_join import read_whole
    from alula.schemas.atomic import atomic_outputs
    from alula.schemas.errors import InputError, UsageError
    from alula.schemas.parameters.targets import TARGETS
    from alula.stages.compression.onboard.cost import require_fit, require_rate, target_facts
    from alula.stages.compression.onboard.image import decode_map
    from alula.stages.compression.onboard.layout import map_facts
    from alula.stages.export.export import export, located
    from alula.stages.export.scene import SCENE_ENCODERS, written_losses

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
        export_model(artifact, name, parameters, common)
        return
    header = common.output.with_suffix(".h")

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        found = read_whole(artifact)
        try:
            parts = list(export(found, name, provenance))
        except InputError as error:
            raise error.reworded(f"{artifact}: {error}") from error

        if config.target != "none":
            image, target = decode_map(parts[0]), TARGETS[config.target]
            require_fit(parts[0], image, target)
            facts = target_facts(parts[0], image, target)
            require_rate(facts, len(image), target, config.rate_hz)
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
    """Contents of the C header of a map's file."""
    from alula.stages.compression.onboard.image import decode_map
    from alula.stages.compression.onboard.layout import image_c_header

    return b"".join(image_c_header(raw[: decode_map(raw).image_bytes], provenance))


def _write_header(output: Path, header: Path, *, force: bool) -> None:
    """Write the C header of an existing map, unless the header is up to date."""
    from alula.cli.shell.runner import current
    from alula.schemas.artifacts.provenance import read_provenance
    from alula.schemas.atomic import atomic_output

    provenance = read_provenance(output)
    assert provenance is not None
    wanted = _header_of(output.read_bytes(), provenance)
    if header.exists() and header.read_bytes() == wanted:
        return
    current(header, provenance, force=force)
    with atomic_output(header) as file:
        file.write(wanted)
