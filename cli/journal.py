"""The file beside an output that lets an interrupted command continue when it is repeated."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Generic, Protocol, TypeVar

import click

from alula.cli.interruption import InterruptedWithAdvice
from alula.cli.options import Common
from alula.schemas.atomic import atomic_output
from alula.schemas.errors import DamagedError, InputError, OutputError
from alula.schemas.journal import SUFFIX, JournalKind, mismatches, pack, unpack
from alula.schemas.progress import Progress
from alula.schemas.provenance import Provenance, read_provenance

PERIOD_S = 30.0  # between two writes
LEAST_S = 3.0  # what a shorter run had measured is not worth a file
MOST_SHARE = 0.02  # of the time may go into writing


class Journal(Protocol):
    """What a command has done so far: how much, and as bytes that it can be made of again."""

    def __len__(self) -> int: ...

    def snapshot(self) -> bytes:
        """All of it."""
        ...


J = TypeVar("J", bound=Journal)


class JournalFile(Generic[J]):
    """`OUTPUT.journal`: written now and then and when interrupted, taken up by the same command again.

    A file of that name that is no journal is neither read nor replaced nor removed. What is taken from a
    journal only saves time: one of another output, or whose checksum is wrong, is left aside.

    Args:
        common: the shared options.
        kind: whose journals these are.
        make: makes a journal of a snapshot, an empty one of no bytes; ValueError where they are none.
    """

    def __init__(self, common: Common, kind: JournalKind, make: Callable[[bytes], J]) -> None:
        self._kind, self._make = kind, make
        self._output = common.output
        self._path = common.output.parent / (common.output.name + SUFFIX)
        self._is_quiet = common.quiet
        self._may_write = not common.dry_run
        self._wanted: Provenance | None = None

    def begin(self, wanted: Provenance) -> None:
        """Learn the provenance of the output that is to be made."""
        self._wanted = wanted

    @contextmanager
    def kept(self, progress: Progress) -> Iterator[tuple[J, Progress]]:
        """The journal to measure with, and `progress` that also writes the file when it is time.

        Raises:
            InterruptedWithAdvice: when the file is there to continue from.
        """
        assert self._wanted is not None
        wanted, journal = self._wanted, self._taken_up(self._wanted)
        written = len(journal)
        start = time.monotonic()
        due = start + PERIOD_S

        def write() -> None:
            nonlocal written, due
            before = time.monotonic()
            if self._may_write and len(journal) > written:
                written = self._write(wanted, journal) or written
            now = time.monotonic()
            due = now + max(PERIOD_S, (now - before) / MOST_SHARE)

        def watched(done: int, total: int) -> None:
            progress(done, total)
            if time.monotonic() >= due:
                write()

        try:
            yield journal, watched
        except KeyboardInterrupt as interruption:
            if time.monotonic() - start >= LEAST_S:
                write()
            if written == 0:
                raise
            raise InterruptedWithAdvice(
                f"the same command continues from {self._path.name}, {written:,} {self._kind.done}"
            ) from interruption

    def remove(self) -> None:
        """Remove the file when it is about the output that is there now, or damaged."""
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
        """Whether the file is a journal, of whatever output and however damaged."""
        with self._path.open("rb") as file:
            return file.read(len(self._kind.magic)) == self._kind.magic

    def _taken_up(self, wanted: Provenance) -> J:
        """What an earlier run had done; nothing, and a word why, when the file is of no use."""
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
        self._say(f"continuing from {self._path.name}: {len(journal):,} of its {self._kind.done}")
        return journal

    def _ignored(self, why: object) -> J:
        self._say(f"ignoring {self._path.name}: {why}")
        return self._make(b"")

    def _write(self, wanted: Provenance, journal: J) -> int:
        """Write all that is done so far; how much, or 0 when that cannot be done."""
        measured, count = journal.snapshot(), len(journal)
        try:
            with atomic_output(self._path, is_final=False) as file:
                file.write(pack(wanted, measured, self._kind))
        except OutputError as error:
            self._say(f"{error}; an interrupted {self._kind.command} starts anew")
            self._may_write = False
            return 0
        return count

    def _say(self, text: str) -> None:
        """One line on stderr."""
        if not self._is_quiet:
            click.echo(f"alula: {text}", err=True)
