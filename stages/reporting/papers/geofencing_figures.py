"""Figures of the geofencing paper, drawn from pendulums and from runs of flights in a fence."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from alula.stages.reporting.figures import Figure, drawing
from alula.stages.reporting.papers.geofencing import (
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
from alula.stages.reporting.papers.pendulum import GAIN, REGULATION, Pendulum, Swing
from alula.stages.reporting.papers.pendulum import PROGRAM as PROGRAM_RULE
from alula.stages.reporting.table import text

OURS, OTHER, GOOD, BAD, SOFT = "#0072b2", "#e69f00", "#009e73", "#d7301f", "#8a9099"
_COLORS = (OURS, OTHER, GOOD, "#cc79a7", "#56b4e9", "#d55e00", "#222222", "#8c6bb1", SOFT)
_RULES = {REGULATION: OURS, PROGRAM_RULE: OTHER}
_LEAST_CHATTER = 1e-6  # of the axis
_SHOWN_S = 4.0  # of the pendulum


def pendulum_figure(
    swings: Sequence[Swing], gentle: dict[str, float], high: dict[str, float]
) -> Figure | None:
    """Figure 4: angle, rate and input of both rules at a gentle and a high gain; None without them."""
    shown = [
        (s, style, gains)
        for gains, style in ((gentle, ":"), (high, "-"))
        for s in swings
        if gains.get(s.rule) == s.gain and s.tick_s == max(x.tick_s for x in swings)
    ]
    if not shown:
        return None
    said = []
    with drawing(9.4, 6.4, rows=3) as (axes, render):
        for s, style, _ in shown:
            label = f"{s.rule}, {GAIN[s.rule]} {s.gain:g}"
            front = s.rule == REGULATION  # what chatters would cover it
            line = {"color": _RULES[s.rule], "linestyle": style, "zorder": 3 if front else 2}
            part = s.time_s <= _SHOWN_S
            axes[0].plot(s.time_s[part], s.angle[part], label=label, linewidth=1.6, **line)
            axes[1].plot(s.time_s[part], s.rate[part], linewidth=1.6, **line)
            axes[2].plot(s.time_s[part], s.input[part], linewidth=1.6 if front else 0.7, **line)
            said.append(f"{label}: chatter {text(s.chatter)} per second")
        axes[0].axhline(Pendulum().largest_angle, color=BAD, linewidth=1)
        axes[0].set(ylabel="θ [rad]")
        axes[0].legend(fontsize=9, loc="lower right")
        axes[1].set(ylabel="θ' [rad/s]")
        axes[2].set(ylabel="u [rad/s²]", xlabel="time [s]")
        svg = render()
    alt = (
        "Angle, rate and filtered input of the pendulum that is pushed against its largest angle, with a "
        f"gentle gain (dotted) and a high one. {'; '.join(said)}."
    )
    return Figure("pendulum", "Figure 4: the pendulum at its largest angle", alt, svg, wide=True)


def chatter_figure(swings: Sequence[Swing]) -> Figure | None:
    """How much the input chatters at the boundary over how soon a rule gets there; None without arrivals."""
    ticks = sorted({s.tick_s for s in swings})
    said = []
    with drawing(7.4, 4.6) as (axes, render):
        for rule, color in _RULES.items():
            for tick, style in zip(ticks, ("-", "--", ":"), strict=False):
                here = [s for s in swings if s.rule == rule and s.tick_s == tick and s.arrival_s is not None]
                here.sort(key=lambda s: s.gain)
                if not here:
                    continue
                axes.plot(
                    [s.arrival_s for s in here],
                    [max(_LEAST_CHATTER, s.chatter) for s in here],
                    style + "o",
                    color=color,
                    label=f"{rule}, tick {1e3 * tick:g} ms",
                    markersize=4,
                )
                if tick == ticks[0]:
                    for s in (here[0], *here[1::2]):  # of all, some would lie on others
                        at = (s.arrival_s or 0.0, max(_LEAST_CHATTER, s.chatter))
                        words = {"fontsize": 8, "xytext": (5, 3), "textcoords": "offset points"}
                        axes.annotate(f"{s.gain:g}", at, **words)
                said.append(
                    f"{rule} at {1e3 * tick:g} ms from {text(here[0].chatter)} to {text(here[-1].chatter)}"
                )
        if not said:
            return None
        axes.set(xscale="log", yscale="log", xlabel="time to 95 % of the largest angle [s]")
        axes.set_xticks([1.25, 1.5, 2, 3, 5, 8], ["1.25", "1.5", "2", "3", "5", "8"])
        axes.minorticks_off()
        axes.set(ylabel="chatter: total variation of u per second")
        axes.legend(fontsize=9, loc="center right")
        svg = render()
    alt = (
        "Total variation of the input per second while the pendulum stands at its boundary, over the time it "
        f"took to get there, one point for each gain (numbers: beta, alpha): {'; '.join(said)}."
    )
    return Figure(
        "chatter", "Oscillation at the boundary over the speed of the approach", alt, svg, wide=True
    )


def approach_figure(
    runs: Sequence[Fenced], scenario: str, variants: Sequence[str], title: str, seconds: float
) -> Figure | None:
    """Figures 5 and 7: distance, speed, tilt or throttle, the pilot's share over time; None without runs."""
    shown = [run for run in select(runs, scenario, variants) if run.ticks is not None]
    if not shown:
        return None
    falls = scenario == "fall"
    said = []
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
                axes[3].plot(t.time_s[part], t.share[part], **line)
            a = approach(t)
            said.append(
                f"{run.variant}: {text(a.peak_km_h)} km/h, least distance {text(a.least_m)} m, least λ "
                f"{text(a.least_share) if run.record.filter == BASE else '–'}"
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
        f"Distance to the barrier, speed, {third_name} and the pilot's share λ over time. {'; '.join(said)}."
    )
    return Figure(scenario, title, alt, svg, wide=True)


def engaged_figure(run: Fenced | None) -> Figure | None:
    """Figure 8: distance and the pilot's share through repeated engagements; None without a run."""
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
        axes[2].plot(t.time_s, t.share, color=OURS, linewidth=1.2)
        axes[2].set(ylabel="λ", xlabel="time [s]", ylim=(-0.03, 1.05))
        svg = render()
    alt = (
        f"One flight that engages its fence {a.engagements} times: distance to the nearest face, at least "
        f"{text(a.least_m)} m, position, and the pilot's share λ, at least {text(a.least_share)} and 0 for "
        f"{text(1e3 * a.helpless_s)} ms in all."
    )
    return Figure("engaged", "Figure 8: walls and floor, again and again", alt, svg, wide=True)


def robustness_figure(runs: Sequence[Fenced]) -> Figure | None:
    """The share of flights that left over the reserve, by disturbance; None without runs."""
    groups = disturbed(runs)
    if not groups:
        return None
    said = []
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
            said.append(f"{group.name} {text(rates[0].value)} % without, enough: {enough}")
        bottom.axhline(0, color=BAD, linewidth=1)
        top.set(ylabel="left the fence [%]")
        top.legend(fontsize=9, ncols=2)
        bottom.set(xlabel="reserve [m]", ylabel="least distance [m]")
        svg = render()
    alt = (
        "Share of flights that left the fence, with 95 % intervals, and the least distance of all, over the "
        f"reserve of the filter. {'; '.join(said)}."
    )
    return Figure("robustness", "What the reserve makes up for", alt, svg, wide=True)


def distances_figure(runs: Sequence[Fenced]) -> Figure | None:
    """The least distance of every flight, filter by filter, of all pilots or of the compared ones."""
    folder = PILOTS if select(runs, PILOTS) else "filters"
    said = []
    with drawing(7.4, 4.4) as (axes, render):
        for name, color in ((BASE, OURS), (PROGRAM, OTHER), (FREE, BAD)):
            least = sorted(
                t.map_clearance_m if t.map_clearance_m is not None else math.inf
                for run in select(runs, folder)
                if run.record.filter == name
                for t in run.record.trials
            )
            if not least:
                continue
            axes.step(least, np.arange(1, len(least) + 1) / len(least), where="post", color=color, label=name)
            median = least[len(least) // 2]
            said.append(f"{name}: {len(least):,} flights, least {text(least[0])} m, median {text(median)} m")
        if not said:
            return None
        axes.axvline(0, color=SOFT, linewidth=1)
        axes.set_xscale("symlog", linthresh=0.01)
        axes.set(xlabel="least distance of a flight [m]", ylabel="share of flights")
        axes.legend(fontsize=9)
        svg = render()
    alt = f"Share of flights whose least distance to the fence is at most a value. {'; '.join(said)}."
    return Figure("distances", "Least distance of each flight", alt, svg, wide=True)


def engaged_run(runs: Sequence[Fenced]) -> Fenced | None:
    """The one that is drawn."""
    return find(runs, "engaged", BASE)
