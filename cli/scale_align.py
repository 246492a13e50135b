"""`alula scale-align`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import options, runner
from alula.cli.options import FINITE_FLOAT, PATH, POINT, Common
from alula.cli.present import plain
from alula.schemas.configs.scale_align import Distance, ScaleAlignConfig
from alula.schemas.errors import InputError, UsageError

if TYPE_CHECKING:
    from alula.stages.alignment.scale_align import Evidence

EXAMPLES = """\b
Examples:
  alula scale-align room.scene.npz -o metric.scene.npz --colmap sparse/0 --reference poses.csv --max-rms 0.02
  alula scale-align room.scene.npz -o metric.scene.npz --distance "0.1 0 0" "0.9 0 0" 2.04"""


@click.command("scale-align", epilog=EXAMPLES)
@click.argument("scene", type=options.input_path())
@click.option("--colmap", type=PATH, help="COLMAP model (folder) with cameras in the scene's frame.")
@click.option("--cameras", type=PATH, help="CSV image,x,y,z of cameras in the scene's frame.")
@click.option("--reference", type=PATH, help="CSV image,x,y,z of the same cameras in the world [m].")
@click.option("--correspondences", type=PATH, help="CSV sx,sy,sz,wx,wy,wz of points in both frames.")
@click.option(
    "--distance",
    "distances",
    type=(POINT, POINT, FINITE_FLOAT),
    multiple=True,
    metavar="'X Y Z' 'X Y Z' METRES",
    help="Two points of the scene and how far they are apart; repeatable; fixes the scale alone.",
)
@click.option("--transform", type=PATH, help="JSON: 4x4 matrix, or scale, rotation and translation_m.")
@options.from_config(ScaleAlignConfig)
@options.output(".scene.npz")
def command(
    scene: Path,
    colmap: Path | None,
    cameras: Path | None,
    reference: Path | None,
    correspondences: Path | None,
    distances: tuple[Distance, ...],
    transform: Path | None,
    config: ScaleAlignConfig,
    common: Common,
) -> None:
    """Give a scene metric scale and a named world frame.

    Exactly one way to align is needed: --colmap or --cameras with --reference, --correspondences,
    --distance, --transform or --scale. The alignment is judged before anything is written. A scene that
    is aligned already may be aligned again.
    """
    from alula.schemas.artifact import Artifact, read_artifact
    from alula.schemas.kinds import SCENE
    from alula.stages.alignment import evidence as kinds
    from alula.stages.alignment.scale_align import scale_align, scale_only

    config = dataclasses.replace(config, distances=distances)
    ways = {
        "--colmap": colmap, "--cameras": cameras, "--correspondences": correspondences,
        "--distance": distances or None, "--transform": transform, "--scale": config.scale,
    }  # fmt: skip
    given = [name for name, value in ways.items() if value is not None]
    if len(given) != 1:
        what = f"not {' and '.join(given)}" if given else "none was given"
        raise UsageError(f"exactly one of {', '.join(ways)} is needed, {what}")
    if (reference is not None) != (given[0] in ("--colmap", "--cameras")):
        raise UsageError("--reference goes with --colmap or --cameras, and these with it")

    files = {"cameras": cameras, "reference": reference, "correspondences": correspondences}
    files["transform"] = transform
    inputs = {"scene": scene} | {role: path for role, path in files.items() if path is not None}
    if colmap is not None:
        inputs |= {f"colmap {part}": path for part, path in kinds.model_files(colmap).items()}

    def evidence() -> Evidence:
        if config.scale is not None:
            return scale_only(config.scale)
        if transform is not None:
            return kinds.parse_transform(_text(transform), transform.name)
        if correspondences is not None:
            return kinds.parse_pairs(_text(correspondences), correspondences.name)
        if reference is None:
            return config.distances
        wanted = kinds.parse_positions(_text(reference), reference.name)
        if cameras is not None:
            return kinds.match(kinds.parse_positions(_text(cameras), cameras.name), wanted)
        assert colmap is not None
        return kinds.match(kinds.read_model(colmap), wanted)

    def build(progress: runner.Progress) -> Artifact:
        report = None if common.quiet or common.json else lambda a: _show(a, common.verbose)
        return scale_align(config, read_artifact(scene, SCENE), evidence(), common.seed, report)

    runner.run_stage(common, SCENE, config, inputs, build, seed=common.seed)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text in UTF-8") from error
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error


def _show(alignment: dict[str, Any], verbose: int) -> None:
    """The alignment on stderr: its ten worst items and warnings; with -v all of it."""
    items = sorted(alignment.get("items", []), key=lambda item: -item["residual_m"])
    shown = items if verbose else items[:10]
    for item in shown:
        mark = "" if item["inlier"] else "  outlier"
        click.echo(f"{item['residual_m']:12.4f} m  {item['item']}{mark}", err=True)
    if len(shown) < len(items):
        click.echo(f"{'':14}  and {len(items) - len(shown)} better ones (-v shows them)", err=True)
    for key, value in alignment.items() if verbose else ():
        if key not in ("items", "matrix", "warnings") and value is not None:
            click.echo(f"  {key:<20}  {plain(value)}", err=True)
    for warning in alignment["warnings"]:
        click.echo(f"warning: {warning}", err=True)
