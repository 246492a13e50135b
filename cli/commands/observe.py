"""`alula observe`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.options import PATH
from alula.schemas.parameters.configs.observe import ObserveConfig

EXAMPLES = """\b
Examples:
  alula observe room.scene.npz -o room.seen.npz --colmap sparse/0 --vehicle crazyflie21
  alula observe room.scene.npz -o room.seen.npz --voxels room.voxels.npz --colmap sparse/0 --radius 0.15
  alula observe hall.scene.npz -o hall.seen.npz --reach "2 1 1" --radius 0.3"""


@grouped.command("observe", epilog=EXAMPLES)
@click.argument("scene", type=options.PATH)
@click.option("--colmap", type=PATH, help="COLMAP model (folder) with cameras in the splat file's frame.")
@click.option(
    "--cameras",
    type=PATH,
    help="CSV image,x,y,z,qw,qx,qy,qz,width,height,fx,fy,cx,cy of cameras in the splat file's frame: camera "
    "to scene, axes x right, y down, z forward; pixels; no distortion.",
)
@grouped.option(
    "--nerfstudio",
    group="Cameras",
    type=PATH,
    help="Run folder or dataparser_transforms.json: the cameras are in the frame of the source poses.",
)
@click.option("--voxels", type=PATH, help="The obstacles, voxels of the SCENE; their level is used.")
@options.vehicle(
    "Built-in vehicle, or vehicle file (.toml), that must be able to go there; default: the quadrotor of "
    "FastBridge."
)
@options.fields_of(
    ObserveConfig,
    groups=dict.fromkeys(
        ("confidence", "min_overlap", "min_opacity", "inflation_m", "ignore_loss", "max_voxels"), "Obstacles"
    ),
)
@options.output(".seen.npz")
def command(
    scene: Path, fields: dict[str, Any], common: options.Common, vehicle_name: str | None, **given: Any
) -> None:
    """Mark the space that cameras saw to be free and that a vehicle can reach.

    SCENE is a metric scene; the cameras are those that the splat was trained on. A voxel counts when a camera
    sees its whole cube in front of every surface, at the level of the obstacles, and a ball of the
    vehicle's radius goes there from the cameras without touching anything else. All rounding is towards
    less. Unmarked voxels are unknown: plan --within stays out of it.

    Memory: 14 bytes per voxel of the scene's box, up to 134,217,728 voxels; 160 to 270 bytes per Gaussian;
    per job an image and 1 byte per voxel.
    """
    from alula.cli.verbs.observe import observe
    from alula.cli.verbs.verb import run_step

    run_step(common, observe.step(scene, **given, vehicle=vehicle_name, jobs=common.jobs, **fields))
