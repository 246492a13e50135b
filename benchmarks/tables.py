"""The figures of the compression benchmark as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from growth import STEPS, TARGET_MB, TARGET_S

Figures = dict[str, Any]
LADDER = ("paper", "ours", "ours_planes")
_TARGET_GAUSSIANS = 1_500_000

_COLUMNS: tuple[tuple[str, Callable[[Figures], str]], ...] = (
    ("CPU s", lambda r: f"{r['cpu_s']:.3g}"),
    ("wall s", lambda r: f"{r['wall_s']:.3g}"),
    ("peak MB", lambda r: f"{r['peak_mb']:.0f}"),
    ("hulls", lambda r: f"{r['hulls']:,}"),
    ("half-planes", lambda r: f"{r['half_planes']:,}"),
    ("bytes", lambda r: f"{r['bytes']:,}"),
    ("not covered", lambda r: f"{r['uncovered_volume']:.2%}" if r["uncovered_volume"] > 1e-7 else "0"),
    ("voxels in no hull", lambda r: f"{r['voxels_outside_every_hull']:,}"),
    ("voxels with a gap", lambda r: f"{r['voxels_with_gap']:,}"),
    ("union / V+", lambda r: f"{r['union_ratio']:.4f}"),
    ("excess / V+", lambda r: f"{r['excess']:.4f}"),
)

_PREFACE = """# Compression, measured

Compare here the covers of alula with those of CoACD, V-HACD and the paper's rule: size, volume, time, memory.
Written by `python benchmarks/compression.py --markdown docs/results/benchmarks.md` on {machine},
Python {python}. All tools got the same obstacles in one run, each in a process of its own that may use
**{limit:g} s of CPU**; a tool that needs more has a row that says so. CPU and wall seconds are those of the
tool's call alone, all threads together; wall seconds depend on what else the machine does. Peak memory is
that of the whole process with Python and numpy.

CoACD and V-HACD read meshes. *Voxels* is the surface of the occupied voxels, without simplification.
*Surface of the density* is the level set 0.3 of the splat's density within a voxel of V+, as SuGaR defines
it: closed, from marching tetrahedra on the voxels' lattice, simplified to {triangles:,} triangles by
quadric errors. It is the kind of mesh that CoACD is made for; making it is not counted. CoACD's own remesh
fills closed rooms, and so do V-HACD's fill modes flood and raycast; its fill mode surface does not. V-HACD's
grid is as fine as the voxels, up to 4 million cells.

V+ is the volume of the occupied voxels, the excess the volume of the union outside them, *not covered* the
fraction of V+ outside the union. *Voxels in no hull* are those that no single hull contains as a whole. Our
covers are checked by this count; it is stricter than necessary for tools that divide voxels between two
hulls. *Voxels with a gap* are those of which the union leaves out more than a millionth. Coplanar triangles
of a mesh count as one half-plane. Bytes of meshes are those of their planes if quantised like ours. Volumes
are exact up to rounding; the maximum error of union / V+ below is {error:.1e}. Measured again along random
vertical lines, {agree} of {all} agree within the sampling error.
"""


def _table(headings: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    heads = list(headings)
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def scene(figures: Figures) -> str:
    """Format the table of one scene, and the comparison with the paper's rule where there is one."""
    text = f"\n## {figures['name']}: {figures['voxels']:,} voxels of {figures['voxel_size_m']:g} m\n\n"
    rows = []
    for row in figures["tools"].values():
        cells = [row["note"], *[""] * (len(_COLUMNS) - 1)] if row["note"] else [f(row) for _, f in _COLUMNS]
        rows.append([row["title"], *cells])
    text += _table(["tool", *(name for name, _ in _COLUMNS)], rows)
    if figures["ladder"]:
        heads = ["hulls", "excess, paper", "ours", "ratio", "half-planes, paper", "ours", "ratio"]
        heads += ["ours with the paper's half-planes: hulls", "excess", "ratio"]
        text += "\nAgainst the paper's rule:\n\n" + _table(heads, map(_ladder_cells, figures["ladder"]))
    return text


def _ladder_cells(step: Figures) -> list[str]:
    paper, ours, planes = (step[key] for key in LADDER)
    if ours["note"] or planes["note"]:
        return [f"{step['hulls']:,}", ours["note"] or planes["note"], *[""] * 8]
    return [
        f"{step['hulls']:,}",
        f"{paper['excess']:.4f}",
        f"{ours['excess']:.4f}",
        f"{ours['excess'] / paper['excess']:.2f}",
        f"{paper['half_planes']:,}",
        f"{ours['half_planes']:,}",
        f"{ours['half_planes'] / paper['half_planes']:.2f}",
        f"{planes['hulls']:,}",
        f"{planes['excess']:.4f}",
        f"{planes['excess'] / paper['excess']:.2f}",
    ]


def growth(result: Figures) -> str:
    """Format seconds and memory per size, and the exponents."""
    if not result["growth"]:
        return ""
    heads = ["Gaussians", ".ply MB", "voxels", "hulls", *(f"{step}, CPU s" for step in STEPS)]
    heads += ["to the cover, CPU s", "wall s", "peak MB", "the paper's merge, CPU s", "its peak MB"]
    rows = []
    for row in result["growth"]:
        start = [f"{row['gaussians']:,}"]
        if row["note"]:
            rows.append([*start, row["note"], *[""] * (len(heads) - 2)])
            continue
        paper = [f"{row['paper_cpu_s']:.2f}", f"{row['paper_peak_mb']:.0f}"]
        rows.append(
            [
                *start,
                f"{row['megabytes']:.0f}",
                f"{row['voxels']:,}",
                f"{row['hulls']:,}",
                *(f"{row[f'{step}_cpu_s']:.2f}" for step in (*STEPS, "cover")),
                f"{row['cover_wall_s']:.2f}",
                f"{row['peak_mb']:.0f}",
                *([row["paper_note"], ""] if row["paper_note"] else paper),
            ]
        )
    text = "\n## Growth: a garden of any size, from `.ply` to the verified cover\n\n" + _table(heads, rows)
    if found := result["exponents"]:
        text += (
            "\nExponents over the number of voxels (CPU seconds; memory beyond the start of the process):\n\n"
        )
        names = {key: key.removesuffix("_cpu_s").replace("_", " ") for key in found}
        names |= {"n_log_n": "N log N", "cover_cpu_s": "to the cover", "paper_cpu_s": "paper's merge"}
        text += _table((names[key] for key in found), [[f"{value:.2f}" for value in found.values()]])
    return text


def targets(result: Figures) -> list[Figures]:
    """List targets and results: `text`, `found`, `is_met`."""
    found: list[Figures] = []

    def add(text: str, value: float, is_met: bool) -> None:
        found.append({"text": text, "found": value, "is_met": bool(is_met)})

    for place in result["scenes"]:
        tools, name = place["tools"], place["name"]
        ours, paper, coacd, planes = (tools.get(k, {}) for k in ("ours", "paper", "coacd", "ours_planes"))
        if "hulls" in ours:
            add(f"{name}: voxels not covered, 0", ours["voxels_outside_every_hull"], _none_outside(ours))
            per_plane = ours["bytes_per_half_plane"]
            add(f"{name}: bytes per half-plane on board, at most 5", per_plane, per_plane <= 5)
        for mesh, of, by in (
            ("voxels", coacd, ours),
            ("the density's surface", tools.get("coacd_surface", {}), tools.get("ours_surface", {})),
        ):
            if "hulls" in by and "hulls" in of:
                ratio = of["cpu_s"] / by["cpu_s"]
                add(f"{name}: CPU of CoACD on {mesh} over ours, at least 50", ratio, ratio >= 50)
                excess = by["excess"] / of["excess"]
                add(
                    f"{name}: excess over that of CoACD on {mesh} at equal hulls, at most 1",
                    excess,
                    excess <= 1,
                )
        for step in [
            {"hulls": paper.get("hulls"), "paper": paper, "ours": ours, "ours_planes": planes},
            *place["ladder"],
        ]:
            if step["hulls"] and step["hulls"] <= 1000 and all("excess" in step[key] for key in LADDER):
                equal, same = (step[key]["excess"] / step["paper"]["excess"] for key in LADDER[1:])
                text = f"{name}, {step['hulls']} hulls: excess over the paper's at equal hulls, at most 0.85"
                add(
                    f"{text} (or at equal half-planes, {same:.2f}, at most 0.6)",
                    equal,
                    equal <= 0.85 or same <= 0.6,
                )
    for row in result["growth"]:
        if row["note"]:
            continue
        what = f"garden of {row['gaussians']:,}"
        ratio = row["verify_wall_s"] / row["merge_wall_s"]
        add(f"{what}: time of verify over merge, at most 1", ratio, ratio <= 1)
        if row["gaussians"] == _TARGET_GAUSSIANS:
            add(
                f"{what}: .ply to cover, at most {TARGET_S:g} s",
                row["cover_wall_s"],
                row["cover_wall_s"] <= TARGET_S,
            )
            peak = row["cover_peak_mb"]
            add(f"{what}: peak memory, at most {TARGET_MB:g} MB", peak, peak <= TARGET_MB)
    if "cover_cpu_s" in (slope := result["exponents"]):
        text = f"growth of CPU time to the cover, at most N log N = {slope['n_log_n']:.2f}"
        add(text, slope["cover_cpu_s"], slope["cover_cpu_s"] <= slope["n_log_n"])
    return found


def _none_outside(row: Figures) -> bool:
    return bool(row["voxels_outside_every_hull"] == 0)


def verdicts(result: Figures) -> str:
    """Format the table of targets."""
    rows = [[t["text"], f"{t['found']:.4g}", "yes" if t["is_met"] else "NO"] for t in result["targets"]]
    return "\n## Targets\n\n" + _table(["target", "found", "met"], rows)


def document(result: Figures) -> str:
    """Format everything as one page."""
    rows = [row for place in result["scenes"] for row in place["tools"].values()]
    done = [row for row in rows if not row["note"]]
    text = _PREFACE.format(
        machine=result["machine"],
        limit=result["limit_s"],
        triangles=result["triangles"],
        python=result["python"],
        error=max((row["union_ratio_error"] for row in done), default=0.0),
        agree=sum(row["agrees"] for row in done),
        all=len(done),
    )
    text += verdicts(result)
    return text + "".join(map(scene, result["scenes"])) + growth(result)
