"""Verdicts on published values, from what was measured: the forms that several papers share."""

from __future__ import annotations

import math
from collections.abc import Sequence

from alula.stages.reporting.statistics import Estimate, Rate
from alula.stages.reporting.table import Table
from papers.claims import Paper, shown
from papers.compared import Measured, Source, Verdict, measured

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
_SAME = 1e-3  # relative difference up to which a setting is the printed one


def verdict_table(paper: Paper, rows: Sequence[Measured]) -> Table:
    """Tabulate published values with ours and a verdict, in reading order; an empty cell reads as a dash."""
    each = [shown(paper.row(found.row)[1], found) for found in rows]
    cells = tuple(tuple(cell or None for cell in row.cells) for row in each)
    return Table("verdicts", "Every published value, ours beside it, and a verdict", _COLUMNS, cells, NOTE)


def stated(paper: Paper, *names: str) -> list[Measured]:
    """Rows that are never measured."""
    found = []
    for name in names:
        verdict = paper.row(name)[1].verdict
        assert verdict is not None, name
        found.append(measured(name, verdict))
    return found


def settings(
    paper: Paper,
    name: str,
    ours: Sequence[float],
    made_of: Sequence[Source] = (),
    rel_tol: float = _SAME,
) -> Measured:
    """A printed setting beside those that we fly with."""
    values = [float(value) for value in ours]
    limits = paper.row(name)[1].limits
    same = all(math.isclose(a, b, rel_tol=rel_tol) for a, b in zip(limits, values, strict=True))
    return measured(name, holds(same, "not comparable"), made_of, values=values)


def holds(condition: bool, otherwise: Verdict = "refuted") -> Verdict:
    """Reproduced where a statement holds."""
    return "reproduced" if condition else otherwise


def below(found: Estimate, published: float) -> Verdict:
    """Judge a value of which less is better by its interval, or by itself where it has none."""
    low = found.value if found.low is None else found.low
    high = found.value if found.high is None else found.high
    return "better" if high < published else "refuted" if low > published else "reproduced"


def above(found: Estimate | Rate | None, limit: float, otherwise: Verdict) -> Verdict:
    """Judge that a value lies above a limit by its interval; `otherwise` where that has the limit in it."""
    if found is None or found.low is None or found.high is None:
        return otherwise
    return "reproduced" if found.low > limit else "refuted" if found.high < limit else otherwise


def close(value: float, published: float, limit: float) -> bool:
    """Whether a value is the published one up to a relative difference."""
    return abs(value - published) <= limit * published
