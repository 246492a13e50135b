"""Make Table I and Figure 4 of PolyMerge from the maps in a folder.

Usage: python compare.py FOLDER SCENE [SCENE ...]

A scene has FOLDER/SCENE.metric.scene.npz, SCENE.voxels.npz, SCENE.coacd.npz, and covers by method
"default" or "paper": SCENE.METHOD.N.cover.npz for the curve, SCENE.METHOD.same.cover.npz beside CoACD.
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

from alula.cli.comparison import write_comparison
from alula.schemas.artifact import read_artifact
from alula.schemas.atomic import atomic_output
from alula.stages.compression.measure import half_spaces, measure_cover, measure_points
from alula.stages.compression.onboard.layout import encode_map
from alula.stages.reporting.papers import polymerge
from alula.stages.reporting.papers.polymerge import Polytopes, SceneMaps

folder, names = Path(sys.argv[1]), sys.argv[2:]
TITLE = "PolyMerge: size and conservativeness of maps"


def of_cover(path: Path, index: np.ndarray | None = None) -> Polytopes:
    """Read a cover; measure it against voxels when they are given."""
    cover = read_artifact(path)
    planes, count = len(cover["plane_offset"]), len(cover["plane_start"]) - 1
    found = measure_cover(cover, index) if index is not None else None
    growth = found.conservativeness if found else cover.manifest.conservativeness
    return Polytopes(count, planes, growth, path.stat().st_size, found, len(encode_map(cover)))


def of_coacd(path: Path, index: np.ndarray) -> Polytopes | None:
    """Read the output of coacd_parts.py; None when it had no CoACD."""
    with np.load(path) as arrays:
        points, start = arrays["points"], arrays["start"]
    parts = [points[a:b] for a, b in pairwise(start)]
    if not parts:
        return None
    found = measure_points(parts, index)
    planes = sum(len(half_spaces(part)) for part in parts)
    return Polytopes(len(parts), planes, found.conservativeness, path.stat().st_size, found)


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
    )


scenes = [maps_of(name) for name in names]
figures = [polymerge.volumes_figure(scenes), polymerge.curve_figure(scenes)]
tables = [polymerge.sizes_table(scenes), polymerge.volumes_table(scenes), polymerge.curve_table(scenes)]
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
    [drawn.figure for drawn in figures],
)
