"""Ctrl-C and SIGTERM: at once where that is safe, a moment later in an import, never too late."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_RETRY_S = 0.02
_IMPORT_SYSTEM = "<frozen importlib._bootstrap>"
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class InterruptedWithAdvice(KeyboardInterrupt):
    """An interruption after which there is something to do, said in one line.

    Only this one's text is for users: other code may word an interruption that passed through it.
    """


class Interruption:
    """Signal handler that raises KeyboardInterrupt where the program can stand it.

    Inside an import it waits: extension modules abort and class bodies wrap the exception. Once an
    output has appeared under its name it comes too late: the command ends with its own exit code.
    """

    def __init__(self) -> None:
        self.came = False
        self._too_late = False

    def install(self) -> None:
        """Take over SIGINT and SIGTERM, but leave ignored what a background job was told to ignore."""
        for number in (*_SIGNALS, signal.SIGALRM):
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self)

    def ignore(self) -> None:
        """Let nothing disturb the exit; Python would restore the default handlers while it ends."""
        for number in (*_SIGNALS, signal.SIGALRM):
            signal.signal(number, signal.SIG_IGN)

    def __call__(self, signum: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt, now or when the import that is going on has ended."""
        self.came = True
        if self._too_late:
            return
        while frame is not None:
            if frame.f_code.co_filename == _IMPORT_SYSTEM:
                signal.setitimer(signal.ITIMER_REAL, _RETRY_S)
                return
            frame = frame.f_back
        raise KeyboardInterrupt

    @contextmanager
    def appearing(self) -> Iterator[None]:
        """Around the moment when an output appears; if that fails, interruptions count again."""
        self._too_late = True
        try:
            yield
        except BaseException:
            self._too_late = False
            raise
