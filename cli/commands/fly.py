"""`alula fly`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from alula.cli.shell import grouped, options
from alula.cli.shell.route import of_link
from alula.cli.shell.set_values import settings_of
from alula.schemas.parameters.configs.fly import FlyConfig

EXAMPLES = """\b
Examples:
  alula fly room.plan.npz --map room.cover.npz --link udpin:127.0.0.1:14550 -o first.run.mcap --dry-run
  alula fly room.plan.npz --map room.metric.scene.npz --filter cone-backup --link sim: -o fast.run.mcap
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("source", type=options.PATH)
@click.option("--map", type=options.PATH, help="Cover, tiles or scene to fly in; required with a plan.")
@grouped.option(
    "--key", group="Maps in tiles", type=options.PATH, help="Key that must have signed the tiles."
)
@click.option("--scene", type=options.PATH, help="Metric scene, if --map is a cover.")
@grouped.option(
    "--within",
    group="Flight",
    type=options.PATH,
    help="Seen space (.seen.npz) to stay in, beside a cover; unseen space counts like hulls.",
)
@options.vehicle("Built-in vehicle, or vehicle file (.toml); default: the quadrotor of FastBridge.")
@click.option(
    "--link",
    metavar="ADDRESS",
    help="Link to the vehicle: udpin:HOST:PORT, udpout:…, tcp:…, serial:DEVICE:BAUD, or sim: for a simulated "
    "one.",
)
@of_link
@options.settings("Parameter of a filter among ellipsoids; may be repeated.", "Filter")
@click.option(
    "--live",
    type=options.Whole(1, 65535),
    is_flag=False,
    flag_value=8080,
    metavar="[PORT]",
    help="Show the flight in a browser, at this port of this machine only (8080).",
)
@grouped.option(
    "--foxglove",
    group="Log",
    type=options.Whole(1, 65535),
    is_flag=False,
    flag_value=8765,
    metavar="[PORT]",
    help="Serve the live channels to Foxglove, at this port of this machine only (8765); requires "
    "alula[foxglove].",
)
@grouped.option(
    "--start-time",
    group="Log",
    metavar="TIME",
    help="Time of the start in the log, such as 2026-05-01T12:00:00Z; default: by the clock of this machine.",
)
@options.fields_of(FlyConfig)
@options.output(".run.mcap")
def command(
    source: Path, settings: tuple[str, ...], fields: dict[str, Any], common: options.Common, **given: Any
) -> None:
    """Fly a plan on a real vehicle, behind a safety filter.

    SOURCE is a plan, with --map and --link, or a scenario (.toml) with a plan. The table [fly] of a scenario
    sets the link and options of this command. After the pre-flight checks the vehicle arms, takes off to the
    height of the plan's start, flies the plan and lands. docs/guide/fly-states.md describes all other
    courses. --dry-run runs the checks and does not arm. Ctrl-C lands the vehicle; a second Ctrl-C stops the
    motors, but only on the ground. The pilot can take control at any time; this command then sends nothing
    more.

    The log is written during the flight; R.run.json beside it holds the summary and the measured times. Exit
    code 3: an input cannot be read, or the flight went well, but its log or record is not complete; 4: a
    check does not hold, the plan was not finished, or the flight came closer to the map than the vehicle's
    radius; 6: the link or the vehicle failed.
    """
    from alula.cli.verbs.fly.fly import fly

    fly(source, common, fields, settings=settings_of(settings), **given)
