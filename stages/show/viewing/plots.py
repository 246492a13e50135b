"""Curves of the flights of a page, as the script beside the scene draws them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.reporting.palette import COLORS
from alula.stages.show.drawing.content import Play, Series
from alula.stages.show.viewing.draw import Span

_POINTS = 300  # per curve; more cannot be distinguished


def flight_data(plays: Sequence[Play], spans: Sequence[Span]) -> list[dict[str, Any]]:
    """Names, places on the timeline and curves of flights, as JSON values."""
    return [
        {
            "label": play.label,
            "run": play.run,
            "trial": play.trial,
            "from": round(play.begin_s, 6),
            "outcome": play.outcome,
            "color": COLORS.get(play.outcome, "#222222"),
            "words": play.words,
            "begin": round(span.begin_s, 3),
            "end": round(span.end_s, 3),
            "worst": round(play.marked_s, 3),
            "plots": _plots(play.series),
            "status": _spells(play),
        }
        for play, span in zip(plays, spans, strict=True)
    ]


def _plots(series: Sequence[Series]) -> list[dict[str, Any]]:
    found: dict[str, dict[str, Any]] = {}
    for one in series:
        plot = found.setdefault(one.plot, {"name": one.plot, "limit": one.limit, "curves": []})
        row = _thin(one.value)
        plot["curves"].append(
            {"label": one.label, "t": _rounded(one.time_s[row], 3), "v": _rounded(one.value[row], 4)}
        )
    return list(found.values())


def _thin(value: FloatArray) -> Any:
    """Rows of the minimum and the maximum in each of `_POINTS` / 2 intervals, so that no peak is lost."""
    if len(value) <= _POINTS:
        return np.arange(len(value))
    rows = []
    for some in np.array_split(np.arange(len(value)), _POINTS // 2):
        known = value[some]
        if np.isfinite(known).any():
            rows += [some[np.nanargmin(known)], some[np.nanargmax(known)]]
        else:
            rows.append(some[0])
    return np.unique([0, *rows, len(value) - 1])


def _rounded(values: FloatArray, decimals: int) -> list[float | None]:
    return [round(value, decimals) if np.isfinite(value) else None for value in values.tolist()]


def _spells(play: Play) -> list[tuple[float, str]]:
    """The filter's status at each time that it changes."""
    found: list[tuple[float, str]] = []
    for time, status in zip(play.time_s.tolist(), play.status, strict=True):
        if not found or found[-1][1] != status:
            found.append((round(time, 3), status))
    return found
