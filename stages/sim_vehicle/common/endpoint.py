"""The sockets of the simulated vehicle, and real time: the only impure part of it."""

from __future__ import annotations

import ipaddress
import select
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from alula.schemas.errors import LinkError, UsageError
from alula.stages.sim_vehicle.common.airframe import TICK_S

KINDS = ("udpout", "udpin", "tcpin")
_PERIOD_S = 2 * TICK_S
_MOST_DATAGRAMS = 1000  # at once: a flood must not stop the vehicle
_Address = tuple[Any, ...]
_LATE_S = 0.25  # a machine that stood still for longer is not caught up with


class Endpoint(Protocol):
    """Where packets come from and go to."""

    name: str

    def fileno(self) -> int:
        """What to wait on."""
        ...

    def read(self) -> list[bytes]:
        """All that has come; never waits."""
        ...

    def write(self, packets: list[bytes]) -> None:
        """Send; what cannot be sent is lost."""
        ...

    def close(self) -> None:
        """Let go."""
        ...


def open_endpoint(link: str, *, allow_remote: bool = False) -> Endpoint:
    """Open `udpout:HOST:PORT`, `udpin:HOST:PORT` or `tcpin:HOST:PORT`.

    Raises:
        UsageError: it is none of these, or not on this machine and not allowed.
        LinkError: it cannot be opened.
    """
    kind, _, place = link.partition(":")
    host, _, port_text = place.rpartition(":")
    if kind not in KINDS or not host or not port_text.isdecimal() or not 0 <= int(port_text) <= 65535:
        forms = ", ".join(f"{kind}:HOST:PORT" for kind in KINDS)
        raise UsageError(f"link {link!r}: not one of {forms}")
    try:
        found = socket.getaddrinfo(host.strip("[]"), int(port_text), type=socket.SOCK_DGRAM)
    except OSError as error:
        raise LinkError(f"link {link}: {error.strerror or error}") from error
    family, *_, address = found[0]
    if not allow_remote and not ipaddress.ip_address(str(address[0]).partition("%")[0]).is_loopback:
        raise UsageError(f"link {link}: not on this machine; --allow-remote allows it")
    try:
        return _Tcp(family, address) if kind == "tcpin" else _Udp(family, address, kind)
    except OSError as error:
        raise LinkError(f"link {link}: {error.strerror or error}") from error


def open_mocap(address: str, *, allow_remote: bool = False) -> Endpoint:
    """Where datagrams of motion capture go, `udp:HOST:PORT`; errors as of `open_endpoint`."""
    scheme, _, place = address.partition(":")
    if scheme != "udp":
        raise UsageError(f"mocap {address!r}: not udp:HOST:PORT")
    return open_endpoint(f"udpout:{place}", allow_remote=allow_remote)


class _Udp:
    """Datagrams: with one place only, or with whoever wrote last."""

    def __init__(self, family: int, address: _Address, kind: str) -> None:
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._waits = kind == "udpin"
        self._peer: _Address | None = None
        try:
            if self._waits:
                self._socket.bind(address)
            else:
                self._socket.connect(address)  # nobody else is heard then
        except OSError:
            self._socket.close()
            raise
        where = self._socket.getsockname() if self._waits else address
        self.name = f"{kind}:{where[0]}:{where[1]}"

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> list[bytes]:
        found: list[bytes] = []
        while len(found) < _MOST_DATAGRAMS:
            try:
                data, self._peer = self._socket.recvfrom(65536)
            except ConnectionError:
                continue  # nobody listens there yet
            except OSError:
                break
            found.append(data)
        return found

    def write(self, packets: list[bytes]) -> None:
        for packet in packets:
            with suppress(OSError):
                if not self._waits:
                    self._socket.send(packet)
                elif self._peer is not None:
                    self._socket.sendto(packet, self._peer)

    def close(self) -> None:
        self._socket.close()


class _Tcp:
    """A stream to one client at a time; a new one takes the place of an old one."""

    def __init__(self, family: int, address: _Address) -> None:
        self._listening = socket.socket(family, socket.SOCK_STREAM)
        try:
            self._listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listening.bind(address)
            self._listening.listen(1)
        except OSError:
            self._listening.close()
            raise
        self._listening.setblocking(False)
        self._client: socket.socket | None = None
        self._unsent = b""
        where = self._listening.getsockname()
        self.name = f"tcpin:{where[0]}:{where[1]}"

    def fileno(self) -> int:
        return (self._client or self._listening).fileno()

    def read(self) -> list[bytes]:
        with suppress(OSError):
            client, _ = self._listening.accept()
            client.setblocking(False)
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._drop()
            self._client = client
        if self._client is None:
            return []
        try:
            data = self._client.recv(65536)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._drop()
            return []
        return [data]

    def write(self, packets: list[bytes]) -> None:
        if self._client is None:
            return
        self._unsent += b"".join(packets)
        try:
            sent = self._client.send(self._unsent)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._drop()
            return
        self._unsent = self._unsent[sent:]
        if len(self._unsent) > 1 << 20:  # nobody reads
            self._drop()

    def close(self) -> None:
        self._drop()
        self._listening.close()

    def _drop(self) -> None:
        if self._client is not None:
            self._client.close()
        self._client, self._unsent = None, b""


class Flown(Protocol):
    """What `serve` keeps alive."""

    def receive(self, data: bytes) -> None:
        """Bytes have come."""
        ...

    def advance(self, to_s: float) -> list[bytes]:
        """Live until a time since boot."""
        ...

    def mocap(self) -> bytes | None:
        """What motion capture sees, when it is time."""
        ...


def serve(
    vehicle: Flown,
    endpoint: Endpoint,
    *,
    mocap: Endpoint | None = None,
    duration_s: float | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> float:
    """Let a vehicle live in real time; the time it lost to a busy machine [s]."""
    begin = time.monotonic()
    lost_s = 0.0
    due = begin
    while not stop():
        due += _PERIOD_S
        now = time.monotonic()
        if now - due > _LATE_S:
            lost_s += now - due
            due = now
        while (wait_s := due - time.monotonic()) > 0:
            ready, _, _ = select.select([endpoint], [], [], wait_s)
            if ready:
                for data in endpoint.read():
                    vehicle.receive(data)
        for data in endpoint.read():
            vehicle.receive(data)
        lived_s = due - begin - lost_s
        endpoint.write(vehicle.advance(lived_s))
        if mocap is not None and (picture := vehicle.mocap()) is not None:
            mocap.write([picture])
        if duration_s is not None and lived_s >= duration_s:
            break
    return lost_s
