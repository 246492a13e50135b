"""`alula fly` as a process of its own, for the real programs that `tests/sitl` flies."""

import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager

import pytest

from alula.schemas.artifacts.artifact import write_artifact

LOOSE = ("--stale", "0.4", "--latency", "0.05")  # the machine may have other work than both programs


class Fly:
    """`alula fly` in a process of its own.

    Attributes:
        lines: its lines of standard error with their times [s].
    """

    def __init__(self, link, folder, *more, plan, cover):
        x, y, _ = plan["coefficient"][0, :3, 0]
        write_artifact(folder / "plan.npz", plan)
        write_artifact(folder / "cover.npz", cover)
        command = [
            *(sys.executable, "-P", "-m", "alula.cli", "fly", str(folder / "plan.npz")),
            *("--map", str(folder / "cover.npz"), "--origin", f"{-x} {-y} 0"),
            *("--link", link, "-o", str(folder / "f.run.mcap"), *LOOSE),
            *("--allow-other-map", *more),  # the plan is not made by `alula plan` in the cover
        ]
        self.lines = []
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self):
        for line in self.process.stderr:
            self.lines.append((time.monotonic(), line.rstrip()))

    def at(self, text):
        """When a text was printed first [s]; None if it was not."""
        return next((at for at, line in list(self.lines) if text in line), None)

    def wait_for(self, text, timeout_s=150.0):
        """Wait until a text is printed; returns when it was [s]."""
        end_s = time.monotonic() + timeout_s
        while (at := self.at(text)) is None:
            if self.process.poll() is not None and self.at(text) is None:
                pytest.fail(f"{text!r} was not printed:\n{self.said}")
            if time.monotonic() > end_s:
                pytest.fail(f"{text!r} was not printed in time:\n{self.said}")
            time.sleep(0.02)
        return at

    @property
    def said(self):
        return "\n".join(line for _, line in self.lines)

    def interrupt(self):
        self.process.send_signal(signal.SIGINT)

    def end(self, timeout_s=90.0):
        """Wait for its end; returns the exit code."""
        self.process.wait(timeout_s)
        self._thread.join(5)
        return self.process.returncode

    def close(self):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait(5)
        self._thread.join(5)
        self.process.stdout.close()
        self.process.stderr.close()


@contextmanager
def fly(link, folder, *more, plan, cover):
    """A flight over a link; it is killed at the end."""
    running = Fly(link, folder, *more, plan=plan, cover=cover)
    try:
        yield running
    finally:
        running.close()
