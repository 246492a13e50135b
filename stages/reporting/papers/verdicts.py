"""Verdicts on the published values of a paper: one row per table, figure and number, ours beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from alula.schemas.errors import InputError
from alula.stages.reporting.table import Table

VERDICTS = ("reproduced", "bounded", "refuted", "not comparable", "not available here")
_COLUMNS = ("item", "quantity", "published", "ours", "95 % interval", "verdict", "why")
_NOTE = (
    "Reproduced: our value agrees, within its interval or the printed digits. Bounded: ours is on the safe "
    "side of the published value, or an interval limits it. Refuted: ours contradicts it. Not comparable: "
    "the paper leaves out what decides the value. Not available here: it needs hardware or data that this "
    "project does not have."
)


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One published value and ours, as text; `item` is a table, a figure or a section of the paper.

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

    def __post_init__(self) -> None:
        """Refuse an unknown verdict."""
        if self.verdict not in VERDICTS:
            raise InputError(f"a verdict is one of {', '.join(VERDICTS)}, not {self.verdict!r}")


def verdict_table(rows: Sequence[PaperRow]) -> Table:
    """Tabulate published values with ours and a verdict, in reading order; an empty cell reads as a dash."""
    cells = tuple(
        tuple(
            cell or None
            for cell in (row.item, row.quantity, row.published, row.ours, row.interval, row.verdict, row.why)
        )
        for row in rows
    )
    return Table("verdicts", "Every published value, ours beside it, and a verdict", _COLUMNS, cells, _NOTE)
