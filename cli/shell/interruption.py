"""Handling of Ctrl-C and SIGTERM: immediate where safe, delayed in an import, ignored after the output."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_RETRY_S = 0.02
_IMPORT_SYSTEM = "<frozen importlib._bootstrap>"
_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class InterruptedWithAdvice(KeyboardInterrupt):
    """An interruption with one line of advice for the user.

    Only the text of this class is printed; other code may add text to a KeyboardInterrupt that passes it.
    """


@contextmanager
def handlers_kept() -> Iterator[None]:
    """Context for an import that replaces signal handlers: glog, in pycolmap, would print a stack and die."""
    before = {number: signal.getsignal(number) for number in _SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class Interruption:
    """Signal handler that raises KeyboardInterrupt where the program can handle it.

    Inside an import it waits, because extension modules abort and class bodies wrap the exception. After an
    output has appeared under its name it does nothing, and the command ends with its own exit code.
    """

    def __init__(self) -> None:
        self.came = False
        self._too_late = False

    def install(self) -> None:
        """Handle SIGINT and SIGTERM, except those that a background job inherited as ignored."""
        for number in (*_SIGNALS, signal.SIGALRM):
            if signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, self)

    def ignore(self) -> None:
        """Ignore all signals during the exit, in which Python would restore the default handlers."""
        for number in (*_SIGNALS, signal.SIGALRM):
            signal.signal(number, signal.SIG_IGN)

    def __call__(self, signum: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt, now or at the end of the current import."""
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
        """Context for the moment when an output appears; if that fails, interruptions count again."""
        self._too_late = True
        try:
            yield
        except BaseException:
            self._too_late = False
            raise
