"""Atomic writing of outputs: a file appears completely or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
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
    with atomic_outputs(path, is_final=is_final) as (file,):
        yield file


@contextmanager
def atomic_outputs(*paths: Path, is_final: bool = True) -> Iterator[list[BinaryIO]]:
    """Context with a binary file for each path; all replace their paths when the block ends, or none does.

    All files are on the disk before the first is renamed, so a full disk replaces none. They are renamed
    from the last to the first: the first is the Make target.

    Args:
        paths: the files to write; not folders or devices.
        is_final: as for `atomic_output`.

    Raises:
        OutputError: a file cannot be created, written or renamed.
    """
    temporary: dict[Path, Path] = {}
    at = paths[0]
    try:
        with ExitStack() as stack:
            files: list[BinaryIO] = []
            for at in paths:
                if at.is_dir():
                    raise OutputError(f"{at}: is a folder, not a file to write")
                if is_special(at):
                    raise OutputError(f"{at}: is a device or a pipe; outputs are files")
                # The name is kept before the file exists, so that an interruption leaves it to be removed.
                temporary[at] = at.parent / f".{at.name}.{secrets.token_hex(6)}.tmp"
                files.append(stack.enter_context(temporary[at].open("x+b")))
            at = paths[0]
            yield files
            for i, file in enumerate(files):
                at = paths[i]
                file.flush()
                os.fsync(file.fileno())
                file.close()
        with appearing() if is_final else nullcontext():
            for at in reversed(paths):
                temporary[at].replace(at)
                del temporary[at]
        for folder in {path.parent for path in paths}:
            sync_folder(folder)
    except OSError as error:
        raise OutputError(f"{at}: cannot write: {error.strerror or error}") from error
    finally:
        for left in temporary.values():
            with suppress(OSError):
                left.unlink()


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Context with a new path for a folder that replaces `path` when the block ends without an exception.

    The block makes the folder, under its final name inside a temporary folder beside `path`. On any exception
    the temporary folder is removed and `path` does not change.

    Args:
        path: the folder to write; an earlier one is removed.

    Raises:
        OutputError: the folder cannot be created, written or renamed.
    """
    temporary = path.parent / f".{path.name}.{secrets.token_hex(6)}.tmp"
    try:
        temporary.mkdir()
        made = temporary / path.name
        yield made
        for file in made.iterdir():
            with file.open("rb") as written:
                os.fsync(written.fileno())
        replace_folder(made, path, temporary / f"{path.name}.old")
    except OSError as error:
        raise OutputError(f"{path}: cannot write: {error.strerror or error}") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def replace_folder(made: Path, path: Path, old: Path) -> None:
    """Give a folder its final name, after which interruptions are ignored.

    Args:
        made: the folder, beside `path` or below that.
        path: its final name.
        old: new name of an earlier folder of that name.

    Raises:
        OSError: a folder cannot be renamed.
    """
    with appearing():
        if path.exists():
            path.rename(old)
        made.rename(path)
    sync_folder(path.parent)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically, in UTF-8.

    Args:
        text: the text; bytes of file names that are not UTF-8 (surrogate escapes) do not change.

    Raises:
        OutputError: the file cannot be written.
    """
    with atomic_output(path) as file:
        file.write(text.encode(errors="surrogateescape"))


def sync_folder(folder: Path) -> None:
    """Flush the names in a folder to the disk, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
