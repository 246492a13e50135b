"""`alula import-splat`."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click

from alula.cli import grouped, options, parted, runner
from alula.cli.import_parts import import_parts, inputs_of
from alula.cli.options import Common
from alula.schemas.configs.import_splat import PART_GAUSSIANS, ImportSplatConfig
from alula.schemas.errors import AlulaError, InputError, UsageError
from alula.schemas.files import printable
from alula.schemas.progress import Progress

EXAMPLES = """\b
Examples:
  alula import-splat point_cloud.ply -o room.scene.npz
  alula import-splat tile.splat -o tile.scene.npz --min-opacity 0.05 --drop-floaters
  alula import-splat street/lod-meta.json -o street.scene.npz --lod 1
  alula import-splat tile_0.splat tile_1.splat -o street.scene.npz
  alula import-splat tile_*.splat -o city.scene
  curl -s https://example.org/room.spz | alula import-splat - -o room.scene.npz --turn x"""


@grouped.command("import-splat", epilog=EXAMPLES)
@click.argument("splats", metavar="SPLAT...", nargs=-1, required=True, type=options.FilePath(stdin=True))
@options.from_config(ImportSplatConfig)
@click.option(
    "--part-gaussians",
    type=options.Whole(100, 2**26),
    default=PART_GAUSSIANS,
    show_default=True,
    help="Maximum number of Gaussians of a part, where the output is a folder.",
)
@options.output(".scene.npz, or a folder .scene")
@click.pass_context
def command(
    context: click.Context,
    splats: tuple[Path, ...],
    config: ImportSplatConfig,
    part_gaussians: int,
    common: Common,
) -> None:
    """Read Gaussian splat files into a scene.

    SPLAT is a file, the output folder of a trainer, or - for standard input. The format is recognised by
    the content; `alula info` reports it too, and docs/guide/splat-formats.md lists all formats. The output
    counts the Gaussians that are left out, by reason. It also records the precision that a lossy format may
    have lost; voxelize grows the ellipsoids accordingly.

    Several files that share one frame, such as tiles, become one scene, in their order. Of a streamed SOG,
    lod-meta.json or its folder reads all files of one level of detail. Any other folder stands for all splats
    in it.

    With an output NAME.scene the scene is a folder of parts, each an ordinary scene of rows of one file; all
    commands take it like a file. Interrupted, the same command continues with the parts that are finished.

    Memory: 250 bytes per Gaussian of all files; with a folder as the output 250 bytes per Gaussian of a part
    per job, whatever the number of parts. Of formats other than .splat, .ply and streamed SOG, of which it is
    one file, a part is a whole file while it is read.
    """
    if parted.is_parted(common.output, ".scene"):
        with read_stdin(splats[0], common) as first:
            import_parts((first, *splats[1:]), config, part_gaussians, common)
        return
    if options.is_given(context, "part_gaussians"):
        raise UsageError("--part-gaussians goes with a folder as the output, such as -o NAME.scene")
    from alula.schemas.artifact import Artifact
    from alula.schemas.kinds import SCENE
    from alula.stages.progress import share
    from alula.stages.reconstruction.formats.capture import joined
    from alula.stages.reconstruction.import_splat import import_splat
    from alula.stages.reconstruction.pieces import find_splats

    if len(splats) > 1 and any(str(path) == "-" for path in splats):
        raise UsageError("- is one stream and cannot be joined with files; write it to a file first")
    with read_stdin(splats[0], common) as first:
        found = find_splats((first, *splats[1:]), config.format, config.lod)
        names = [printable("-" if one.path == first != splats[0] else one.path.name) for one in found]

        def build(progress: Progress) -> Artifact:
            read = joined(
                [
                    (name, one.decode(share(progress, k / len(found), (k + 1) / len(found))))
                    for k, (name, one) in enumerate(zip(names, found, strict=True))
                ]
            )
            try:
                return import_splat(config, read)
            except InputError as error:
                more = f" and {len(found) - 1} more" if len(found) > 1 else ""
                raise InputError(f"{splats[0]}{more}: {error}") from error

        inputs = {role: path for files in inputs_of(found) for role, path in files.items()}
        runner.run_stage(common, SCENE, config, inputs, build)


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
