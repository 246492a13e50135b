"""Shares with their intervals as columns of tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from alula.stages.reporting.tables import Table, text

LOW, HIGH = "95 % low", "95 % high"  # columns after that of a share


def folded(table: Table) -> Table:
    """As read: each share with its interval in one cell that does not break, such as 99.5 (99.1 to 99.7);
    without columns of published values where nothing is.
    """
    at = [i for i, name in enumerate(table.columns) if name == LOW]
    empty = [
        i
        for i, name in enumerate(table.columns)
        if name.startswith("published") and all(row[i] is None for row in table.rows)
    ]
    left_out = {*at, *(i + 1 for i in at), *empty}

    def fold(row: Sequence[Any], name: bool) -> tuple[Any, ...]:
        cells = list(row)
        for i in at:
            value, low, high = row[i - 1], row[i], row[i + 1]
            known = f"{text(value)} ({text(low)} to {text(high)})".replace(" ", "\u00a0")
            cells[i - 1] = f"{value} (95 %)" if name else None if value is None else known
        return tuple(cell for i, cell in enumerate(cells) if i not in left_out)

    rows = tuple(fold(row, False) for row in table.rows)
    return replace(table, columns=fold(table.columns, True), rows=rows)
