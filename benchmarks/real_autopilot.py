"""Parts of benchmarks that fly the real autopilot: vehicles side by side, `alula fly`, a page's sections."""

from __future__ import annotations

import queue
import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self, TypeVar

INDOORS = {"FS_THR_ENABLE": 3, "FS_DR_ENABLE": 1}  # it must not fly home in an emergency
_TIMED = re.compile(r" *\d+\.\d+ s  ")
_STARTING_S = 4.0  # until a program has its ports
_starting = threading.Lock()

B = TypeVar("B")


@contextmanager
def vehicle(folder: Path, parameters: dict[str, float] | None = None) -> Iterator[Any]:
    """Run the program in an empty folder; two that start at once would choose the same ports.

    Args:
        folder: of its files.
        parameters: besides `INDOORS`.
    """
    from support.vehicles.ardupilot_sitl import sitl

    _starting.acquire()
    threading.Timer(_STARTING_S, _starting.release).start()
    with sitl(folder, INDOORS | (parameters or {})) as sim:
        yield sim


def fly_batches(batches: Sequence[B], jobs: int, fly: Callable[[B], None]) -> None:
    """Fly batches in threads, each with a vehicle of its own; an error ends its batch only.

    Args:
        batches: flights of one vehicle each.
        jobs: vehicles at once.
        fly: flies a batch.
    """
    waiting: queue.Queue[B] = queue.Queue()
    for batch in batches:
        waiting.put(batch)

    def work() -> None:
        while True:
            try:
                batch = waiting.get_nowait()
            except queue.Empty:
                return
            try:
                fly(batch)
            except BaseException as error:  # noqa: BLE001  pytest.fail, too; it is missing in the table
                print(f"{type(error).__name__}: {error}", file=sys.stderr, flush=True)

    threads = [threading.Thread(target=work) for _ in range(jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


class FlyProcess:
    """`alula fly` in a process of its own; it is killed at the end.

    Args:
        words: its arguments.

    Attributes:
        heard: its lines of standard error with the times of their arrival [s].
    """

    def __init__(self, *words: str) -> None:
        command = [sys.executable, "-P", "-m", "alula.cli", "fly", *words]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        self.heard: list[tuple[float, str]] = []
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self.is_running:
            self.process.kill()
        self.process.wait()
        self._thread.join(5)
        assert self.process.stderr is not None
        self.process.stderr.close()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.heard.append((time.monotonic(), line.rstrip()))

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self.process.poll() is None

    @property
    def lines(self) -> list[str]:
        """All lines so far."""
        return [line for _, line in list(self.heard)]

    def has_said(self, text: str) -> bool:
        """Whether a line contains a text."""
        return any(text in line for line in self.lines)

    def end(self, timeout_s: float) -> int | None:
        """Wait for its end; the exit code, or None after it was terminated at the end of the time.

        Args:
            timeout_s: maximum time [s].
        """
        try:
            code: int | None = self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self.process.terminate()
            code = None
        if code is None:
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._thread.join(5)
        return code


def timed(heard: list[tuple[float, str]]) -> list[tuple[float, str]]:
    """Lines with their times [s] on this machine's clock: those that `fly` printed, "   3.21 s  words".

    The line that arrived with the smallest delay gives the difference of the clocks.

    Args:
        heard: lines with the times of their arrival [s].
    """
    printed = {line: float(line.split(" s  ")[0]) for _, line in heard if _TIMED.match(line)}
    offset = min((at - printed[line] for at, line in heard if line in printed), default=0.0)
    return [(offset + printed[line] if line in printed else at, line) for at, line in heard]


def with_section(page: str, section: str, keeps_notes: bool = False) -> str:
    """Page in which a section replaces the one of the same heading, or follows the last one.

    Args:
        page: Markdown.
        section: begins with its line "## heading".
        keeps_notes: keep what the page has below the last row of the old section's tables.
    """
    heading = section.partition("\n")[0] + "\n"
    before, found, rest = page.partition(heading)
    old, _, after = rest.partition("\n## ") if found else ("", "", "")
    if keeps_notes and "\n|" in old:
        section = section.rstrip("\n") + "\n" + old.rpartition("\n|")[2].partition("\n")[2]
    return before.rstrip("\n") + "\n\n" + section.rstrip("\n") + (f"\n\n## {after}" if after else "\n")
