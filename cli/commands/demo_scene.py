"""`alula demo-scene`."""

from __future__ import annotations

from typing import Any

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.options import PATH, Common
from alula.schemas.parameters.configs.demo_scene import DemoSceneConfig

EXAMPLES = """\b
Examples:
  alula demo-scene -o room.ply
  alula demo-scene -o room.ply --colmap sparse --reference poses.csv --cameras cameras.csv"""


@grouped.command("demo-scene", epilog=EXAMPLES)
@click.option("--colmap", type=PATH, help="Also write the cameras as a COLMAP text model to this folder.")
@click.option("--cameras", type=PATH, help="Also write the cameras in the scene's frame to this CSV file.")
@click.option(
    "--reference", type=PATH, help="Also write the cameras' measured positions [m] to this CSV file."
)
@options.from_config(DemoSceneConfig)
@options.output(".ply")
def command(config: DemoSceneConfig, common: Common, **given: Any) -> None:
    """Write the built-in scene: a furnished room with hoops.

    The room is 8 x 6 x 3 m, with z up, the floor at z = 0 and a corner at the origin. The file has an
    arbitrary frame and scale, like the result of a training run; scale-align recovers the room's frame.
    """
    from alula.cli.verbs.demo_scene import write_scene

    write_scene(config, common, **given)
