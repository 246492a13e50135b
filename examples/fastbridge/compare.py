"""Figures 2 to 4 of FastBridge, and the ablations, from the runs in a folder.

Usage: python compare.py FOLDER RUN [RUN ...]

A run is SCENE/VARIANT@SPEED.run.mcap with its record beside it; tables and figures are written into FOLDER.
"""

import sys
from pathlib import Path

from alula.cli.runner import input_ref
from alula.schemas.atomic import write_text
from alula.schemas.flights import read_flights
from alula.schemas.run import read_run
from alula.stages.reporting import fastbridge, fastbridge_figures
from alula.stages.reporting.material import Material, Run
from alula.stages.reporting.page import page
from alula.stages.reporting.sweeps import Sweep
from alula.stages.reporting.tables import inputs_table, table_csv, to_markdown

folder, runs = Path(sys.argv[1]), [Path(word) for word in sys.argv[2:]]
names = list(dict.fromkeys(path.parent.name for path in runs))
TITLE = "FastBridge: collision cones through the quadrotor"
PATHS = (fastbridge.BASELINE, fastbridge.GATED, fastbridge.OURS)


def sweep_of(path: Path) -> Sweep:
    """A run; its paths are read only where they are drawn."""
    variant, speed = path.name.removesuffix(".run.mcap").rsplit("@", 1)
    record = read_run(path)
    flights = read_flights(path).by_trial if variant in PATHS else {}
    label = f"{path.parent.name}/{variant}@{speed}"
    return Sweep(path.parent.name, variant, float(speed), Run(label, record, flights))


files = sorted(dict.fromkeys(runs), key=lambda path: names.index(path.parent.name))  # else as they are given
sweeps = [sweep_of(path) for path in files]
is_ablation = [s.variant.startswith(("ecbf-", "backup-")) for s in sweeps]
ablated = {(s.scene, s.speed_m_s) for s, yes in zip(sweeps, is_ablation, strict=True) if yes}
whole = [s for s, yes in zip(sweeps, is_ablation, strict=True) if not yes]
tables = [
    fastbridge.gap_table(whole),
    fastbridge.comparison_table(whole),
    fastbridge.ratio_table(whole),
    *fastbridge.flight_tables(
        sorted((s for s in whole if s.variant != "ideal-di"), key=lambda s: (s.scene, s.speed_m_s)),
        "figure-4",
        "Figure 4",
        published=True,
    ),
    *fastbridge.flight_tables(
        sorted(
            (
                s
                for s, yes in zip(sweeps, is_ablation, strict=True)
                if yes or (s.variant in ("cone-ecbf", "cone-backup") and (s.scene, s.speed_m_s) in ablated)
            ),
            key=lambda s: (s.scene, s.run.record.filter),
        ),
        "ablations",
        "Ablations",
        bases=[s for s in whole if s.variant in ("cone-ecbf", "cone-backup")],
    ),
]
figures = []
for name in names:
    figures.append(fastbridge_figures.gap_figure(whole, name))
    figures.append(fastbridge_figures.comparison_figure(whole, name))
    paths = fastbridge_figures.paths_figure(whole, name, fastbridge_figures.telling_trial(whole, name))
    figures += [paths] if paths is not None else []
facts = fastbridge.in_short(whole)
material = Material(TITLE, inputs=tuple(input_ref(path.name, path) for path in files))
for table in tables:
    write_text(folder / f"{table.name}.csv", table_csv(table))
for figure in figures:
    write_text(folder / f"{figure.name}.svg", figure.svg)
write_text(folder / "fastbridge.md", to_markdown(TITLE, facts, tables, ""))
write_text(
    folder / "fastbridge.html", page(material, [*tables, inputs_table(material)], figures, None, facts=facts)
)
