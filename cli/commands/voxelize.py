"""`alula voxelize`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from alula.cli.shell import grouped, options
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig

EXAMPLES = """\b
Examples:
  alula voxelize room.scene.npz -o room.voxels.npz --size 0.05 --min-overlap 3
  alula voxelize street.scene.npz -o street.voxels.npz --confidence 0.99 --crop -20 -20 -2 20 20 8
  alula voxelize city.scene -o city.voxels --size 0.1
"""


@grouped.command("voxelize", epilog=EXAMPLES)
@click.argument("scene", type=options.PATH)
@options.fields_of(VoxelizeConfig)
@grouped.option(
    "--tile",
    "tile_m",
    group="Limits",
    type=options.FINITE_FLOAT,
    help="Edge of a tile [m]: each job works on one tile at a time, which bounds the memory. In a folder "
    "of voxels each tile is a part; default then: 512 voxels, halved where more "
    "than 1,048,576 ellipsoids touch a tile.",
)
@options.scheduler("Send tiles, 128 voxels wide unless --tile is given,")
@options.output(".voxels.npz, or a folder .voxels")
def command(
    scene: Path, fields: dict[str, Any], tile_m: float | None, scheduler: str | None, common: options.Common
) -> None:
    """Mark every voxel that an obstacle touches.

    SCENE is a metric scene. A voxel is marked when the ellipsoid of a Gaussian at the chosen level,
    grown by the inflation, touches its closed cube. Rounding is outward, so no touched voxel is missed.
    The number of voxels is estimated first: if it is far above --max-voxels, the command ends before the
    work and names a size, and the few Gaussians, if there are any, that make most of the voxels.

    Memory: the scene (56 bytes per Gaussian), 16 bytes per marked voxel, and counters of 512 bytes per
    brick of 4 x 4 x 8 voxels with a touched voxel. More than 134,217,728 voxels or 4,194,304 bricks are
    refused: 2 GiB each. --tile limits the counters to those of one tile per job, but takes 32 bytes per
    marked voxel. Tiles, jobs and scheduler never change the result.

    With an output NAME.voxels the voxels are a folder of parts, one per tile, and --max-voxels is the limit
    of a tile. Where SCENE or the output is a folder, memory holds three parts of the scene, and the Gaussians
    (96 bytes each) and the voxels of one tile, whatever the number of parts; with --crop also a byte per
    Gaussian of the scene. Interrupted, the same command continues with the parts that are finished.
    """
    from alula.cli.verbs.verb import run_step
    from alula.cli.verbs.voxelize import voxelize

    how: dict[str, Any] = {"tile_m": tile_m, "scheduler": scheduler, "jobs": common.jobs}
    run_step(common, voxelize.step(scene, **how, scratch=common.output.parent, **fields))
