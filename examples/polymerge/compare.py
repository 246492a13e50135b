"""Make the tables and figures of PolyMerge, and a verdict on each of its numbers, from the files in a folder.

Usage: python compare.py [--markdown FILE] [--onboard FILE] FOLDER SCENE [SCENE ...]

A scene has FOLDER/SCENE.metric.scene.npz, SCENE.voxels.npz, SCENE.coacd.npz, and covers by method
"default" or "paper": SCENE.METHOD.N.cover.npz for the curve, SCENE.METHOD.same.cover.npz beside CoACD.
SCENE.figure-5.json, SCENE.table-2.json and SCENE.table-2-crazyflie.json are the flights of flights.py and
crazyflie.py, where there are any. The rate on a
microcontroller is read from the page --onboard.
"""

import argparse
import json
import re
from itertools import pairwise
from pathlib import Path

import numpy as np

from alula.schemas.artifacts.artifact import read_artifact
from alula.schemas.atomic import atomic_output
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.reporting.table import folded
from papers.comparison import common_words, this_machine, write_comparison, write_record
from papers.papers import POLYMERGE
from papers.polymerge import maps as polymerge
from papers.polymerge.figures import flights_figure
from papers.polymerge.flights import Flights, figure_5_table, from_record, table_2, table_2_in_firmware
from papers.polymerge.maps import Polytopes, SceneMaps
from papers.polymerge.measure import half_spaces, measure_cover, measure_points
from papers.polymerge.verdicts import verdict_rows
from papers.verdicts import verdict_table

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
common_words(parser)
parser.add_argument("--onboard", type=Path, metavar="FILE", help="page with the figures of emulated cores")
parser.add_argument("folder", type=Path)
parser.add_argument("names", nargs="+", metavar="SCENE")
options = parser.parse_args()
folder, names = options.folder, options.names
TITLE = "PolyMerge: covers of hulls, and flights among them"


def of_cover(path: Path, index: np.ndarray | None = None) -> Polytopes:
    """Read a cover; measure it against voxels when they are given."""
    cover = read_artifact(path)
    planes, count = len(cover["plane_offset"]), len(cover["plane_start"]) - 1
    found = measure_cover(cover, index) if index is not None else None
    growth = found.conservativeness if found else cover.manifest.conservativeness
    return Polytopes(count, planes, growth, path.stat().st_size, found, len(encode_map(cover)), path.name)


def why_no_coacd(path: Path) -> str:
    """Say why a file of coacd_parts.py has no parts."""
    limit_s = float(np.load(path)["limit_s"])
    return f"no parts in {limit_s:g} s of CPU" if limit_s > 0 else "CoACD was not run"


def of_coacd(path: Path, index: np.ndarray) -> Polytopes | None:
    """Read the output of coacd_parts.py; None when it had no CoACD."""
    with np.load(path) as arrays:
        points, start = arrays["points"], arrays["start"]
    parts = [points[a:b] for a, b in pairwise(start)]
    if not parts:
        return None
    found = measure_points(parts, index)
    planes = sum(len(half_spaces(part)) for part in parts)
    size = path.stat().st_size
    return Polytopes(len(parts), planes, found.conservativeness, size, found, file=path.name)


def maps_of(name: str) -> SceneMaps:
    """Read all maps of a scene."""
    source = folder / f"{name}.metric.scene.npz"
    voxels = read_artifact(folder / f"{name}.voxels.npz")
    index = voxels["index"]
    same, curves = {}, {}
    for method in ("default", "paper"):
        same[method] = of_cover(folder / f"{name}.{method}.same.cover.npz", index)
        found = [of_cover(path) for path in folder.glob(f"{name}.{method}.*[0-9].cover.npz")]
        curves[method] = sorted({f.hulls: f for f in found}.values(), key=lambda f: f.hulls)
    theirs = of_coacd(folder / f"{name}.coacd.npz", index)
    return SceneMaps(
        name,
        len(read_artifact(source)["mean"]),
        source.stat().st_size,
        len(index),
        voxels.manifest.voxel_size_m,
        same if theirs is None else {**same, "coacd": theirs},
        curves,
        why_no_coacd(folder / f"{name}.coacd.npz"),
    )


def flights_of(what: str) -> list[Flights]:
    """Read the flights of all scenes."""
    files = [path for name in names if (path := folder / f"{name}.{what}.json").exists()]
    return [from_record(record) for path in files for record in json.loads(path.read_text())]


def onboard_rate() -> float | None:
    """Read the filter's rate with 150 hulls [Hz]."""
    if options.onboard is None:
        return None
    found = re.search(r"`m4_polytope_150_hz` \| ([0-9,]+)", options.onboard.read_text())
    return None if found is None else float(found[1].replace(",", ""))


scenes = [maps_of(name) for name in names]
limits = [float(np.load(folder / f"{name}.coacd.npz")["limit_s"]) for name in names]
HEAD = f"""Read here which results of the PolyMerge paper hold, and how its covers compare with others.
Written by `make -C examples/polymerge page` with `ALULA_DATA` set, on {this_machine()}.
A cover is made of the voxels of a scene; volumes and containment are exact. Flights are judged by the exact
distance of the whole path to the ellipsoids, not to the map that was flown. *Surface + CoACD* stands for the
paper's baseline: the level set 0.3 of the splat's density, as SuGaR defines it, simplified to 20,000
triangles, then CoACD with threshold 0.05 and without its own remesh, which fills closed rooms. It may use
{max(limits):g} s of CPU. The paper tunes CoACD to as many hulls as it gives; our maps get the number that
CoACD finds, or 300 where it finds none in that time."""
figure_5, second = flights_of("figure-5"), flights_of("table-2")
in_firmware = flights_of("table-2-crazyflie")
figures = [polymerge.volumes_figure(scenes), polymerge.curve_figure(scenes)]
shown = [drawn.figure for drawn in figures]
shown += [drawn] if (drawn := flights_figure(figure_5)) is not None else []
verdicts = verdict_rows(scenes, figure_5, second, onboard_rate(), in_firmware)
tables = [
    verdict_table(POLYMERGE, verdicts),
    polymerge.sizes_table(scenes),
    polymerge.volumes_table(scenes),
    polymerge.curve_table(scenes),
    *([figure_5_table(figure_5)] if figure_5 else []),
    *([table_2(second)] if second else []),
    *([table_2_in_firmware(in_firmware)] if in_firmware else []),
]
files = sorted(path for name in names for path in folder.glob(f"{name}.*.npz"))
for drawn in figures:
    with atomic_output(folder / f"{drawn.figure.name}.png") as file:
        file.write(drawn.png)
write_comparison(
    folder / "polymerge",
    TITLE,
    [(path.name, path) for path in files],
    polymerge.in_short(scenes),
    tables,
    shown,
    read=[folded(table) for table in tables],
    markdown=options.markdown,
    head=HEAD,
)
write_record(folder / "polymerge", POLYMERGE, verdicts, shown, options)
