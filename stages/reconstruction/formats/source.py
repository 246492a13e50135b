"""Source of a splat: one file, or the files of a folder."""

from __future__ import annotations

import io
import mmap
import re
from functools import cached_property
from pathlib import Path, PurePosixPath

from alula.schemas.errors import ArtifactError, InputError
from alula.schemas.files import READ_AT_ONCE, check_no_stream

HEAD = 4096


class Source:
    """A file or a folder; its bytes are mapped into memory on first use.

    Attributes:
        path: the file, or the folder.
        notes: notes for the user about the choice of the file.
        level: level of detail to read, for formats with several; None is the finest.
    """

    def __init__(self, path: Path, notes: tuple[str, ...] = (), level: int | None = None) -> None:
        self.path = path
        self.notes = notes
        self.level = level
        self._mapped: dict[Path, memoryview] = {}

    @cached_property
    def is_folder(self) -> bool:
        """True when the source is a folder, which has members but no content of its own."""
        return self.path.is_dir()

    @property
    def folder(self) -> Path:
        """Folder that the names of members are relative to."""
        return self.path if self.is_folder else self.path.parent

    @property
    def suffix(self) -> str:
        """Lower-case suffix with the dot; empty for a folder."""
        return "" if self.is_folder else self.path.suffix.lower()

    @property
    def data(self) -> memoryview:
        """The whole file.

        Raises:
            ArtifactError: it is empty, or a folder.
            InputError: it cannot be read.
        """
        if self.is_folder:
            raise ArtifactError("is a folder, not a file")
        return self._map(self.path)

    @cached_property
    def head(self) -> bytes:
        """First 4096 bytes; empty for a folder."""
        return b"" if self.is_folder else bytes(self.data[:HEAD])

    def has(self, name: str) -> bool:
        """Test whether a file is in the folder."""
        return (self.folder / name).is_file()

    def member(self, name: str) -> memoryview:
        """Bytes of another file, by its name relative to the folder.

        Raises:
            ArtifactError: the name leads out of the folder, or the file is missing or empty.
        """
        try:
            return self._map(self.folder / relative_name(name))
        except ArtifactError as error:
            raise ArtifactError(f"{name}: {error}") from error

    def _map(self, path: Path) -> memoryview:
        if path not in self._mapped:
            check_no_stream(path)
            try:
                with path.open("rb") as file:
                    file.seek(0, io.SEEK_END)
                    if file.tell() == 0:
                        raise ArtifactError("is empty")
                    if file.tell() <= READ_AT_ONCE:
                        file.seek(0)
                        self._mapped[path] = memoryview(file.read())
                        return self._mapped[path]
                    self._mapped[path] = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
            except FileNotFoundError as error:
                if path == self.path:
                    raise InputError(f"{path}: does not exist") from error
                raise ArtifactError("does not exist") from error
            except (OSError, ValueError) as error:  # ValueError: a file that cannot be mapped
                reason = getattr(error, "strerror", None) or error
                raise InputError(f"{path}: cannot read: {reason}") from error
        return self._mapped[path]


def let_go(buffer: memoryview, begin: int, end: int) -> None:
    """Release the memory of bytes of a mapped file that were read; they can still be read again.

    Args:
        buffer: the whole mapped file; others are left alone.
    """
    if isinstance(buffer.obj, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        begin -= begin % mmap.PAGESIZE
        end -= end % mmap.PAGESIZE
        if begin < end and len(buffer) == len(buffer.obj):
            buffer.obj.madvise(mmap.MADV_DONTNEED, begin, end - begin)


def relative_name(name: str) -> PurePosixPath:
    """Check a relative name that a file gives to another file.

    Raises:
        ArtifactError: the name is absolute, leads upwards, or is not valid.
    """
    path = PurePosixPath(name)
    if not name or path.is_absolute() or ".." in path.parts or "\0" in name or "\\" in name or ":" in name:
        raise ArtifactError(f"{name[:100]!r} is no name of a file in the same folder")
    return path


def find_source(path: Path, level: int | None = None) -> Source:
    """Find the file or folder to read for a path that the user gave.

    A folder of INRIA's trainer stands for its last `point_cloud/iteration_*/point_cloud.ply`.

    Args:
        level: level of detail to read, for formats with several; None is the finest.

    Raises:
        InputError: there is nothing of that name.
    """
    if not path.exists():
        raise InputError(f"{path}: does not exist")
    if path.is_dir():
        iterations = {
            int(found[1]): file
            for file in path.glob("point_cloud/iteration_*/point_cloud.ply")
            if (found := re.fullmatch(r"iteration_([0-9]{1,9})", file.parent.name))
        }
        if iterations:
            last = max(iterations)
            more = f", the last of {len(iterations)}" if len(iterations) > 1 else ""
            return Source(iterations[last], (f"iteration {last} of the folder{more}",))
    return Source(path, level=level)
