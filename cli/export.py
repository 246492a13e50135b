"""`alula export`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from alula.cli import options
from alula.cli.options import Common
from alula.schemas.configs.export import ExportConfig

if TYPE_CHECKING:
    from alula.cli.runner import Progress
    from alula.schemas.provenance import Provenance

EXAMPLES = """\b
Examples:
  alula export room.cover.npz -o room.glb
  alula export room.scene.npz -o room.spz
  alula export room.cover.npz -o room.map.bin
"""


@click.command(epilog=EXAMPLES)
@click.argument("artifact", metavar="INPUT", type=options.input_path())
@options.from_config(ExportConfig)
@options.output(".glb .obj .json .stl .bin .h .ply .splat .spz")
def command(artifact: Path, config: ExportConfig, common: Common) -> None:
    """Convert a cover or a scene for other programs.

    A cover becomes GLB, OBJ, STL (one mesh per hull), JSON (the exact integers), or an onboard map that
    a microcontroller reads in place (.bin; the same as a C array in .h); a scene becomes PLY, SPLAT or SPZ
    (Gaussians), GLB or OBJ (points). Of Gaussians, it is measured and told what the format lost. Coordinates
    are not turned. A .splat has no room to say where it came from, so that only -f replaces one.
    """
    from alula.cli.runner import run
    from alula.schemas.artifact import read_artifact
    from alula.schemas.atomic import atomic_output
    from alula.schemas.errors import InputError
    from alula.stages.compression.map_image import decode_map
    from alula.stages.compression.onboard import map_facts
    from alula.stages.reporting.export import export
    from alula.stages.reporting.export_scene import SCENE_ENCODERS, written_losses

    parameters = config.parameters(common.output)
    name = str(parameters["format"])

    def make(provenance: Provenance, progress: Progress) -> tuple[Any, dict[str, Any]]:
        found = read_artifact(artifact)
        try:
            parts = list(export(found, name, provenance))
        except InputError as error:
            raise type(error)(f"{artifact}: {error}") from error

        def write() -> None:
            with atomic_output(common.output) as file:
                file.writelines(parts)

        what = {"hulls": "plane_start", "gaussians": "mean"}
        counts: dict[str, Any] = {
            word: len(found[array]) for word, array in what.items() if array in found.arrays
        }
        if "hulls" in counts:
            counts["hulls"] -= 1
        if name == "onboard":
            counts |= map_facts(decode_map(parts[0]))
        if name in SCENE_ENCODERS:
            counts |= written_losses(found, name, b"".join(parts))
            if "loss" in found.arrays:
                counts["notes"] = ["what the scene's own source may have lost is not recorded in this file"]
        return write, {"format": name, **counts, "bytes": sum(map(len, parts))}

    run(common, "alula/export", "1.0", parameters, {"input": artifact}, make)
