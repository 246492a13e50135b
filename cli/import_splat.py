"""`alula import-splat`."""

from __future__ import annotations

from pathlib import Path

import click

from alula.cli import options, runner
from alula.cli.options import Common
from alula.schemas.configs.import_splat import ImportSplatConfig

EXAMPLES = """\b
Examples:
  alula import-splat point_cloud.ply -o room.scene.npz
  alula import-splat tile.splat -o tile.scene.npz --min-opacity 0.05 --drop-floaters"""


@click.command("import-splat", epilog=EXAMPLES)
@click.argument("splat", type=options.input_path())
@options.from_config(ImportSplatConfig)
@options.output(".scene.npz")
def command(splat: Path, config: ImportSplatConfig, common: Common) -> None:
    """Read a Gaussian splat file into a scene.

    SPLAT is an INRIA .ply (binary or ascii, 3DGS or 2DGS) or an antimatter15 .splat; the content
    decides. Gaussians that are left out are counted, by reason, in the output.
    """
    from alula.schemas.artifact import Artifact
    from alula.schemas.errors import InputError
    from alula.schemas.kinds import SCENE
    from alula.stages.reconstruction.formats import read_splats
    from alula.stages.reconstruction.import_splat import import_splat

    def build(progress: runner.Progress) -> Artifact:
        splats = read_splats(splat, config.format, progress)
        try:
            return import_splat(config, splats)
        except InputError as error:
            raise InputError(f"{splat}: {error}") from error

    runner.run_stage(common, SCENE, config, {"splat": splat}, build)
