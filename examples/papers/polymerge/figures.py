"""Figure 5 of PolyMerge from our flights: time, success and path length of every method in each scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from alula.stages.reporting.figures import Figure, drawing
from alula.stages.reporting.palette import AXIS, BLUE, GREEN, INK, ORANGE, PURPLE, VERMILLION
from alula.stages.reporting.table import text
from papers.polymerge.flights import OURS, Flights, path_ratio

_COLORS = (BLUE, ORANGE, AXIS, VERMILLION, PURPLE, GREEN)


def flights_figure(flown: Sequence[Flights]) -> Figure | None:
    """Plot time per step, success rate and path length over ours, as bars by scene; None without flights."""
    if not flown:
        return None
    scenes = list(dict.fromkeys(f.scene for f in flown))
    methods = list(dict.fromkeys(f.method for f in flown))
    width = 0.8 / len(methods)
    said = []
    with drawing(9.4, 7.6, rows=3) as ((times, rates, lengths), render):
        for place, (method, color) in enumerate(zip(methods, _COLORS, strict=False)):
            for number, scene in enumerate(scenes):
                here = {f.method: f for f in flown if f.scene == scene}
                if (f := here.get(method)) is None:
                    continue
                at = number + (place - (len(methods) - 1) / 2) * width
                label = method if number == 0 else None
                times.bar(at, f.filter_us, 0.92 * width, color=color, label=label)
                rate = f.success
                value = rate.value or 0.0
                error = [[max(0.0, value - rate.ends[0])], [max(0.0, rate.ends[1] - value)]]
                rates.bar(at, value, 0.92 * width, color=color, yerr=error, ecolor=INK, capsize=2)
                ours = here.get(OURS)
                ratio = None if ours is None else path_ratio(f, ours, (ours, f))
                if ratio is not None:
                    lengths.bar(at, ratio.value, 0.92 * width, color=color)
                said.append(f"{scene}, {method}: {text(f.filter_us)} µs, {rate}")
        times.set(yscale="log", ylabel="filter [µs per step]")
        times.figure.legend(loc="outside upper center", ncols=len(methods), fontsize=9)
        rates.set(ylabel="success [%]", ylim=(0, 105))
        lengths.axhline(1, color=INK, linewidth=1)
        lengths.set(ylabel="path over ours")
        lengths.set_xticks(np.arange(len(scenes)), scenes)
        svg = render()
    alt = (
        "Time of the filter per step, success rate with its 95 % interval, and path length over ours where "
        "both "
        f"fly without a collision, by scene and method. {'; '.join(said)}."
    )
    return Figure("figure-5", "Figure 5: time, success, path length", alt, svg, wide=True)
