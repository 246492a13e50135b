"""`alula voxelize`."""

from __future__ import annotations

from pathlib import Path

import click

from alula.cli import grouped, options
from alula.schemas.parameters.configs.voxelize import VoxelizeConfig

EXAMPLES = """\b
Examples:
  alula voxelize room.scene.npz -o room.voxels.npz --size 0.05 --min-overlap 3
  alula voxelize street.scene.npz -o street.voxels.npz --confidence 0.99 --crop -20 -20 -2 20 20 8
  alula voxelize city.scene -o city.voxels --size 0.1
"""


@grouped.command("voxelize", epilog=EXAMPLES)
@click.argument("scene", type=options.input_path())
@options.from_config(VoxelizeConfig)
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
@click.pass_context
def command(
    context: click.Context,
    scene: Path,
    config: VoxelizeConfig,
    tile_m: float | None,
    scheduler: str | None,
    common: options.Common,
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
    from alula.cli.parted import is_parted
    from alula.cli.runner import index_of, run_stage
    from alula.cli.voxelize_parts import voxelize_parts
    from alula.schemas.artifacts.artifact import Artifact, read_artifact
    from alula.schemas.artifacts.kinds import SCENE, VOXELS
    from alula.schemas.errors import InfeasibleError, InputError, UsageError
    from alula.schemas.progress import Progress
    from alula.stages.compression.voxelize import voxelize

    if config.confidence is not None and options.is_given(context, "sigma"):
        raise UsageError("--confidence sets sigma; give one of --confidence and --sigma")

    if is_parted(common.output, VOXELS.folder_suffix) or index_of(scene) != scene:
        voxelize_parts(scene, config, tile_m, scheduler, common)
        return

    def build(progress: Progress) -> Artifact:
        metric = read_artifact(scene, SCENE)
        try:
            return voxelize(
                config,
                metric,
                tile_m=tile_m,
                scheduler=scheduler,
                jobs=common.jobs,
                progress=progress,
            )
        except (InputError, InfeasibleError) as error:
            raise error.reworded(f"{scene}: {error}") from error

    run_stage(common, VOXELS, config, {"scene": scene}, build)
