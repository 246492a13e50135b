"""Sockets and real time of the simulated vehicle, the only part with side effects."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Protocol

from alula.schemas.errors import LinkError, UsageError
from alula.stages.loopback import is_loopback
from alula.stages.sim_vehicle.common.airframe import TICK_S

KINDS = ("udpout", "udpin", "tcpin")
_PERIOD_S = 2 * TICK_S
_MAX_DATAGRAMS = 1000  # in one call: a flood must not stop the vehicle
_Address = tuple[Any, ...]
_LATE_S = 0.25  # a longer delay of the machine is skipped, not caught up


class Endpoint(Protocol):
    """One end of a link that sends and receives packets."""

    name: str

    def fileno(self) -> int:
        """File descriptor for `select`."""
        ...

    def read(self) -> list[bytes]:
        """All received packets; never blocks."""
        ...

    def write(self, packets: list[bytes]) -> None:
        """Send packets; those that cannot be sent are lost."""
        ...

    def close(self) -> None:
        """Close the sockets."""
        ...


def open_endpoint(link: str, *, allow_remote: bool = False) -> Endpoint:
    """Open `udpout:HOST:PORT`, `udpin:HOST:PORT` or `tcpin:HOST:PORT`.

    Raises:
        UsageError: the address has another form, or is on another machine without permission.
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
    if not allow_remote and not is_loopback(str(address[0]).partition("%")[0]):
        raise UsageError(f"link {link}: not on this machine; pass --allow-remote to allow it")
    try:
        return _Tcp(family, address) if kind == "tcpin" else _Udp(family, address, kind)
    except OSError as error:
        raise LinkError(f"link {link}: {error.strerror or error}") from error


def open_mocap(address: str, *, allow_remote: bool = False) -> Endpoint:
    """Open the endpoint that datagrams of motion capture are sent to; errors as in `open_endpoint`.

    Args:
        address: `udp:HOST:PORT`.
    """
    scheme, _, place = address.partition(":")
    if scheme != "udp":
        raise UsageError(f"mocap {address!r}: must be udp:HOST:PORT")
    return open_endpoint(f"udpout:{place}", allow_remote=allow_remote)


class _Udp:
    """Datagrams, to and from one address (udpout) or the last sender (udpin)."""

    def __init__(self, family: int, address: _Address, kind: str) -> None:
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._waits = kind == "udpin"
        self._peer: _Address | None = None
        try:
            if self._waits:
                self._socket.bind(address)
            else:
                self._socket.connect(address)  # then it receives from this address only
        except OSError:
            self._socket.close()
            raise
        where = self._socket.getsockname() if self._waits else address
        self.name = f"{kind}:{where[0]}:{where[1]}"

    def fileno(self) -> int:
        return self._socket.fileno()

    def read(self) -> list[bytes]:
        found: list[bytes] = []
        while len(found) < _MAX_DATAGRAMS:
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
    """A stream to one client at a time; a new client replaces the old one."""

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


class Vehicle(Protocol):
    """A simulated vehicle that `serve` can run."""

    def receive(self, data: bytes) -> None:
        """Process received bytes."""
        ...

    def advance(self, to_s: float) -> list[bytes]:
        """Simulate up to a time since boot [s]; returns the packets to send."""
        ...

    def mocap(self) -> bytes | None:
        """Datagram of motion capture if one is due, else None."""
        ...


def serve(
    vehicle: Vehicle,
    endpoint: Endpoint,
    *,
    mocap: Endpoint | None = None,
    duration_s: float | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> float:
    """Run a vehicle in real time.

    Args:
        mocap: where its motion capture is sent; None for none.
        stop: polled in every period; True stops it.

    Returns:
        The time that was not simulated because the machine was too slow [s].
    """
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
        time_s = due - begin - lost_s
        endpoint.write(vehicle.advance(time_s))
        if mocap is not None and (datagram := vehicle.mocap()) is not None:
            mocap.write([datagram])
        if duration_s is not None and time_s >= duration_s:
            break
    return lost_s
