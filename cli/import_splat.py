"""`alula import-splat`."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from alula.cli import options, runner
from alula.cli.options import Common
from alula.schemas.configs.import_splat import ImportSplatConfig
from alula.schemas.errors import AlulaError, InputError, UsageError
from alula.schemas.progress import Progress

EXAMPLES = """\b
Examples:
  alula import-splat point_cloud.ply -o room.scene.npz
  alula import-splat tile.splat -o tile.scene.npz --min-opacity 0.05 --drop-floaters
  curl -s https://example.org/room.spz | alula import-splat - -o room.scene.npz --turn x"""


@click.command("import-splat", epilog=EXAMPLES)
@click.argument("splat", type=options.FilePath(stdin=True))
@options.from_config(ImportSplatConfig)
@options.output(".scene.npz")
def command(splat: Path, config: ImportSplatConfig, common: Common) -> None:
    """Read a Gaussian splat file into a scene.

    SPLAT is a file, the output folder of a trainer, or - for standard input. The format is recognised by
    the content; `alula info` reports it too, and docs/guide/splat-formats.md lists all formats. The output
    counts the Gaussians that are left out, by reason. It also records the precision that a lossy format may
    have lost; voxelize grows the ellipsoids accordingly.
    """
    from alula.schemas.artifact import Artifact
    from alula.schemas.kinds import SCENE
    from alula.stages.reconstruction.formats.registry import SplatFile
    from alula.stages.reconstruction.import_splat import import_splat

    with read_stdin(splat, common) as path:
        found = SplatFile.find(path, config.format)

        def build(progress: Progress) -> Artifact:
            splats = found.decode(progress)
            try:
                return import_splat(config, splats)
            except InputError as error:
                raise InputError(f"{splat}: {error}") from error

        runner.run_stage(common, SCENE, config, found.files(), build)


@contextmanager
def read_stdin(path: Path, common: Common) -> Iterator[Path]:
    """Context with the path to read: the file itself, or for - a temporary copy of standard input.

    Args:
        path: the argument of the command.
        common: the shared options.

    Raises:
        UsageError: standard input is a terminal, or --depfile is given with it.
        InputError: standard input cannot be copied.
    """
    if str(path) != "-":
        yield path
        return
    if common.depfile is not None:
        raise UsageError("--depfile names files, but the input is a stream")
    if sys.stdin is None or sys.stdin.isatty():
        raise UsageError("standard input is a terminal; pipe a splat file into it")
    with tempfile.TemporaryDirectory(prefix="alula-") as folder:
        copy = Path(folder) / "stdin"
        try:
            with copy.open("wb") as file:
                shutil.copyfileobj(sys.stdin.buffer, file, 2**20)
        except OSError as error:
            raise InputError(f"standard input: cannot be copied: {error.strerror or error}") from error
        try:
            yield copy
        except AlulaError as error:  # users do not know the name of the copy
            error.args = tuple(str(a).replace(str(copy), "standard input") for a in error.args)
            raise
