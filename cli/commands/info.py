"""`alula info`."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.addresses import Address, Limits, limited

EXAMPLES = """\b
Examples:
  alula info room.cover.npz
  alula info scan.ply --json
  alula info https://example.org/scan.spz
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("file", type=options.FilePath(web=True))
@limited
@options.reporting
def command(file: Path | Address, limits: Limits, json: bool, quiet: bool, verbose: int) -> None:
    """Explain an artifact or a splat file.

    FILE may also be the folder of a splat, of an artifact in parts, or of a map in tiles; or an address,
    https://host/file, whose file is downloaded and removed. For a damaged file, info prints what it can still
    read and ends with exit code 3.
    """
    from alula.cli.shell.present import print_json, print_sections
    from alula.cli.verbs.info import explain
    from alula.schemas.files import printable, size_of

    (sha256,) = limits.for_each(int(isinstance(file, Address))) or ("",)
    with _local(file, limits.most_bytes, sha256) as path:
        facts, error = explain(path)
        name = file.name if isinstance(file, Path) else str(file)
        facts = {"file": printable(name), "bytes": size_of(path), "undamaged": error is None, **facts}
        if "damage" in facts:
            facts["damage"] = facts["damage"].replace(str(path), str(file))
        if json:
            print_json(facts)
        elif not quiet:
            print_sections(facts)
        if error is not None:
            raise error


def _local(file: Path | Address, most_bytes: int, sha256: str) -> AbstractContextManager[Path]:
    """Context with the path to read: the file itself, or a temporary copy of an address."""
    if isinstance(file, Path):
        return nullcontext(file)
    from alula.cli.shell.download import downloaded

    return downloaded(file, most_bytes, sha256)
