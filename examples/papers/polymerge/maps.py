"""Table I and Figure 4 of PolyMerge on our scenes: sizes of maps, and volume by number of hulls."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from alula.stages.reporting.figures import Figure, drawing
from alula.stages.reporting.palette import AXIS, BLACK, BLUE, GREEN, INK, ORANGE, PURPLE, SKY, VERMILLION
from alula.stages.reporting.table import Table, text
from alula.stages.reporting.tables import BYTES_PER_GAUSSIAN, BYTES_PER_HALF_PLANE
from papers.polymerge.measure import Measure
from papers.published import POLYMERGE_SCENES, POLYMERGE_SIZES

_METHODS = {"default": "ours", "paper": "paper's rule", "coacd": "surface + CoACD"}
_COLORS = {"default": BLUE, "paper": ORANGE, "coacd": AXIS}
_SCENE_COLORS = (BLUE, VERMILLION, GREEN, PURPLE, SKY, ORANGE, BLACK)
_MB = 1e6
_HIGHEST_BAR = 4.0  # higher bars are cut off, so that the others can be compared


@dataclass(frozen=True, slots=True)
class Polytopes:
    """A map of convex polytopes: number of hulls and half-planes, sizes, and volume.

    `measure` is None where only the manifest's `conservativeness` is known; `onboard_bytes` is None where the
    map has no form for a microcontroller; `file` is the map's name.
    """

    hulls: int
    half_planes: int
    conservativeness: float
    file_bytes: int | None = None
    measure: Measure | None = None
    onboard_bytes: int | None = None
    file: str = ""


@dataclass(frozen=True, slots=True)
class SceneMaps:
    """The maps of one scene.

    Attributes:
        name: of the scene.
        ellipsoids: their number.
        scene_bytes: size of its file.
        voxels: number of occupied voxels.
        voxel_size_m: their edge [m].
        same_count: by method "default", "paper" or "coacd", maps with about the same number of polytopes.
        curves: by method, maps with decreasing numbers of polytopes.
        coacd_note: why there are no parts of CoACD.
    """

    name: str
    ellipsoids: int
    scene_bytes: int
    voxels: int
    voxel_size_m: float
    same_count: Mapping[str, Polytopes]
    curves: Mapping[str, Sequence[Polytopes]] = field(default_factory=dict)
    coacd_note: str = "CoACD was not run"


def sizes_table(scenes: Sequence[SceneMaps]) -> Table:
    """Make Table I: ellipsoids, CoACD and ours, with the published rows below."""
    rows: list[tuple[Any, ...]] = []
    for scene in scenes:
        ours, theirs = scene.same_count["default"], scene.same_count.get("coacd")
        row: list[Any] = [scene.name, scene.ellipsoids, scene.scene_bytes / _MB]
        row += [scene.ellipsoids * BYTES_PER_GAUSSIAN / _MB]
        row += [None] * 4 if theirs is None else [theirs.hulls, *_planes(theirs)]
        onboard = None if ours.onboard_bytes is None else ours.onboard_bytes / _MB
        rows.append((*row, ours.hulls, *_planes(ours), onboard))
    each, one = BYTES_PER_HALF_PLANE / _MB, BYTES_PER_GAUSSIAN / _MB
    for (name, n, f), (count, whole, g, small, large) in zip(POLYMERGE_SCENES, POLYMERGE_SIZES, strict=True):
        rows.append(
            (
                *(f"published: {name}", count, whole, count * one),
                *(n, g, small, g * each, n, f, large, f * each, None),
            )
        )
    columns = ["scene", "ellipsoids", "ellipsoids: file [MB]", "ellipsoids: geometry [MB]"]
    for method in ("surface + CoACD", "hulls"):
        columns += [
            f"{method}: {what}" for what in ("primitives", "half-planes", "file [MB]", "geometry [MB]")
        ]
    columns.append("hulls: onboard map [MB]")
    note = (
        f"Geometry counts {BYTES_PER_GAUSSIAN} bytes per ellipsoid and {BYTES_PER_HALF_PLANE} per "
        "half-plane, in the published rows too. Our files also hold vertices, members and provenance; a "
        "microcontroller reads the onboard map. Published: CoACD on SuGaR's mesh, half-planes and "
        "ellipsoids rounded as printed; in our rows CoACD runs on the surface of the density. Scenes differ, "
        "so only ratios compare."
    )
    return Table("table-1", "Table I: size of the map", tuple(columns), tuple(rows), note)


def _planes(found: Polytopes) -> tuple[Any, ...]:
    size = None if found.file_bytes is None else found.file_bytes / _MB
    return found.half_planes, size, found.half_planes * BYTES_PER_HALF_PLANE / _MB


def volumes_table(scenes: Sequence[SceneMaps]) -> Table:
    """Tabulate Figure 4a: volume of the union over that of the voxels, and the part inside the voxels."""
    rows = [
        (
            scene.name,
            _METHODS[method],
            found.hulls,
            found.half_planes,
            found.conservativeness,
            found.measure.filled if found.measure is not None else None,
            found.measure.open_voxels if found.measure is not None else None,
            scene.voxels,
            scene.voxel_size_m,
        )
        for scene in scenes
        for method, found in scene.same_count.items()
    ]
    columns = (
        *("scene", "method", "primitives", "half-planes", "volume / voxels", "inside voxels"),
        *("voxels not filled", "voxels", "voxel edge [m]"),
    )
    note = (
        "Volumes of unions, computed from convex pieces, are exact up to rounding. A voxel is not filled "
        "when more than 1e-9 of it is left out."
    )
    return Table("figure-4a", "Figure 4a: conservativeness", columns, tuple(rows), note)


def curve_table(scenes: Sequence[SceneMaps]) -> Table:
    """Tabulate Figure 4b: volume of the union over that of the voxels by number of hulls."""
    rows = [
        (scene.name, _METHODS[method], found.hulls, found.half_planes, found.conservativeness)
        for scene in scenes
        for method, curve in scene.curves.items()
        for found in curve
    ]
    columns = ("scene", "method", "hulls", "half-planes", "volume / voxels")
    return Table("figure-4b", "Figure 4b: volume by number of hulls", columns, tuple(rows))


@dataclass(frozen=True, slots=True)
class Drawn:
    """A figure as SVG and as PNG."""

    figure: Figure
    png: bytes


def volumes_figure(scenes: Sequence[SceneMaps]) -> Drawn:
    """Plot Figure 4a: a bar per map; the hatched part is inside the voxels."""
    from matplotlib.patches import Patch

    methods = [m for m in _METHODS if any(m in scene.same_count for scene in scenes)]
    width = 0.8 / len(methods)
    top = min(_HIGHEST_BAR, max(f.conservativeness for s in scenes for f in s.same_count.values()))
    with drawing(max(6.2, 2.4 + 1.5 * len(scenes)), 4.0) as (axes, render):
        for place, scene in enumerate(scenes):
            for number, method in enumerate(methods):
                if method not in scene.same_count:
                    continue
                found = scene.same_count[method]
                at = place + (number - (len(methods) - 1) / 2) * width
                axes.bar(at, found.conservativeness, 0.92 * width, color=_COLORS[method], alpha=0.55)
                if found.measure is not None:
                    hatched: dict[str, Any] = {
                        "fill": False,
                        "hatch": "////",
                        "edgecolor": INK,
                        "lw": 0,
                    }
                    axes.bar(at, found.measure.filled, 0.92 * width, **hatched)
                shown = min(found.conservativeness, top)
                axes.annotate(
                    f"{found.conservativeness:.2f}" + (" ↑" if found.conservativeness > top else ""),
                    (at, shown),
                    (0, 2),
                    textcoords="offset points",
                    ha="center",
                    va="bottom",
                    fontsize=9,
                )
        axes.axhline(1, color=INK, linewidth=1)
        names = [f"{scene.name}\n{scene.same_count['default'].hulls} hulls" for scene in scenes]
        axes.set_xticks(range(len(scenes)), names)
        axes.tick_params(axis="x", length=0)
        axes.grid(visible=False, axis="x")
        axes.set(ylabel="volume / volume of voxels", xlim=(-0.6, len(scenes) - 0.4))
        axes.set_ylim(0, 1.12 * top)
        keys = [Patch(facecolor=_COLORS[m], alpha=0.55, label=_METHODS[m]) for m in methods]
        keys.append(Patch(fill=False, hatch="////", edgecolor=INK, lw=0, label="inside voxels"))
        axes.figure.legend(handles=keys, loc="outside upper center", ncols=len(keys), fontsize=10)
        image, svg = _png(axes), render()
    values = "; ".join(
        f"{scene.name}: "
        + ", ".join(
            f"{_METHODS[m]} {text(found.conservativeness)}"
            + (f" with {text(found.measure.filled)} inside" if found.measure is not None else "")
            for m, found in scene.same_count.items()
        )
        for scene in scenes
    )
    alt = f"Volume of the union of hulls over that of the voxels; hatched: inside the voxels. {values}."
    return Drawn(Figure("figure-4a", "Figure 4a: conservativeness", alt, svg, wide=True), image)


def curve_figure(scenes: Sequence[SceneMaps]) -> Drawn:
    """Plot Figure 4b: volume of the union over the number of hulls."""
    from matplotlib.lines import Line2D

    with drawing(7.4, 4.6) as (axes, render):
        for scene, color in zip(scenes, _SCENE_COLORS * len(scenes), strict=False):
            for method, curve in scene.curves.items():
                hulls = [found.hulls for found in curve]
                growth = [found.conservativeness for found in curve]
                style: dict[str, Any] = (
                    {"linestyle": "-"} if method == "default" else {"linestyle": (0, (4, 2))}
                )
                axes.plot(hulls, growth, marker=".", color=color, linewidth=1.6, **style)
        counts = sorted({found.hulls for scene in scenes for c in scene.curves.values() for found in c})
        ticks = [c * 10**p for p in range(7) for c in (1, 3)]
        ticks = [t for t in ticks if counts[0] <= t <= counts[-1]]
        axes.set(xscale="log", yscale="log", xlabel="hulls", ylabel="volume of hulls / volume of voxels")
        axes.set_xticks(ticks, [text(t) for t in ticks])
        bottom, top = axes.get_ylim()
        rungs = [c * 10.0**p for p in range(7) for c in (1, 1.2, 1.5, 2, 3, 5)]
        rungs = [t for t in rungs if t <= top]
        axes.set_yticks(rungs, [text(t) for t in rungs])
        axes.set_ylim(min(0.97, bottom), top)
        axes.minorticks_off()
        axes.axhline(1, color=INK, linewidth=1)
        keys = [
            Line2D([], [], color=c, linewidth=1.6, label=s.name)
            for s, c in zip(scenes, _SCENE_COLORS * len(scenes), strict=False)
        ]
        keys += [
            Line2D([], [], color=INK, linewidth=1.6, label="ours"),
            Line2D([], [], color=INK, linewidth=1.6, linestyle=(0, (4, 2)), label="paper's rule"),
        ]
        axes.legend(handles=keys, loc="upper right", fontsize=10)
        image, svg = _png(axes), render()
    ends = "; ".join(
        f"{scene.name}, {_METHODS[method]}: from {text(curve[0].conservativeness)} at {text(curve[0].hulls)} "
        f"hulls to {text(curve[-1].conservativeness)} at {text(curve[-1].hulls)}"
        for scene in scenes
        for method, curve in scene.curves.items()
        if curve
    )
    alt = f"Volume of the union of hulls over that of the voxels, by the number of hulls. {ends}."
    return Drawn(Figure("figure-4b", "Figure 4b: volume by number of hulls", alt, svg, wide=True), image)


def _png(axes: Any) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure, out = axes.figure, io.BytesIO()
    vector = figure.canvas
    figure.set_dpi(130)
    FigureCanvasAgg(figure).print_png(out, metadata={"Software": None})
    figure.set_dpi(100)
    figure.set_canvas(vector)
    return out.getvalue()


def excess_saved(scene: SceneMaps) -> float | None:
    """Relative reduction of enclosed free space against the paper's rule at the same number of hulls."""
    ours, theirs = scene.same_count.get("default"), scene.same_count.get("paper")
    if ours is None or theirs is None or not theirs.conservativeness > 1:
        return None
    return float(1 - (ours.conservativeness - 1) / (theirs.conservativeness - 1))


def in_short(scenes: Sequence[SceneMaps]) -> dict[str, str]:
    """Summarise the maps, one line per scene."""
    lines = {}
    for scene in scenes:
        ours = scene.same_count["default"]
        words = f"{text(scene.ellipsoids)} ellipsoids → {text(ours.hulls)} hulls"
        words += f" of {text(ours.half_planes)} half-planes, volume / voxels {text(ours.conservativeness)}"
        if (saved := excess_saved(scene)) is not None:
            words += f", free space enclosed {text(100 * saved)} % below the paper's rule"
        theirs = scene.same_count.get("coacd")
        if theirs is not None and theirs.measure is not None:
            percent = 100 * theirs.measure.open_voxels / theirs.measure.voxels
            words += (
                f"; CoACD {text(theirs.conservativeness)}, leaves out parts of {text(percent)} % of the "
                "voxels"
            )
            words += f", {text(100 * (1 - theirs.measure.filled))} % of their volume"
        lines[scene.name] = words
    return lines
