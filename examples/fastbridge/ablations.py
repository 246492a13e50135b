"""Make the page of our own ablations from runs: other policies and guides, and one parameter at a time.

Usage: python ablations.py [--markdown FILE] FOLDER RUN [RUN ...]
"""

from pathlib import Path

from alula.schemas.log.run import read_run
from alula.stages.reporting.material import Run
from papers.comparison import comparison_words, write_comparison
from papers.fastbridge import tables as fastbridge
from papers.fastbridge.sweeps import Sweep

HEAD = """Read here what each part of our filters contributes: flights with one part changed.
Written by `make -C examples/fastbridge ablations`. Pairs, references, rate and plant are those of
[fastbridge.md](fastbridge.md)."""


def sweep_of(path: Path) -> Sweep:
    """Read a run."""
    variant, speed = path.name.removesuffix(".run.mcap").rsplit("@", 1)
    run = Run(f"{path.parent.name}/{variant}@{speed}", read_run(path), {})
    return Sweep(path.parent.name, variant, float(speed), run)


options = comparison_words(__doc__.splitlines()[0])
files = list(dict.fromkeys(options.runs))
sweeps = [sweep_of(path) for path in files]
tables = fastbridge.flight_tables(
    sorted(sweeps, key=lambda s: (s.scene, s.run.record.filter, s.speed_m_s)),
    "ablations",
    "Ablations",
    bases=[s for s in sweeps if s.variant in ("cone-ecbf", "cone-backup")],
)
write_comparison(
    options.folder / "ablations",
    "FastBridge: ablations of our filters",
    [(path.name, path) for path in files],
    {},
    tables,
    [],
    markdown=options.markdown,
    head=HEAD,
)
