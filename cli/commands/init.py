"""`alula init`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from alula.cli.shell import grouped, options

if TYPE_CHECKING:
    from alula.cli.verbs.project import Choices

UPS = ("+x", "-x", "+y", "-y", "+z", "-z")
EXAMPLES = """\b
Examples:
  alula init garden.ply --metres-per-unit 1.8
  alula init garden.ply -o yard --height 2.6
  alula init garden.ply --colmap sparse/0
  alula init tile_*.splat -o city
"""


@grouped.command("init", epilog=EXAMPLES)
@click.argument("splats", metavar="SPLAT...", nargs=-1, required=True, type=options.PATH)
@click.option("--colmap", type=options.PATH, help="COLMAP model (folder) of the splat: its cameras tell up.")
@click.option(
    "--up",
    type=click.Choice(UPS),
    help="Axis of the splat that points up; default: by its header, format or floor.",
)
@click.option("--metres-per-unit", type=options.FINITE_FLOAT, help="Length of a unit of the splat [m].")
@click.option("--height", "height_m", type=options.FINITE_FLOAT, help="Height of all that is shown [m].")
@click.option(
    "--lod", type=options.Whole(0), help="Level of detail of a streamed splat; default: 0, the finest."
)
@click.option(
    "--trials", type=options.Whole(1, 100_000), default=20, show_default=True, help="Random flights."
)
@click.option(
    "-o", "--output", type=options.PATH, help="Folder to write; default: the name of the first splat."
)
@options.common(
    "--jobs", type=options.JOBS, default=0, help="Threads; 0 is all processors.", show_default=True
)
@options.reporting
def command(
    splats: tuple[Path, ...],
    colmap: Path | None,
    up: str | None,
    metres_per_unit: float | None,
    height_m: float | None,
    lod: int | None,
    trials: int,
    output: Path | None,
    jobs: int,
    json: bool,
    quiet: bool,
    verbose: int,
) -> None:
    """Write a first project for a splat of your own, ready for make.

    It looks at SPLAT and chooses up, scale, crop, voxel size, and a start and a goal in free space, and says
    what it assumed. Several files that share one frame, such as tiles, become one scene, as with
    import-splat. The folder gets a Makefile, a scenario and a README.md. `make` there takes the splat to a
    report; make verify, plan, simulate and fly-rehearsal stop at their step.
    """
    from alula.cli.shell.present import echo, print_json
    from alula.cli.verbs.project import LEARN_SCALE, folder_of, look, write_project

    folder = folder_of(splats[0], output)
    chosen: Choices = look(
        splats, colmap=colmap, up=up, metres_per_unit=metres_per_unit, height_m=height_m, lod=lod, jobs=jobs
    )
    write_project(folder, splats, chosen, trials)
    if json:
        print_json({"output": str(folder), "status": "written", "assumed": chosen.assumed})
        return
    if quiet:
        return
    echo(f"{folder}: written")
    for name, sentence in chosen.assumed.items():
        echo(f"  {name:<11} {sentence}")
    if chosen.is_scale_assumed:
        echo(f"note: 1 unit is ASSUMED to be {chosen.scale:g} m: {LEARN_SCALE}", err=True)
    echo(f"next: make -C {folder}")
