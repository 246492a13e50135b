"""A table of a report: its values, and how they read as text, CSV and Markdown."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

LOW, HIGH = "95 % low", "95 % high"  # the two columns after that of a value with an interval


@dataclass(frozen=True, slots=True)
class Table:
    """A table of raw values; `text` says how they read."""

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    note: str = ""


def text(value: Any) -> str:
    """A value as a person reads it: four digits of a float, thousands of an integer apart."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return f"{value:.4g}" if abs(value) < 1e4 else f"{value:,.0f}"
    if isinstance(value, list | tuple):
        return ", ".join(text(item) for item in value)
    if isinstance(value, dict):
        return ", ".join(f"{key} {text(item)}" for key, item in value.items())
    return str(value)


def flat(record: Any, prefix: str = "") -> dict[str, Any]:
    """A nested record as one level of dotted keys."""
    if not isinstance(record, dict):
        return {prefix: record}
    result: dict[str, Any] = {}
    for key in sorted(record):
        result |= flat(record[key], f"{prefix}.{key}" if prefix else str(key))
    return result


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


def table_csv(table: Table) -> str:
    """A table with all digits; an unknown value is empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows([csv_cell(value) for value in row] for row in table.rows)
    return out.getvalue()


def csv_cell(value: Any) -> str:
    """A value of a CSV file with all digits; a list is joined by spaces, None is empty."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return " ".join(repr(item) for item in value)
    return value if isinstance(value, str) else repr(value)


def to_markdown(title: str, facts: Mapping[str, Any], tables: Sequence[Table], first_line: str) -> str:
    """The facts in short, then the tables, as Markdown; `first_line` is put into a comment at the top."""
    parts = [f"<!-- {first_line} -->" if first_line else "", f"# {_cell(title)}"]
    if facts:
        items = [f"- {key.replace('_', ' ')}: {_cell(text(value))}" for key, value in facts.items()]
        parts.append("\n".join(["## In short", "", *items]))
    for table in tables:
        head = "| " + " | ".join(_cell(name) for name in table.columns) + " |"
        rule = "|" + " --- |" * len(table.columns)
        rows = ["| " + " | ".join(_cell(text(value)) for value in row) + " |" for row in table.rows]
        parts.append("\n".join([f"## {_cell(table.title)}", "", head, rule, *rows]))
        if table.note:
            parts.append(table.note)
    return "\n\n".join(part for part in parts if part) + "\n"


def _cell(word: str) -> str:
    """Text that stays one cell: no line breaks, no markup of Markdown or HTML."""
    for mark in "\\|`*_<>[]":
        word = word.replace(mark, f"\\{mark}" if mark not in "<>" else {"<": "&lt;", ">": "&gt;"}[mark])
    return " ".join(word.split())
