"""Make the tables and figures of DR-ACBF, with the effect of its free choices, from the runs in a folder.

Usage: python compare.py [--markdown FILE] FOLDER RUN [RUN ...]

A run is SCENARIO/VARIANT.run.mcap with its record beside it. Tables and figures are written into FOLDER, and
the same tables as one Markdown page into FILE.
"""

import json

from alula.schemas.log.run import read_run
from alula.stages.reporting.table import folded
from papers.comparison import comparison_words, this_machine, write_comparison, write_record
from papers.dracbf import analysis as dracbf_analysis
from papers.dracbf import difficulty as dracbf_difficulty
from papers.dracbf import figures as dracbf_figures
from papers.dracbf import tables as dracbf
from papers.dracbf import verdicts as dracbf_verdicts
from papers.dracbf import warning as dracbf_warning
from papers.papers import DRACBF
from papers.verdicts import verdict_table

TITLE = "DR-ACBF: moving obstacles, uncertain and late"
WRITTEN = """Read here which results of the DR-ACBF paper hold, and where the filters fail.
Written by `make -C examples/dr-acbf page`"""
options = comparison_words(__doc__.splitlines()[0])
folder, paths = options.folder, options.runs
flown = [
    dracbf.Flown(path.parent.name, path.name.removesuffix(".run.mcap"), read_run(path)) for path in paths
]
times = folder / "times.json"
saved = json.loads(times.read_text()) if times.is_file() else {}
verdicts = dracbf_verdicts.verdict_rows(flown, saved)
found = [
    verdict_table(DRACBF, verdicts),
    dracbf_difficulty.difficulty_table(flown),
    dracbf_difficulty.tuning_table(flown),
    dracbf_difficulty.hard_table(flown),
    dracbf_verdicts.saving_table(saved),
    dracbf_warning.warning_table(),
    *dracbf.group_tables(flown),
    dracbf_analysis.collapse_table(flown),
    *dracbf.hardware_tables(flown),
    dracbf.wall_table(flown),
    dracbf_analysis.recursion_table(flown),
    dracbf_analysis.risk_table(flown),
    dracbf.sensitivity_table(flown, "sensitivity-1"),
    dracbf.sensitivity_table(flown, "sensitivity-2"),
]
tables = [table for table in found if table is not None]
drawn = [
    *(dracbf_figures.difficulty_figure(flown, axis) for axis in dracbf_difficulty.AXES),
    dracbf_figures.success_figure(flown, "scenario-1"),
    dracbf_figures.success_figure(flown, "scenario-2"),
    dracbf_figures.collapse_figure(flown),
    dracbf_figures.risk_figure(flown),
    dracbf_figures.recursion_figure(),
    dracbf_figures.stop_figure(),
]
figures = [figure for figure in drawn if figure is not None]
facts = (
    dracbf_verdicts.counted(verdicts)
    | {"flown": dracbf.effort(flown)}
    | dracbf_analysis.in_short(flown)
    | dracbf_difficulty.crossings(flown)
    | dracbf_difficulty.hard_facts(flown)
)
write_comparison(
    folder / "dr-acbf",
    TITLE,
    [(path.parent.name, path) for path in paths],
    facts,
    tables,
    figures,
    read=[folded(table) for table in tables],
    markdown=options.markdown,
    head=f"{WRITTEN} on {this_machine()}. The tables name the numbers of trials. Times of Tables I to V were "
    "measured during the trials.",
)
write_record(folder / "dr-acbf", DRACBF, verdicts, figures, options)
