"""Figures 2 and 3 of FastBridge, drawn from sweeps of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from alula.schemas.log.run import TrialResult
from alula.stages.reporting.figures import Figure, drawing
from alula.stages.reporting.palette import (
    AXIS,
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
)
from alula.stages.reporting.statistics import mean_estimate
from alula.stages.reporting.table import text
from papers.fastbridge.sweeps import Sweep, find, realisation_error, speeds_of, succeeded
from papers.fastbridge.tables import (
    BASELINE,
    OURS,
)

COLORS = {
    "ideal-di": GREY,
    "cone-di": GREEN,
    "cone-ecbf": BLUE,
    "safer-splat": VERMILLION,
    "safer-splat-gated": ORANGE,
    "cone-backup": PURPLE,
    "safer-splat-tuned": BLACK,
    "safer-splat-gated-tuned": GREY,
    "cone-ecbf-tuned": SKY,
}
GAP = ("ideal-di", "cone-di", "cone-ecbf", "cone-backup")
DRAWN = (
    *("safer-splat", "safer-splat-tuned", "safer-splat-gated", "safer-splat-gated-tuned"),
    *("cone-ecbf", "cone-ecbf-tuned", "cone-backup"),
)
PATHS = (BASELINE, "safer-splat-gated-tuned", OURS)
_BY_SPEED = (SKY, BLUE, GREEN, ORANGE, VERMILLION)  # from slow to fast
_SPEEDS = "peak speed of the reference [m/s]"


def gap_figure(sweeps: Sequence[Sweep], scene: str) -> Figure:
    """Plot Figure 2: peak realisation error and minimum gamma over the reference speed."""
    from matplotlib.ticker import MaxNLocator

    values = []
    with drawing(7.4, 5.6, rows=2) as ((top, bottom), render):
        for variant in GAP:
            runs = _by_speed(sweeps, scene, variant)
            if not runs:
                continue
            color = COLORS[variant]
            values.append(f"{variant}: {_line(top, runs, realisation_error, color, variant)}")
            speeds = [run.speed_m_s for run in runs]
            gamma = [np.sort(run.values(lambda t: t.min_gamma)) for run in runs]
            bottom.plot(speeds, [np.median(g) for g in gamma], ".-", color=color, linewidth=1.6)
            bottom.plot(speeds, [g[0] for g in gamma], ".:", color=color, linewidth=1.2)
        bottom.axhline(0, color=VERMILLION, linewidth=1)
        bottom.set_yscale("symlog", linthresh=0.1)
        top.set(ylabel="peak |e_a| [m/s²]")
        top.legend(fontsize=10)
        bottom.set(ylabel="minimum γ (median, of all)", xlabel=_SPEEDS)
        bottom.xaxis.set_major_locator(MaxNLocator(8))
        svg = render()
    alt = (
        f"Peak realisation error by reference speed in {scene}, mean of the trials with its 95 % interval: "
        f"{'; '.join(values)}. Below, the minimum γ of each trial: median, and dotted the minimum of all."
    )
    return Figure(f"figure-2-{scene}", f"Figure 2: the realisation gap, {scene}", alt, svg, wide=True)


def comparison_figure(sweeps: Sequence[Sweep], scene: str) -> Figure:
    """Plot Figure 3, right: jerk, time and speed over the reference speed."""
    values = []
    with drawing(7.4, 8.4, rows=4) as (axes, render):
        for variant in DRAWN:
            runs = _by_speed(sweeps, scene, variant)
            if not runs:
                continue
            color = COLORS[variant]
            jerk = _line(axes[0], runs, lambda t: t.mean_jerk_m_s3, color, variant)
            timed = [(r.speed_m_s, r.timing("filter_total_s"), r.timing("filter_calls")) for r in runs]
            micro = [(v, 1e6 * s / n) for v, s, n in timed if s is not None and n]
            axes[1].plot(*np.array(micro).T if micro else ([], []), ".-", color=color, linewidth=1.6)
            reached = _line(axes[2], runs, lambda t: t.max_speed_m_s, color, variant)
            _line(axes[3], runs, lambda t: float(succeeded(t)), color, variant, (0.0, 1.0))
            values.append(f"{variant}: mean jerk {jerk}; top speed {reached}")
        speeds = speeds_of(sweeps, scene, (BASELINE, OURS))
        axes[2].plot(speeds, speeds, color=AXIS, linewidth=1)
        axes[1].set_yscale("log")
        axes[0].set(ylabel="mean jerk [m/s³]")
        axes[0].legend(fontsize=10)
        axes[1].set(ylabel="filter [µs]")
        axes[2].set(ylabel="top speed [m/s]")
        axes[3].set(ylabel="goal rate", xlabel=_SPEEDS, ylim=(-0.03, 1.03))
        svg = render()
    alt = (
        f"By reference speed in {scene}, means over the trials with 95 % intervals: mean jerk, time of a "
        f"filter call, top speed (the reference's as a line), goal rate. {'; '.join(values)}."
    )
    return Figure(f"figure-3-{scene}", f"Figure 3: jerk, time, speed, {scene}", alt, svg, wide=True)


def paths_figure(sweeps: Sequence[Sweep], scene: str, trial: int) -> Figure | None:
    """Plot Figure 3, left: paths of one pair from above, one line per reference speed; None without logs.

    Args:
        sweeps: all runs.
        scene: name of the scene.
        trial: index of the pair.
    """
    shown = tuple(v for v in PATHS if v == OURS or _by_speed(sweeps, scene, v))
    speeds = speeds_of(sweeps, scene, shown)
    drawn = 0
    with drawing(4.0 * len(shown), 4.6, columns=len(shown)) as (axes, render):
        for place, variant in zip(np.atleast_1d(axes), shown, strict=True):
            for number, speed in enumerate(speeds):
                sweep = find(sweeps, scene, variant, speed)
                flight = sweep.run.flights.get(trial) if sweep is not None else None
                if flight is None:
                    continue
                color = _BY_SPEED[number % len(_BY_SPEED)]
                place.plot(
                    *flight.position_world[:, :2].T, color=color, linewidth=1.4, label=f"{speed:g} m/s"
                )
                place.plot(*flight.position_world[-1, :2], "x", color=color, markersize=6)
                drawn += 1
            place.set(title=variant, xlabel="x [m]", aspect="equal")
        first = np.atleast_1d(axes)[0]
        first.set(ylabel="y [m]")
        if not drawn:
            return None
        first.legend(fontsize=9)
        svg = render()
    alt = f"Paths of trial {trial} in {scene} from above at {text(speeds)} m/s: {', '.join(shown)}."
    return Figure(f"figure-3-paths-{scene}", f"Figure 3: paths of one pair, {scene}", alt, svg, wide=True)


def telling_trial(sweeps: Sequence[Sweep], scene: str) -> int:
    """Choose the trial to draw: the longest detour among those in which `OURS` always succeeds."""
    runs = _by_speed(sweeps, scene, OURS)
    count = min(len(run.run.record.trials) for run in runs)
    best, bend = 0, 0.0
    for i in range(count):
        trials = [run.run.record.trials[i] for run in runs]
        if all(succeeded(t) for t in trials):
            ratio = float(np.mean([t.path_length_m / t.straight_length_m for t in trials]))
            if ratio > bend:
                best, bend = i, ratio
    return best


def _by_speed(sweeps: Sequence[Sweep], scene: str, variant: str) -> list[Sweep]:
    found = [s for s in sweeps if s.scene == scene and s.variant == variant]
    return sorted(found, key=lambda s: s.speed_m_s)


def _line(
    axes: Any,
    runs: Sequence[Sweep],
    get: Callable[[TrialResult], float | None],
    color: str,
    label: str,
    bounds: tuple[float, float] | None = None,
) -> str:
    """Plot mean and interval by speed; return the first and last value in words."""
    points = []
    for run in runs:
        values = run.values(get)
        found = mean_estimate(values[np.isfinite(values)], bounds=bounds)
        if found is not None:
            points.append((run.speed_m_s, found.value, found.low, found.high))
    if not points:
        return "nothing"
    speed, value, low, high = np.array(points, np.float64).T  # None becomes NaN, which is not drawn
    axes.fill_between(speed, low, high, color=color, alpha=0.18, linewidth=0)
    axes.plot(speed, value, ".-", color=color, linewidth=1.6, label=label)
    ends = [f"{text(float(value[i]))} at {text(float(speed[i]))} m/s" for i in (0, -1)]
    return f"from {ends[0]} to {ends[1]}" if len(points) > 1 else ends[0]
