"""Verdicts on the published values of a paper: one row per table, figure and number, ours beside it.

A row is text. `exact` writes a rounded number so that its row keeps the value with all digits as well: a page
shows the one and holds the other.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from alula.schemas.errors import InputError
from alula.stages.reporting.statistics import Estimate
from alula.stages.reporting.table import Table, text
from papers.compared import VERDICTS, ShownNumber

_COLUMNS = ("item", "quantity", "published", "ours", "95 % interval", "verdict", "why")
VERDICT_WORDS = {
    "better": "ours is on the favourable side of the published value, by more than its interval or the "
    "printed digits",
    "reproduced": "our value agrees, within its interval or the printed digits",
    "bounded": "ours is on the safe side of the published value, or an interval limits it",
    "refuted": "ours contradicts it",
    "not comparable": "the paper leaves out what decides the value",
    "not available here": "it needs hardware or data that this project does not have",
}
NOTE = " ".join(f"{name.capitalize()}: {words}." for name, words in VERDICT_WORDS.items())
_MARK = "\u2063"  # an invisible separator, which no name and no unit contains
_MARKED = re.compile(f"{_MARK}([^{_MARK}]*){_MARK}([^{_MARK}]*){_MARK}")


def exact(value: Any, form: str | None = None) -> str:
    """Write a number for the text of a row, which keeps all its digits.

    Args:
        value: the number; anything else is written as `text` does.
        form: format, by default that of `text`.
    """
    shown = text(value) if form is None else format(value, form)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return shown
    return f"{_MARK}{value!r}{_MARK}{shown}{_MARK}"


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One published value and ours, as text; `item` is a table, a figure or a section of the paper.

    Attributes:
        runs: files below the example's output folder that the row is made from; `made_from` sets them.
        flights: number of flights in them; None where it is made from no flight.
        numbers: the numbers written by `exact` in `ours` and in `interval`.

    Raises:
        InputError: `verdict` is not one of `VERDICTS`.
    """

    item: str
    quantity: str
    published: str
    ours: str
    interval: str
    verdict: str
    why: str
    runs: tuple[str, ...] = ()
    flights: int | None = None
    numbers: tuple[ShownNumber, ...] = field(default=())

    def __post_init__(self) -> None:
        """Refuse an unknown verdict; keep the numbers that the texts carry."""
        if self.verdict not in VERDICTS:
            raise InputError(f"a verdict is one of {', '.join(VERDICTS)}, not {self.verdict!r}")
        found = list(self.numbers)
        for name in ("item", "quantity", "published", "ours", "interval", "why"):
            plain, numbers = _plain(getattr(self, name), name)
            object.__setattr__(self, name, plain)
            if name in ("ours", "interval"):
                found += numbers
        object.__setattr__(self, "numbers", tuple(found))

    def made_from(self, runs: Iterable[str], flights: int | None = None) -> PaperRow:
        """Return the row with the files that it is made from, and the number of flights in them."""
        return replace(self, runs=tuple(dict.fromkeys(runs)), flights=flights)


def verdict_table(rows: Sequence[PaperRow]) -> Table:
    """Tabulate published values with ours and a verdict, in reading order; an empty cell reads as a dash."""
    cells = tuple(
        tuple(
            cell or None
            for cell in (row.item, row.quantity, row.published, row.ours, row.interval, row.verdict, row.why)
        )
        for row in rows
    )
    return Table("verdicts", "Every published value, ours beside it, and a verdict", _COLUMNS, cells, NOTE)


def lower_is_better(found: Estimate, published: float) -> str:
    """Judge a value of which less is better by its interval, or by itself where it has none."""
    low = found.value if found.low is None else found.low
    high = found.value if found.high is None else found.high
    return "better" if high < published else "refuted" if low > published else "reproduced"


def _plain(words: str, name: str) -> tuple[str, list[ShownNumber]]:
    """Take the exact values out of a text."""
    if _MARK not in words:
        return words, []
    parts, numbers, at, end = [], [], 0, 0
    for found in _MARKED.finditer(words):
        parts.append(words[end : found.start()])
        at += len(parts[-1])
        numbers.append(ShownNumber(cell=name, at=at, shown=found[2], value=float(found[1])))
        parts.append(found[2])
        at += len(found[2])
        end = found.end()
    return "".join([*parts, words[end:]]), numbers
