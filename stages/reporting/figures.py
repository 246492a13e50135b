"""The figures of a report, drawn as SVG text from the arrays of `curves` and `fenced`.

Maps from above, flights in a geofence from the side, distributions over trials, and the curve of compression.
One function draws one figure.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.reporting import curves
from alula.stages.reporting.curves import paths_of
from alula.stages.reporting.fenced import fence_shape, is_fenced
from alula.stages.reporting.material import NOT_JUDGED, OUTCOMES, Material, Run
from alula.stages.reporting.palette import AXIS, COLORS, DASHES, GRID, INK, RUN_COLORS, run_color
from alula.stages.reporting.table import text
from alula.stages.runlog.maps import SHOWN_BEYOND_M

STILL = "still"  # name of the still picture
_STYLE = {
    "svg.hashsalt": "alula",
    "svg.fonttype": "none",
    "font.size": 11,
    "font.family": "sans-serif",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GRID,
    "axes.edgecolor": AXIS,
    "axes.facecolor": "none",
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "text.color": INK,
    "text.parse_math": False,  # names of runs may have dollar signs
    "xtick.color": AXIS,
    "xtick.labelcolor": INK,
    "ytick.color": AXIS,
    "ytick.labelcolor": INK,
    "axes.axisbelow": True,
    "legend.frameon": False,
}
_VECTOR_FOOTPRINTS = 1500  # more footprints are drawn as an image inside the figure
_MAX_FENCED_RUNS = 4
_MAX_MAPS = 4
_FEW_PATHS = 40  # more paths are drawn thinner
_DOTTED = 40  # distributions of more values are drawn without dots


@dataclass(frozen=True, slots=True, kw_only=True)
class TimeAxis:
    """Where the time of a flight lies in a figure.

    Attributes:
        begin, end: times at the ends of the axis [s].
        left, right: where they are, in widths of the figure from its left side.
        top, bottom: of the curves, in heights of the figure from its upper side.
    """

    run: str
    trial: int
    begin: float
    end: float
    left: float
    right: float
    top: float
    bottom: float


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure: SVG text, title, and a description in words (`alt`) that is also its caption."""

    name: str
    title: str
    alt: str
    svg: str
    wide: bool = False  # takes the whole width of the page
    time: TimeAxis | None = None  # of a single flight's curves


def all_figures(material: Material) -> list[Figure]:
    """Draw the figures that the material has data for, in reading order."""
    found = []
    for number, shown in enumerate(curves.flight_maps(material)[:_MAX_MAPS], 1):
        found.append(_map_figure(shown, f"map-{number}"))
    found += fence_figures(material)
    many = () if [run.course is None for run in material.runs] == [False] else material.runs
    if clearances := curves.clearances(many):  # a single real flight is no distribution
        found.append(_clearance_figure(clearances, all(map(is_fenced, material.runs))))
    if ratios := curves.path_ratios(many):
        found.append(_ratio_figure(ratios))
    if (curve := curves.compression(material.cover)) is not None:
        found.append(_compression_figure(curve))
    return found


@dataclass(frozen=True, slots=True)
class Sheet:
    """Place of a drawing on paper.

    Attributes:
        size: width and height of the sheet [inch].
        box: left, bottom, width and height of the drawing on it, as fractions of the sheet.
        font_size: of the drawing [pt].
    """

    size: tuple[float, float]
    box: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)
    font_size: float = 8.0


_Place = Callable[[float, float], Sheet]
_ON_PAPER: ContextVar[tuple[_Place, list[Any]] | None] = ContextVar("on_paper", default=None)


@contextmanager
def on_paper(place: _Place) -> Iterator[list[Any]]:
    """Let figures be drawn on sheets, for files without a style sheet: opaque, in their own size.

    Args:
        place: from width and height of a drawing on the page [inch] to its sheet.

    Yields:
        The figures of matplotlib, in the order in which they are drawn.
    """
    drawn: list[Any] = []
    token = _ON_PAPER.set((place, drawn))
    try:
        yield drawn
    finally:
        _ON_PAPER.reset(token)


@contextmanager
def drawing(
    width: float,
    height: float,
    rows: int = 1,
    columns: int = 1,
    heights: Sequence[float] | None = None,
) -> Iterator[tuple[Any, Callable[[], str]]]:
    """Yield the axes of a new figure and a function that renders it as SVG; equal data gives equal text.

    Within `on_paper` the figure is kept for its sheet, and the text is empty.

    Args:
        width: of the figure [inch].
        height: of the figure [inch].
        rows: number of axes below each other, with a common x axis.
        columns: number of axes side by side, with a common y axis.
        heights: of the rows, relative to each other; by default all equal.
    """
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure as Canvas

    paper = _ON_PAPER.get()
    with mpl.rc_context():
        mpl.rcdefaults()  # ignore the user's style
        mpl.rcParams.update(_STYLE)
        if paper is None:
            figure = Canvas(figsize=(width, height), layout="constrained")
        else:
            sheet = paper[0](width, height)
            mpl.rcParams.update({"font.size": sheet.font_size, "figure.facecolor": "white"})
            figure = Canvas(figsize=sheet.size, layout="constrained")
            engine: Any = figure.get_layout_engine()
            engine.set(rect=sheet.box)
            paper[1].append(figure)
        FigureCanvasSVG(figure)
        axes = figure.subplots(rows, columns, sharex=rows > 1, sharey=columns > 1, height_ratios=heights)

        def render() -> str:
            _plain_ticks(figure)
            if paper is not None:
                return ""
            layout: Any = figure.get_layout_engine()
            layout.execute(figure)
            figure.set_layout_engine(None)  # which savefig would run by drawing everything once more
            out = io.StringIO()
            figure.savefig(out, format="svg", metadata={"Date": None, "Creator": None})
            return out.getvalue()

        yield axes, render


def _plain_ticks(figure: Any) -> None:
    """Write the ticks of logarithmic axes as numbers: what is drawn is text, which is not parsed as TeX."""
    from matplotlib.ticker import LogFormatterSciNotation

    class Plain(LogFormatterSciNotation):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return text(float(x)) if super().__call__(x, pos) else ""

    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            for of, is_minor in ((axis.get_major_formatter(), False), (axis.get_minor_formatter(), True)):
                if type(of) is LogFormatterSciNotation:
                    plain = Plain(labelOnlyBase=of.labelOnlyBase, minor_thresholds=of.minor_thresholds)
                    (axis.set_minor_formatter if is_minor else axis.set_major_formatter)(plain)


def window(lines: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Lower and upper corner of the view around points in the plane, shape (2,) each [m].

    The view is smaller than the region to which `fence_shell` cuts an open fence.

    Args:
        lines: points in the plane, shape (n, 2) each [m].
    """
    low = np.min([line.min(axis=0) for line in lines], axis=0)
    high = np.max([line.max(axis=0) for line in lines], axis=0)
    size = high - low
    pad = np.clip(np.maximum(0.1 * size.max(), 0.5 * (0.25 * size.max() - size)), 1.0, 0.9 * SHOWN_BEYOND_M)
    return low - pad, high + pad


def outline(axes: Any, corners: FloatArray) -> None:
    """Draw the outline of a fence from its projected corners, shape (V, 2) [m]."""
    if len(corners):
        line = curves.footprint(corners)
        axes.plot(*np.vstack([line, line[:1]]).T, color=INK, linewidth=1.8, zorder=2)


def _map_figure(shown: curves.FlightMap, name: str) -> Figure:
    from matplotlib.collections import LineCollection, PolyCollection

    points = [p.position_world[:, :2] for p in shown.paths] + list(shown.footprints)
    points = [p for p in points if len(p)]
    low = np.min([p.min(axis=0) for p in points], axis=0) if points else np.zeros(2)
    high = np.max([p.max(axis=0) for p in points], axis=0) if points else np.ones(2)
    margin = 0.02 * np.maximum(high - low, 1e-3).max()
    low, high = (low - margin, high + margin) if shown.fence is None else window(points)
    size = high - low
    height = float(np.clip(9.5 * size[1] / size[0] + 0.9, 3.0, 9.5))
    with drawing(9.5, height) as (axes, render):
        axes.grid(visible=False)
        axes.add_collection(
            PolyCollection(
                shown.footprints,
                facecolors=(0.36, 0.41, 0.47, 0.22),
                edgecolors=(0.27, 0.32, 0.38, 0.45),
                linewidths=0.5,
                rasterized=len(shown.footprints) > _VECTOR_FOOTPRINTS,
            )
        )
        few = len(shown.paths) <= _FEW_PATHS
        size_of_end = 22 if few else 11
        for outcome in (*OUTCOMES, NOT_JUDGED, "planned"):
            paths = [p.position_world for p in shown.paths if p.outcome == outcome and len(p.position_world)]
            if not paths:
                continue
            axes.add_collection(
                LineCollection(
                    [p[:, :2] for p in paths],
                    colors=COLORS[outcome],
                    linewidths=(1.4 if few else 0.9) * (1.6 if outcome in ("collision", "planned") else 1),
                    linestyles=DASHES[outcome],
                    label=f"{outcome} ({len(paths)})",
                    zorder=3,
                )
            )
            ends = np.array([(p[0, :2], p[-1, :2]) for p in paths])
            axes.scatter(
                *ends[:, 0].T, s=size_of_end, facecolors="white", edgecolors=COLORS[outcome], zorder=4
            )
            axes.scatter(
                *ends[:, 1].T, s=size_of_end, color=COLORS[outcome], marker="X", linewidths=0, zorder=4
            )
        if shown.fence is not None:
            outline(axes, shown.fence)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        if shown.paths:
            axes.legend(loc="upper left", bbox_to_anchor=(0, -0.08), ncols=5, fontsize="small")
        svg = render()
    counts = ", ".join(
        f"{sum(p.outcome == o for p in shown.paths)} {o}"
        for o in (*OUTCOMES, NOT_JUDGED, "planned")
        if any(p.outcome == o for p in shown.paths)
    )
    where = ""
    if shown.hulls:
        where = f" over the footprints of {len(shown.footprints)} of {shown.hulls} hulls"
        if shown.band_m is not None:
            where += (
                f", those between the flown heights {text(shown.band_m[0])} m and {text(shown.band_m[1])} m"
            )
    if shown.fence is not None:
        where += "; dark lines are the outline of the fence"
    alt = (
        f"Map from above of {shown.label}: paths {counts or 'none'}{where}. Circles are starts, crosses ends."
    )
    return Figure(name, f"From above: {shown.label}", alt, svg, wide=True)


def _steps(axes: Any, shown: Sequence[curves.Distribution]) -> None:
    for number, one in enumerate(shown):
        color = run_color(number)
        axes.step(one.value, one.fraction, where="post", color=color, linewidth=2, label=one.label)
        if len(one.value) <= _DOTTED:
            axes.plot(one.value, one.fraction, ".", color=color, markersize=5)
    axes.set(ylim=(0, 1.03), ylabel="fraction of trials")
    if len(shown) > 1:
        axes.legend(fontsize="small")


def _spread(shown: Sequence[curves.Distribution], unit: str) -> str:
    return "; ".join(
        f"{one.label}: minimum {text(float(one.value[0]))}{unit}, "
        f"median {text(float(np.median(one.value)))}{unit}, maximum {text(float(one.value[-1]))}{unit}"
        for one in shown
    )


def _clearance_figure(shown: Sequence[curves.Distribution], is_to_fence: bool) -> Figure:
    what, below = ("distance to the fence", "outside") if is_to_fence else ("clearance", "a collision")
    with drawing(6.2, 3.6) as (axes, render):
        axes.axvline(0, color=COLORS["collision"], linewidth=1.2)
        minimum = min(float(one.value[0]) for one in shown)
        if minimum < 0:
            axes.axvspan(minimum, 0, color=COLORS["collision"], alpha=0.08, linewidth=0)
        _steps(axes, shown)
        axes.set(xlabel=f"minimum {what} of a trial [m]")
        svg = render()
    spread = _spread(shown, " m")
    alt = f"Cumulative distribution of the minimum {what} of the trials. {spread}. Below 0 is {below}."
    return Figure("clearance", f"Minimum {what} of each trial", alt, svg)


def _ratio_figure(shown: Sequence[curves.Distribution]) -> Figure:
    with drawing(6.2, 3.6) as (axes, render):
        _steps(axes, shown)
        axes.set(xlabel="path flown / straight line")
        svg = render()
    alt = (
        "Cumulative distribution of path length over straight-line length, successful trials. "
        f"{_spread(shown, '')}."
    )
    return Figure("path-ratio", "Path length over straight line", alt, svg)


def _compression_figure(curve: curves.Compression) -> Figure:
    shown = ((curve.growth, "sum of hulls / voxels"), (curve.planes, "half-planes"))
    with drawing(6.2, 4.6, rows=2) as (axes, render):
        for place, (values, label) in enumerate(shown):
            axes[place].plot(curve.hulls, values, ".-", color=RUN_COLORS[place], linewidth=1.6)
            axes[place].set(xscale="log", ylabel=label)
        axes[1].set(xlabel="hulls")
        ticks = [c * 10**p for p in range(8) for c in (1, 2, 5)]
        ticks = [t for t in ticks if curve.hulls.min() <= t <= curve.hulls.max()]
        axes[1].set_xticks(ticks, [text(t) for t in ticks])
        axes[1].minorticks_off()
        svg = render()
    ends = ", ".join(
        f"{label} from {text(float(values[0]))} to {text(float(values[-1]))}" for values, label in shown
    )
    alt = (
        f"From {text(int(curve.hulls[0]))} to {text(int(curve.hulls[-1]))} hulls while merging: {ends}. "
        "Volumes are summed over hulls, before they were tightened."
    )
    return Figure("compression", "Volume and half-planes by number of hulls", alt, svg)


def fence_figures(material: Material) -> list[Figure]:
    """Draw a view from the side for each run in a fence."""
    fenced = [run for run in material.runs if is_fenced(run) and run.flights][:_MAX_FENCED_RUNS]
    return [_side_figure(run, f"side-{number}") for number, run in enumerate(fenced, 1)]


def _side_figure(run: Run, name: str) -> Figure:
    """Plot height over the horizontal axis with the longer extent of the paths."""
    paths = paths_of(run)
    points = np.concatenate([path.position_world for path in paths])
    across = int(np.argmax(np.ptp(points[:, :2], axis=0)))
    axes_shown = (across, 2)
    low, high = window([path.position_world[:, axes_shown] for path in paths])
    shape = fence_shape(run)
    width, tall = high - low
    with drawing(9.5, float(np.clip(9.5 * tall / width + 0.9, 2.6, 7.0))) as (axes, render):
        if shape is not None:
            outline(axes, shape.corners_world[:, axes_shown])
        for result in OUTCOMES:
            for path in (p for p in paths if p.outcome == result):
                line = path.position_world[:, axes_shown]
                axes.plot(*line.T, color=COLORS[result], linewidth=1.2, zorder=3)
                axes.plot(
                    *line[0], "o", color=COLORS[result], markersize=5, markerfacecolor="white", zorder=4
                )
                axes.plot(*line[-1], "X", color=COLORS[result], markersize=5, zorder=4)
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
        axes.set(xlabel=f"{'xy'[across]} [m]", ylabel="z [m]")
        svg = render()
    alt = (
        f"The {len(paths)} logged flights of {run.label} from the side, heights from "
        f"{text(float(points[:, 2].min()))} m to {text(float(points[:, 2].max()))} m"
        f"{'; dark lines are the outline of the fence' if shape is not None else ''}. Circles are starts, "
        "crosses ends."
    )
    return Figure(name, f"From the side: {run.label}", alt, svg, wide=True)
