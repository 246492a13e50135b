"""A pipe to a process beside the flight: what it has no room for is left out, and nothing waits for it."""

from __future__ import annotations

import fcntl
import os
import select
import struct
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import BinaryIO

_LENGTH = struct.Struct("<I")
_ATOMIC = 4096  # PIPE_BUF on Linux: what is written at once is whole or not at all
_PIPE_BYTES = 2**20


class FlightPipe:
    """Starts a Python process, and hands it messages on its standard input.

    Args:
        code: what the process runs; it takes messages by `next_message`.
        arguments: of the process, from `sys.argv[1]` on.
        files: descriptors that it inherits.
        stdout: of the process, as of `subprocess.Popen`.
    """

    def __init__(
        self, code: str, arguments: Sequence[str], *, files: Sequence[int] = (), stdout: int | None = None
    ) -> None:
        self.process = subprocess.Popen(  # in a session of its own: Ctrl-C is not for it
            [sys.executable, "-P", "-c", code, *arguments],
            stdin=subprocess.PIPE,
            stdout=stdout,
            pass_fds=files,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
        )
        assert self.process.stdin is not None
        self._pipe = self.process.stdin.fileno()
        fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)

    def put(self, message: bytes, timeout_s: float = 30.0) -> None:
        """Write a message however long it is.

        Raises:
            OSError: nobody reads any more, or takes nothing for so long.
        """
        os.set_blocking(self._pipe, False)
        frame = memoryview(_LENGTH.pack(len(message)) + message)
        while frame:
            if not select.select([], [self._pipe], [], timeout_s)[1]:
                raise TimeoutError("nothing is taken")
            frame = frame[os.write(self._pipe, frame[:_ATOMIC]) :]

    def offer(self, message: bytes) -> bool:
        """Write a message if there is room for it at once; after the first `put`."""
        frame = _LENGTH.pack(len(message)) + message
        if len(frame) > _ATOMIC:
            return False
        try:
            os.write(self._pipe, frame)
        except OSError:  # full, or nobody reads any more
            return False
        return True

    def close(self, timeout_s: float) -> bool:
        """End the pipe and wait for the process, or kill it when the time is over; whether it ended well."""
        assert self.process.stdin is not None
        if self.process.stdout is not None:
            self.process.stdout.close()
        try:
            self.process.stdin.close()
            return self.process.wait(timeout_s) == 0
        except (OSError, subprocess.TimeoutExpired):
            self.process.kill()
            self.process.wait()
            with suppress(OSError):
                self.process.stdin.close()
            return False


def next_message(source: BinaryIO) -> bytes:
    """The next message; empty when there is none any more."""
    raw = source.read(_LENGTH.size)
    return source.read(_LENGTH.unpack(raw)[0]) if len(raw) == _LENGTH.size else b""
