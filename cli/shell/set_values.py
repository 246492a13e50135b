"""Values of the option `--set PATH=VALUE`."""

from __future__ import annotations

import math
import re
from collections.abc import Container, Iterable
from contextlib import suppress
from typing import Any

from alula.schemas.errors import UsageError


def settings_of(words: Iterable[str], texts: Container[str] = ()) -> dict[str, Any]:
    """Parse the words of --set; a later one replaces an earlier one.

    Args:
        words: PATH=VALUE.
        texts: paths whose values are text as it stands; others are numbers, lists and truth
            values where they look so.

    Raises:
        UsageError: a path or a value is missing, or a number is not finite.
    """
    found = {}
    for word in words:
        path, equals, text = word.partition("=")
        if not (equals and path and text):
            raise UsageError(f"--set needs PATH=VALUE, not {word!r}")
        found[path] = text if path in texts else _value_of(path, text)
    return found


def _value_of(path: str, text: str) -> Any:
    """An integer, a number, a list with commas, in brackets or not, true or false, else the text."""
    if text.startswith("[") and text.endswith("]"):
        inner = text[1:-1].strip()
        if "[" not in inner:
            return [_value_of(path, part.strip()) for part in inner.split(",")] if inner else []
        rows = re.fullmatch(r"\[[^\[\]]*\](\s*,\s*\[[^\[\]]*\])*", inner)
        if rows is None:
            raise UsageError(f"--set {path}: {text!r} is neither a list nor a list of lists")
        return [_value_of(path, row) for row in re.findall(r"\[[^\[\]]*\]", inner)]
    if "," in text:
        return [_value_of(path, part) for part in text.split(",")]
    if text in ("true", "false"):
        return text == "true"
    for convert in (int, float):
        with suppress(ValueError):
            value = convert(text)
            if isinstance(value, float) and not math.isfinite(value):
                raise UsageError(f"--set {path}: {text!r} is not finite")
            return value
    return text
