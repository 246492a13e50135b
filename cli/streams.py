"""Standard streams as a program among others finds them: closed, full, or read by `head`."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


class ClosedPipeError(Exception):
    """Nobody reads the output any more; click would turn a BrokenPipeError into exit code 1."""


@contextmanager
def pipe() -> Iterator[None]:
    """Turn a BrokenPipeError into ClosedPipeError."""
    try:
        yield
    except BrokenPipeError as error:
        raise ClosedPipeError from error


def open_streams() -> None:
    """Closed standard streams lead nowhere, and what a stream cannot encode becomes a question mark."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
    if sys.stdout is None:
        sys.stdout = Path(os.devnull).open("w")  # noqa: SIM115  it stays open
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def discard_stdout() -> None:
    """Let the interpreter's last flush of stdout go nowhere."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
