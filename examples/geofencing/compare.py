"""Make the tables and figures of the geofencing paper, and further ones, from the runs in a folder.

Usage: python compare.py [--markdown FILE] FOLDER RUN [RUN ...]

A run is SCENARIO/VARIANT.run.mcap with its record beside it; FOLDER/pendulum.json holds the times that
pendulum.py measured. Tables and figures are written into FOLDER, and the same tables as one Markdown page
into FILE.
"""

import json
import re
from pathlib import Path

from alula.schemas.log.run import read_run
from alula.stages.reporting.table import folded
from papers.comparison import comparison_words, this_machine, write_comparison, write_record
from papers.geofencing import figures as geofencing_figures
from papers.geofencing import pendulum
from papers.geofencing import tables as geofencing
from papers.geofencing.pendulum import PROGRAM, REGULATION, sweep
from papers.geofencing.ticks import read_ticks
from papers.geofencing.verdicts import paper_rows
from papers.papers import GEOFENCING
from papers.verdicts import verdict_table

TITLE = "Geofencing: racing drones in a fence"
WRITTEN = """Read here which results of the geofencing paper hold, and how robust the fence is.
Written by `make -C examples/geofencing page`"""
DRAWN = ("wall", "fall", "engaged", "corner")  # the first flights of these folders are read tick by tick
GAINS = {REGULATION: (1.5, 5.0, 15.0, 60.0, 200.0, 1000.0), PROGRAM: (1.0, 5.0, 10.0, 50.0, 200.0, 1000.0)}
TICKS_S = (0.01, 0.0025)
GENTLE, HIGH = {REGULATION: 5.0, PROGRAM: 1.0}, {REGULATION: 60.0, PROGRAM: 50.0}
options = comparison_words(__doc__.splitlines()[0])
folder, paths = options.folder, options.runs
runs = [
    geofencing.Fenced(
        path.parent.name,
        path.name.removesuffix(".run.mcap"),
        read_run(path),
        read_ticks(path).get(0) if path.parent.name in DRAWN else None,
    )
    for path in paths
]
measured = json.loads((folder / "pendulum.json").read_text(encoding="utf-8"))
swings = sweep(GAINS, TICKS_S)
onboard = Path(__file__).resolve().parents[2] / "docs/results/onboard.md"
counted = re.search(r"`m7_geofence_us` \| ([\d.]+)", onboard.read_text("utf-8") if onboard.is_file() else "")
teensy_us = float(counted[1]) if counted else None
verdicts = paper_rows(runs, swings, measured, teensy_us)
found = [
    verdict_table(GEOFENCING, verdicts),
    pendulum.time_table(measured),
    pendulum.gains_table(swings),
    geofencing.approach_table(runs, "wall", "Figures 5a and 7a: straight at a wall", geofencing.WALL_NOTE),
    geofencing.approach_table(runs, "fall", "Figures 5b and 7b: a fall from 70 m", geofencing.FALL_NOTE),
    geofencing.flights_table(
        runs, "engaged", "Figure 8: repeated engagements, edges and corners", ("engaged", "corner")
    ),
    geofencing.flights_table(
        runs, "fences", "All kinds of pilots and fences", ("box", "faces", "cover", "combined")
    ),
    geofencing.filters_table(runs, "filters", ("geofence", "backup-qp", "none")),
    geofencing.robustness_table(runs),
    geofencing.pilots_table(runs),
    geofencing.passes_table(runs),
]
tables = [table for table in found if table is not None]
drawn = [
    geofencing_figures.pendulum_figure(swings, GENTLE, HIGH),
    geofencing_figures.chatter_figure(swings),
    geofencing_figures.approach_figure(
        runs,
        "wall",
        ("from-40", "from-64", "from-120", "from-40-none"),
        "Figures 5a, 7a: straight at a wall",
        6.0,
    ),
    geofencing_figures.approach_figure(
        runs, "fall", ("fall", "drag", "gentle", "reserve"), "Figures 5b, 7b: a fall from 70 m", 8.0
    ),
    geofencing_figures.engaged_figure(geofencing_figures.engaged_run(runs)),
    geofencing_figures.robustness_figure(runs),
    geofencing_figures.distances_figure(runs),
]
figures = [figure for figure in drawn if figure is not None]
facts = geofencing.in_short(runs, swings, measured)
write_comparison(
    folder / "geofencing",
    TITLE,
    [(path.parent.name, path) for path in paths],
    facts,
    tables,
    figures,
    read=[folded(table) for table in tables],
    markdown=options.markdown,
    head=f"{WRITTEN} on {this_machine()}. The filter and its guarantee: "
    "[geofence.md](../theory/geofence.md).",
)
write_record(folder / "geofencing", GEOFENCING, verdicts, figures, options)
