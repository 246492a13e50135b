"""`alula help`."""

from __future__ import annotations

import click

from alula.cli import grouped
from alula.cli.present import echo
from alula.schemas.errors import UsageError

EXAMPLES = """\b
Examples:
  alula help
  alula help import-splat
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("name", metavar="[COMMAND]", required=False)
@click.pass_context
def command(context: click.Context, name: str | None) -> None:
    """Show the help of alula or of a command."""
    group = context.parent
    assert group is not None
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
