"""Figures of flights in a geofence: from the side, and what happened in the one that came closest."""

from __future__ import annotations

from typing import Any

import numpy as np

from alula.stages.reporting.curves import paths_of
from alula.stages.reporting.fenced import ClosestFlight, closest_flights, fence_shape, is_fenced
from alula.stages.reporting.figures import COLORS, Figure, drawing, outline, window
from alula.stages.reporting.material import OUTCOMES, Material, Run
from alula.stages.reporting.tables import text

_MOST_RUNS = 4
_SHADES = {"backup": "#e69f00", "no-pilot": "#8c6bb1", "hand-over": "#d7301f", "refused": "#7f7f7f"}
_WORDS = {"backup": "backup alone", "no-pilot": "no pilot", "hand-over": "handed over", "refused": "refused"}


def fence_figures(material: Material) -> list[Figure]:
    """For each run in a fence a view from the side and its closest flight."""
    found = []
    fenced = [run for run in material.runs if is_fenced(run) and run.flights][:_MOST_RUNS]
    for number, (run, closest) in enumerate(zip(fenced, closest_flights(fenced), strict=True), 1):
        found += [_side_figure(run, f"side-{number}"), _closest_figure(closest, f"fence-{number}")]
    return found


def _side_figure(run: Run, name: str) -> Figure:
    """The horizontal axis along which more was flown, and the height."""
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


def _closest_figure(closest: ClosestFlight, name: str) -> Figure:
    with drawing(9.5, 6.0, rows=3) as ((top, middle, bottom), render):
        top.axhline(0, color=COLORS["collision"], linewidth=1.2)
        top.plot(closest.time_s, closest.distance_m, color="#0072b2", linewidth=1.6)
        top.set(ylabel="distance to\nthe fence [m]")
        middle.plot(closest.time_s, closest.share, color="#222222", linewidth=1.4)
        middle.set(ylabel="λ, the\npilot's share", ylim=(-0.04, 1.04))
        bottom.plot(closest.speed_time_s, 3.6 * closest.speed_m_s, color="#009e73", linewidth=1.6)
        bottom.set(xlabel="time [s]", ylabel="speed [km/h]", ylim=(0, None))
        shaded = _shade((top, middle, bottom), closest)
        if shaded:
            top.legend(fontsize=10, ncols=len(shaded), loc="upper right")
        svg = render()
    least = closest.trial.map_clearance_m
    spent = ", ".join(
        f"{_WORDS.get(word, word)} in {100 * closest.status.count(word) / len(closest.status):.0f} %"
        for word in dict.fromkeys(closest.status)
    )
    alt = (
        f"True distance to the fence, the pilot's share of the command and the speed over time of trial "
        f"{closest.trial.index} of {closest.label}, whose least distance was {text(least)} m and top speed "
        f"{text(3.6 * closest.trial.max_speed_m_s)} km/h. Of the logged ticks: {spent}."
    )
    return Figure(
        name, f"The closest flight: {closest.label}, trial {closest.trial.index}", alt, svg, wide=True
    )


def _shade(axes: tuple[Any, ...], closest: ClosestFlight) -> list[str]:
    """Colour the times in which the filter was in another mode than passing or blending; which ones."""
    status = np.array(closest.status)
    edges = np.append(closest.time_s, closest.time_s[-1:])
    begins = np.flatnonzero(np.append(True, status[1:] != status[:-1])) if len(status) else np.empty(0, int)
    ends = np.append(begins[1:], len(status))
    named: list[str] = []
    for begin, end in zip(begins, ends, strict=True):
        word = str(status[begin])
        if word not in _SHADES:
            continue
        for at, one in enumerate(axes):
            label = _WORDS[word] if at == 0 and word not in named else None
            one.axvspan(edges[begin], edges[end], color=_SHADES[word], alpha=0.25, linewidth=0, label=label)
        if word not in named:
            named.append(word)
    return named
