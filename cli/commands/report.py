"""`alula report`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from alula.cli.shell import grouped, options
from alula.schemas.parameters.configs.report import ReportConfig

EXAMPLES = """\b
Examples:
  alula report room.run.mcap --cover room.cover.npz -o report.html
  alula report with.run.mcap without.run.mcap -o comparison.html
  alula report room.run.mcap --cover room.cover.npz -o report.pdf
"""


@grouped.command(epilog=EXAMPLES)
@click.argument("runs", nargs=-1, type=options.PATH)
@click.option("--cover", type=options.PATH, help="Cover that the runs flew through (.cover.npz).")
@click.option("--scene", type=options.PATH, help="Scene that the cover was made from (.scene.npz).")
@click.option("--plan", type=options.PATH, help="Plan that was flown (.plan.npz).")
@click.option("--certificate", type=options.PATH, help="Certificate that `verify` wrote (.json).")
@options.fields_of(ReportConfig)
@options.output(".html .md .csv .json .tex .pdf .png")
def command(runs: tuple[Path, ...], fields: dict[str, Any], common: options.Common, **named: Any) -> None:
    """Turn runs into a verdict, pictures, figures and tables.

    The page opens with a verdict in words, a picture and four numbers of each run. Playback, guarantees and
    figures follow; tables, parameters and provenance are folded. It loads nothing from elsewhere.

    Several runs are compared: each with the first, trial by trial where they have the same starts and goals,
    with 95 % intervals of the differences.

    Beside a page two more files are written: a .md file with the same tables and a .csv file with one row per
    trial. All formats have the same contents and the same numbers.
    """
    from alula.cli.verbs.report import report

    report(*runs, **named, **fields).write(common)
