"""Program of the watchdog process of a Crazyflie: the takeover of `companion` in packets of CRTP.

A Crazyflie follows plans of its own high-level commander without a radio. So two commands suffice: back
to where it is, then land. They need a line of their own. A radio or a cable belongs to one process, so cflib
opens it when the program of the flight has ended. If that has only stalled, nothing can be done.
"""

from __future__ import annotations

import marshal
import signal
import socket
import struct
import sys
import time
from typing import Any, Protocol

from alula.stages.flight.watchdog import companion

HOLD_S = 1.5  # duration of the plan back to where the vehicle is
SINK_M_S = 0.3
_HIGH_LEVEL, _SETPOINTS, _META = 8, 7, 1
_GO_TO, _LAND = 4, 10
_SAFE = 0x0C  # bits of the header that are always set
_REPEAT_S = 0.05
_OPEN_S = 0.2  # between attempts to open the radio


def _packet(port: int, channel: int, data: bytes) -> bytes:
    return bytes((port << 4 | _SAFE | channel,)) + data


def hold_packets() -> list[bytes]:
    """Packets of a plan that leads back to the present position, and of the end of set-points."""
    plan = struct.pack("<BBBfffff", _GO_TO, 0, 1, 0.0, 0.0, 0.0, 0.0, HOLD_S)
    return [_packet(_HIGH_LEVEL, 0, plan), _packet(_SETPOINTS, _META, struct.pack("<BI", 0, 0))]


def land_packets(floor_m: float) -> list[bytes]:
    """Packets of a plan that lands.

    Args:
        floor_m: height at which the motors stop, in the vehicle's frame [m].
    """
    plan = struct.pack("<BBf?f?f", _LAND, 0, floor_m, False, 0.0, True, SINK_M_S)
    return [_packet(_HIGH_LEVEL, 0, plan)]


class Answers:
    """What the high-level commander has accepted, in place of `companion.Frames`."""

    def __init__(self) -> None:
        self.mode: int | None = None
        self.stamp = 0
        self.forget()

    def forget(self) -> None:
        """Forget what was heard."""
        self.accepted: set[int] = set()

    def take(self, data: bytes, *, is_datagram: bool) -> None:
        """Read one packet; those that are no answer of the high-level commander are ignored."""
        del is_datagram
        if len(data) >= 5 and data[0] >> 4 == _HIGH_LEVEL and data[4] == 0:
            self.accepted.add(data[1])


class Takeover(companion.Takeover):
    """The takeover of a Crazyflie: it holds, and lands `companion.STOPPING_S` later.

    Args:
        settings: `floor_m`, height at which it stood [m].
    """

    frames: Answers  # type: ignore[assignment]

    def __init__(self, settings: dict[str, Any]) -> None:
        names = {"control": 0, "stopping": 1, "landing": 2, "stop_name": "hold", "land_name": "land"}
        super().__init__({"system": 0, "component": 0, "vehicle": 0, "key": None, "link": 0} | names)
        self.frames = Answers()
        self._floor_m = settings["floor_m"]

    def is_missing(self, now_s: float) -> bool:
        """Return whether the loop should be in control of the vehicle, and its program has ended."""
        return self._is_gone and super().is_missing(now_s)

    def poll(self, now_s: float) -> list[bytes]:
        """Packets to send now."""
        if self.began_s is None or self.is_over:
            return []
        lands = now_s >= self._lands_s
        if (_LAND if lands else _GO_TO) in self.frames.accepted:
            return self._end("watchdog: the vehicle lands") if lands else []
        if now_s > self._ends_s:
            return self._end("watchdog: the vehicle did not confirm that it lands")
        if now_s - self._sent_s < _REPEAT_S:
            return []
        self._sent_s = now_s
        return land_packets(self._floor_m) if lands else hold_packets()


class UdpLine:
    """A line of its own to a simulated vehicle.

    Args:
        address: host and port.
    """

    is_datagram = True

    def __init__(self, address: tuple[str, int]) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect(address)

    def send(self, packets: list[bytes]) -> None:
        """Send packets; those for which there is no room are dropped."""
        for packet in packets:
            try:
                self._socket.send(packet)
            except OSError:  # the commands are repeated
                continue

    def receive(self) -> bytes:
        """A received packet; empty if there is none."""
        try:
            return self._socket.recv(companion.MESSAGE_BYTES)
        except OSError:
            return b""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class RadioLine:
    """A line by cflib's driver, which is opened for the first packets.

    Args:
        uri: as for cflib.
    """

    is_datagram = True

    def __init__(self, uri: str) -> None:
        import cflib.crtp  # now: it takes longer than the vehicle may wait

        if not cflib.crtp.CLASSES:
            cflib.crtp.init_drivers()
        self._uri, self._crtp = uri, cflib.crtp
        self._driver: Any = None
        self._tried_s = -1e9

    def send(self, packets: list[bytes]) -> None:
        """Send packets, with the radio opened; those that cannot be sent are dropped."""
        from cflib.crtp.crtpstack import CRTPPacket

        if not packets or not self._is_open():
            return
        for packet in packets:
            self._driver.send_packet(CRTPPacket(packet[0], packet[1:]))

    def receive(self) -> bytes:
        """A received packet; empty if there is none."""
        found = None if self._driver is None else self._driver.receive_packet(0)
        return b"" if found is None else bytes((found.header,)) + bytes(found.data)

    def close(self) -> None:
        """Close the radio."""
        if self._driver is not None:
            self._driver.close()

    def _is_open(self) -> bool:
        now_s = time.monotonic()
        if self._driver is None and now_s - self._tried_s >= _OPEN_S:
            self._tried_s = now_s
            try:
                self._driver = self._crtp.get_link_driver(self._uri)
            except Exception:  # noqa: BLE001  cflib raises plain ones; it is tried again
                return False
        return self._driver is not None


class _Line(Protocol):
    is_datagram: bool

    def send(self, packets: list[bytes], /) -> None: ...
    def receive(self) -> bytes: ...
    def close(self) -> None: ...


class Process(companion.Process):
    """The process: it has a line of its own, so the loop sends only the settings."""

    _line: _Line | None  # type: ignore[assignment]

    def _take(self, message: bytes, attached: list[tuple[int, int, bytes]]) -> None:
        if message[:1] != companion.SETTINGS:
            super()._take(message, attached)
            return
        settings = marshal.loads(message[1:])
        self._takeover = Takeover(settings)
        udp = settings["udp"]
        self._line = RadioLine(settings["uri"]) if udp is None else UdpLine(udp)
        self._loop.send(companion.READY)


def main() -> None:
    """Run the process; its arguments are those of `companion.main`."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP):
        signal.signal(number, signal.SIG_IGN)
    companion._run_first()
    Process(socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2])).run()


if __name__ == "__main__":
    main()
