"""Make Figures 2 to 4 of FastBridge, and the ablations, from the runs in a folder.

Usage: python compare.py [--markdown FILE] FOLDER RUN [RUN ...]

A run is SCENE/VARIANT@SPEED.run.mcap with its record beside it. Tables and figures are written into
FOLDER, and the same tables as one Markdown page into FILE.
"""

from pathlib import Path

from alula.cli.comparison import comparison_words, write_comparison
from alula.schemas.flights import read_flights
from alula.schemas.run import read_run
from alula.stages.reporting.material import Run
from alula.stages.reporting.papers import fastbridge, fastbridge_figures
from alula.stages.reporting.papers.sweeps import Sweep

options = comparison_words(__doc__.splitlines()[0])
folder, runs = options.folder, options.runs
names = list(dict.fromkeys(path.parent.name for path in runs))
TITLE = "FastBridge: collision cones through the quadrotor"
HEAD = """Written by `make -C examples/fastbridge page` with `ALULA_DATA` set. All filters fly the same
pairs, references, gains, rate (100 Hz) and plant (rigid body, 1 kHz): in the built-in room pairs whose
straight line meets an obstacle, in the outdoor tile pairs drawn at random. Collisions are computed from the
exact clearance of the flown path, not from a filter's own barrier; e_a is the body's acceleration minus the
commanded one, gamma is r'Ar - 1 of the ellipsoids as grown for the filter. Times on an idle machine are in
[benchmarks-filters.md](benchmarks-filters.md).

How to read the jerk: the filter `none` shows the jerk of the reference itself. Where the reference causes
most of a filter's jerk, as in the room from 3 m/s on, no filter that follows the reference can be far below
another that does. `safer-splat` with a row for every ellipsoid is smooth because its barrier caps the
speed: compare how many flights arrive, and how fast. The paper compares with the gated form; its mean
includes flights that collide, so the ratios are also given for pairs that both filters fly to the goal."""
PATHS = (fastbridge.BASELINE, fastbridge.GATED, fastbridge.OURS)


def sweep_of(path: Path) -> Sweep:
    """Read a run; its paths are read only where they are drawn."""
    variant, speed = path.name.removesuffix(".run.mcap").rsplit("@", 1)
    record = read_run(path)
    flights = read_flights(path).by_trial if variant in PATHS else {}
    label = f"{path.parent.name}/{variant}@{speed}"
    return Sweep(path.parent.name, variant, float(speed), Run(label, record, flights))


files = sorted(
    dict.fromkeys(runs), key=lambda path: names.index(path.parent.name)
)  # stable: otherwise in the given order
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
write_comparison(
    folder / "fastbridge",
    TITLE,
    [(path.name, path) for path in files],
    facts,
    tables,
    figures,
    markdown=options.markdown,
    head=HEAD,
)
