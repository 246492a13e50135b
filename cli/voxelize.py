"""`alula voxelize`."""

from __future__ import annotations

from pathlib import Path

import click

from alula.cli import options
from alula.schemas.configs.voxelize import VoxelizeConfig

EXAMPLES = """\b
Examples:
  alula voxelize room.scene.npz -o room.voxels.npz --size 0.05 --min-overlap 3
  alula voxelize street.scene.npz -o street.voxels.npz --confidence 0.99 --crop -20 -20 -2 20 20 8
"""


@click.command("voxelize", epilog=EXAMPLES)
@click.argument("scene", type=options.input_path())
@options.from_config(VoxelizeConfig)
@options.output(".voxels.npz")
@click.pass_context
def command(context: click.Context, scene: Path, config: VoxelizeConfig, common: options.Common) -> None:
    """Mark every voxel that an obstacle touches.

    SCENE is a metric scene. A voxel is marked when the ellipsoid of a Gaussian at the chosen level,
    grown by the inflation, touches its closed cube; rounding is outward, so nothing is missed.
    """
    from alula.cli.runner import Progress, run_stage
    from alula.schemas.artifact import Artifact, read_artifact
    from alula.schemas.errors import InfeasibleError, InputError, UsageError
    from alula.schemas.kinds import SCENE, VOXELS
    from alula.stages.compression.voxelize import voxelize

    if config.confidence is not None and options.is_given(context, "sigma"):
        raise UsageError("--confidence sets sigma: give one of the two, not both")

    def build(progress: Progress) -> Artifact:
        metric = read_artifact(scene, SCENE)
        try:
            return voxelize(config, metric, jobs=common.jobs, progress=progress)
        except (InputError, InfeasibleError) as error:
            raise type(error)(f"{scene}: {error}") from error

    run_stage(common, VOXELS, config, {"scene": scene}, build)
