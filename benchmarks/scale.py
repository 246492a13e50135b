"""From the files of a city to verified tile maps: time, memory and bytes by size, and on several workers.

Each size is a city of repeated tiles with jitter (`city.py`), written file by file. Every step is a command
in a process of its own, as a user runs it. Figures of each step: elapsed and processor seconds, the latter of
all its processes, and the peak of the memory of all of them together and of the largest one.

- `seconds_per_million`: processor seconds of all steps for each million Gaussians, at the largest size;
- `growth_exponent`: slope of the logarithm of processor seconds over that of the number of Gaussians;
- `peak_mb`, `peak_mb_at_four_times`: peak memory of the processes of a command, at a size and at four times;
- `excess_blocks_over_single`: volume outside the voxels of the cover that was merged by blocks, over that of
  the cover that was merged at once, at equal numbers of hulls;
- `uncovered_voxels`: voxels and ellipsoids that `verify` finds outside the cover or outside a tile;
- `efficiency_2_workers`: elapsed time with one worker over twice that with two, of the steps with workers;
- `tile_switch_mismatches`: commands of a filter in the tiles that differ in a bit from those in the whole
  map, on ways across the city.

    python benchmarks/scale.py --quick --json            # a generated city, under a minute
    python benchmarks/scale.py --millions 1 3 10 30 100 --folder build/scale --markdown docs/scale.md

With --folder, the figures of each finished step are written there at once, and files that no later step needs
are removed. After an interruption the same command continues with the first step that is not finished; when
all are, it only writes the page again.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).resolve().parent))

import city
import numpy as np
from scale_page import page

from alula import _core
from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.artifacts.kinds import VOXELS
from alula.schemas.artifacts.parts import Parts
from alula.schemas.artifacts.parts_join import read_whole
from alula.schemas.artifacts.tiles import WHOLE, read_tiles
from alula.schemas.parameters.configs.merge import MergeConfig
from alula.stages.compression.merge import merge
from alula.stages.compression.merge_blocks import merge_blocks, plan_blocks
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.filtering.obstacles import tile_set

PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
GAUSSIANS_PER_HULL = 500
STEPS = ("import-splat", "scale-align", "voxelize", "merge", "verify", "export", "verify tiles")
WITH_WORKERS = ("import-splat", "voxelize", "merge", "verify")
_OFTEN_S, _RARELY_S, _LONG_S = 0.05, 0.5, 30.0  # intervals of looks at the memory; rarely after so long


@dataclass(frozen=True, slots=True, kw_only=True)
class Setting:
    """What a city is made into.

    Attributes:
        voxel_m: edge of a voxel [m].
        block_m: edge of a block of the merge [m].
        tile_m: edge of a tile [m].
        reach_m: how far a tile reaches beyond its border [m].
    """

    voxel_m: float = 0.5
    block_m: float = 72.0
    tile_m: float = 36.0
    reach_m: float = 5.0


@dataclass(slots=True, kw_only=True)
class Cost:
    """Figures of one command."""

    wall_s: float = 0.0
    cpu_s: float = 0.0
    peak_mb: float = 0.0
    largest_mb: float = 0.0
    facts: dict[str, Any] = field(default_factory=dict)


def run_command(words: Sequence[str], accept: tuple[int, ...] = (0,)) -> Cost:
    """Run a command of alula with --json, and measure all processes of its session.

    Raises:
        SystemExit: the command fails.
    """
    before = os.times()
    begin = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "alula.cli", *words, "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    cost, done = Cost(), threading.Event()

    def watch() -> None:
        while not done.wait(_OFTEN_S if time.monotonic() - begin < _LONG_S else _RARELY_S):
            sizes = _resident_mb(process.pid)
            cost.peak_mb = max(cost.peak_mb, sum(sizes))
            cost.largest_mb = max(cost.largest_mb, max(sizes, default=0.0))

    watcher = threading.Thread(target=watch)
    watcher.start()
    out, err = process.communicate()
    done.set()
    watcher.join()
    after = os.times()
    cost.wall_s = time.monotonic() - begin
    cost.cpu_s = after.children_user + after.children_system - before.children_user - before.children_system
    if process.returncode not in accept:
        raise SystemExit(f"alula {' '.join(map(str, words))}: exit code {process.returncode}: {err.strip()}")
    cost.facts = json.loads(out)
    return cost


def _resident_mb(session: int) -> list[float]:
    """Memory of each process of a session [MB], shared pages counted in each."""
    found = []
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            state = (folder / "stat").read_text().rpartition(")")[2].split()
            if int(state[3]) == session:
                resident = int((folder / "statm").read_text().split()[1])
                found.append(resident * PAGE_BYTES / 1e6)
        except (OSError, IndexError):  # it has ended
            continue
    return found


@dataclass(frozen=True, slots=True)
class Row:
    """A city that went through all steps."""

    gaussians: int
    area_km2: float
    workers: int
    cost: dict[str, Cost]

    def total(self, name: str) -> float:
        """Sum of a figure over the steps."""
        return float(sum(getattr(cost, name) for cost in self.cost.values()))

    @property
    def peak_mb(self) -> float:
        """Maximum over the steps [MB]."""
        return max(cost.peak_mb for cost in self.cost.values())


class Record:
    """Figures of the finished steps of a city, in a file beside its files."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.values: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}

    def keep(self, name: str, value: Any) -> Any:
        """Write a value."""
        self.values[name] = value
        fresh = self._path.with_suffix(".tmp")
        fresh.write_text(json.dumps(self.values, indent=1))
        fresh.replace(self._path)
        return value

    def cost(self, name: str) -> Cost | None:
        """Figures of a finished step."""
        return Cost(**self.values[name]) if name in self.values else None


@dataclass(frozen=True, slots=True)
class Step:
    """A command, and the files that no later one needs."""

    words: list[str]
    removed: tuple[str, ...] = ()


def steps_of(
    folder: Path, files: Sequence[str], gaussians: int, setting: Setting, workers: int
) -> dict[str, Step]:
    """Commands from the files of a city to verified tile maps."""
    jobs = ("--jobs", str(workers))
    scene, metric, voxels, cover, tiled = (
        str(folder / name)
        for name in ("city.scene", "city.metric.scene", "city.voxels", "city.cover", "city.tiles")
    )
    hulls = str(max(1, gaussians // GAUSSIANS_PER_HULL))
    size, block = str(setting.voxel_m), str(setting.block_m)
    lengths = ("--tiles", str(setting.tile_m), "--reach", str(setting.reach_m))
    opaque, unscaled = ("--min-opacity", "0.1"), ("--scale", "1")
    proof = ("--voxels", voxels, "--scene", metric, *jobs)
    return {
        "import-splat": Step(["import-splat", *files, "-o", scene, *opaque, *jobs, "-f"], ("files",)),
        "scale-align": Step(["scale-align", scene, "-o", metric, *unscaled, *jobs, "-f"], ("city.scene",)),
        "voxelize": Step(["voxelize", metric, "-o", voxels, "--size", size, "--ignore-loss", *jobs, "-f"]),
        "merge": Step(["merge", voxels, "-o", cover, "--block", block, *jobs, "--hulls", hulls, "-f"]),
        "verify": Step(["verify", cover, *proof]),
        "export": Step(["export", cover, "-o", tiled, *lengths, "-f"], ("city.cover",)),
        "verify tiles": Step(["verify", tiled, *proof], ("city.metric.scene", "city.voxels", "city.tiles")),
    }


def pass_through(
    folder: Path, gaussians: int, sources: Any, setting: Setting, workers: int, *, keep: bool
) -> Row:
    """Take a city from its files to verified tile maps, from the first step that is not finished.

    Args:
        folder: of the city.
        gaussians: wanted number.
        sources: templates of the cells.
        setting: what the city is made into.
        workers: number of jobs.
        keep: keep the voxels and the tiles.
    """
    folder.mkdir(parents=True, exist_ok=True)
    record = Record(folder / "record.json")
    if "city" not in record.values:
        made = city.write_city(folder / "files", gaussians, sources)
        found = {"files": [str(path) for path in made.files], "gaussians": made.gaussians}
        record.keep("city", found | {"area_km2": made.area_km2})
    whole = record.values["city"]
    cost = {}
    for name, step in steps_of(folder, whole["files"], whole["gaussians"], setting, workers).items():
        found_cost = record.cost(name)
        if found_cost is None:
            found_cost = run_command(step.words)
            record.keep(name, dataclasses.asdict(found_cost))
            print(
                f"{whole['gaussians'] / 1e6:.2f} million, {workers} workers, {name}:"
                f" {found_cost.cpu_s:.0f} CPU s, {found_cost.wall_s:.0f} s, {found_cost.peak_mb:.0f} MB",
                file=sys.stderr,
                flush=True,
            )
        for left in step.removed:
            if not (keep and left in ("city.voxels", "city.tiles")):
                shutil.rmtree(folder / left, ignore_errors=True)
        cost[name] = found_cost
    return Row(whole["gaussians"], whole["area_km2"], workers, cost)


def mismatches(folder: Path, ways: int, seed: int = 0) -> dict[str, int]:
    """Fly points behind polytope-cbf across the tiles of a folder, and compare with the whole map.

    Returns:
        `tile_switch_mismatches`, `commands` that were compared, and `switches` of the tile.
    """
    tiles = read_tiles(folder)
    whole = encode_map(read_artifact(folder / WHOLE), indexed=True)
    low, high = _bounds(folder)
    extent_m = float(np.abs([low, high]).max()) + 20.0
    options = {"extent_m": extent_m, "radius_m": 0.3, "beta": 2.0, "kappa": 100.0, "dt_s": 0.05, "v_max": 4.0}
    by_whole = _core.PolytopeCbf.from_image(whole, **options)
    by_tile = _core.PolytopeCbf.from_tiles(tile_set(tiles), 0, **options)
    rng = np.random.default_rng(seed)
    found = {"tile_switch_mismatches": 0, "commands": 0, "switches": 0}
    for _ in range(ways):
        x, goal = (np.append(rng.uniform(low[:2], high[:2]), rng.uniform(6, 10)) for _ in range(2))
        last = None
        for _ in range(4000):
            way = goal - x
            if np.linalg.norm(way) < 1.0:
                break
            u_nom = (4.0 * way / np.linalg.norm(way)).tolist()
            one, other = by_whole.filter(x.tolist(), u_nom), by_tile.filter(x.tolist(), u_nom)
            found["tile_switch_mismatches"] += one[:2] != other[:2]
            found["commands"] += 1
            row, _ = by_tile.tile()
            found["switches"] += last not in (None, row)
            last = row
            if np.linalg.norm(one[0]) < 0.05:
                break
            x = x + 0.05 * np.array(one[0])
    return found


def _bounds(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    cover = read_artifact(folder / WHOLE)
    corner = np.asarray(cover["vertex"]) * cover.manifest.voxel_size_m  # type: ignore[attr-defined]
    return corner.min(axis=0), corner.max(axis=0)


def excess_ratio(voxels: Path, block_m: float, hulls: int) -> float:
    """Excess volume of the cover by blocks over that of the cover at once, at equal numbers of hulls."""
    artifact = read_whole(voxels, VOXELS)
    config = MergeConfig(hulls=hulls, block_m=block_m)
    (blocks,) = merge_blocks(config, plan_blocks(config, Parts.of(artifact)), jobs=1)
    at_once = merge(MergeConfig(hulls=int(blocks.manifest.summary["hulls"])), artifact, jobs=1)
    by_blocks, once = (made.manifest.conservativeness - 1 for made in (blocks, at_once))  # type: ignore[attr-defined]
    return float(by_blocks / once)


def uncovered(row: Row) -> int:
    """Failures that both verifications counted."""
    return sum(
        int(check["failed"])
        for name, cost in row.cost.items()
        if name.startswith("verify")
        for check in cost.facts.get("checks", [])
    )


def slope(rows: Sequence[Row]) -> float:
    """Slope of log processor seconds over log Gaussians; 0 for a single size."""
    if len({row.gaussians for row in rows}) < 2:
        return 0.0
    count, seconds = (
        np.log([getter(row) for row in rows])
        for getter in (lambda r: r.gaussians, lambda r: r.total("cpu_s"))
    )
    return float(np.polyfit(count, seconds, 1)[0])


def efficiency(one: Row, other: Row, workers: int) -> float:
    """Elapsed time with one worker over that with several times their number, of the steps with workers."""
    return sum(one.cost[name].wall_s for name in WITH_WORKERS) / (
        workers * sum(other.cost[name].wall_s for name in WITH_WORKERS)
    )


def sources_of(*, quick: bool) -> tuple[str, list[city.Template]]:
    """Words for the templates of cities, and the templates."""
    data = os.environ.get("ALULA_DATA")
    words = "three real tiles of a street" if data and not quick else "pieces of the generated garden"
    return words, city.templates(Path(data) if data and not quick else None)


def measured(
    folder: Path, sizes: Sequence[float], setting: Setting, *, quick: bool
) -> tuple[list[Row], dict[str, Any], str]:
    """Make cities of the given numbers of Gaussians, and measure them."""
    source, sources = sources_of(quick=quick)
    rows: list[Row] = []
    for count in sizes:
        for workers in (2,) if count != sizes[0] else (1, 2) if quick else (1, 2, 4):
            place, is_first = folder / f"{count / 1e6:g}-{workers}", count == sizes[0] and workers == 2
            rows.append(pass_through(place, int(count), sources, setting, workers, keep=is_first))
    first = folder / f"{sizes[0] / 1e6:g}-2"
    by_workers = {row.workers: row for row in rows if row.gaussians == rows[0].gaussians}
    on_two = [row for row in rows if row.workers == 2]
    record = Record(first / "record.json")
    if "compared" not in record.values:
        hulls = max(1, on_two[0].gaussians // GAUSSIANS_PER_HULL)
        ratio = excess_ratio(first / "city.voxels", setting.block_m / 2, hulls)
        record.keep("compared", {"ratio": ratio, **mismatches(first / "city.tiles", 10 if quick else 60)})
    compared = dict(record.values["compared"])
    figures: dict[str, Any] = {
        "seconds_per_million": on_two[-1].total("cpu_s") / on_two[-1].gaussians * 1e6,
        "growth_exponent": slope(on_two),
        "peak_mb": on_two[0].peak_mb,
        "peak_mb_at_four_times" if sizes[-1] == 4 * sizes[0] else "peak_mb_at_largest": on_two[-1].peak_mb,
        "excess_blocks_over_single": compared.pop("ratio"),
        "uncovered_voxels": sum(uncovered(row) for row in rows),
        **{f"efficiency_{n}_workers": efficiency(rows[0], row, n) for n, row in by_workers.items() if n > 1},
        **compared,
    }
    return rows, figures, source


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="two small generated cities")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument(
        "--millions", type=float, nargs="+", default=[1, 4], metavar="M", help="sizes of the cities"
    )
    parser.add_argument("--voxel", type=float, default=0.5, help="edge of a voxel [m]")
    parser.add_argument(
        "--only-measure",
        action="store_true",
        help="take the cities through all steps with 2 workers, no more",
    )
    parser.add_argument("--note", default="", help="sentence about this run, for the page")
    parser.add_argument("--folder", type=Path, help="keep all files there")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the page to FILE")
    options = parser.parse_args()
    sizes = [5e4, 2e5] if options.quick else [1e6 * each for each in options.millions]
    setting = Setting(voxel_m=0.5 if options.quick else options.voxel)
    with tempfile.TemporaryDirectory(prefix="alula-scale-") as name:
        folder = options.folder or Path(name)
        folder.mkdir(parents=True, exist_ok=True)
        if options.only_measure:
            _, sources = sources_of(quick=options.quick)
            for count in sizes:
                pass_through(folder / f"{count / 1e6:g}-2", int(count), sources, setting, 2, keep=False)
            return
        rows, figures, source = measured(folder, sizes, setting, quick=options.quick)
    if options.markdown is not None:
        options.markdown.write_text(
            page(rows, figures, setting, source, GAUSSIANS_PER_HULL, options.note), encoding="utf-8"
        )
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        print(page(rows, figures, setting, source, GAUSSIANS_PER_HULL, options.note))
    if figures["uncovered_voxels"] or figures["tile_switch_mismatches"]:
        raise SystemExit("a voxel is not covered, or a command in tiles differs")


if __name__ == "__main__":
    main()
