"""Tables that a notebook shows below a cell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape


def table(title: str, facts: Mapping[str, str], notes: Sequence[str] = ()) -> str:
    """A small table for a notebook."""
    style = "style='text-align:left'"
    rows = "".join(
        f"<tr><td {style}>{escape(name.replace('_', ' '))}</td><td {style}>{escape(value)}</td></tr>"
        for name, value in facts.items()
    )
    below = "".join(f"<p>{escape(note)}</p>" for note in notes)
    return f"<div><b>{escape(title)}</b><table>{rows}</table>{below}</div>"
