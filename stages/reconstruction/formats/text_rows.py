"""Tables of numbers in text files: every line is a row of as many numbers, or the file is refused."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import ArtifactError

_CONTROL = re.compile(rb"[^\t\n\r\x20-\x7e]")
_COMMENT = re.compile(rb"#[^\r\n]*")
_NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)(e[+-]?\d+)?|nan|inf(inity)?)", re.IGNORECASE | re.ASCII)
_SHOWN = 40


def text_lines(raw: bytes, *, comments: bool) -> list[str]:
    """Lines of an ASCII text, with any line ends, without comments.

    Args:
        comments: `#` begins a comment, which may hold any character.

    Raises:
        ArtifactError: naming the line with a character that no number has.
    """
    plain = raw.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if comments:
        plain = _COMMENT.sub(b"", plain)
    wrong = _CONTROL.search(plain)
    if wrong is not None:
        line = plain.count(b"\n", 0, wrong.start()) + 1
        raise ArtifactError(f"line {line} holds the byte {wrong[0][0]:#04x}, which is no part of a number")
    return plain.decode("ascii").split("\n")


def number_rows(lines: Sequence[str], what: str, first: int = 1) -> FloatArray:
    """Numbers of all lines that are not blank.

    Args:
        lines: without comments.
        what: a row, for messages.

    Returns:
        Shape (rows, columns); (0, 0) without rows.

    Raises:
        ArtifactError: naming the line that is not of numbers, or has not as many as the first row.
    """
    if not any(line and not line.isspace() for line in lines):
        return np.empty((0, 0))
    try:
        return np.loadtxt(lines, np.float64, comments=None, ndmin=2)
    except ValueError:
        raise _wrong(lines, what, first) from None


def _wrong(lines: Sequence[str], what: str, first: int) -> ArtifactError:
    """What is wrong with the first line that is."""
    columns = 0
    for number, line in enumerate(lines, start=first):
        words = line.split()
        for word in words:
            if not _NUMBER.fullmatch(word):
                return ArtifactError(
                    f"line {number}: {what} needs numbers with spaces between them, not {word[:_SHOWN]!r}"
                )
        if words and columns and len(words) != columns:
            return ArtifactError(
                f"line {number}: {what} has {len(words)} numbers, but those before have {columns}"
            )
        columns = len(words) or columns
    return ArtifactError(f"{what} is not readable as numbers")
