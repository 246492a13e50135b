"""Output of facts: tables on a terminal, plain lines elsewhere."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import click

from alula.schemas.decimals import exact
from alula.schemas.text import one_line

LONGEST = 12  # longer sequences of numbers are summarised
_HASH_DIGITS = 12
_STATED = frozenset(
    {"guarantee", "properties", "parameters", "map_origin_m"}
)  # sections and facts with numbers that guarantees rest on, or that are calculated with


def echo(text: str, *, err: bool = False) -> None:
    """Print one line; every line of every command passes here, without control characters.

    Args:
        text: the line, which may have words of files and links.
    """
    click.echo(one_line(text), err=err)


def print_json(facts: Mapping[str, Any]) -> None:
    """Print one JSON object on stdout; it remains the command's answer if an error follows."""
    context = click.get_current_context(silent=True)
    if context is not None and isinstance(context.obj, dict):
        context.obj["answered"] = True
    click.echo(json.dumps(facts, indent=2).replace("\x7f", "\\u007f"))  # JSON may hold DEL as it is


def plain(value: Any, *, digits: int | None = 6) -> str:
    """Format a value for reading: short floats, sequences without brackets, long ones summarised.

    Args:
        digits: significant digits of floats; None for as many as identify them.
    """
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return exact(value) if digits is None else f"{value:.{digits}g}"
    if isinstance(value, list | tuple):
        if len(value) <= LONGEST:
            return ("; " if any(isinstance(item, list | tuple | dict) for item in value) else " ").join(
                plain(item, digits=digits) for item in value
            )
        if all(isinstance(item, int | float) for item in value):
            first, last, low, high = (
                plain(item, digits=digits) for item in (value[0], value[-1], min(value), max(value))
            )
            return f"{len(value)} numbers from {first} to {last}, within {low} and {high}"
        return f"{len(value)} entries"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {plain(item, digits=digits)}" for key, item in value.items())
    return str(value)


def digits_of(name: str) -> int | None:
    """Digits of floats in a section or fact, for `plain`; None (all) where others are computed from them."""
    return None if name in _STATED else 6


def print_sections(facts: Mapping[str, Any]) -> None:
    """Print plain facts first, then a section per nested fact; deeper values are named by their path."""
    simple = {key: value for key, value in facts.items() if not _nested(value) and not _blank(value)}
    _pairs("", simple)
    for title, value in facts.items():
        if _blank(value) or title in simple:
            continue
        rows = _table(value)
        if rows is not None:
            print_table(title, *rows)
        elif isinstance(value, Mapping):
            _pairs(title, {key: item for key, item in flat(value) if not _blank(item)})
        else:
            _pairs(title, {str(number): item for number, item in enumerate(value, 1)})


def flat(table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Keys and values, those of a nested table after its name and a dot."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from ((f"{key}.{inner}", found) for inner, found in flat(value))
        else:
            yield key, value


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table with a title and aligned columns."""
    if sys.stdout.isatty():
        from rich.console import Console
        from rich.markup import escape
        from rich.table import Table

        console = Console()
        if title:
            console.print(f"\n{one_line(title)}", style="bold", markup=False, highlight=False)
        table = Table(box=None, show_header=any(columns), pad_edge=False)
        for name in columns:
            table.add_column(escape(one_line(name)), overflow="fold")
        for row in rows:
            table.add_row(*(escape(one_line(word)) for word in row))
        console.print(table)
        return
    widths = [max(len(row[i]) for row in [columns, *rows]) for i in range(len(columns))]
    if title:
        echo("")
        echo(title)
    for row in [columns, *rows] if any(columns) else rows:
        echo(("  " + "  ".join(word.ljust(w) for word, w in zip(row, widths, strict=True))).rstrip())


def _pairs(title: str, facts: Mapping[str, Any]) -> None:
    stated = digits_of(title)
    words = {key: _words(value, stated and digits_of(key)) for key, value in facts.items()}
    if sys.stdout.isatty() or title:
        print_table(title, ("", ""), list(words.items()))
        return
    width = max((len(key) for key in facts), default=0)
    for key, value in words.items():
        echo(f"{key:<{width}}  {value}")


def _words(value: Any, digits: int | None = 6) -> str:
    """Format a value on one line, without control characters."""
    return one_line(" ".join(plain(value, digits=digits).split()))


def _nested(value: Any) -> bool:
    return isinstance(value, Mapping) or (isinstance(value, list) and any(_nested(item) for item in value))


def _blank(value: Any) -> bool:
    return value is None or value in ({}, [], "")


def _table(value: Any) -> tuple[list[str], list[list[str]]] | None:
    """Header and rows when all entries are records with the same keys; else None."""
    if isinstance(value, Mapping):
        items: list[Any] = [
            {"name": k} | dict(v) if isinstance(v, Mapping) else None for k, v in value.items()
        ]
    else:
        items = [dict(item) if isinstance(item, Mapping) else None for item in value]
    if not items or any(item is None or item.keys() != items[0].keys() for item in items):
        return None
    if isinstance(value, Mapping) and len(items) == 1:
        return None
    return list(items[0]), [[_cell(*pair) for pair in item.items()] for item in items]


def _cell(key: str, value: Any) -> str:
    if key == "shape" and isinstance(value, list):
        return " x ".join(map(str, value))
    if key == "dtype" and isinstance(value, str) and value[2:].isdigit():  # "<f4" is f32 in the documentation
        return f"{value[1]}{8 * int(value[2:])}"
    return _words(value)[:_HASH_DIGITS] if key == "sha256" else _words(value)
