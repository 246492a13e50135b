"""What names of files stand for, asked without opening them: a pipe that is opened waits for a writer."""

from __future__ import annotations

import os
from pathlib import Path

from alula.schemas.errors import InputError


def is_special(path: Path) -> bool:
    """Whether there is a device, a pipe or a socket of that name: nothing to replace, nothing to map."""
    return path.exists() and not (path.is_file() or path.is_dir())


def check_no_stream(path: Path) -> None:
    """That an input, if it is there, is a file or a folder.

    Raises:
        InputError: it is a device or a pipe, such as `/dev/stdin` and what `<(...)` of a shell makes.
    """
    if is_special(path):
        raise InputError(
            f"{path}: is a pipe or a device, not a file; write it to a file first (import-splat reads -)"
        )


def printable(name: str) -> str:
    """A file's name as text that can be written in UTF-8; other bytes become a backslash and their code."""
    return os.fsencode(name).decode("utf-8", "backslashreplace")
