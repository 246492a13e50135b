"""Figures of the geofencing paper, drawn from pendulum flights and from runs of flights in a fence."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from alula.stages.reporting.fenced import fence_distance
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
from alula.stages.reporting.table import text
from papers.geofencing.pendulum import GAIN, REGULATION, Pendulum, Swing
from papers.geofencing.pendulum import PROGRAM as PROGRAM_RULE
from papers.geofencing.tables import (
    BASE,
    FREE,
    KM_H,
    PILOTS,
    PROGRAM,
    Fenced,
    approach,
    disturbed,
    find,
    select,
)

OURS, OTHER, GOOD, BAD, SOFT = BLUE, ORANGE, GREEN, VERMILLION, AXIS
_COLORS = (OURS, OTHER, GOOD, PURPLE, SKY, VERMILLION, BLACK, GREY, SOFT)
_RULES = {REGULATION: OURS, PROGRAM_RULE: OTHER}
_LOWEST_CHATTER = 1e-6  # start of the axis
_SHOWN_S = 4.0  # of a pendulum flight


def pendulum_figure(
    swings: Sequence[Swing], gentle: dict[str, float], high: dict[str, float]
) -> Figure | None:
    """Plot Figure 4: angle, rate and input of both rules at a gentle and a high gain; None without them.

    Args:
        swings: pendulum flights.
        gentle: by rule, the gain that is dotted.
        high: by rule, the other gain.
    """
    shown = [
        (s, style, gains)
        for gains, style in ((gentle, ":"), (high, "-"))
        for s in swings
        if gains.get(s.rule) == s.gain and s.tick_s == max(x.tick_s for x in swings)
    ]
    if not shown:
        return None
    values = []
    with drawing(9.4, 6.4, rows=3) as (axes, render):
        for s, style, _ in shown:
            label = f"{s.rule}, {GAIN[s.rule]} {s.gain:g}"
            front = s.rule == REGULATION  # the chattering curve would cover it
            line = {"color": _RULES[s.rule], "linestyle": style, "zorder": 3 if front else 2}
            part = s.time_s <= _SHOWN_S
            axes[0].plot(s.time_s[part], s.angle[part], label=label, linewidth=1.6, **line)
            axes[1].plot(s.time_s[part], s.rate[part], linewidth=1.6, **line)
            axes[2].plot(s.time_s[part], s.input[part], linewidth=1.6 if front else 0.7, **line)
            values.append(f"{label}: chatter {text(s.chatter)} per second")
        axes[0].axhline(Pendulum().largest_angle, color=BAD, linewidth=1)
        axes[0].set(ylabel="θ [rad]")
        axes[0].legend(fontsize=9, loc="lower right")
        axes[1].set(ylabel="θ' [rad/s]")
        axes[2].set(ylabel="u [rad/s²]", xlabel="time [s]")
        svg = render()
    alt = (
        "Angle, rate and filtered input of the pendulum that is pushed against its largest angle, with a "
        f"gentle gain (dotted) and a high one. {'; '.join(values)}."
    )
    return Figure("pendulum", "Figure 4: the pendulum at its largest angle", alt, svg, wide=True)


def chatter_figure(swings: Sequence[Swing]) -> Figure | None:
    """Plot the chatter of the input at the boundary over the arrival time there; None without arrivals."""
    ticks = sorted({s.tick_s for s in swings})
    values = []
    with drawing(7.4, 4.6) as (axes, render):
        for rule, color in _RULES.items():
            for tick, style in zip(ticks, ("-", "--", ":"), strict=False):
                here = [s for s in swings if s.rule == rule and s.tick_s == tick and s.arrival_s is not None]
                here.sort(key=lambda s: s.gain)
                if not here:
                    continue
                axes.plot(
                    [s.arrival_s for s in here],
                    [max(_LOWEST_CHATTER, s.chatter) for s in here],
                    style + "o",
                    color=color,
                    label=f"{rule}, tick {1e3 * tick:g} ms",
                    markersize=4,
                )
                if tick == ticks[0]:
                    for s in (here[0], *here[1::2]):  # labels of all would overlap
                        at = (s.arrival_s or 0.0, max(_LOWEST_CHATTER, s.chatter))
                        words = {"fontsize": 8, "xytext": (5, 3), "textcoords": "offset points"}
                        axes.annotate(f"{s.gain:g}", at, **words)
                values.append(
                    f"{rule} at {1e3 * tick:g} ms from {text(here[0].chatter)} to {text(here[-1].chatter)}"
                )
        if not values:
            return None
        axes.set(xscale="log", yscale="log", xlabel="time to 95 % of the largest angle [s]")
        axes.set_xticks([1.25, 1.5, 2, 3, 5, 8], ["1.25", "1.5", "2", "3", "5", "8"])
        axes.minorticks_off()
        axes.set(ylabel="chatter: total variation of u per second")
        axes.legend(fontsize=9, loc="center right")
        svg = render()
    alt = (
        "Total variation of the input per second while the pendulum stands at its boundary, over the time to "
        f"get there, one point for each gain (numbers: beta, alpha): {'; '.join(values)}."
    )
    return Figure("chatter", "Chatter at the boundary over the time of arrival", alt, svg, wide=True)


def approach_figure(
    runs: Sequence[Fenced], scenario: str, variants: Sequence[str], title: str, seconds: float
) -> Figure | None:
    """Plot Figures 5 and 7: distance, speed, tilt or throttle and lambda over time; None without runs.

    Args:
        runs: all runs.
        scenario: `wall` or `fall`; a fall shows the throttle instead of the tilt.
        variants: variants to draw.
        title: of the figure.
        seconds: length of the time axis.
    """
    shown = [run for run in select(runs, scenario, variants) if run.ticks is not None]
    if not shown:
        return None
    falls = scenario == "fall"
    values = []
    with drawing(9.4, 8.4, rows=4) as (axes, render):
        for run, color in zip(shown, _COLORS, strict=False):
            t = run.ticks
            assert t is not None  # as selected
            part = t.time_s <= seconds
            line = {"color": color, "linewidth": 1.5, "label": run.variant}
            axes[0].plot(t.time_s[part], t.distance_m[part], **line)
            axes[1].plot(t.time_s[part], KM_H * np.linalg.norm(t.velocity[part], axis=1), **line)
            third = t.throttle[:, 1] if falls else np.degrees(t.tilt_rad)
            axes[2].plot(t.time_s[part], third[part], **line)
            if run.record.filter == BASE:
                axes[3].plot(t.time_s[part], t.regulation[part], **line)
            a = approach(t)
            values.append(
                f"{run.variant}: {text(a.peak_km_h)} km/h, minimum distance {text(a.least_m)} m, minimum λ "
                f"{text(a.min_lambda) if run.record.filter == BASE else '–'}"
            )
        axes[0].axhline(0, color=BAD, linewidth=1)
        low, high = axes[0].get_ylim()
        axes[0].set(ylabel="distance [m]", ylim=(max(low, -0.15 * high), high))
        axes[0].legend(fontsize=9, ncols=2)
        axes[1].set(ylabel="speed [km/h]")
        axes[2].set(ylabel="throttle flown" if falls else "tilt [°]")
        axes[3].set(ylabel="λ", xlabel="time [s]", ylim=(-0.03, 1.05))
        svg = render()
    third_name = "throttle" if falls else "tilt"
    alt = (
        f"Distance to the barrier, speed, {third_name} and regulation function λ over time. "
        f"{'; '.join(values)}."
    )
    return Figure(scenario, title, alt, svg, wide=True)


def engaged_figure(run: Fenced | None) -> Figure | None:
    """Plot Figure 8: distance and lambda through repeated engagements; None without a run."""
    if run is None or run.ticks is None:
        return None
    t, a = run.ticks, approach(run.ticks)
    with drawing(9.4, 6.6, rows=3) as (axes, render):
        axes[0].plot(t.time_s, t.distance_m, color=OURS, linewidth=1.4)
        axes[0].axhline(0, color=BAD, linewidth=1)
        axes[0].set(ylabel="distance to the\nnearest face [m]")
        for i, (name, color) in enumerate(zip("xyz", (OURS, OTHER, GOOD), strict=True)):
            axes[1].plot(t.time_s, t.position[:, i], color=color, linewidth=1.4, label=name)
        axes[1].set(ylabel="position [m]")
        axes[1].legend(fontsize=9, ncols=3)
        axes[2].plot(t.time_s, t.regulation, color=OURS, linewidth=1.2)
        axes[2].set(ylabel="λ", xlabel="time [s]", ylim=(-0.03, 1.05))
        svg = render()
    alt = (
        f"One flight that engages its fence {a.engagements} times: distance to the nearest face, minimum "
        f"{text(a.least_m)} m; position; regulation function λ, minimum {text(a.min_lambda)}, 0 for "
        f"{text(1e3 * a.backup_s)} ms in total."
    )
    return Figure("engaged", "Figure 8: repeated engagement of walls and floor", alt, svg, wide=True)


def robustness_figure(runs: Sequence[Fenced]) -> Figure | None:
    """Plot the percentage of flights that left over the reserve, by disturbance; None without runs."""
    groups = disturbed(runs)
    if not groups:
        return None
    values_in_words = []
    with drawing(9.4, 6.4, rows=2) as ((top, bottom), render):
        for place, (group, color) in enumerate(zip(groups, _COLORS, strict=False)):
            reserve = np.array([run.reserve_m for run in group.runs])
            rates = [run.left for run in group.runs]
            values = np.array([r.value or 0.0 for r in rates])
            spread = [values - [r.low for r in rates], [r.high for r in rates] - values]
            line = {"color": color, "markersize": 4, "linewidth": 1.4}
            apart = reserve + 0.008 * (place - len(groups) / 2)
            top.errorbar(
                apart, values, yerr=spread, fmt="o-", capsize=2, elinewidth=0.8, label=group.name, **line
            )
            bottom.plot(reserve, [run.least_m for run in group.runs], "o-", **line)
            enough = "none of the grid" if group.enough is None else f"{text(group.enough.reserve_m)} m"
            values_in_words.append(f"{group.name} {text(rates[0].value)} % without, sufficient: {enough}")
        bottom.axhline(0, color=BAD, linewidth=1)
        top.set(ylabel="left the fence [%]")
        top.legend(fontsize=9, ncols=2)
        bottom.set(xlabel="reserve [m]", ylabel="minimum distance [m]")
        svg = render()
    alt = (
        "Percentage of flights that left the fence, with 95 % intervals, and the minimum distance of all, "
        f"over the reserve of the filter. {'; '.join(values_in_words)}."
    )
    return Figure("robustness", "Disturbances that the reserve compensates", alt, svg, wide=True)


def distances_figure(runs: Sequence[Fenced]) -> Figure | None:
    """Plot the distribution of the minimum distance by filter, of all pilots or of the compared ones."""
    folder = PILOTS if select(runs, PILOTS) else "filters"
    values = []
    with drawing(7.4, 4.4) as (axes, render):
        for name, color in ((BASE, OURS), (PROGRAM, OTHER), (FREE, BAD)):
            distances = sorted(
                fence_distance(t)
                for run in select(runs, folder)
                if run.record.filter == name
                for t in run.record.trials
            )
            if not distances:
                continue
            axes.step(
                distances,
                np.arange(1, len(distances) + 1) / len(distances),
                where="post",
                color=color,
                label=name,
            )
            median = distances[len(distances) // 2]
            values.append(
                f"{name}: {len(distances):,} flights, minimum {text(distances[0])} m, median {text(median)} m"
            )
        if not values:
            return None
        axes.axvline(0, color=SOFT, linewidth=1)
        axes.set_xscale("symlog", linthresh=0.01)
        axes.set(xlabel="minimum distance of a flight [m]", ylabel="fraction of flights")
        axes.legend(fontsize=9)
        svg = render()
    alt = f"Cumulative distribution of the minimum distance to the fence of a flight. {'; '.join(values)}."
    return Figure("distances", "Minimum distance of each flight", alt, svg, wide=True)


def engaged_run(runs: Sequence[Fenced]) -> Fenced | None:
    """The run that `engaged_figure` draws."""
    return find(runs, "engaged", BASE)
