"""`alula completion`."""

from __future__ import annotations

import click

from alula.cli.shell import grouped
from alula.cli.shell.present import echo

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
