"""Covers of the same voxels by this library, the paper's rule, CoACD and V-HACD, side by side in one run.

CoACD and V-HACD get the mesh that they are made for, the surface of the splat's density, and the surface
of the voxels. CPU and wall seconds are those of the tool's call alone and count all threads; peak memory is
that of the whole process. Times are not tested; an obstacle voxel that our cover leaves out fails the run.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # its idle threads count as CPU time
sys.path.append(str(Path(__file__).resolve().parent))
sys.path.sort(key=sys.path[-1].__eq__)  # last: newer standard libraries have a package `compression`

import argparse
import json
import math
import platform
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import growth
import scenes
import tables
from tools import run_tool, write_mesh

from alula.schemas.artifacts.artifact import Artifact, read_artifact, write_artifact
from alula.schemas.artifacts.kinds import VOXELS
from alula.schemas.parameters.configs.merge import MergeConfig
from papers.polymerge.density_mesh import density_mesh, simplified

Figures = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sizes:
    """Extent of the measurement; `fallback` is the number of hulls where CoACD finds none in time."""

    hoops: tuple[int, int, float]  # hoops, Gaussians, voxel edge [m]
    room: int = 0  # Gaussians; 0 is none
    garden: int = 0
    real: bool = False
    peers: tuple[str, ...] = ()
    ladder: tuple[int, ...] = ()
    growth: tuple[int, ...] = ()
    fallback: int = 30
    limit_s: float = 36.0  # CPU time of one tool
    triangles: int = 20_000  # of the surface of the density
    budget_s: float = math.inf  # elapsed, for the whole run; it limits the growth table


FULL = Sizes(
    hoops=(4, 120_000, 0.024),
    room=200_000,
    garden=300_000,
    real=True,
    peers=(
        *("coacd_surface", "coacd", "coacd_remesh"),
        *("vhacd_flood", "vhacd_raycast", "vhacd_surface", "vhacd_of_surface"),
    ),
    limit_s=300.0,
    ladder=(50, 150, 300, 1000, 3000),
    growth=(50_000, 150_000, 500_000, 1_500_000, 2_250_000),
    fallback=100,
)
QUICK = Sizes(
    hoops=(2, 40_000, 0.03), peers=("coacd", "vhacd_surface"), growth=(50_000, 150_000), budget_s=45.0
)
TINY = Sizes(
    hoops=(1, 20_000, 0.05),
    peers=("coacd", "coacd_surface"),
    triangles=10**9,  # without open3d, which takes long to import
    growth=(4_000, 8_000),
)

_NO_REMESH = {"threshold": 0.05, "preprocess_mode": "off"}
PEERS: dict[
    str, tuple[str, str, bool, Figures]
] = {  # title, tool, whether it gets the density's surface, options
    "coacd": ("CoACD t 0.05, voxels", "coacd", False, _NO_REMESH),
    "coacd_remesh": ("CoACD t 0.05, voxels, its own remesh", "coacd", False, {"threshold": 0.05}),
    "coacd_surface": ("CoACD t 0.05, surface of the density", "coacd", True, _NO_REMESH),
    "vhacd_flood": ("V-HACD, voxels, fill mode flood", "vhacd", False, {"fillMode": "flood"}),
    "vhacd_raycast": ("V-HACD, voxels, fill mode raycast", "vhacd", False, {"fillMode": "raycast"}),
    "vhacd_surface": ("V-HACD, voxels, fill mode surface", "vhacd", False, {"fillMode": "surface"}),
    "vhacd_of_surface": (
        "V-HACD, surface of the density, fill mode surface",
        "vhacd",
        True,
        {"fillMode": "surface"},
    ),
}


@dataclass(frozen=True, slots=True)
class Kept:
    """Rows of an interrupted run, in a folder; without a folder nothing is kept."""

    folder: Path | None
    limit_s: float

    def row(self, name: str, voxels: int, make: Callable[[], Figures]) -> Figures:
        """Return the kept row of these voxels and this limit, or make and keep it."""
        if self.folder is None:
            return make()
        path = self.folder / f"{name.replace('/', '-').replace(' ', '-')}.json"
        facts = {"voxels": voxels, "limit_s": self.limit_s}
        if path.exists():
            known = json.loads(path.read_text())
            if facts.items() <= known.items():
                return dict(known["row"])
        row = make()
        self.folder.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(facts | {"row": row}))
        return row


def inputs(sizes: Sizes) -> Iterator[tuple[str, float, Callable[[], Artifact]]]:
    """Name, voxel edge [m] and maker of each scene."""
    count, gaussians, size = sizes.hoops
    yield f"{count} hoops", size, lambda: scenes.hoops(count, gaussians)
    if sizes.room:
        yield "room", 0.05, lambda: scenes.room(sizes.room)
    if sizes.garden:
        yield "garden", 0.05, lambda: scenes.metric(scenes.garden(sizes.garden))
    data = os.environ.get("ALULA_DATA") if sizes.real else None
    for name, (scale, edge) in scenes.REAL.items() if data else ():
        if (path := Path(str(data), name)).exists():
            yield name, edge, partial(scenes.real, path, scale)


def compare(sizes: Sizes, scene: str, voxels: Path, mesh: Path, kept: Kept) -> dict[str, Figures]:
    """Run all tools on the obstacles of a scene.

    V-HACD, ours and the paper's rule get the number of hulls of CoACD on the voxels, or else on the surface
    of the density, and ours gets the latter too.

    Args:
        sizes: tools and limits.
        scene: its name.
        voxels: an `alula/voxels` file.
        mesh: file of the surface of the density.
        kept: rows of an interrupted run.
    """
    rows: dict[str, Figures] = {}
    count = len(read_artifact(voxels, VOXELS)["index"])

    def run(key: str, title: str, tool: str, options: Figures, of: Path | None = None) -> Figures:
        def measured() -> Figures:
            outcome = run_tool(tool, voxels, sizes.limit_s, mesh=of, **options)
            return {"title": title, "note": outcome.note, **outcome.figures}

        rows[key] = kept.row(f"{scene}.{key}", count, measured)
        return rows[key]

    hulls = sizes.fallback
    for key in sizes.peers:
        title, tool, is_surface, options = PEERS[key]
        more = {"maxConvexHulls": hulls} if tool == "vhacd" else {}
        run(key, title, tool, options | more, mesh if is_surface else None)
        counts = [rows.get(name, {}).get("hulls") for name in ("coacd", "coacd_surface")]
        hulls = next((n for n in counts if n), sizes.fallback)  # the voxels' number where there are both
    paper = run("paper", "the paper's rule", "merge", {"hulls": hulls, "method": "paper"})
    fair = paper.get("hulls", hulls)
    rows["ours"] = kept.row(f"{scene}.ours", count, lambda: ours_with(sizes, voxels, fair))
    if (on_surface := rows.get("coacd_surface", {}).get("hulls")) is not None:
        title = "ours, as many hulls as CoACD on the density's surface"
        rows["ours_surface"] = kept.row(
            f"{scene}.ours_surface", count, lambda: ours_with(sizes, voxels, on_surface) | {"title": title}
        )
    if "half_planes" in paper:
        title = "ours, with the paper's half-planes"
        run("ours_planes", title, "merge", {"max_planes": paper["half_planes"]})
        for title, options in variants(paper):
            run(title, title, "merge", options)
    return rows


def variants(paper: Figures) -> Iterator[tuple[str, Figures]]:
    """List further options with the half-planes or bytes of the paper's rule, where `merge` has them."""
    planes = {"max_planes": paper["half_planes"]}
    known = {field.name for field in fields(MergeConfig)}
    for title, options in (
        ("ours, hulls as they are, with the paper's half-planes", {"facet_cap": "none"} | planes),
        ("ours, at most 12 half-planes a hull", {"facet_cap": 12} | planes),
        ("ours, half-planes of 26 directions", {"kdop": 26} | planes),
        ("ours, in the paper's bytes", {"max_bytes": paper["bytes"]}),
    ):
        if options.keys() <= known:
            yield title, options


def ours_with(sizes: Sizes, voxels: Path, hulls: int) -> Figures:
    """Run our default with exactly this number of hulls, or the nearest number below.

    Tightening can leave fewer hulls than requested; then a few more are requested.
    """
    best: Figures = {}
    requested = hulls
    for _ in range(6):
        outcome = run_tool("merge", voxels, sizes.limit_s, hulls=requested)
        row = {"title": "ours", "note": outcome.note, "hulls_asked": requested, **outcome.figures}
        if outcome.note:
            return best or row
        if row["hulls"] <= hulls and row["hulls"] > best.get("hulls", 0):
            best = row
        if row["hulls"] == hulls:
            break
        requested += hulls - row["hulls"]
    return best


def ladder(sizes: Sizes, voxels: Path) -> Iterator[Figures]:
    """Compare ours with the paper's rule for several numbers of hulls."""
    for hulls in sizes.ladder:
        paper = run_tool("merge", voxels, sizes.limit_s, hulls=hulls, method="paper")
        if paper.note or paper.figures["hulls"] < hulls:
            continue
        ours = ours_with(sizes, voxels, hulls)
        planes = run_tool("merge", voxels, sizes.limit_s, max_planes=paper.figures["half_planes"])
        yield {
            "hulls": hulls,
            "paper": {"note": "", **paper.figures},
            "ours": ours,
            "ours_planes": {"note": planes.note, **planes.figures},
        }


def contract(rows: dict[str, Figures]) -> Figures:
    """Figures of the first scene under the keys that scripts read."""
    ours, paper, coacd = (rows.get(name, {}) for name in ("ours", "paper", "coacd"))
    both = ours.get("cpu_s") and coacd.get("cpu_s")
    return {
        "ours_cpu_s": ours.get("cpu_s"),
        "coacd_cpu_s": coacd.get("cpu_s"),
        "coacd_note": coacd.get("note", "not run"),  # empty when done; else its CPU time is a lower bound
        "coacd_over_ours": coacd["cpu_s"] / ours["cpu_s"] if both else None,
        "uncovered_voxels": ours.get("voxels_outside_every_hull"),
        "union_ratio_ours": ours.get("union_ratio"),
        "union_ratio_coacd": coacd.get("union_ratio"),
        "union_ratio_paper": paper.get("union_ratio"),
        "hulls": ours.get("hulls"),
        "hulls_paper": paper.get("hulls"),
        "hulls_coacd": coacd.get("hulls"),
        "half_planes_ours": ours.get("half_planes"),
        "half_planes_paper": paper.get("half_planes"),
        "bytes_per_half_plane": ours.get("bytes_per_half_plane"),
    }


def is_covered(result: Figures) -> bool:
    """Return whether none of our covers leaves out a voxel."""
    ours = [row for scene in result["scenes"] for key, row in scene["tools"].items() if key not in PEERS]
    ours += [step[key] for scene in result["scenes"] for step in scene["ladder"] for key in tables.LADDER]
    return all(row["voxels_outside_every_hull"] == 0 for row in ours if not row["note"]) and all(
        row["covered"] for row in result["growth"] if not row["note"]
    )


def main() -> int:
    """Measure everything; return 1 when one of our covers leaves out a voxel."""
    start = time.monotonic()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true", help="one scene and CoACD alone, half a minute")
    size.add_argument("--tiny", action="store_true", help="inputs too small for a comparison, for tests")
    parser.add_argument("--only", metavar="TEXT", help="only scenes with this in their name, or growth")
    parser.add_argument("--limit", type=float, metavar="S", help="CPU seconds that each tool may take")
    parser.add_argument(
        "--keep", type=Path, metavar="FOLDER", help="keep rows in FOLDER, and take those that it has"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of tables")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="also write the tables to FILE")
    options = parser.parse_args()
    sizes = QUICK if options.quick else TINY if options.tiny else FULL
    if options.limit is not None:
        sizes = replace(sizes, limit_s=options.limit)

    def show(text: str) -> None:
        if not options.json:
            print(text, flush=True)

    result: Figures = {
        "quick": options.quick,
        "machine": f"{os.cpu_count()} processors, {platform.machine()}",
        "python": platform.python_version(),
        "limit_s": sizes.limit_s,
        "triangles": sizes.triangles,
        "scenes": [],
    }
    kept = Kept(options.keep, sizes.limit_s)
    with tempfile.TemporaryDirectory(prefix="alula-bench-") as folder:
        path, mesh = Path(folder, "scene.voxels.npz"), Path(folder, "surface.npz")
        for name, edge, make in inputs(sizes):
            if options.only is not None and options.only not in name:
                continue
            splats = make()
            voxels = scenes.voxels_of(splats, edge)
            write_artifact(path, voxels)
            if any(PEERS[key][2] for key in sizes.peers):
                write_mesh(mesh, *simplified(*density_mesh(splats, voxels), sizes.triangles))
            scene: Figures = {"name": name, "voxel_size_m": edge, "voxels": len(voxels["index"])}
            scene["tools"] = compare(sizes, name, path, mesh, kept)
            has_ladder = name in ("room", "garden")
            steps = partial(lambda at: {"steps": list(ladder(sizes, at))}, path)
            count = scene["voxels"]
            scene["ladder"] = kept.row(f"{name}.ladder", count, steps)["steps"] if has_ladder else []
            result["scenes"].append(scene)
            show(tables.scene(scene))
    grown = sizes.growth if options.only in (None, "growth") else ()
    result["growth"] = kept.row(
        "growth",
        sum(grown),
        lambda: {"rows": list(growth.rows(grown, sizes.limit_s, start + sizes.budget_s))},
    )["rows"]
    result["exponents"] = growth.exponents(result["growth"])
    result["targets"] = tables.targets(result)
    result = contract(result["scenes"][0]["tools"] if result["scenes"] else {}) | result
    show(tables.growth(result))
    show(tables.verdicts(result))
    if options.json:
        print(json.dumps(result, indent=2))
    if options.markdown is not None:
        options.markdown.write_text(tables.document(result))
    return 0 if is_covered(result) else 1


if __name__ == "__main__":
    sys.exit(main())
