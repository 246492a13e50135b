"""`alula export`."""

from __future__ import annotations

from pathlib import Path

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.options import Common
from alula.schemas.parameters.configs.export import ExportConfig

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
@click.argument("artifact", metavar="[INPUT]", required=False, type=options.PATH)
@options.from_config(ExportConfig)
@grouped.option(
    "--sign",
    "key_path",
    group="Maps in tiles",
    metavar="KEYFILE",
    type=options.PATH,
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
    map, and the instructions and time of a tick of the filter (of the Crazyflie's app with its defaults, else
    of polytope-cbf with 0.1 m radius and 1 m/s): the maximum over positions all over the map, its fraction of
    the period of each control rate, and a bound for any position (every hull counts). A map that does not fit
    ends with exit code 5 and the number of bytes that would fit. A map whose tick takes longer than the
    period of the control rate (--rate) ends with exit code 4. Neither writes a file.

    With --tiles the map becomes a folder of tiles, each a whole onboard map in which all that is not within
    --reach is an obstacle. docs/guide/tiles.md has the guarantee, and the reach that a speed needs.
    """
    from alula.cli.verbs.export import export

    export(artifact, config, key_path, common)
