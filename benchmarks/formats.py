"""Readers of splat formats compared with other readers, and with reading the same bytes, in one run.

Every real file under ALULA_DATA is read by ours and by the oracles of its format, and compared row by
row. Large files are timed in turns: minimum wall seconds over the runs, and ratios of these. Times are not
tested; a file on which a reader and its oracle differ by more than rounding fails the run.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).resolve().parent))
sys.path.sort(key=sys.path[-1].__eq__)  # last: a module of the same name elsewhere comes first

import numpy as np
from oracles import KINDS, LARGE, ORACLES, Oracle, differences, large_file

from alula.schemas.errors import AlulaError
from alula.schemas.parameters.configs.demo_scene import DemoSceneConfig
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.stages.reconstruction.demo_scene import demo_scene
from alula.stages.reconstruction.formats.registry import SplatFile, formats, read_splats
from alula.stages.reconstruction.formats.splats import Splats
from alula.stages.reconstruction.import_splat import import_splat

_SUFFIXES = {".ply", ".splat", ".spz", ".sog", ".ksplat", ".gltf", ".glb", ".json"}
_BYTES_KEPT = 59  # of a Gaussian of a scene, its bounds of loss included
FULL_ROWS, QUICK_ROWS = 1_500_000, 20_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Agreement:
    """Comparison of all real files of one format with one oracle; see `oracles.differences`."""

    format: str
    files: int = 0
    refused: int = 0
    gaussians: int = 0
    oracle: str = ""
    compared: int = 0
    differences: dict[str, float]
    turns: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()  # files that the oracle cannot read, and why
    agrees: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Speed:
    """Times of one file; seconds are minima over the runs."""

    format: str
    label: str
    gaussians: int
    megabytes: float
    runs: int
    read_s: float
    import_s: float
    bytes_s: float
    oracle: str = ""
    oracle_s: float | None = None
    peak_over_kept: float | None = None

    @property
    def figures(self) -> dict[str, float | None]:
        """Gaussians per second, and ratios of times."""
        whole = self.read_s + self.import_s
        return {
            "gaussians_per_s": self.gaussians / self.read_s,
            "imported_per_s": self.gaussians / whole,
            "read_over_bytes": self.read_s / self.bytes_s,
            "import_over_bytes": whole / self.bytes_s,
            "read_over_oracle": self.read_s / self.oracle_s if self.oracle_s else None,
        }


def real_files(root: Path | None, quick: bool) -> dict[str, list[SplatFile]]:
    """Find the recognised files under a folder, by format."""
    found: dict[str, list[SplatFile]] = {candidate.name: [] for candidate in formats()}
    for path in sorted(root.rglob("*")) if root is not None else ():
        if path.suffix not in _SUFFIXES or not path.is_file() or (quick and path.stat().st_size > 2**20):
            continue
        try:
            file = SplatFile.find(path)
        except AlulaError:
            continue
        found[file.format.name].append(file)
    return found


def agreements(name: str, files: list[SplatFile]) -> Iterator[Agreement]:
    """Compare with each oracle of the format; yield one result without an oracle when there is none."""
    decoded: list[tuple[Path, Splats]] = []
    for file in files:
        try:
            decoded.append((file.path, file.decode()))
        except AlulaError:
            continue
    counts: dict[str, Any] = {
        "format": name,
        "files": len(decoded),
        "refused": len(files) - len(decoded),
        "gaussians": sum(len(splats) for _, splats in decoded),
    }
    oracles = [oracle for oracle in ORACLES.get(name, ()) if oracle.is_there]
    for oracle in oracles:
        yield _compared(oracle, decoded, counts)
    if not oracles:
        yield Agreement(**counts, differences={})


def _compared(oracle: Oracle, decoded: list[tuple[Path, Splats]], counts: dict[str, Any]) -> Agreement:
    largest = dict.fromkeys(KINDS, 0.0)
    turns, unread, compared = set(), [], 0
    for path, ours in decoded:
        try:
            found, turn = differences(ours, oracle.values(oracle.load(path)))
        except Exception as error:  # noqa: BLE001  other readers raise any exception
            unread.append(
                f"{path.name}: {str(error).splitlines()[0] if str(error) else type(error).__name__}"
            )
            continue
        compared += 1
        largest = {kind: max(largest[kind], found[kind]) for kind in KINDS}
        if turn != "none":
            turns.add(turn)
    return Agreement(
        **counts,
        oracle=oracle.name,
        compared=compared,
        differences=largest if compared else {},
        turns=tuple(sorted(turns)),
        unread=tuple(unread),
        agrees=all(largest[kind] <= oracle.tolerance[kind] for kind in KINDS),
    )


def speeds(
    known: Sequence[str], files: dict[str, list[SplatFile]], rows: int, runs: int, folder: Path
) -> Iterator[Speed]:
    """Time generated files, and the largest real file of each format that cannot be generated."""
    made = set()
    for large in LARGE:
        if large.format not in known:
            continue
        count = max(2000, rows * large.percent // 100)
        with large_file(large, folder, demo_scene(DemoSceneConfig(gaussians=count), 0)) as path:
            if path is not None:
                made.add(large.format)
                yield _timed(large.format, large.label, path, runs, with_memory=large.format == "ply")
    for name in known:
        readable = [file for file in files[name] if name not in made and _is_read(file)]
        if readable:
            largest = max(readable, key=lambda file: sum(p.stat().st_size for p in file.files().values()))
            yield _timed(name, "/".join(largest.path.parts[-2:]), largest.path, runs, with_memory=False)


def _is_read(file: SplatFile) -> bool:
    try:
        return len(import_splat(ImportSplatConfig(drop_nan=True), file.decode())["mean"]) > 0
    except AlulaError:
        return False


def _timed(name: str, label: str, path: Path, runs: int, *, with_memory: bool) -> Speed:
    parts = list(SplatFile.find(path).files().values())
    oracles = [oracle for oracle in ORACLES.get(name, ()) if oracle.is_there]
    best = dict.fromkeys(("read", "import", "bytes", *(oracle.name for oracle in oracles)), float("inf"))

    def measure(what: str, action: Callable[[], Any]) -> Any:
        start = time.perf_counter()
        result = action()
        best[what] = min(best[what], time.perf_counter() - start)
        return result

    gaussians = 0
    for _ in range(runs + 1):  # the first fills caches
        measure("bytes", lambda: [np.fromfile(part, np.uint8) for part in parts])
        splats = measure("read", partial(read_splats, path))
        gaussians = len(splats)
        measure("import", partial(import_splat, ImportSplatConfig(drop_nan=True), splats))
        del splats
        for oracle in oracles:
            measure(oracle.name, partial(oracle.load, path))
    fastest = min(oracles, key=lambda oracle: best[oracle.name], default=None)
    return Speed(
        format=name,
        label=label,
        gaussians=gaussians,
        megabytes=sum(part.stat().st_size for part in parts) / 1e6,
        runs=runs,
        read_s=best["read"],
        import_s=best["import"],
        bytes_s=best["bytes"],
        oracle=fastest.name if fastest else "",
        oracle_s=best[fastest.name] if fastest else None,
        peak_over_kept=_peak(path) if with_memory else None,
    )


_PEAK = """
import concurrent.futures, resource, sys
from pathlib import Path
from alula.schemas.parameters.configs.import_splat import ImportSplatConfig
from alula.stages.reconstruction.formats.registry import read_splats
from alula.stages.reconstruction.import_splat import import_splat
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)
before = peak()
made = import_splat(ImportSplatConfig(min_opacity=0.0), read_splats(Path(sys.argv[1])))
print((peak() - before) / len(made["mean"]))
"""


def _peak(path: Path) -> float:
    """Peak memory beyond that of the imports, relative to the memory of the kept Gaussians."""
    # Started by a small process: a child's figure begins with the memory of its parent.
    start = "import subprocess, sys; subprocess.run(sys.argv[1:], check=True)"
    command = [sys.executable, "-P", "-c"]
    done = subprocess.run(
        [*command, start, *command, _PEAK, str(path)], check=True, capture_output=True, text=True
    )
    return float(done.stdout) / _BYTES_KEPT


def _cell(value: float | None, form: str = ".3g") -> str:
    return "" if value is None else format(value, form)


def page(found: Sequence[Agreement], timed: Sequence[Speed]) -> str:
    """Format both tables as Markdown."""
    heads = ["format", "files read", "refused", "Gaussians", "oracle", "files it reads"]
    heads += ["mean / largest", "scale, relative", "rotation, rad", "opacity", "agrees"]
    lines = [_line(heads), "|" + " --- |" * len(heads)]
    for row in found:
        differ = [_cell(row.differences.get(kind), ".2g") for kind in KINDS]
        oracle = row.oracle + (f", rotated about {', '.join(row.turns)}" if row.turns else "")
        start = [row.format, str(row.files), str(row.refused), f"{row.gaussians:,}", oracle or "none"]
        verdict = "" if not row.compared else "yes" if row.agrees else "NO"
        lines.append(_line([*start, str(row.compared) if row.oracle else "", *differ, verdict]))
    heads = [
        "format",
        "file",
        "Gaussians",
        "MB",
        "read, M/s",
        "imported, M/s",
        "read / bytes",
        "import / bytes",
    ]
    heads += ["oracle", "read / oracle", "peak / kept"]
    lines += ["", _line(heads), "|" + " --- |" * len(heads)]
    for speed in timed:
        figures = speed.figures
        cells = [speed.format, speed.label, f"{speed.gaussians:,}", f"{speed.megabytes:.1f}"]
        cells += [_cell((figures[key] or 0) / 1e6) for key in ("gaussians_per_s", "imported_per_s")]
        cells += [_cell(figures[key]) for key in ("read_over_bytes", "import_over_bytes")]
        cells += [speed.oracle or "none", _cell(figures["read_over_oracle"]), _cell(speed.peak_over_kept)]
        lines.append(_line(cells))
    return "\n".join(lines) + "\n"


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


_PREFACE = """# Splat formats, measured

Look up here how fast and how exactly each splat format is read, beside other readers.
Written by `python benchmarks/formats.py --markdown FILE` on {machine}, Python {python}. Differences are
maxima over all rows of all files, against the oracle. *Bytes* is `numpy.fromfile` of the same
files; ratios are those of the minimum wall seconds of {runs} runs in turns, so below 1 is in our favour.
*Import* is reading, checking and hashing the scene. *Peak* is the memory beyond that of an idle process,
divided by 59 bytes for each kept Gaussian.

"""


def main() -> int:
    """Run everything; return 1 when a reader and its oracle disagree."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small files, a few seconds")
    parser.add_argument("--rows", type=int, metavar="N", help=f"Gaussians of generated files, {FULL_ROWS:,}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write all figures to FILE")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the tables to FILE")
    options = parser.parse_args()
    rows = options.rows or (QUICK_ROWS if options.quick else FULL_ROWS)
    runs = 1 if options.quick else 5
    data = os.environ.get("ALULA_DATA")
    files = real_files(Path(data) if data else None, options.quick)
    found = [row for name, known in files.items() for row in agreements(name, known)]
    with tempfile.TemporaryDirectory(prefix="alula-bench-") as folder:
        timed = list(speeds(list(files), files, rows, runs, Path(folder)))
    text = page(found, timed)
    print(text, end="")
    machine = f"{platform.machine()}, {os.cpu_count()} processors"
    if options.markdown is not None:
        preface = _PREFACE.format(machine=machine, python=platform.python_version(), runs=runs)
        options.markdown.write_text(preface + text)
    if options.json is not None:
        document = {
            "quick": options.quick,
            "machine": machine,
            "python": platform.python_version(),
            "agreement": [asdict(row) for row in found],
            "speed": [asdict(row) | row.figures for row in timed],
        }
        options.json.write_text(json.dumps(document, indent=2) + "\n")
    return 0 if all(row.agrees for row in found) else 1


if __name__ == "__main__":
    sys.exit(main())
