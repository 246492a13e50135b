"""Facts on a screen: tables on a terminal, plain lines elsewhere."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import click

from alula.cli.runner import plain


def print_json(facts: Mapping[str, Any]) -> None:
    """One JSON object on stdout."""
    click.echo(json.dumps(facts, indent=2))


def print_sections(facts: Mapping[str, Any]) -> None:
    """Plain facts first, then a section per nested one."""
    simple = {key: value for key, value in facts.items() if not _nested(value) and not _blank(value)}
    _pairs("", simple)
    for title, value in facts.items():
        if _blank(value) or title in simple:
            continue
        rows = _table(value)
        if rows is not None:
            print_table(title, *rows)
        elif isinstance(value, Mapping):
            _pairs(title, {key: item for key, item in value.items() if not _blank(item)})
        else:
            _pairs(title, {str(number): item for number, item in enumerate(value, 1)})


def print_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table with a title; its columns are aligned."""
    if sys.stdout.isatty():
        from rich.console import Console
        from rich.markup import escape
        from rich.table import Table

        table = Table(title=escape(title) or None, title_justify="left", title_style="bold")
        for name in columns:
            table.add_column(escape(name), overflow="fold")
        for row in rows:
            table.add_row(*map(escape, row))
        Console().print(table)
        return
    widths = [max(len(row[i]) for row in [columns, *rows]) for i in range(len(columns))]
    if title:
        click.echo(f"\n{title}")
    for row in [columns, *rows] if any(columns) else rows:
        click.echo(("  " + "  ".join(word.ljust(w) for word, w in zip(row, widths, strict=True))).rstrip())


def _pairs(title: str, facts: Mapping[str, Any]) -> None:
    if sys.stdout.isatty() or title:
        print_table(title, ("", ""), [(key, _words(value)) for key, value in facts.items()])
        return
    width = max((len(key) for key in facts), default=0)
    for key, value in facts.items():
        click.echo(f"{key:<{width}}  {_words(value)}")


def _words(value: Any) -> str:
    """A value on one line, without characters that steer a terminal."""
    text = " ".join(plain(value).split())
    return "".join(c if c.isprintable() else "?" for c in text)


def _nested(value: Any) -> bool:
    return isinstance(value, Mapping) or (isinstance(value, list) and any(_nested(item) for item in value))


def _blank(value: Any) -> bool:
    return value is None or value in ({}, [], "")


def _table(value: Any) -> tuple[list[str], list[list[str]]] | None:
    """Header and rows when all entries are records with the same keys."""
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
    return " × ".join(map(str, value)) if key == "shape" and isinstance(value, list) else _words(value)
