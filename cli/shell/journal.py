"""Journal files: an interrupted command continues from its journal when it is repeated."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Generic, NoReturn, Protocol, TypeVar

from alula.cli.shell.interruption import InterruptedWithAdvice
from alula.cli.shell.options import Common
from alula.cli.shell.present import echo
from alula.schemas.artifacts.journal import SUFFIX, JournalKind, mismatches, pack, unpack
from alula.schemas.artifacts.provenance import Provenance, read_provenance
from alula.schemas.atomic import atomic_output
from alula.schemas.errors import DamagedError, InputError, OutputError
from alula.schemas.progress import Progress

PERIOD_S = 30.0  # between two writes
MIN_RUN_S = 3.0  # a shorter interrupted run writes no file
MAX_WRITING_FRACTION = 0.02  # of the time


class Journal(Protocol):
    """Finished work of a command: its amount, and a snapshot as bytes that it can be restored from."""

    def __len__(self) -> int: ...

    def snapshot(self) -> bytes:
        """All finished work, as bytes."""
        ...


J = TypeVar("J", bound=Journal)


class JournalFile(Generic[J]):
    """The file `OUTPUT.journal`: written from time to time and when interrupted, read by the same command.

    A file of that name that is not a journal is neither read nor replaced nor removed. A journal only saves
    time; one of another output, or with a wrong checksum, is ignored.

    Args:
        make: function from a snapshot to a journal, which is empty for no bytes; raises ValueError for
            invalid bytes.
    """

    def __init__(self, common: Common, kind: JournalKind, make: Callable[[bytes], J]) -> None:
        self._kind, self._make = kind, make
        self._output = common.output
        self._path = common.output.parent / (common.output.name + SUFFIX)
        self._is_quiet = common.quiet
        self._may_write = not common.dry_run
        self._wanted: Provenance | None = None
        self._stopped: Callable[[KeyboardInterrupt], NoReturn] | None = None

    def begin(self, wanted: Provenance) -> None:
        """Set the provenance of the output; call this before `kept`, both within `until_written`."""
        self._wanted = wanted

    def kept(self, progress: Progress) -> tuple[J, Progress]:
        """The journal to use, and a progress callback that also writes the file when due."""
        assert self._wanted is not None
        wanted, journal = self._wanted, self._continued(self._wanted)
        written = len(journal)
        start = time.monotonic()
        due = start + PERIOD_S

        def write() -> None:
            nonlocal written, due
            before = time.monotonic()
            if self._may_write and len(journal) > written:
                written = self._write(wanted, journal) or written
            now = time.monotonic()
            due = now + max(PERIOD_S, (now - before) / MAX_WRITING_FRACTION)

        def watched(done: int, total: int) -> None:
            progress(done, total)
            if time.monotonic() >= due:
                write()

        def stopped(interruption: KeyboardInterrupt) -> NoReturn:
            if time.monotonic() - start >= MIN_RUN_S:
                write()
            if written == 0:
                raise interruption
            raise InterruptedWithAdvice(
                f"the same command continues from {self._path.name}, {written:,} {self._kind.done}"
            ) from interruption

        self._stopped = stopped
        return journal, watched

    @contextmanager
    def until_written(self) -> Iterator[None]:
        """Context of all work up to the written output; when it is interrupted, the file is written.

        Raises:
            InterruptedWithAdvice: the command was interrupted, and the file allows it to continue.
        """
        try:
            yield
        except KeyboardInterrupt as interruption:
            if self._stopped is None:
                raise
            self._stopped(interruption)

    def remove(self) -> None:
        """Remove the file when it belongs to the output that now exists, or is damaged."""
        if not self._may_write or not self._path.is_file():
            return
        made = read_provenance(self._output)
        with suppress(OSError):
            try:
                recorded, _ = unpack(self._path.read_bytes(), self._kind)
                is_done = made is not None and not mismatches(recorded, made)
            except InputError:
                is_done = self._is_ours()
            if is_done:
                self._path.unlink()

    def _is_ours(self) -> bool:
        """Test whether the file begins like a journal of this kind, even of another output or damaged."""
        with self._path.open("rb") as file:
            return file.read(len(self._kind.magic)) == self._kind.magic

    def _continued(self, wanted: Provenance) -> J:
        """Journal of an earlier run; an empty one, with a message, when the file cannot be used."""
        if not os.path.lexists(self._path):
            return self._make(b"")
        try:
            if not self._path.is_file() or not self._is_ours():
                raise DamagedError(f"it is no journal of a {self._kind.command}, and is left as it is")
        except (OSError, InputError) as error:
            self._may_write = False
            return self._ignored(error)
        try:
            recorded, measured = unpack(self._path.read_bytes(), self._kind)
            if strange := mismatches(recorded, wanted):
                return self._ignored(f"it is of another {self._kind.command}: {'; '.join(strange)}")
            journal = self._make(measured)
        except (OSError, ValueError, InputError) as error:
            return self._ignored(error)
        self._print(f"continuing from {self._path.name}: {len(journal):,} of its {self._kind.done}")
        return journal

    def _ignored(self, why: object) -> J:
        self._print(f"ignoring {self._path.name}: {why}")
        return self._make(b"")

    def _write(self, wanted: Provenance, journal: J) -> int:
        """Write all finished work; return its amount, or 0 when the file cannot be written."""
        measured, count = journal.snapshot(), len(journal)
        try:
            with atomic_output(self._path, is_final=False) as file:
                file.write(pack(wanted, measured, self._kind))
        except OutputError as error:
            self._print(f"{error}; an interrupted {self._kind.command} starts anew")
            self._may_write = False
            return 0
        return count

    def _print(self, text: str) -> None:
        if not self._is_quiet:
            echo(f"alula: {text}", err=True)
