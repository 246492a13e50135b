"""Servers of views beside a flight: processes on loopback that the flight feeds and never waits for."""

from __future__ import annotations

import socket
import subprocess
import threading

from alula.schemas.errors import OutputError, UsageError
from alula.stages.flight.recorder.pipe import FlightPipe

HOST = "127.0.0.1"
NICE = 10  # of the processes, below the flight
_READY_S = 30.0  # maximum time to import the server's library on a busy machine


def open_served(option: str, port: int, code: str, head: bytes) -> tuple[FlightPipe, str]:
    """Start a server's process and wait until clients can connect to it.

    The process listens on loopback only, and ends when the pipe is closed.

    Args:
        code: of the process: it reads `head` and all messages from its standard input, with `next_message`,
            and writes its port as a line to its standard output when it listens.

    Returns:
        The pipe to the process, and its port as text.

    Raises:
        UsageError: the port is taken.
        OutputError: the process does not start.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError as error:
            raise UsageError(f"{option} {port}: {error.strerror}") from error
    pipe = FlightPipe(code, (str(port),), stdout=subprocess.PIPE)
    assert pipe.process.stdout is not None
    watchdog = threading.Timer(_READY_S, pipe.process.kill)
    watchdog.daemon = True
    watchdog.start()
    try:
        pipe.put(head, _READY_S)
        port_line = pipe.process.stdout.readline().decode().strip()
    except OSError:
        port_line = ""
    finally:
        watchdog.cancel()
    if not port_line:
        pipe.close(0.0)
        raise OutputError(f"{option}: the process of the view did not start")
    return pipe, port_line
