"""`alula import-splat`."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.addresses import Address, Limits, limited
from alula.cli.shell.options import Common
from alula.cli.shell.progress import shown_progress
from alula.schemas.errors import AlulaError, InputError, UsageError
from alula.schemas.files import printable
from alula.schemas.parameters.configs.import_splat import PART_GAUSSIANS, ImportSplatConfig

EXAMPLES = """\b
Examples:
  alula import-splat point_cloud.ply -o room.scene.npz
  alula import-splat tile.splat -o tile.scene.npz --min-opacity 0.05 --drop-floaters
  alula import-splat street/lod-meta.json -o street.scene.npz --lod 1
  alula import-splat tile_0.splat tile_1.splat -o street.scene.npz
  alula import-splat tile_*.splat -o city.scene
  alula import-splat https://example.org/room.spz -o room.scene.npz --turn x
  cat tile.splat | alula import-splat - -o tile.scene.npz"""


@grouped.command("import-splat", epilog=EXAMPLES)
@click.argument(
    "splats", metavar="SPLAT...", nargs=-1, required=True, type=options.FilePath(stdin=True, web=True)
)
@options.from_config(ImportSplatConfig)
@grouped.option(
    "--part-gaussians",
    type=options.Whole(100, 2**26),
    default=PART_GAUSSIANS,
    show_default=True,
    help="Maximum number of Gaussians of a part, where the output is a folder.",
)
@limited
@options.output(".scene.npz, or a folder .scene")
@click.pass_context
def command(
    context: click.Context,
    splats: tuple[Path | Address, ...],
    config: ImportSplatConfig,
    part_gaussians: int,
    limits: Limits,
    common: Common,
) -> None:
    """Read Gaussian splat files into a scene.

    SPLAT is a file, the output folder of a trainer, - for standard input, or an address, https://host/file,
    whose file is downloaded, read and removed. The format is recognised by the content; `alula info` reports
    it too, and docs/guide/splat-formats.md lists all formats. The output counts the Gaussians that are left
    out, by reason. It also records the precision that a lossy format may have lost; voxelize grows the
    ellipsoids accordingly.

    Several files that share one frame, such as tiles, become one scene, in their order. Of a streamed SOG,
    lod-meta.json or its folder reads all files of one level of detail. Any other folder stands for all splats
    in it.

    With an output NAME.scene the scene is a folder of parts, each an ordinary scene of rows of one file; all
    commands take it like a file. Interrupted, the same command continues with the parts that are finished.

    Memory: 250 bytes per Gaussian of all files; with a folder as the output 250 bytes per Gaussian of a part
    per job, whatever the number of parts. Of formats other than .splat, .ply and streamed SOG, of which it is
    one file, a part is a whole file while it is read.
    """
    from alula.cli.shell.parted import is_parted
    from alula.cli.verbs.import_splat import SplatFiles, inputs_of, names_of
    from alula.cli.verbs.verb import run_step
    from alula.schemas.artifacts.kinds import SCENE

    if options.is_given(context, "part_gaussians") and not is_parted(common.output, SCENE):
        raise UsageError("--part-gaussians goes with a folder as the output, such as -o NAME.scene")
    with local_copies(splats, limits, common) as paths:
        shown = _shown(splats, paths)
        known_as = {paths[0]: "-"} if str(splats[0]) == "-" else shown
        found = SplatFiles(paths, config.format, config.lod, known_as)
        names = names_of(found.found, inputs_of(found.found), shown)
        run_step(common, found.step(config, part_gaussians, common.jobs), names=names)


def _shown(splats: Sequence[Path | Address], paths: Sequence[Path]) -> dict[Path, str]:
    """Address of each file that was downloaded."""
    pairs = zip(splats, paths, strict=True)
    return {path: printable(str(splat)) for splat, path in pairs if isinstance(splat, Address)}


@contextmanager
def local_copies(
    splats: Sequence[Path | Address], limits: Limits, common: Common
) -> Iterator[tuple[Path, ...]]:
    """Context with the paths to read: files themselves, and temporary copies of all others.

    Raises:
        UsageError: --depfile is given with a download, an address is named twice, or - with others.
        UsageError, InputError: as `Limits.for_each`, `read_stdin` and `downloaded`.
    """
    if len(splats) > 1 and any(str(path) == "-" for path in splats):
        raise UsageError("- is one stream and cannot be joined with files; write it to a file first")
    addresses = [splat for splat in splats if isinstance(splat, Address)]
    wanted = iter(limits.for_each(len(addresses)))
    if addresses and common.depfile is not None:
        raise UsageError("--depfile names files, but the input is an address")
    for number, address in enumerate(addresses):
        if address in addresses[:number]:
            raise UsageError(f"{address}: is named twice")
    with ExitStack() as stack:
        paths = []
        for splat in splats:
            if isinstance(splat, Path):
                paths.append(stack.enter_context(read_stdin(splat, common)))
                continue
            from alula.cli.shell.download import downloaded

            with shown_progress(common) as progress:
                copy = downloaded(splat, limits.most_bytes, next(wanted), progress)
                paths.append(stack.enter_context(copy))
        yield tuple(paths)


@contextmanager
def read_stdin(path: Path, common: Common) -> Iterator[Path]:
    """Context with the path to read: the file itself, or for - a temporary copy of standard input.

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
