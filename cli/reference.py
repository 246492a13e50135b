"""Command reference: `python -m alula.cli.reference FILE` writes it from the parsers."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from alula.cli.main import COMMANDS, cli
from alula.cli.shell.grouped import Command

HEADER = """# Command reference

This page has the help of every command: what it reads and writes, its options with their defaults, and
examples. Exit codes come first. The options that matter most are the first ones; those that all commands
share come last. `alula fly --help` shows the first ones only, `alula fly --help-all` all of them. On a
terminal:

```sh
alula help plan                            # the same text
alula help --man ~/.local/share/man/man1   # man pages, for `man alula-plan`
eval "$(alula completion bash)"            # Tab completes commands, options, files, filters, vehicles
```

Made from the parsers by `make docs`; do not edit.

"""


WIDTH: dict[str, Any] = {"terminal_width": 100, "max_content_width": 100}


def reference() -> str:
    """Help of every command, as Markdown."""
    top = cli.make_context("alula", [], resilient_parsing=True, **WIDTH)
    parts = [HEADER + f"```\n{cli.get_help(top)}\n```\n"]
    for name in COMMANDS:
        command = cli.get_command(top, name)
        assert isinstance(command, Command)
        context = command.make_context(name, [], top, resilient_parsing=True, **WIDTH)
        parts.append(f"## alula {name}\n\n```\n{command.help_of_all(context)}\n```\n")
    return "\n".join(parts)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(reference())
