"""Start of the program: an interruption ends it with one line even while its modules are imported."""

from __future__ import annotations

import os
import signal
from types import FrameType


def _stop(signum: int, frame: FrameType | None) -> None:
    os.write(2, b"alula: interrupted\n")
    os._exit(130)


def main() -> None:
    """Run the program; `cli.main` replaces the handlers of signals by its own."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _stop)
    from alula.cli.main import main as run

    run()
