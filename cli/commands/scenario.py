"""`alula scenario`."""

from __future__ import annotations

from pathlib import Path

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.set_values import settings_of
from alula.schemas.errors import OutputError, UsageError
from alula.schemas.scenarios.examples import NAMES

EXAMPLES = """\b
Examples:
  alula scenario room.toml
  alula scenario room.toml --set vehicle.type=crazyflie21 --set safety.cone-backup.horizon_s=2
  alula scenario room.toml -o whole.toml
  alula scenario --keys safety.cone-backup
  alula scenario --example room-mocap -o balls.toml
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("file", type=options.PATH, required=False)
@options.settings(
    "Replace a value by the path of its key; may be repeated. Names of files are relative to FILE."
)
@click.option(
    "--keys",
    "part",
    is_flag=False,
    flag_value="",
    metavar="[PART]",
    help="List all keys that a scenario can have, or those of a part of it.",
)
@click.option(
    "--example",
    type=click.Choice(NAMES),
    help="Write a scenario to begin with: room-mocap is a Crazyflie and two thrown balls in the map "
    "room.cover.npz, outdoor-radar a quadrotor and two other vehicles in the open.",
)
@click.option("-o", "--output", type=options.PATH, help="Write the scenario to this file (.toml).")
@click.option("-f", "--force", is_flag=True, help="Replace an output that exists.")
@options.reporting
def command(
    file: Path | None,
    settings: tuple[str, ...],
    part: str | None,
    example: str | None,
    output: Path | None,
    force: bool,
    json: bool,
    quiet: bool,
    verbose: int,
) -> None:
    """Show a scenario with all of its values and their sources.

    FILE is a scenario (.toml). The result is a scenario that says everything: each line ends with the source
    of its value, which is the file, --set, the vehicle, or a default. A scenario whose parts contradict one
    another is refused, and the message says what would work instead.
    """
    from alula.cli.shell.present import echo, print_json

    if part is not None:
        if file is not None or settings or output is not None or example is not None:
            raise UsageError("--keys lists keys, and takes no FILE, --set, --example or --output")
        _list_keys(part, json=json, quiet=quiet)
        return
    if example is not None:
        if file is not None or settings or json:
            raise UsageError("--example writes a scenario, and takes no FILE, --set or --json")
        _show_example(example, output, force=force, quiet=quiet)
        return
    if file is None:
        raise UsageError("needs a FILE, --example or --keys")
    from alula.schemas.files import printable
    from alula.schemas.scenarios.check import refusal
    from alula.schemas.scenarios.defaults import vehicle_of
    from alula.schemas.scenarios.scenario import TEXTS, read_sources
    from alula.schemas.scenarios.text import moved, toml_of, values_of

    read = read_sources(file, settings_of(settings, TEXTS))
    vehicle = vehicle_of(read.scenario, file.parent)
    if (words := refusal(read.scenario, vehicle)) is not None:
        raise UsageError(f"{file}: {words}")
    values = values_of(read, vehicle, printable(file.name))
    if output is not None:
        _write(output, toml_of(moved(values, file.parent, output.parent)), force=force)
    if json:
        print_json({"values": [{**item._asdict(), "value": _json(item.value)} for item in values]})
    elif output is None and not quiet:
        for line in toml_of(values).splitlines():
            echo(line)


def _show_example(name: str, output: Path | None, *, force: bool, quiet: bool) -> None:
    from alula.cli.shell.present import echo
    from alula.schemas.scenarios.examples import text_of

    text = text_of(name)
    if output is not None:
        _write(output, text, force=force)
    elif not quiet:
        echo(text.rstrip())


def _write(output: Path, text: str, *, force: bool) -> None:
    from alula.schemas.atomic import write_text

    if output.exists() and not force:
        raise OutputError(f"{output}: exists; -f replaces it")
    write_text(output, text)


def _json(value: object) -> object:
    """A value as JSON has it, which knows no infinity."""
    return str(value) if value == float("inf") else value


def _list_keys(part: str, *, json: bool, quiet: bool) -> None:
    from alula.cli.shell.present import echo, print_json
    from alula.schemas.scenarios.text import keys_of

    keys = keys_of(part)
    if json:
        print_json({"keys": [key._asdict() for key in keys]})
    elif not quiet:
        for key in keys:
            default = f" = {key.default}" if key.default else ""
            echo(f"{key.path}{default}  ({key.type})")
            echo(f"    {key.about}")
