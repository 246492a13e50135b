"""Tests of file names without opening the files, because opening a pipe waits for its writer."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from alula.schemas.errors import InputError

READ_AT_ONCE = 2**26  # [B]; shorter files are read, longer ones mapped: another program may cut those


def is_special(path: Path) -> bool:
    """Test whether a path is a device, a pipe or a socket, which can be neither replaced nor mapped.

    Args:
        path: it need not exist.
    """
    return path.exists() and not (path.is_file() or path.is_dir())


def check_no_stream(path: Path) -> None:
    """Check that an input, if it exists, is a file or a folder.

    Raises:
        InputError: it is a device or a pipe, such as `/dev/stdin` or the `<(...)` of a shell.
    """
    if is_special(path):
        raise InputError(
            f"{path}: is a pipe or a device, not a file; write it to a file first (import-splat reads -)"
        )


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Context in which a file is read.

    Raises:
        InputError: it cannot be read.
    """
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error


def read_small(path: Path, most_bytes: int) -> bytes:
    """Read a file of limited length; never waits for the writer of a pipe.

    Args:
        most_bytes: longer files are refused.

    Raises:
        InputError: it is a folder, a device or a pipe, is too long, or cannot be read.
    """
    check_no_stream(path)
    with reading(path), path.open("rb") as file:
        raw = file.read(most_bytes + 1)
    if len(raw) > most_bytes:
        raise InputError(f"{path}: is longer than {most_bytes} bytes")
    return raw


def size_of(path: Path) -> int:
    """Bytes of a file, or of all files in a folder."""
    if not path.is_dir():
        return path.stat().st_size
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def text_of(path: Path) -> str:
    """Text of a file in UTF-8.

    Raises:
        InputError: it cannot be read, or is no such text.
    """
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not text in UTF-8") from error
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error


def printable(name: str) -> str:
    """Convert a file's name to text for UTF-8; other bytes become a backslash and their code.

    Args:
        name: the name, with surrogate escapes for bytes that are not UTF-8.
    """
    return os.fsencode(name).decode("utf-8", "backslashreplace")


_KINDS = (
    (b"\x89MCAP0\r\n", "it is a run, which report, view, info and simulate --pairs-from read"),
    (b"PK\x03\x04", "it is an artifact or another ZIP, which info names"),
    (b"ply\n", "it is a PLY file, which import-splat or import-voxels reads"),
    (b"glTF", "it is a glTF file, which import-splat or import-voxels reads"),
)


def what_it_is(path: Path) -> str:
    """What a file of another kind is, as words after the refusal; "" where that is unknown."""
    if path.suffix == ".toml":
        return "; it is a TOML file, such as a scenario or a vehicle"
    with path.open("rb") as file:
        head = file.read(16)
    return next((f"; {words}" for begin, words in _KINDS if head.startswith(begin)), "")
