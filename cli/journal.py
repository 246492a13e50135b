"""The file beside an output that lets an interrupted merge continue when its command is repeated."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

import click

from alula.cli.interruption import InterruptedWithAdvice
from alula.cli.options import Common
from alula.schemas.atomic import atomic_output
from alula.schemas.errors import DamagedError, InputError, OutputError
from alula.schemas.journal import MAGIC, SUFFIX, pack, strangeness, unpack
from alula.schemas.provenance import Provenance, read_provenance

if TYPE_CHECKING:
    from alula import _core

Progress = Callable[[int, int], None]

PERIOD_S = 30.0  # between two writes
LEAST_S = 3.0  # what a shorter run had measured is not worth a file
MOST_SHARE = 0.02  # of the time may go into writing


class JournalFile:
    """`OUTPUT.journal`: written now and then and when interrupted, taken up by the same command again.

    A file of that name that is no journal is neither read nor replaced nor removed. What is taken from a
    journal only saves time: one of another merge, or whose checksum is wrong, is left aside.
    """

    def __init__(self, common: Common) -> None:
        self._output = common.output
        self._path = common.output.parent / (common.output.name + SUFFIX)
        self._is_quiet = common.quiet
        self._may_write = not common.dry_run
        self._wanted: Provenance | None = None

    def begin(self, wanted: Provenance) -> None:
        """Learn the provenance of the output that is to be made."""
        self._wanted = wanted

    @contextmanager
    def kept(self, progress: Progress) -> Iterator[tuple[_core.MergeJournal, Progress]]:
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
                f"the same command continues from {self._path.name}, {written:,} measurements"
            ) from interruption

    def remove(self) -> None:
        """Remove the file when it is about the output that is there now, or damaged."""
        if not self._may_write or not self._path.is_file():
            return
        made = read_provenance(self._output)
        with suppress(OSError):
            try:
                recorded, _ = unpack(self._path.read_bytes())
                is_done = made is not None and not strangeness(recorded, made)
            except InputError:
                is_done = self._is_ours()
            if is_done:
                self._path.unlink()

    def _is_ours(self) -> bool:
        """Whether the file is a journal, of whatever merge and however damaged."""
        with self._path.open("rb") as file:
            return file.read(len(MAGIC)) == MAGIC

    def _taken_up(self, wanted: Provenance) -> _core.MergeJournal:
        """What an earlier run had measured; nothing, and a word why, when the file is of no use."""
        from alula import _core

        if not os.path.lexists(self._path):
            return _core.MergeJournal()
        try:
            if not self._path.is_file() or not self._is_ours():
                raise DamagedError("it is no journal of a merge, and is left as it is")
        except (OSError, InputError) as error:
            self._may_write = False
            return self._ignored(error)
        try:
            recorded, measured = unpack(self._path.read_bytes())
            if strange := strangeness(recorded, wanted):
                return self._ignored(f"it is of another merge: {'; '.join(strange)}")
            journal = _core.MergeJournal(measured)
        except (OSError, ValueError, InputError) as error:
            return self._ignored(error)
        self._say(f"continuing from {self._path.name}: {len(journal):,} of its measurements")
        return journal

    def _ignored(self, why: object) -> _core.MergeJournal:
        from alula import _core

        self._say(f"ignoring {self._path.name}: {why}")
        return _core.MergeJournal()

    def _write(self, wanted: Provenance, journal: _core.MergeJournal) -> int:
        """Write all measurements so far; how many, or 0 when that cannot be done."""
        measured, count = journal.snapshot(), len(journal)
        try:
            with atomic_output(self._path, is_final=False) as file:
                file.write(pack(wanted, measured))
        except OutputError as error:
            self._say(f"{error}; an interrupted merge starts anew")
            self._may_write = False
            return 0
        return count

    def _say(self, text: str) -> None:
        """One line on stderr."""
        if not self._is_quiet:
            click.echo(f"alula: {text}", err=True)
