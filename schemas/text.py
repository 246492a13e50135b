"""Text that comes from files and links, made harmless for a terminal and for a page."""

from __future__ import annotations

import html
from typing import Any


def one_line(text: str) -> str:
    """Text on one line without control characters: each one, and any line break, becomes `?` or a space.

    Escape sequences of terminals begin with a control character; marks of the direction of writing could
    show a text in another order than it has.
    """
    return "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in text)


def html_text(value: Any) -> str:
    """Text for the inside of an HTML element or a quoted attribute, which shows it as it is."""
    return html.escape(one_line(str(value)))
