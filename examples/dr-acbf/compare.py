"""The tables of DR-ACBF, the sensitivity of what it leaves open, and more, from the runs in a folder.

Usage: python compare.py [--markdown FILE] FOLDER RUN [RUN ...]

A run is SCENARIO/VARIANT.run.mcap with its record beside it; tables and figures are written into FOLDER, the
same tables as one page of Markdown into FILE.
"""

import argparse
import os
import platform
from pathlib import Path

from alula.cli.runner import input_ref
from alula.schemas.atomic import write_text
from alula.schemas.run import read_run
from alula.stages.reporting import dracbf, dracbf_beyond, dracbf_figures, dracbf_small
from alula.stages.reporting.material import Material
from alula.stages.reporting.page import page
from alula.stages.reporting.tables import inputs_table, table_csv, to_markdown

TITLE = "DR-ACBF: moving obstacles, uncertain and late"
WRITTEN = "Written by `make -C examples/dr-acbf page`"
parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the tables to FILE")
parser.add_argument("folder", type=Path)
parser.add_argument("runs", type=Path, nargs="+", metavar="RUN")
options = parser.parse_args()
folder, paths = options.folder, options.runs
flown = [
    dracbf.Flown(path.parent.name, path.name.removesuffix(".run.mcap"), read_run(path)) for path in paths
]
found = [
    *dracbf.group_tables(flown),
    dracbf_beyond.collapse_table(flown),
    *dracbf_small.hardware_tables(flown),
    dracbf_small.wall_table(flown),
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
facts = {"flown": dracbf.effort(flown)} | dracbf_beyond.in_short(flown)
material = Material(TITLE, inputs=tuple(input_ref(path.parent.name, path) for path in paths))
for table in tables:
    write_text(folder / f"{table.name}.csv", table_csv(table))
for figure in figures:
    write_text(folder / f"{figure.name}.svg", figure.svg)
read = [dracbf.folded(table) for table in tables]
text = to_markdown(TITLE, facts, read, "")
write_text(folder / "dr-acbf.md", text)
write_text(
    folder / "dr-acbf.html", page(material, [*read, inputs_table(material)], figures, None, facts=facts)
)
if options.markdown is not None:
    machine = f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}"
    head = f"{WRITTEN} on {machine}. Times are measured while the trials flew."
    write_text(options.markdown, text.replace("\n\n", f"\n\n{head}\n\n", 1))
