"""The watchdog of a flight without its process, on the clock of a test."""

from __future__ import annotations

import socket

from alula.stages.flight.watchdog.companion import Process
from alula.stages.flight.watchdog.watchdog import Watchdog


class Program(Process):
    """The program of the watchdog process; keeps what it prints in `said` and what it sends in `sent`."""

    def __init__(self, loop: socket.socket, memory: int) -> None:
        super().__init__(loop, memory)
        self.said: list[str] = []
        self.sent: set[bytes] = set()

    def _take(self, message, attached):
        before = self._line
        super()._take(message, attached)
        if self._line is not before:
            send = self._line.send
            self._line.send = lambda frames: (self.sent.update(frames), send(frames))

    def say(self, words: str) -> None:
        self.said.append(words)

    def close(self) -> None:
        """Close what the end of the process would close."""
        self._loop.close()
        if self._line is not None:
            self._line.close()
            self._line = None


class WatchdogHere(Watchdog):
    """A `Watchdog` whose program runs in this process; a test calls `program.step`."""

    def _start(self, theirs, memory):
        self.program = Program(theirs.dup(), memory)

    def _meet(self):
        self.program.step(0.0)
        super()._meet()

    def _wait_for_end(self):
        """Let the program read that the loop has ended; if it takes over, tests go on with it."""
        if self.program._loop.fileno() >= 0:
            self.program.step(self.program._takeover._beat_s)
        if self.program._takeover.is_over:
            self.program.close()
