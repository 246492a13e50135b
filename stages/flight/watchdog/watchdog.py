"""The flight's end of its watchdog: starts the process, gives it signs of life, and learns of a takeover."""

from __future__ import annotations

import dataclasses
import marshal
import math
import mmap
import os
import socket
import subprocess
import sys
from array import array
from collections.abc import Callable
from contextlib import suppress

from alula.schemas.errors import LinkError
from alula.stages.flight.links.protocol import Link, Place, Ward
from alula.stages.flight.watchdog import companion

_OF_CRAZYFLIE = "alula.stages.flight.watchdog.crazyflie_companion"
_START_S = 5.0  # the process starts in some hundredths of a second
_END_S = 1.0
_LOOK = 25  # beats between two looks whether the process is there
_NOW = socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL


class Watchdog:
    """Process that orders the vehicle to stop and to land when the control loop ends or stalls.

    The loop calls `beat` once a tick. While it is in control and beats are missing for `companion.STALL_S`,
    or the process of the loop ends without `close`, the watchdog takes over. It has its own session, ignores
    the signals of a terminal, and runs before all ordinary processes where the system allows it.

    Beats, and whether it has taken over, are in shared memory, so a beat wakes nobody and needs no system
    call. A socket pair carries the settings, the line (with its descriptor, again when it changes) and the
    farewell; its end tells each of the two that the other has ended.

    Attributes:
        has_ended: the process is gone.

    Raises:
        LinkError: the process does not start.
    """

    def __init__(self, ward: Ward) -> None:
        self._ward, self._place = ward, Place(None, "")
        self._is_in_control = self.has_ended = False
        self._beats = 0
        memory = os.memfd_create("alula-watchdog")
        os.truncate(memory, companion.MEMORY_BYTES)
        self._memory = mmap.mmap(memory, companion.MEMORY_BYTES)
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._start(theirs, memory)
        except OSError as error:
            self._socket.close()
            raise LinkError(f"the watchdog process does not start: {error.strerror or error}") from error
        finally:
            theirs.close()
            os.close(memory)
        try:
            self._socket.settimeout(_START_S)
            self._socket.send(companion.SETTINGS + marshal.dumps(ward.settings))
            self._send_place(ward.place())
            self._meet()
            self._socket.setblocking(False)
        except OSError as error:
            self._socket.close()
            self.process.kill()
            self.process.wait()
            raise LinkError(f"the watchdog process does not run: {error}") from error

    def _start(self, theirs: socket.socket, memory: int) -> None:
        """Start the process with its end of the socket pair and the descriptor of the memory."""
        files = theirs.fileno(), memory
        program = ["-P", "-m", _OF_CRAZYFLIE] if self._ward.speaks_crtp else ["-I", "-S", companion.__file__]
        self.process = subprocess.Popen(
            [sys.executable, *program, *map(str, files)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=files,
            start_new_session=True,
        )

    def _meet(self) -> None:
        if self._socket.recv(1) != companion.READY:
            raise OSError("it ended")

    @property
    def has_taken_over(self) -> bool:
        """Return whether it has taken the vehicle over."""
        return bool(self._memory[companion.TAKEN_AT])

    def beat(self, now_s: float, *, is_in_control: bool) -> None:
        """Give a sign of life; never raises, never waits."""
        self._beats, self._is_in_control = self._beats + 1, is_in_control
        number, reported = self._beats, self._ward.reported()
        companion.BEAT.pack_into(self._memory, 0, number, now_s, is_in_control, *reported, number)
        try:
            if (place := self._ward.place()) != self._place:
                self._send_place(place)
            if number % _LOOK == 0 and not self.has_ended:
                self.has_ended = not self._socket.recv(1, _NOW)
        except BlockingIOError:  # nothing is to be read, or it is held up
            pass
        except OSError:
            self.has_ended = True

    def close(self) -> None:
        """End the process. If this program is still in control, the watchdog takes over instead."""
        if not (self.has_ended or self._is_in_control):
            try:
                self._socket.send(companion.FAREWELL, _NOW)
            except OSError:
                self.has_ended = True
        self._socket.close()
        self._wait_for_end()

    def _wait_for_end(self) -> None:
        with suppress(subprocess.TimeoutExpired):  # it may be landing the vehicle
            self.process.wait(_END_S)

    def _send_place(self, place: Place) -> None:
        if place.file is None:
            return
        attached = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array("i", [place.file]))]
        self._socket.sendmsg([companion.LINE + marshal.dumps((place.kind, place.peer))], attached)
        self._place = place


def is_possible() -> bool:
    """Whether the system has memory shared without a file and sockets that keep records apart: Linux does."""
    return hasattr(os, "memfd_create") and hasattr(socket, "SOCK_SEQPACKET")


def guard(link: Link) -> Watchdog | None:
    """Start the watchdog of a link, after `prepare`; None where the link has none or none is possible.

    Raises:
        LinkError: the process does not start.
    """
    guarded: Callable[[], Ward | None] | None = getattr(link, "guarded", None)
    ward = None if guarded is None or not is_possible() else guarded()
    if ward is None:
        return None
    watchdog = Watchdog(ward)
    own = link.status.own_safety
    if own is not None:
        alone_s = math.inf if math.isnan(own.alone_s) else own.alone_s
        link.status.own_safety = dataclasses.replace(own, watched_s=min(alone_s, companion.REACTION_S))
    return watchdog
