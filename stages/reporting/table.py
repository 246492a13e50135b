"""A table of a report: its values and their form as text, CSV and Markdown."""

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
    """A table of raw values; `text` formats them for reading.

    Attributes:
        name: identifier, for `--table` and file names.
        rows: one tuple per row, as long as `columns`.
        note: paragraph below the table.
        before: sentence above the table; empty for none.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Any, ...], ...]
    note: str = ""
    before: str = ""


def text(value: Any) -> str:
    """Format a value for reading: four significant digits of a float, thousands separators in an integer."""
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
    """Flatten a nested record to one level of dotted keys."""
    if not isinstance(record, dict):
        return {prefix: record}
    result: dict[str, Any] = {}
    for key in sorted(record):
        result |= flat(record[key], f"{prefix}.{key}" if prefix else str(key))
    return result


def folded(table: Table) -> Table:
    """Shorten a table for reading.

    Each value with an interval becomes one cell without line breaks, such as 99.5 (99.1 to 99.7). Columns of
    published values are dropped where they are empty.
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
            if low is None:
                known = text(value)
            cells[i - 1] = f"{value} (95 %)" if name else None if value is None else known
        return tuple(cell for i, cell in enumerate(cells) if i not in left_out)

    rows = tuple(fold(row, False) for row in table.rows)
    return replace(table, columns=fold(table.columns, True), rows=rows)


def table_csv(table: Table) -> str:
    """Write a table as CSV with all digits; an unknown value is empty."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows([csv_cell(value) for value in row] for row in table.rows)
    return out.getvalue()


def csv_cell(value: Any) -> str:
    """Format a value for CSV with all digits; a list is joined by spaces, None is empty."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return " ".join(repr(item) for item in value)
    return value if isinstance(value, str) else repr(value)


def to_markdown(title: str, facts: Mapping[str, Any], tables: Sequence[Table], first_line: str) -> str:
    """Write the facts, then the tables, as Markdown; `first_line` goes into a comment at the top."""
    parts = [f"<!-- {first_line} -->" if first_line else "", f"# {markdown_cell(title)}"]
    if facts:
        items = [f"- {key.replace('_', ' ')}: {markdown_cell(text(value))}" for key, value in facts.items()]
        parts.append("\n".join(["## In short", "", *items]))
    parts += [markdown_table(table) for table in tables]
    return "\n\n".join(part for part in parts if part) + "\n"


def markdown_table(table: Table, *, before: str = "") -> str:
    """Write a table as Markdown, with its title above and its note below.

    Args:
        before: paragraph between title and table.
    """
    head = "| " + " | ".join(markdown_cell(name) for name in table.columns) + " |"
    rule = "|" + " --- |" * len(table.columns)
    rows = ["| " + " | ".join(markdown_cell(text(value)) for value in row) + " |" for row in table.rows]
    parts = [f"## {markdown_cell(table.title)}", before, "\n".join([head, rule, *rows]), table.note]
    return "\n\n".join(part for part in parts if part)


def markdown_cell(word: str) -> str:
    """Escape text so that it stays one cell: no line breaks, no markup of Markdown or HTML."""
    for mark in "\\|`*_<>[]":
        word = word.replace(mark, f"\\{mark}" if mark not in "<>" else {"<": "&lt;", ">": "&gt;"}[mark])
    return " ".join(word.split())
