"""Pipe to a process beside the flight; a full pipe drops messages, and the flight never waits for it."""

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
_ATOMIC = 4096  # PIPE_BUF on Linux: a write of at most this size is complete or fails
_PIPE_BYTES = 2**20


class FlightPipe:
    """Python process that receives messages on its standard input.

    Args:
        code: Python code of the process; it reads messages by `next_message`.
        arguments: arguments of the process, from `sys.argv[1]` on.
        files: descriptors that the process inherits.
    """

    def __init__(
        self, code: str, arguments: Sequence[str], *, files: Sequence[int] = (), stdout: int | None = None
    ) -> None:
        self.process = subprocess.Popen(  # in its own session, so that it does not receive Ctrl-C
            [sys.executable, "-P", "-c", code, *arguments],
            stdin=subprocess.PIPE,
            stdout=stdout,
            pass_fds=files,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))},
        )
        assert self.process.stdin is not None
        self._pipe = self.process.stdin.fileno()
        if hasattr(fcntl, "F_SETPIPE_SZ"):  # only Linux; elsewhere fewer messages fit
            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)

    def put(self, message: bytes, timeout_s: float = 30.0) -> None:
        """Write a message of any length.

        Args:
            timeout_s: maximum time without progress [s].

        Raises:
            OSError: the process has closed the pipe, or reads nothing for `timeout_s`.
        """
        os.set_blocking(self._pipe, False)
        frame = memoryview(_LENGTH.pack(len(message)) + message)
        while frame:
            if not select.select([], [self._pipe], [], timeout_s)[1]:
                raise TimeoutError("the process reads nothing")
            frame = frame[os.write(self._pipe, frame[:_ATOMIC]) :]

    def offer(self, message: bytes) -> bool:
        """Write a message if the pipe has room for it now; call `put` first.

        Args:
            message: to write; a message over 4092 bytes is never written.

        Returns:
            True if it was written.
        """
        frame = _LENGTH.pack(len(message)) + message
        if len(frame) > _ATOMIC:
            return False
        try:
            os.write(self._pipe, frame)
        except OSError:  # the pipe is full or closed
            return False
        return True

    def close(self, timeout_s: float) -> bool:
        """Close the pipe and wait for the process to end; kill it after `timeout_s`.

        Returns:
            True if the process ended without an error.
        """
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
    """Read the next message; empty at the end of the pipe."""
    raw = source.read(_LENGTH.size)
    return source.read(_LENGTH.unpack(raw)[0]) if len(raw) == _LENGTH.size else b""
