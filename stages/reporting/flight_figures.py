"""Figures of single flights: speed, clearance, commands and what each filter did, over one time.

Every row has the same time axis, and a line marks the worst moment in all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from alula.stages.reporting import plain
from alula.stages.reporting.curves import Spell, broken
from alula.stages.reporting.figures import Figure, TimeAxis, drawing
from alula.stages.reporting.flight_curves import Curve, FilterAnswers, FlightCurves, worst_flights
from alula.stages.reporting.material import Material
from alula.stages.reporting.palette import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, SOFT, VERMILLION

NAME = "flight-"
_WIDTH, _ROW, _STRIP, _FOOT = 9.5, 1.5, 0.34, 0.75  # [inch]
_PARTS = {"hulls": BLUE, "splats": ORANGE, "fence": PURPLE, "moving obstacles": GREEN}
_WORDS = {
    "ok": "command unchanged",
    "passed": "command unchanged",
    "filtered": "changed",
    "blended": "blended with the backup",
    "shortened": "step shortened",
    "recovering": "recovering",
    "backup": "backup alone",
    "no-pilot": "no pilot",
    "hand-over": "handed over",
    "refused": "refused",
}
_STATUS = {
    "ok": "#e6e8eb",
    "passed": "#e6e8eb",
    "filtered": SKY,
    "blended": SKY,
    "shortened": BLUE,
    "recovering": ORANGE,
    "backup": ORANGE,
    "no-pilot": PURPLE,
    "hand-over": VERMILLION,
    "refused": VERMILLION,
}
_STATES = {"fly": GREEN, "hold": ORANGE, "hand-over": VERMILLION, "abort": VERMILLION}
_NAMED_FRACTION = 0.08  # of a flight's time; shorter states have no room for their names
_KM_H_FROM = 15.0  # top speed [m/s] from which speeds are in km/h

Row = tuple[float, Callable[[Any], None]]


def flight_figures(material: Material) -> list[Figure]:
    """Draw the closest flight of each run."""
    found = worst_flights(material)
    return [_figure(one, f"{NAME}{number}") for number, one in enumerate(found, 1)]


def _figure(flight: FlightCurves, name: str) -> Figure:
    rows: list[Row] = [(_ROW, lambda axes: _draw_speed(axes, flight))]
    if flight.clearances or flight.margin is not None:
        rows.append((1.25 * _ROW, lambda axes: _draw_clearance(axes, flight)))
    if flight.commands:
        rows.append((_ROW, lambda axes: _draw_commands(axes, flight)))
    if flight.regulation is not None:
        rows.append((0.8 * _ROW, lambda axes: _draw_regulation(axes, flight)))
    strips = len(flight.filters)
    if strips:
        rows.append((_STRIP * (strips + 1.2), lambda axes: _draw_filters(axes, flight.filters)))
    heights = [height for height, _ in rows]
    with drawing(_WIDTH, sum(heights) + _FOOT, rows=len(rows), heights=heights) as (axes, render):
        each = [axes] if len(rows) == 1 else list(axes)
        for one, (_, draw) in zip(each, rows, strict=True):
            draw(one)
            if flight.worst_s is not None:
                one.axvline(flight.worst_s, color=VERMILLION, linewidth=1.2, linestyle=(0, (4, 2)), zorder=6)
        _draw_states(each, flight.spells)
        each[-1].set(xlabel="time [s]")
        if flight.worst_s is not None and not flight.spells:
            where = each[0].get_xaxis_transform()
            words = f"worst moment, {flight.worst_s:.2f} s"
            each[0].text(
                flight.worst_s, 1.03, words, transform=where, ha="center", fontsize="small", color=VERMILLION
            )
        svg = render()
        time = _time_axis(each, flight)
    return Figure(name, _title(flight), _alt(flight), svg, wide=True, time=time)


def _time_axis(axes: Sequence[Any], flight: FlightCurves) -> TimeAxis:
    """Place of the common axis in a figure that was rendered."""
    first, last = axes[0].get_position(), axes[-1].get_position()
    begin, end = axes[0].get_xlim()
    return TimeAxis(
        run=flight.run,
        trial=flight.trial,
        begin=round(float(begin), 6),
        end=round(float(end), 6),
        left=round(float(first.x0), 6),
        right=round(float(first.x1), 6),
        top=round(1 - float(first.y1), 6),
        bottom=round(1 - float(last.y0), 6),
    )


def _title(flight: FlightCurves) -> str:
    if flight.closest_m is None:
        return f"The flight over time: {flight.run}, trial {flight.trial}"
    which = (
        "The closest flight" if flight.logged is None else f"The closest of {flight.logged} logged flights"
    )
    return f"{which}: {flight.run}, trial {flight.trial}"


def _alt(flight: FlightCurves) -> str:
    shown = ["speed"]
    if flight.clearances:
        shown.append(f"clearance to {', '.join(curve.name for curve in flight.clearances)}")
    elif flight.margin is not None:
        shown.append("margin that the filter reported")
    shown += [flight.quantity.split(" [")[0] + " commanded"] if flight.commands else []
    shown += ["regulation function λ"] if flight.regulation is not None else []
    shown += ["status of each filter"] if flight.filters else []
    words = f"{'; '.join(shown)} over time."
    words = words[0].upper() + words[1:]
    if flight.outcome is not None:
        words += f" The flight ended: {flight.outcome}."
    if flight.closest_m is not None:
        words += f" Minimum clearance as judged: {flight.closest_m:.4g} m."
    if flight.worst_s is not None:
        of = "clearance" if flight.clearances else "margin"
        words += f" The dashed line marks the minimum {of}, at {flight.worst_s:.2f} s."
    for filter_ in flight.filters:
        if spent := _spent(filter_):
            words += f" {filter_.name}: {spent}."
    if flight.spells:
        words += f" States of the supervisor: {', '.join(map(str, flight.spells))}."
    return words


def _spent(filter_: FilterAnswers) -> str:
    """Statuses of a filter with their shares of its answers."""
    status = [word.lower() or "ok" for word in filter_.status]
    return ", ".join(
        f"{_WORDS.get(word, word)} in {plain.share(status.count(word), len(status))}"
        for word in dict.fromkeys(status)
    )


def _draw_speed(axes: Any, flight: FlightCurves) -> None:
    fast = float(np.max(flight.speed.value, initial=0.0)) >= _KM_H_FROM
    factor, unit = (3.6, "km/h") if fast else (1.0, "m/s")
    axes.plot(flight.speed.time_s, factor * flight.speed.value, color=BLACK, linewidth=1.5)
    if (limit := flight.speed_limit_m_s) is not None:
        _draw_limit(axes, factor * limit)
    axes.set(ylabel=f"speed [{unit}]", ylim=(0, None))


def _draw_limit(axes: Any, limit: float) -> None:
    axes.axhline(limit, color=GREY, linewidth=1.1, linestyle=":", label="limit")
    axes.legend(fontsize="small", loc="upper right", ncols=3)


def _draw_clearance(axes: Any, flight: FlightCurves) -> None:
    in_metres = flight.margin_unit == "m" or bool(flight.clearances)
    axes.axhline(0, color=VERMILLION, linewidth=1.2)
    lowest = 0.0
    for curve in flight.clearances:
        _draw(axes, curve, _PARTS[curve.name], f"to {curve.name}")
        lowest = min(lowest, float(np.nanmin(curve.value, initial=0.0)))
    if flight.margin is not None:
        dash = {"linestyle": "--"} if flight.clearances else {}
        color = GREY if flight.clearances else BLUE
        _draw(axes, flight.margin, color, flight.margin.name, **dash)
        lowest = min(lowest, float(np.nanmin(flight.margin.value, initial=0.0)))
    if lowest < 0:
        axes.axhspan(lowest, 0, color=VERMILLION, alpha=0.1, linewidth=0)
    unit = "[m]" if in_metres else flight.margin_unit
    axes.set(ylabel=f"clearance {unit}" if flight.clearances else f"margin\n{unit}")
    if flight.clearances:
        top = _top(flight.clearances)
        axes.set_ylim(min(lowest, -0.05 * top), 1.08 * top)
    axes.legend(fontsize="small", loc="upper right", ncols=4)


def _top(clearances: Sequence[Curve]) -> float:
    """Maximum over time of the clearance to the nearest part: nothing farther away is of interest."""
    time_s = clearances[0].time_s
    nearest = np.full(len(time_s), np.inf)
    for curve in clearances:
        known = np.isfinite(curve.value)
        if known.any():
            value = np.interp(time_s, curve.time_s[known], curve.value[known])
            nearest = np.minimum(nearest, value)
    nearest = nearest[np.isfinite(nearest)]
    return max(float(nearest.max(initial=0.0)), 0.05)


def _draw_commands(axes: Any, flight: FlightCurves) -> None:
    for curve, color, width in zip(flight.commands, (ORANGE, BLUE), (2.6, 1.3), strict=True):
        _draw(axes, curve, color, curve.name, linewidth=width)
    if flight.limit is not None:
        axes.axhline(flight.limit, color=GREY, linewidth=1.1, linestyle=":", label="limit")
    name, unit = flight.quantity.split(" [")
    axes.set(ylabel=f"{name}\ncommand [{unit}", ylim=(0, None))
    axes.legend(fontsize="small", loc="upper right", ncols=3)


def _draw_regulation(axes: Any, flight: FlightCurves) -> None:
    assert flight.regulation is not None
    axes.plot(flight.regulation.time_s, flight.regulation.value, color=BLACK, linewidth=1.3)
    axes.set(ylabel="regulation\nfunction λ", ylim=(-0.05, 1.05))


def _draw(axes: Any, curve: Curve, color: str, label: str, **style: Any) -> None:
    style = {"linewidth": 1.5} | style
    axes.plot(*broken(curve.time_s, curve.value), color=color, label=label, **style)


def _draw_filters(axes: Any, filters: Sequence[FilterAnswers]) -> None:
    """Draw a strip for each filter, coloured by its status."""
    from matplotlib.patches import Patch

    named: dict[str, str] = {}
    for row, filter_ in enumerate(filters):
        spans = _spans(filter_)
        colors = [_STATUS.get(span.state, GREY) for span in spans]
        for span, color in zip(spans, colors, strict=True):
            named.setdefault(_WORDS.get(span.state, span.state), color)
        # All at once: each call looks through all earlier spans for the limits of the axes.
        times = [(span.begin_s, span.end_s - span.begin_s) for span in spans]
        axes.broken_barh(times, (row - 0.38, 0.76), facecolors=colors, linewidth=0)
    axes.set(ylim=(len(filters) - 0.4, -0.6), yticks=range(len(filters)))
    axes.set_yticklabels([filter_.name for filter_ in filters], fontsize="small")
    axes.grid(visible=False)
    axes.spines["left"].set_visible(False)
    axes.tick_params(axis="y", length=0)
    patches = [Patch(facecolor=color, label=word) for word, color in named.items()]
    axes.legend(
        handles=patches,
        fontsize="small",
        ncols=6,
        loc="lower left",
        bbox_to_anchor=(0, 1.0),
        borderaxespad=0.1,
        handlelength=1.2,
    )


def _spans(filter_: FilterAnswers) -> list[Spell]:
    """Intervals of one status; each answer holds until the next one."""
    if not filter_.status:
        return []
    status = np.array([word.lower() or "ok" for word in filter_.status])
    begins = np.flatnonzero(np.append(True, status[1:] != status[:-1]))
    step = float(np.median(np.diff(filter_.time_s))) if len(status) > 1 else 0.0
    edges = np.append(filter_.time_s, filter_.time_s[-1] + step)
    ends = np.append(begins[1:], len(status))
    return [
        Spell(str(status[a]), float(edges[a]), float(edges[b]))
        for a, b in zip(begins.tolist(), ends.tolist(), strict=True)
    ]


def _draw_states(axes: Sequence[Any], spells: Sequence[Spell]) -> None:
    """Shade the supervisor's states behind the curves of a real flight; name the longer ones above."""
    if not spells:
        return
    begin, end = spells[0].begin_s, spells[-1].end_s
    for spell in spells:
        color = _STATES.get(spell.state)
        for one in axes:
            one.axvline(spell.begin_s, color=SOFT, linewidth=0.5, zorder=0)
            if color is not None:
                one.axvspan(spell.begin_s, spell.end_s, color=color, alpha=0.1, linewidth=0, zorder=0)
        if spell.end_s - spell.begin_s > _NAMED_FRACTION * (end - begin) or spell.state in _STATES:
            middle = 0.5 * (spell.begin_s + spell.end_s)
            where = axes[0].get_xaxis_transform()
            axes[0].text(
                middle, 1.02, spell.state, transform=where, ha="center", fontsize="small", color=SOFT
            )
    axes[0].set_xlim(begin, end)
