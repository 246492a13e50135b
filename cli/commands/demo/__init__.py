"""`alula demo`: the example of the built-in room, whose Makefile and scenario stand beside this file."""

from __future__ import annotations

import shutil
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import click

from alula.cli.shell import grouped, options

EXAMPLES = """\b
Examples:
  alula demo
  alula demo -o room
"""
PARTS = ("Makefile", "scenario.toml")


@grouped.command("demo", epilog=EXAMPLES)
@click.option(
    "-o",
    "--output",
    type=options.PATH,
    default=Path("alula-demo"),
    show_default=True,
    help="Folder to work in.",
)
@options.reporting
def command(output: Path, json: bool, quiet: bool, verbose: int) -> None:
    """Fly the built-in scene end to end and leave a report.

    The folder gets a Makefile and a scenario, and `make` runs there: it needs the program make. A second
    call goes on where the first one ended, and does again what depends on a file that you changed.
    """
    from alula.cli.shell.present import print_json
    from alula.schemas.atomic import write_text
    from alula.schemas.errors import AlulaError, OutputError, UsageError

    if shutil.which("make") is None:
        raise UsageError("the program make is missing: sudo apt-get install make")
    for name in PARTS:
        if not (output / name).exists():
            try:
                output.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise OutputError(f"{output}: {error.strerror}") from error
            write_text(output / name, (files("alula.cli.commands.demo") / name).read_text())
    program = Path(sys.argv[0])
    alula = str(program.absolute()) if program.name == "alula" else f"{sys.executable} -P -m alula.cli"
    make = ["make", "--no-print-directory", "-j2", "--output-sync", "-C", str(output), f"ALULA={alula}"]
    done = subprocess.run(make, stdout=subprocess.DEVNULL if json or quiet else None)
    if done.returncode:
        raise AlulaError(f"{output}: the demo ended before its report, for the reason above")
    if json:
        print_json({"output": str(output / "out/room.report.html"), "status": "written"})
