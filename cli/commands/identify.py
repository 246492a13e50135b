"""`alula identify`."""

from __future__ import annotations

import dataclasses
from typing import Any

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.route import of_link
from alula.schemas.parameters.configs.identify import IdentifyConfig

EXAMPLES = """\b
Examples:
  alula identify --link udpin:127.0.0.1:14550 --box -8 -8 0 8 8 12 -o mine.toml --dry-run
  alula identify --link udpin:127.0.0.1:14550 --box -8 -8 0 8 8 12 --speeds 0.5,1,2,3 -o mine.toml
  alula identify --link serial:/dev/ttyUSB0:57600 --box -5 -5 0 5 5 8 --rates --vehicle my.toml -o mine.toml
"""


def _speeds(context: click.Context, parameter: click.Parameter, value: str) -> tuple[float, ...]:
    return tuple(
        options.FINITE_FLOAT.convert(part, parameter, context) for part in value.replace(",", " ").split()
    )


@grouped.command("identify", epilog=EXAMPLES)
@click.option(
    "--link",
    "address",
    required=True,
    metavar="ADDRESS",
    help="Link to the vehicle: udpin:HOST:PORT, udpout:…, tcp:…, serial:DEVICE:BAUD, or sim: for a simulated "
    "one.",
)
@options.vehicle(
    "First guess, a built-in vehicle or a file (.toml), which gives all that is not measured; default: the "
    "quadrotor of FastBridge."
)
@click.option(
    "--speeds",
    "speeds_m_s",
    default="0.5,1,2",
    show_default=True,
    callback=_speeds,
    metavar="SPEEDS",
    help="Speeds of the steps, at least two, separated by commas [m/s].",
)
@of_link
@options.from_config(IdentifyConfig)
@options.output(".toml")
def command(
    address: str,
    speeds_m_s: tuple[float, ...],
    config: IdentifyConfig,
    common: options.Common,
    **given: Any,
) -> None:
    """Measure how a vehicle responds to steps, and write its vehicle file.

    The vehicle takes off in the middle of a box that the user keeps free, flies steps of the velocity in all
    directions at all speeds, with --rates also short steps of body rates and thrust, and lands. The file has
    lag, delay, limits, hover throttle and drag with 95 % intervals; fly --vehicle uses them. A step that does
    not fit into the box is left out. A line tells where the first guess, or a parameter of the vehicle, is
    wrong by more than a quarter. The checks before the flight, the pilot's control, Ctrl-C and the geofence
    are those of fly; --dry-run runs the checks and does not arm.

    Exit code 2: the box is too small; 4: a check does not hold, or the steps do not determine the lag; 6: the
    link or the vehicle failed. Then no file is written.
    """
    from alula.cli.verbs.identify import identify

    identify(address, dataclasses.replace(config, speeds_m_s=speeds_m_s), common, **given)
