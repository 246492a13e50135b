"""The tables of DR-ACBF, the sensitivity of what it leaves open, and more, from the runs in a folder.

Usage: python compare.py FOLDER RUN [RUN ...]

A run is SCENARIO/VARIANT.run.mcap with its record beside it; tables and figures are written into FOLDER.
"""

import sys
from pathlib import Path

from alula.cli.runner import input_ref
from alula.schemas.atomic import write_text
from alula.schemas.run import read_run
from alula.stages.reporting import dracbf, dracbf_beyond, dracbf_figures
from alula.stages.reporting.material import Material
from alula.stages.reporting.page import page
from alula.stages.reporting.tables import Table, inputs_table, table_csv, to_markdown

TITLE = "DR-ACBF: moving obstacles, uncertain and late"
folder, paths = Path(sys.argv[1]), [Path(word) for word in sys.argv[2:]]
flown = [
    dracbf.Flown(path.parent.name, path.name.removesuffix(".run.mcap"), read_run(path)) for path in paths
]
found = [
    *dracbf.group_tables(flown),
    dracbf_beyond.collapse_table(flown),
    dracbf.hardware_table(flown),
    dracbf.wall_table(flown),
    dracbf_beyond.recursion_table(flown),
    dracbf_beyond.risk_table(flown),
    dracbf.sensitivity_table(flown, "sensitivity-1"),
    dracbf.sensitivity_table(flown, "sensitivity-2"),
]
tables = [table for table in found if table is not None]
drawn = [
    dracbf_figures.success_figure(flown, "scenario-1"),
    dracbf_figures.success_figure(flown, "scenario-2"),
    dracbf_figures.collapse_figure(flown),
    dracbf_figures.risk_figure(flown),
    dracbf_figures.recursion_figure(),
    dracbf_figures.stop_figure(),
]
figures = [figure for figure in drawn if figure is not None]
facts = dracbf_beyond.in_short(flown)
material = Material(TITLE, inputs=tuple(input_ref(path.parent.name, path) for path in paths))
for table in tables:
    write_text(folder / f"{table.name}.csv", table_csv(table))
for figure in figures:
    write_text(folder / f"{figure.name}.svg", figure.svg)
write_text(folder / "dr-acbf.md", to_markdown(TITLE, facts, tables, ""))
short = Table("short", "In short", ("", "found"), tuple(facts.items()))
write_text(folder / "dr-acbf.html", page(material, [short, *tables, inputs_table(material)], figures, None))
