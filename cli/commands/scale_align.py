"""`alula scale-align`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.alignment_table import show_alignment
from alula.cli.shell.options import PATH, Common, Numbers, NumbersOption
from alula.cli.shell.present import print_json
from alula.schemas.parameters.configs.scale_align import ScaleAlignConfig

EXAMPLES = """\b
Examples:
  alula scale-align room.scene.npz -o metric.scene.npz --colmap sparse/0 --reference poses.csv --max-rms 0.02
  alula scale-align room.scene.npz -o metric.scene.npz --distance "0 0 0" "1 0 0" 2.5 --up "0 -1 0" --floor
  alula scale-align city.scene -o metric.scene --transform utm.json"""


@grouped.command("scale-align", epilog=EXAMPLES)
@click.argument("scene", type=options.PATH)
@click.option("--colmap", type=PATH, help="COLMAP model (folder) with cameras in the scene's frame.")
@click.option("--cameras", type=PATH, help="CSV image,x,y,z of cameras in the scene's frame.")
@click.option(
    "--reference",
    type=PATH,
    help="CSV of the same cameras in the world: image,x,y,z [m] or image,lat,lon,alt.",
)
@grouped.option(
    "--poses",
    group="Cameras",
    type=PATH,
    help="CSV image,x,y,z,qw,qx,qy,qz: camera to world, axes x right, y down, z forward (OpenCV, COLMAP); "
    "--cameras then needs them too.",
)
@grouped.option(
    "--nerfstudio",
    group="Cameras",
    type=PATH,
    help="Run folder or dataparser_transforms.json: map the scene back to the frame of the source poses; "
    "--colmap or --cameras are then in that frame.",
)
@grouped.option(
    "--correspondences", group="Points", type=PATH, help="CSV sx,sy,sz,wx,wy,wz of points in both frames."
)
@click.option(
    "--distance",
    "distances",
    type=Numbers(7),
    cls=NumbersOption,
    multiple=True,
    metavar="'X Y Z' 'X Y Z' METRES",
    help="Two points of the scene and their distance; repeatable; determines the scale alone.",
)
@grouped.option(
    "--cloud", group="Points", type=PATH, help="Surveyed cloud [m]: PLY, PCD, XYZ, PTS or .npz (points)."
)
@grouped.option(
    "--initial",
    group="Points",
    type=PATH,
    help="First guess for --cloud, a file like that of --transform; cameras or --correspondences can replace "
    "it; default: the identity.",
)
@click.option("--transform", type=PATH, help="JSON: 4x4 matrix, or scale, rotation and translation_m.")
@options.fields_of(ScaleAlignConfig)
@options.output(".scene.npz, or a folder .scene")
def command(
    scene: Path,
    distances: tuple[tuple[float, ...], ...],
    fields: dict[str, Any],
    common: Common,
    **paths: Path | None,
) -> None:
    """Give a scene metric scale and a named world frame.

    Give one kind of evidence: --colmap or --cameras with --reference or --poses, --nerfstudio,
    --correspondences, --distance, --cloud, --transform or --scale. The alignment is checked before
    anything is written. The 3D points of --colmap show whether its cameras are in the frame of the splat. A
    scene that is aligned already may be aligned again, or only levelled.

    A scene in parts gives a folder of parts, -o NAME.scene: one similarity for all parts. Memory then holds
    300 bytes per Gaussian of a part per job, and 24 bytes for each of at most 4,194,304 centres, evenly
    chosen, where --floor or --cloud compares them. An output .npz takes 300 bytes per Gaussian of the scene.
    """
    from alula.cli.verbs.align import Files
    from alula.cli.verbs.verb import run_step
    from alula.schemas.artifacts.kinds import SCENE
    from alula.schemas.artifacts.parts import open_parts

    files = Files(**paths)
    config = files.config_of(fields, [((a, b, c), (d, e, f), x) for a, b, c, d, e, f, x in distances])
    shown: list[dict[str, Any]] = []

    def report(alignment: dict[str, Any]) -> None:
        shown.append(alignment)
        if not (common.quiet or common.json):
            show_alignment(alignment, common.verbose)

    def run(common: Common) -> None:
        run_step(common, files.step(scene, config, common.seed, report, common.jobs))

    if not common.json:
        run(common)
        return
    # Print the whole record, not only the summary that every command prints.
    run(dataclasses.replace(common, json=False, quiet=True))
    status = "unchanged" if not shown else "dry-run" if common.dry_run else "written"
    answer: dict[str, Any] = {"output": str(common.output), "status": status}
    if status == "dry-run":
        print_json({**answer, "alignment": shown[0]})
        return
    manifest: Any = open_parts(common.output, SCENE).manifest
    print_json({**answer, "summary": manifest.summary, "alignment": manifest.alignment})
