"""`alula completion`, and what the shells complete beside the names of files."""

from __future__ import annotations

import click
from click.shell_completion import CompletionItem

from alula.cli import grouped
from alula.cli.present import echo

EXAMPLES = """\b
Examples:
  alula completion bash > ~/.local/share/bash-completion/completions/alula
  eval "$(alula completion zsh)"
  alula completion fish > ~/.config/fish/completions/alula.fish
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def command(context: click.Context, shell: str) -> None:
    """Print the completion script of a shell.

    It completes commands, options, files, and the names of filters and vehicles.
    """
    from click.shell_completion import get_completion_class

    made = get_completion_class(shell)
    assert made is not None
    for line in made(context.find_root().command, {}, "alula", "_ALULA_COMPLETE").source().splitlines():
        echo(line)


def filters(_context: click.Context, _parameter: click.Parameter, given: str) -> list[CompletionItem]:
    """Names of filters that continue a list with commas."""
    from alula.stages.filtering.registry import filter_names

    before, comma, begun = given.rpartition(",")
    taken = before.split(",")
    names = [name for name in filter_names() if name.startswith(begun) and name not in taken]
    return [CompletionItem(f"{before}{comma}{name}") for name in names]


def vehicles(_context: click.Context, _parameter: click.Parameter, given: str) -> list[CompletionItem]:
    """Names of built-in vehicles, and files."""
    from typing import get_args

    from alula.schemas.scenarios.tables import VehicleName

    names = [name for name in get_args(VehicleName) if name.startswith(given)]
    return [*(CompletionItem(name) for name in names), CompletionItem(given, type="file")]
