"""The flight's end of its watchdog: starts the process, gives it signs of life, and learns of a takeover."""

from __future__ import annotations

import dataclasses
import marshal
import math
import socket
import subprocess
import sys
from array import array
from collections.abc import Callable
from contextlib import suppress

from alula.schemas.errors import LinkError
from alula.stages.flight.links.protocol import Link, Place, Ward
from alula.stages.flight.watchdog import companion

_START_S = 5.0  # the process starts in some hundredths of a second
_END_S = 1.0
_NOW = socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL


class Watchdog:
    """Process that orders the vehicle to stop and to land when the control loop ends or stalls.

    The loop calls `beat` once a tick. While it is in control and beats are missing for `companion.STALL_S`,
    or the process of the loop ends without `close`, the watchdog takes over. It has its own session, ignores
    the signals of a terminal, and runs before all ordinary processes where the system allows it.

    The two talk over a socket pair: the settings and the line (with its descriptor, again when it changes),
    then beats; in the other direction READY, and TOOK_OVER before the first order.

    Args:
        ward: the link.

    Attributes:
        has_ended: the process is gone.

    Raises:
        LinkError: the process does not start.
    """

    def __init__(self, ward: Ward) -> None:
        self._ward, self._place = ward, Place(None, "")
        self._has_taken_over = self._is_in_control = self.has_ended = False
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._start(theirs)
        except OSError as error:
            self._socket.close()
            raise LinkError(f"the watchdog process does not start: {error.strerror or error}") from error
        finally:
            theirs.close()
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

    def _start(self, theirs: socket.socket) -> None:
        """Start the process with its end of the socket pair."""
        self.process = subprocess.Popen(
            [sys.executable, "-I", "-S", companion.__file__, str(theirs.fileno())],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=(theirs.fileno(),),
            start_new_session=True,
        )

    def _meet(self) -> None:
        """Wait until the process is ready."""
        if self._socket.recv(1) != companion.READY:
            raise OSError("it ended")

    @property
    def has_taken_over(self) -> bool:
        """Return whether it has taken the vehicle over; never raises, never waits."""
        if not (self._has_taken_over or self.has_ended):
            try:
                message = self._socket.recv(1, _NOW)
                self._has_taken_over = message == companion.TOOK_OVER
                self.has_ended = not message
            except BlockingIOError:
                pass
            except OSError:
                self.has_ended = True
        return self._has_taken_over

    def beat(self, now_s: float, *, is_in_control: bool) -> None:
        """Give a sign of life; never raises, never waits.

        Args:
            now_s: monotonic clock [s].
            is_in_control: whether the vehicle depends on this program.
        """
        if self.has_ended:
            return
        self._is_in_control = is_in_control
        try:
            if (place := self._ward.place()) != self._place:
                self._send_place(place)
            beat = companion.BEAT.pack(now_s, is_in_control, *self._ward.reported())
            self._socket.send(companion.ALIVE + beat, _NOW)
        except BlockingIOError:  # it is held up, and has many beats to read
            pass
        except OSError:
            self.has_ended = not self.has_taken_over

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


def guard(link: Link) -> Watchdog | None:
    """Start the watchdog of a link, after `prepare`; None for a link that has none.

    Args:
        link: to the vehicle, opened and prepared.

    Raises:
        LinkError: the process does not start.
    """
    guarded: Callable[[], Ward] | None = getattr(link, "guarded", None)
    if guarded is None:
        return None
    watchdog = Watchdog(guarded())
    own = link.status.own_safety
    if own is not None:
        alone_s = math.inf if math.isnan(own.alone_s) else own.alone_s
        link.status.own_safety = dataclasses.replace(own, watched_s=min(alone_s, companion.REACTION_S))
    return watchdog
