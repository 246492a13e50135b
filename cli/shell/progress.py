"""Progress of a command: a bar on a terminal, a line every ten seconds elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from alula.cli.shell.options import Common
from alula.cli.shell.present import echo
from alula.schemas.progress import Progress

PERIOD_S = 10.0  # between two lines
_LEAST_SHARE = 0.03  # below it there is no estimate of the time left
_SMOOTHING = 0.5  # weight of the newest estimate


class ProgressLines:
    """Progress callback for logs: at most one line every `PERIOD_S`, with an estimate of the time left.

    The whole time is estimated as the elapsed time over the fraction done, smoothed over the lines.

    Args:
        name: of the output, at the start of each line.
        clock: time that never decreases [s].
    """

    def __init__(
        self,
        name: str,
        clock: Callable[[], float] = time.monotonic,
        write: Callable[[str], None] = lambda line: echo(line, err=True),
    ) -> None:
        self._name, self._clock, self._write = name, clock, write
        self._start = self._last = clock()
        self._whole_s: float | None = None

    def __call__(self, done: int, total: int) -> None:
        """Report (parts done, total parts); a total of at most 1 means that it is unknown."""
        now = self._clock()
        if now - self._last < PERIOD_S:
            return
        self._last = now
        elapsed_s = now - self._start
        if total <= 1:
            self._write(f"{self._name}: {_duration(elapsed_s)} so far")
            return
        share = min(max(done / total, 0.0), 1.0)
        line = f"{self._name}: {100 * share:.0f} % after {_duration(elapsed_s)}"
        if share >= _LEAST_SHARE:
            newest_s = elapsed_s / share
            if self._whole_s is not None:
                newest_s = _SMOOTHING * newest_s + (1 - _SMOOTHING) * self._whole_s
            self._whole_s = newest_s
            line += f", about {_duration(max(0.0, newest_s - elapsed_s))} left"
        self._write(line)


def _duration(seconds: float) -> str:
    """Format a time for reading: 40 s, 2 min 10 s or 3 h 5 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


@contextmanager
def shown_progress(common: Common) -> Iterator[Progress]:
    """Context with a progress callback that draws a bar on a terminal and prints lines on stderr elsewhere.

    The callback takes (done, total); a total of at most 1 means that it is unknown. With --quiet it shows
    nothing, and with --json no bar.
    """
    is_terminal = sys.stderr.isatty()
    if common.quiet or (common.json and is_terminal):
        yield lambda done, total: None
        return
    if not is_terminal:
        yield ProgressLines(common.output.name)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (
        *(TextColumn(common.output.name, markup=False), BarColumn(), TaskProgressColumn()),
        *(TimeRemainingColumn(compact=True), TextColumn("left")),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        task = bars.add_task("", total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total if total > 1 else None)
