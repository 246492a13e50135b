"""Make the page of FastBridge from the runs in a folder: a verdict for every published value, and all tables.

Usage: python compare.py [--markdown FILE] --tuning CSV FOLDER RUN [RUN ...]

A run is SCENE/VARIANT@SPEED.run.mcap with its record beside it; CSV is the table of the search for gains.
Tables and figures are written into FOLDER, and the same tables as one Markdown page into FILE.
"""

import csv
from pathlib import Path

from alula.schemas.log.flights import read_flights
from alula.schemas.log.run import read_run
from alula.stages.reporting.material import Run
from alula.stages.reporting.table import Table
from papers.comparison import comparison_words, write_comparison, write_record
from papers.fastbridge import figures as fastbridge_figures
from papers.fastbridge import tables as fastbridge
from papers.fastbridge.feasibility import feasibility_table
from papers.fastbridge.sweeps import Sweep
from papers.fastbridge.verdicts import verdict_rows
from papers.papers import FASTBRIDGE
from papers.verdicts import verdict_table

TITLE = "FastBridge: collision cones through the quadrotor"
HEAD = """Read here which results of the FastBridge paper hold, with SAFER-Splat flown beside it.
Written by `make -C examples/fastbridge page` with `ALULA_DATA` set. The first table has every
table, figure and number of the paper (arXiv 2607.01200) with ours beside it and a verdict. Its
numbers are the authors' where it says published; all others are measured here. All filters fly
the same pairs, references, tracking gains, rate (100 Hz unless stated) and plant (rigid body, 1
kHz): in the built-in room pairs whose straight line meets an obstacle, in the outdoor tile pairs
drawn at random. Collisions are computed from the exact clearance of the flown path, not from a
filter's own barrier. Times on this page include what else the machine did; those of an idle machine are in
[benchmarks-filters.md](benchmarks-filters.md), our ablations in
[fastbridge-ablations.md](fastbridge-ablations.md).

Settings. Every method is flown at the gains that its authors print (ours at the defaults) and tuned by
one search: the same number of settings for each, a Sobol sequence over the logarithms of up to three
gains, on another seed of the room with other pairs and on another tile, which no table here reports;
most goals without a collision first, then fewest collisions, then the lowest jerk.
`make -C examples/fastbridge tune` repeats it. Our defaults come from earlier flights in the reported room
and may be fitted to it, so the tuned rows are the fair ones.

How to read the jerk: the filter `none` shows the jerk of the reference itself. Where the reference
causes most of a filter's jerk, as in the room from 3 m/s on, no filter that follows the reference can be
far below another that does. A filter that is slow or stuck is smooth: compare how many flights arrive,
and how fast, and the ratios for pairs that both filters fly to the goal."""
LOGGED = fastbridge_figures.PATHS


def sweep_of(path: Path) -> Sweep:
    """Read a run; its paths are read only where they are drawn."""
    variant, speed = path.name.removesuffix(".run.mcap").rsplit("@", 1)
    record = read_run(path)
    flights = read_flights(path).by_trial if variant in LOGGED else {}
    label = f"{path.parent.name}/{variant}@{speed}"
    return Sweep(path.parent.name, variant, float(speed), Run(label, record, flights))


def tuning_table(path: Path) -> Table:
    """Tabulate what the search found best for each method, beside its first setting."""
    with path.open(newline="") as file:
        found = list(csv.DictReader(file))
    rows = []
    for row in found:
        if row["setting"] == "0" or row["best"] == "yes":
            settings = sum(other["method"] == row["method"] for other in found)
            counts = (int(row[key]) for key in ("flights", "collided", "reached"))
            words = "best" if row["best"] == "yes" else "published or default"
            rows.append((row["method"], words, row["gains"], settings, *counts, float(row["jerk_m_s2"])))
    columns = ("method", "setting", "gains", "settings flown", "flights", "collided", "reached")
    note = (
        "Flights of the search only, in the room of another seed at 4.1 m/s and in another tile at "
        "3.1 m/s. Jerk is integrated over a flight. All settings are in examples/fastbridge/tuning.csv."
    )
    return Table(
        "tuning", "Gains found by the search", (*columns, "integrated jerk [m/s²]"), tuple(rows), note
    )


def is_of_the_paper(sweep: Sweep) -> bool:
    """Return whether a variant is one of the paper's programs, or flies its loop or its CLF."""
    return sweep.variant.startswith("printed-") or sweep.variant.endswith(("-clf", "-rates", "-split"))


options = comparison_words(__doc__.splitlines()[0], tuning=True)
folder, runs = options.folder, options.runs
names = list(dict.fromkeys(path.parent.name for path in runs))
# Stable: otherwise in the given order.
files = sorted(dict.fromkeys(runs), key=lambda path: names.index(path.parent.name))
sweeps = [sweep_of(path) for path in files]
feasibility = feasibility_table()
verdicts = verdict_rows(sweeps, names[0], feasibility)
paper = [s for s in sweeps if is_of_the_paper(s)]
whole = [s for s in sweeps if not is_of_the_paper(s)]
tables = [
    verdict_table(FASTBRIDGE, verdicts),
    tuning_table(options.tuning),
    fastbridge.gap_table(whole),
    fastbridge.comparison_table(whole),
    fastbridge.ratio_table(whole),
    *fastbridge.flight_tables(
        sorted(paper, key=lambda s: (s.scene, s.speed_m_s)),
        "programs",
        "The paper's programs, its CLF and its loop",
        bases=[s for s in sweeps if s.variant in ("printed-ecbf-14", "printed-backup", "cone-di")],
    ),
    *fastbridge.flight_tables(
        sorted((s for s in whole if s.variant != "ideal-di"), key=lambda s: (s.scene, s.speed_m_s)),
        "figure-4",
        "Figure 4",
        published=True,
    ),
    feasibility,
]
figures = []
for name in names:
    figures.append(fastbridge_figures.gap_figure(whole, name))
    figures.append(fastbridge_figures.comparison_figure(whole, name))
    paths = fastbridge_figures.paths_figure(whole, name, fastbridge_figures.telling_trial(whole, name))
    figures += [paths] if paths is not None else []
write_comparison(
    folder / "fastbridge",
    TITLE,
    [(path.name, path) for path in files],
    fastbridge.in_short(whole),
    tables,
    figures,
    markdown=options.markdown,
    head=HEAD,
)
write_record(folder / "fastbridge", FASTBRIDGE, verdicts, figures, options)
