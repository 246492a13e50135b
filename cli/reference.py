"""`python -m alula.cli.reference FILE` writes the command reference from the parsers."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from alula.cli.main import COMMANDS, cli

HEADER = """# Command reference

Made from the parsers by `make docs`; do not edit.

"""


def reference() -> str:
    """The help of every command, as Markdown."""
    names = ["-h", "--help"]
    top = click.Context(
        cli, info_name="alula", max_content_width=100, terminal_width=100, help_option_names=names
    )
    parts = [HEADER + f"```\n{cli.get_help(top)}\n```\n"]
    for name in COMMANDS:
        command = cli.get_command(top, name)
        assert command is not None
        context = click.Context(command, top, info_name=name, max_content_width=100, terminal_width=100)
        parts.append(f"## alula {name}\n\n```\n{command.get_help(context)}\n```\n")
    return "\n".join(parts)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(reference())
