"""`alula help`."""

from __future__ import annotations

from pathlib import Path

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.present import echo
from alula.schemas.errors import OutputError, UsageError

EXAMPLES = """\b
Examples:
  alula help
  alula help import-splat
  alula help --man ~/.local/share/man/man1
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("name", metavar="[COMMAND]", required=False)
@click.option("--man", type=options.PATH, help="Write the man pages of all commands to this folder instead.")
@click.pass_context
def command(context: click.Context, name: str | None, man: Path | None) -> None:
    """Show the help of alula or of a command."""
    group = context.parent
    assert group is not None
    if man is not None:
        if name is not None:
            raise UsageError("--man writes the pages of all commands; leave COMMAND out")
        _write_pages(man)
        return
    if name is None:
        _show(group.get_help())
        return
    assert isinstance(group.command, click.Group)
    found = group.command.get_command(group, name)
    if found is None:
        raise UsageError(f"no command is called {name!r} (alula help lists them)")
    with click.Context(found, group, name) as inner:
        _show(found.get_help(inner))


def _show(text: str) -> None:
    for line in text.splitlines():
        echo(line)


def _write_pages(folder: Path) -> None:
    """Write the man pages into a folder, which is made if it does not exist.

    Raises:
        OutputError: they cannot be written.
    """
    from alula.cli.shell.manual import man_pages
    from alula.schemas.atomic import write_text

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be made: {error.strerror or error}") from error
    pages = man_pages()
    for name, page in pages.items():
        write_text(folder / name, page)
    echo(f"{folder}: {len(pages)} man pages")
