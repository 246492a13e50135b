"""Atomic writing of outputs: a file appears completely or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import BinaryIO

from alula.schemas.errors import OutputError
from alula.schemas.files import is_special

# Context of the moment when an output appears; the command line delays interruptions in it.
appearing: Callable[[], AbstractContextManager[None]] = nullcontext


@contextmanager
def atomic_output(path: Path, *, is_final: bool = True) -> Iterator[BinaryIO]:
    """Context with a binary file that replaces `path` when the block ends without an exception.

    The file is written under a temporary name in the same folder, flushed to the disk and renamed. On any
    exception, Ctrl-C included, the temporary file is removed and `path` does not change.

    Args:
        path: the file to write; not a folder or a device.
        is_final: the file is the command's output, after which interruptions are ignored.

    Raises:
        OutputError: the file cannot be created, written or renamed.
    """
    # The name is set before the file exists, so that an interruption always leaves it to be removed.
    temporary: Path | None = path.parent / f".{path.name}.{secrets.token_hex(6)}.tmp"
    try:
        if path.is_dir():
            raise OutputError(f"{path}: is a folder, not a file to write")
        if is_special(path):
            raise OutputError(f"{path}: is a device or a pipe; outputs are files")
        assert temporary is not None
        with temporary.open("x+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        with appearing() if is_final else nullcontext():
            temporary.replace(path)
            temporary = None
        _sync_folder(path.parent)
    except OSError as error:
        raise OutputError(f"{path}: cannot write: {error.strerror or error}") from error
    finally:
        if temporary is not None:
            with suppress(OSError):
                temporary.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, in UTF-8.

    Args:
        path: the file to write.
        text: the text; bytes of file names that are not UTF-8 (surrogate escapes) do not change.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_output(path) as file:
        file.write(text.encode(errors="surrogateescape"))


def _sync_folder(folder: Path) -> None:
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
