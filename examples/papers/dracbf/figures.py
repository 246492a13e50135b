"""Figures of DR-ACBF: success by filter, feasible closing speeds, calibration of its risk, the triggers."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from alula import _core
from alula.stages.reporting.figures import Figure, drawing
from alula.stages.reporting.palette import AXIS, BLACK, BLUE, GREEN, ORANGE, VERMILLION
from alula.stages.reporting.statistics import Rate
from alula.stages.reporting.table import text
from papers.dracbf.analysis import collapse_cells, risk_bins, stop
from papers.dracbf.difficulty import AXES, COMPARED, PUBLISHED, levels
from papers.dracbf.tables import BASE, METHODS, Flown, find, select, success

OURS, OTHER, BAD, SOFT = BLUE, ORANGE, VERMILLION, AXIS
_LOWEST_RISK = 1e-4  # start of the axis


def success_figure(flown: Sequence[Flown], scenario: str) -> Figure | None:
    """Plot the failures of each filter by obstacle, with intervals; None without runs."""
    runs = [f for f in select(flown, scenario, METHODS) if f.variant != "none"]
    if not runs:
        return None
    with drawing(7.4, 3.8) as (axes, render):
        for i, color in enumerate((OURS, OTHER)[: runs[0].obstacles]):
            rates = [success(f, i) for f in runs]
            at = np.arange(len(runs)) + 0.2 * (i - 0.5)
            axes.errorbar(
                at,
                [100 - (r.value or 0.0) for r in rates],
                yerr=_bars(
                    [Rate(100 - (r.value or 0.0), 100 - r.ends[1], 100 - r.ends[0], r.n) for r in rates]
                ),
                fmt="o",
                color=color,
                capsize=3,
                label=f"obstacle {i + 1}",
            )
        axes.set_xticks(np.arange(len(runs)), [f.variant for f in runs])
        axes.set(ylabel="trials with a collision [%]")
        axes.set_ylim(0, 1.25 * axes.get_ylim()[1])  # room for the legend
        axes.legend(loc="upper right", ncols=2)
        svg = render()
    rates_in_words = "; ".join(
        f"{f.variant} {', '.join(str(success(f, i)) for i in range(f.obstacles))}" for f in runs
    )
    alt = f"Collisions by filter and obstacle with 95 % intervals. Success: {rates_in_words}."
    return Figure(f"success-{scenario}", f"Collisions by filter, {scenario}", alt, svg, wide=True)


def difficulty_figure(flown: Sequence[Flown], axis: str) -> Figure | None:
    """Plot the success of runs over one kind of difficulty, with intervals; None without runs.

    Args:
        flown: all runs.
        axis: a key of `AXES`.
    """
    at = [level for level in levels(flown) if level.axis == axis]
    if not at:
        return None
    name = AXES[axis][0]
    words = []
    with drawing(5.6, 4.2) as (axes, render):
        axes.axhspan(*PUBLISHED, color=SOFT, alpha=0.3, linewidth=0, label="published, scenario 2")
        for method, color in zip(COMPARED, (OURS, OTHER, GREEN, BAD), strict=True):
            here = [(level.value, success(level.runs[method])) for level in at if method in level.runs]
            rates = [found for _, found in here]
            values = [found.value or 0.0 for found in rates]
            axes.errorbar(
                [x for x, _ in here],
                values,
                yerr=_bars(rates),
                fmt="o-",
                color=color,
                capsize=3,
                label=method,
            )
            words.append(f"{method} " + ", ".join(f"{text(x)}: {found}" for x, found in here))
        if axis in ("noise", "speed", "limit"):
            axes.set(xscale="log")
        axes.set(xlabel=name, ylabel="runs without a collision [%]", ylim=(-3, 103))
        axes.legend(fontsize=9)
        svg = render()
    alt = f"Success of runs over the {name} with 95 % intervals: {'; '.join(words)}."
    return Figure(f"difficulty-{axis}", f"Success over the {name}", alt, svg)


def recursion_figure(a_max: float = 6.0) -> Figure:
    """Plot the closing speed up to which the rows alone suffice over the horizon.

    Args:
        a_max: half-width of the box of accelerations [m/s^2].
    """
    horizons = np.linspace(0.15, 0.8, 60)
    limit = np.array([_core.recursive_speed(a_max, float(h)) for h in horizons])
    with drawing(5.6, 4.2) as (axes, render):
        axes.fill_between(horizons, 0, limit, color=OURS, alpha=0.18, linewidth=0)
        axes.plot(horizons, limit, color=OURS, linewidth=1.8, label="0.645 v₀/H = a_max")
        axes.axhline(5, color=BAD, linewidth=1, label="slowest obstacle of the scenarios")
        axes.set(xlabel="H [s]", ylabel="closing speed v₀ [m/s]", ylim=(0, None))
        axes.legend(fontsize=9)
        svg = render()
    alt = (
        f"The closing speed up to which a row requires at most {a_max:g} m/s² grows with the horizon, from "
        f"{text(float(limit[0]))} m/s at {horizons[0]:g} s to {text(float(limit[-1]))} m/s at "
        f"{horizons[-1]:g} s."
    )
    return Figure("recursion", "Where the rows alone are recursively feasible", alt, svg)


def stop_figure(a_max: float = 6.0, horizon_s: float = 0.4) -> Figure:
    """Plot the range less all clearance while only a row and the box act.

    Args:
        a_max: half-width of the box of accelerations [m/s^2].
        horizon_s: horizon of the row.
    """
    speeds = (2.0, _core.recursive_speed(a_max, horizon_s), 5.0, 8.0)
    values = []
    with drawing(5.6, 4.2) as (axes, render):
        for speed, color in zip(speeds, (OURS, GREEN, OTHER, BAD), strict=True):
            flown = stop(speed, horizon_s, a_max)
            shown = slice(None, None, max(1, len(flown.time_s) // 300))
            label = f"{speed:.3g} m/s: {100 * flown.undershoot_m:.3g} cm"
            scaled = flown.range_m[shown] / (speed * horizon_s)
            axes.plot(flown.time_s[shown] / horizon_s, scaled, color=color, label=label)
            values.append(f"from {speed:.3g} m/s by {flown.undershoot_m:.3g} m")
        t = np.linspace(0, 3 * math.pi / 4, 100)
        axes.plot(t, np.exp(-t) * np.cos(t), ":", color=BLACK, linewidth=1.4, label="exp(-t/H) cos(t/H)")
        axes.axhline(0, color=SOFT, linewidth=1)
        axes.set(xlabel="t / H", ylabel="D / (v₀ H)")
        axes.legend(fontsize=9, title="from v₀, undershoot")
        svg = render()
    alt = (
        f"With only a row of H = {horizon_s:g} s and the box of {a_max:g} m/s² acting along one axis, the "
        f"range less all clearance falls below zero {', '.join(values)}."
    )
    return Figure("undershoot", "Undershoot of a row that is followed exactly", alt, svg)


def risk_figure(flown: Sequence[Flown]) -> Figure | None:
    """Plot the observed collision rate over the estimated risk of a run; None without runs."""
    runs = [f for s in ("scenario-1", "scenario-2") if (f := find(flown, s, BASE)) is not None]
    if not runs:
        return None
    values = []
    with drawing(6.4, 4.6) as (axes, render):
        for f, color in zip(runs, (OURS, OTHER), strict=False):
            bins = risk_bins(f.record.trials)
            estimate = [max(_LOWEST_RISK, b.estimate) for b in bins]
            shown = [max(_LOWEST_RISK, (b.observed.value or 0.0) / 100) for b in bins]
            low = [max(_LOWEST_RISK, b.observed.ends[0] / 100) for b in bins]
            high = [b.observed.ends[1] / 100 for b in bins]
            spread = [np.subtract(shown, low), np.subtract(high, shown)]
            axes.errorbar(estimate, shown, yerr=spread, fmt="o", color=color, capsize=3, label=f.scenario)
            values += [f"{b.estimate:.3g}: {text(b.observed.value)} %" for b in bins]
        line = [_LOWEST_RISK, 1.0]
        axes.plot(line, line, color=SOFT, linewidth=1, label="observed = estimate")
        axes.set(xscale="log", yscale="log", xlabel="mean risk estimate of a run", ylabel="collision rate")
        axes.legend(fontsize=9)
        svg = render()
    alt = (
        "Observed collision rate over the estimated risk of a whole run, with 95 % intervals, in six bins of "
        "equal numbers of trials; above the line the estimate is too small. Estimate: observed, "
        f"{'; '.join(values)}."
    )
    return Figure("risk", "Risk of a whole run: estimate and observed", alt, svg)


def collapse_figure(flown: Sequence[Flown]) -> Figure | None:
    """Plot the success with either trigger in every sensing condition; None without runs."""
    cells = collapse_cells(flown)
    if not cells:
        return None
    at = np.arange(len(cells))
    with drawing(9.6, 4.6) as (axes, render):
        for name, color, rates in (
            ("DR-CVaR", OURS, [c.distributional for c in cells]),
            ("simple", BAD, [c.simple for c in cells]),
        ):
            values = [r.value or 0.0 for r in rates]
            axes.errorbar(at, values, yerr=_bars(rates), fmt="o", color=color, capsize=2, label=name)
        labels = [
            f"{c.delay_s:g} + {c.lag_s:g} s, ×{c.noise_scale:g}, {c.rate_hz:g} Hz, {c.detection:g}"
            for c in cells
        ]
        axes.set_xticks(at, labels, rotation=90, fontsize=8)
        axes.set(ylabel="runs without a collision [%]", ylim=(-3, 103))
        axes.legend()
        svg = render()
    alt = (
        f"Success of runs in {len(cells)} conditions of delays, noise, rate and detection probability, the "
        f"worst for the simple trigger first: {cells[0].simple} against {cells[0].distributional} with "
        "DR-CVaR."
    )
    return Figure("collapse", "Either trigger under worse sensing", alt, svg, wide=True)


def _bars(rates: Sequence[Rate]) -> list[list[float]]:
    """Lengths of error bars."""
    values = [r.value or 0.0 for r in rates]
    return [
        [max(0.0, v - r.ends[0]) for v, r in zip(values, rates, strict=True)],
        [max(0.0, r.ends[1] - v) for v, r in zip(values, rates, strict=True)],
    ]
