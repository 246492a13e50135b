"""Non-blocking transport of bytes to and from a vehicle: UDP, TCP and serial lines."""

from __future__ import annotations

import contextlib
import os
import socket
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from alula.schemas.errors import LinkError
from alula.stages.flight.links.addresses import Address
from alula.stages.flight.links.protocol import Place

_DATAGRAM = 4096
_MAX_WAITING = 1024  # bytes that a stream has not accepted yet; beyond, whole frames are dropped
_BUFFER = 1 << 18
_AGAIN_S = 0.5  # between attempts to reopen a serial line


class Transport(Protocol):
    """A line for bytes; its methods raise LinkError when the connection is lost."""

    is_datagram: bool

    @property
    def place(self) -> Place:
        """Where the vehicle is reached, for another process."""
        ...

    def receive(self) -> tuple[bytes, Any] | None:
        """Received bytes and their sender; None if there are none."""
        ...

    def send(self, data: bytes) -> bool:
        """Send a frame, whole or not at all; returns whether it was accepted."""
        ...

    def use(self, peer: Any) -> None:
        """Send to this peer from now on."""
        ...

    def close(self) -> None:
        """Close the line."""
        ...


def open_transport(address: Address, timeout_s: float, clock: Callable[[], float]) -> Transport:
    """Open the line of an address.

    Args:
        clock: monotonic clock [s], for reopening a serial line that dropped out.

    Raises:
        UsageError: the address is incomplete.
        LinkError: it cannot be opened.
    """
    try:
        if address.scheme == "serial":
            return _Serial(*address.device_baud(), clock)
        if address.scheme == "tcp":
            return _Tcp(*address.host_port(), timeout_s)
        return _Udp(*address.host_port(), is_listening=address.scheme == "udpin")
    except OSError as error:
        raise LinkError(f"{address.scheme}:{address.place}: {error.strerror or error}") from error


def find_udp(host: str, port: int) -> tuple[socket.AddressFamily, Any]:
    """Socket family and address of a host; IPv4 if it has both, because vehicles send to 127.0.0.1.

    Raises:
        OSError: the host is unknown.
    """
    found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
    family, _, _, _, destination = min(found, key=lambda each: each[0] != socket.AF_INET)
    return family, destination


class _Udp:
    is_datagram = True

    def __init__(self, host: str, port: int, *, is_listening: bool) -> None:
        family, destination = find_udp(host, port)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._peer: Any = None if is_listening else destination
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            if is_listening:
                self._socket.bind(destination)
            else:
                self._socket.connect(destination)  # accepts packets from there only
        except OSError:
            self._socket.close()
            raise
        self._is_connected = not is_listening
        self._socket.setblocking(False)

    @property
    def place(self) -> Place:
        return Place(self._socket.fileno(), "udp" if self._is_connected else "udp to", self._peer)

    def receive(self) -> tuple[bytes, Any] | None:
        try:
            return self._socket.recvfrom(_DATAGRAM)
        except (BlockingIOError, InterruptedError):
            return None
        except OSError:  # nobody listens there now; the session counts the silence
            return None

    def send(self, data: bytes) -> bool:
        try:
            if self._is_connected:
                self._socket.send(data)
            elif self._peer is not None:
                self._socket.sendto(data, self._peer)
            return self._peer is not None
        except OSError:
            return False

    def use(self, peer: Any) -> None:
        if not self._is_connected:
            self._peer = peer

    def close(self) -> None:
        self._socket.close()


class _Stream(ABC):
    """A stream; it may accept part of a frame, and the rest is sent before the next one."""

    is_datagram = False

    def __init__(self) -> None:
        self._waiting = b""

    def send(self, data: bytes) -> bool:
        is_accepted = len(self._waiting) + len(data) <= _MAX_WAITING
        if is_accepted:
            self._waiting += data
        if self._waiting:
            try:
                self._waiting = self._waiting[self._write(self._waiting) :]
            except (BlockingIOError, InterruptedError):
                pass
            except OSError as error:
                raise LinkError(
                    f"the connection to the vehicle is lost: {error.strerror or error}"
                ) from error
        return is_accepted

    def receive(self) -> tuple[bytes, Any] | None:
        try:
            data = self._read()
        except (BlockingIOError, InterruptedError):
            return None
        except OSError as error:
            raise LinkError(f"the connection to the vehicle is lost: {error.strerror or error}") from error
        if not data:
            raise LinkError("the vehicle closed the connection")
        return data, None

    def use(self, peer: Any) -> None:  # noqa: B027  the other end of a stream is always the same
        pass

    @property
    @abstractmethod
    def place(self) -> Place:
        """See `Transport`."""

    @abstractmethod
    def _read(self) -> bytes:
        """Some of the received bytes; empty at the end, OSError if there are none."""

    @abstractmethod
    def _write(self, data: bytes) -> int:
        """Number of bytes that were accepted; OSError if none can be."""


class _Tcp(_Stream):
    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        super().__init__()
        self._socket = socket.create_connection((host, port), timeout=max(timeout_s, 0.1))
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.setblocking(False)

    @property
    def place(self) -> Place:
        return Place(self._socket.fileno(), "stream")

    def _read(self) -> bytes:
        return self._socket.recv(_DATAGRAM)

    def _write(self, data: bytes) -> int:
        return self._socket.send(data)

    def close(self) -> None:
        self._socket.close()


class _Serial(_Stream):
    """A terminal line in raw mode, 8 data bits, no parity, no flow control.

    A line that drops out, for example by a loose plug, is reopened when its device is back.
    """

    def __init__(self, device: str, baud: int, clock: Callable[[], float]) -> None:
        super().__init__()
        self._device, self._baud, self._clock = device, baud, clock
        self._again_s = 0.0
        self._file: int | None = _open_serial(device, baud)

    @property
    def place(self) -> Place:
        return Place(self._file, "stream")

    def receive(self) -> tuple[bytes, Any] | None:
        with self._opened():
            return super().receive()

    def send(self, data: bytes) -> bool:
        with self._opened():
            return super().send(data)

    @contextlib.contextmanager
    def _opened(self) -> Iterator[None]:
        """Reopen the line if it was closed; close it after an error."""
        try:
            if self._file is None:
                if self._clock() < self._again_s:
                    raise LinkError(f"the connection to the vehicle is lost: {self._device}")
                self._file = _open_serial(self._device, self._baud)
            yield
        except (LinkError, OSError) as error:
            if self._file is not None or self._clock() >= self._again_s:
                self._again_s = self._clock() + _AGAIN_S
            self.close()
            if isinstance(error, LinkError):
                raise
            raise LinkError(f"the connection to the vehicle is lost: {error.strerror or error}") from error

    def _read(self) -> bytes:
        return os.read(self._line, _DATAGRAM)

    def _write(self, data: bytes) -> int:
        return os.write(self._line, data)

    @property
    def _line(self) -> int:
        assert self._file is not None
        return self._file

    def close(self) -> None:
        file, self._file, self._waiting = self._file, None, b""
        if file is not None:
            with contextlib.suppress(OSError):
                os.close(file)


def _open_serial(device: str, baud: int) -> int:
    try:
        import termios  # not on Windows
        import tty
    except ImportError as error:
        raise LinkError("serial lines need termios; use udpin: with a router instead") from error
    speed = getattr(termios, f"B{baud}", None)
    if speed is None:
        raise LinkError(f"{device}: this system does not support {baud} baud")
    file = os.open(device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tty.setraw(file)
        mode = termios.tcgetattr(file)
        mode[2] = (mode[2] | termios.CLOCAL | termios.CREAD) & ~(
            getattr(termios, "CRTSCTS", 0) | termios.CSTOPB
        )
        mode[4] = mode[5] = speed
        termios.tcsetattr(file, termios.TCSANOW, mode)
        termios.tcflush(file, termios.TCIOFLUSH)
    except (OSError, termios.error) as error:
        os.close(file)
        reason = error.args[-1] if error.args else error  # termios.error has no strerror
        raise LinkError(f"{device}: cannot be set up as a serial line: {reason}") from error
    return file
