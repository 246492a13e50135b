"""`alula observe`."""

from __future__ import annotations

import dataclasses
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from alula.cli.shell import grouped, options, runner
from alula.cli.shell.interruption import handlers_kept
from alula.cli.shell.options import PATH
from alula.schemas.errors import InputError, UsageError
from alula.schemas.files import text_of
from alula.schemas.parameters.configs.observe import ObserveConfig
from alula.schemas.progress import Progress

if TYPE_CHECKING:
    from alula.stages.planning.pinholes import Pinholes

EXAMPLES = """\b
Examples:
  alula observe room.scene.npz -o room.seen.npz --colmap sparse/0 --vehicle crazyflie21
  alula observe room.scene.npz -o room.seen.npz --voxels room.voxels.npz --colmap sparse/0 --radius 0.15
  alula observe hall.scene.npz -o hall.seen.npz --reach "2 1 1" --radius 0.3"""

LEVEL = (
    *("size_m", "sigma", "confidence", "min_overlap", "crop", "min_opacity", "inflation_m", "ignore_loss"),
    "max_voxels",
)


@grouped.command("observe", epilog=EXAMPLES)
@click.argument("scene", type=options.input_path())
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
@options.from_config(
    ObserveConfig,
    groups=dict.fromkeys(
        ("confidence", "min_overlap", "min_opacity", "inflation_m", "ignore_loss", "max_voxels"), "Obstacles"
    ),
)
@options.output(".seen.npz")
@click.pass_context
def command(
    context: click.Context,
    scene: Path,
    config: ObserveConfig,
    common: options.Common,
    colmap: Path | None,
    cameras: Path | None,
    nerfstudio: Path | None,
    voxels: Path | None,
    vehicle_name: str | None,
) -> None:
    """Mark the space that cameras saw to be free and that a vehicle can reach.

    SCENE is a metric scene; the cameras are those that the splat was trained on. A voxel counts when a camera
    sees its whole cube in front of every surface, at the level of the obstacles, and a ball of the
    vehicle's radius goes there from the cameras without touching anything else. All rounding is towards
    less. Unmarked voxels are unknown: plan --within stays out of it.

    Memory: 14 bytes per voxel of the scene's box, up to 134,217,728 voxels; 160 to 270 bytes per Gaussian;
    per job an image and 1 byte per voxel.
    """
    from alula.schemas.artifacts.artifact import Artifact
    from alula.schemas.artifacts.kinds import SCENE, SEEN, VOXELS
    from alula.schemas.artifacts.parts_join import read_whole
    from alula.schemas.scenarios.vehicles import vehicle_named
    from alula.stages.alignment import colmap as models
    from alula.stages.alignment import nerfstudio as training
    from alula.stages.planning.observe import observe

    given = {"--colmap": colmap, "--cameras": cameras, "--reach": config.reach}
    kinds = [name for name, value in given.items() if value is not None]
    if len(kinds) != 1:
        raise UsageError(f"exactly one of {', '.join(given)} is needed, not {' and '.join(kinds) or 'none'}")
    if nerfstudio is not None and config.reach is not None:
        raise UsageError("--nerfstudio goes with --colmap or --cameras")
    if colmap is None and options.is_given(context, "min_near"):
        raise UsageError("--min-near goes with --colmap")
    if config.radius_m is not None and vehicle_name is not None:
        raise UsageError("--radius is that of the vehicle; leave out --vehicle")
    if voxels is not None:
        for name in LEVEL:
            if options.is_given(context, name):
                option = next(p.opts[0] for p in context.command.params if p.name == name)
                raise UsageError(f"the level is that of --voxels; leave out {option}")
    inputs = {"scene": scene}
    if config.radius_m is None:
        vehicle, file = vehicle_named(vehicle_name)
        config = dataclasses.replace(config, radius_m=vehicle.body.radius_m)
        inputs |= file
    if colmap is not None:
        with handlers_kept(), suppress(ImportError):  # the stage says that it is not installed
            import pycolmap  # noqa: F401
    inputs |= {"voxels": voxels} if voxels is not None else {}
    inputs |= {"cameras": cameras} if cameras is not None else {}
    if colmap is not None:
        inputs |= {f"colmap {part}": path for part, path in models.model_files(colmap).items()}
    if nerfstudio is not None:
        inputs |= training.transform_files(nerfstudio)

    def build(progress: Progress) -> Artifact:
        metric = read_whole(scene, SCENE)
        obstacles = None if voxels is None else read_whole(voxels, VOXELS)
        if obstacles is not None:
            _check_origin(voxels, obstacles, runner.input_ref("scene", scene).sha256)
        found = None if config.reach is not None else _pinholes(colmap, cameras, nerfstudio)
        return observe(config, metric, found, obstacles, jobs=common.jobs, progress=progress)

    runner.run_stage(common, SEEN, config, inputs, build)


def _check_origin(path: Path | None, voxels: object, sha256: str) -> None:
    """Refuse voxels that were made from another scene: their obstacles would be missing."""
    recorded = [ref for ref in voxels.manifest.inputs if ref.role == "scene"]  # type: ignore[attr-defined]
    if recorded and recorded[0].sha256 != sha256:
        raise InputError(f"{path}: was made from another scene, {recorded[0].name}")


def _pinholes(colmap: Path | None, cameras: Path | None, nerfstudio: Path | None) -> Pinholes:
    """Read the cameras, in the frame that the scene was trained in."""
    from alula.stages.alignment import nerfstudio as training
    from alula.stages.alignment.similarity import inverse
    from alula.stages.alignment.tables import parse_pinholes
    from alula.stages.planning.pinholes import Pinholes, read_pinholes

    if colmap is not None:
        found = read_pinholes(colmap)
    else:
        assert cameras is not None
        found = Pinholes(*parse_pinholes(text_of(cameras), cameras.name))
    if nerfstudio is None:
        return found
    path = training.transform_files(nerfstudio)["nerfstudio"]
    frame = training.parse_training_frame(text_of(path), path.name)
    return found.moved(inverse(frame.original_from_training))
