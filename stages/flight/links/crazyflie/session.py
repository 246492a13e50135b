"""Non-blocking connection to a Crazyflie through cflib, which runs threads of its own.

cflib is the optional extra `crazyflie` (its licence is the GPL, version 3). Only `open` imports it.
"""

from __future__ import annotations

import logging
import math
import struct
import threading
from collections import deque
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any

from alula.schemas.errors import LinkError
from alula.stages.flight.links.options import LinkOptions

OLDEST_PROTOCOL = 9  # the first with the present sign of the yaw rate in velocity set-points
_SUPERVISOR_PROTOCOL = 12
_POLL_S = 0.01
_ANSWER_S = 3.0
_SETTLE_S = 0.03
_HIGH_LEVEL, _PLATFORM, _LOCALIZATION, _LINK = 8, 13, 6, 15  # ports of CRTP
_ECHO = b"alula"  # begins an echo request, so that the answers to those of cflib are not taken
_ROUND_TRIPS_S = 5.0  # answers to echo requests count for this long
_ARM, _WATCHDOG = 1, 4
_MAX_TEXT = 1000


class Session:
    """Connection to one vehicle. `open`, `read`, `write` and `close` may block; all else returns at once.

    A thread sends all packets, because cflib blocks while the radio is lost. Of waiting set-points and poses
    it sends only the newest. cflib's thread stores what it receives in attributes.

    Attributes:
        heard_s: when the last packet arrived, monotonic clock [s].
        lost: why the connection ended; None while it holds.
        round_trips: times of the newest echo requests and of their round trips, both [s].
    """

    def __init__(self, uri: str, options: LinkOptions) -> None:
        self.uri, self.options = uri, options
        self.heard_s: float | None = None
        self.lost: str | None = None
        self.round_trips: deque[tuple[float, float]] = deque(maxlen=64)
        self._echoes: dict[int, float] = {}  # requests by number: when they were queued
        self._echo = 0
        self._vehicle: Any = None
        self._ready = threading.Event()
        self._updates: dict[str, int] = {}  # number of received values by parameter
        self._queue: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._sender: threading.Thread | None = None
        self._newest: dict[str, Callable[[Any], None]] = {}
        self._waiting: set[str] = set()
        self._text = ""
        self._texts: SimpleQueue[str] = SimpleQueue()
        self._answers: SimpleQueue[tuple[int, int]] = SimpleQueue()

    @property
    def protocol(self) -> int:
        """Version of CRTP that the vehicle uses."""
        return int(self._vehicle.platform.get_protocol_version())

    def open(self, timeout_s: float) -> None:
        """Connect, and read all tables and parameters.

        Raises:
            LinkError: no vehicle answers.
        """
        import cflib.crtp
        from cflib.crazyflie import Crazyflie

        logging.getLogger("cflib").addHandler(logging.NullHandler())
        if not cflib.crtp.CLASSES:
            cflib.crtp.init_drivers()
        self._vehicle = vehicle = Crazyflie()
        vehicle.fully_connected.add_callback(lambda _: self._ready.set())
        vehicle.connection_failed.add_callback(lambda _, why: self._lose(why))
        vehicle.connection_lost.add_callback(lambda _, why: self._lose(why))
        vehicle.packet_received.add_callback(self._note_packet)
        vehicle.console.receivedChar.add_callback(self._take_text)
        vehicle.add_port_callback(_HIGH_LEVEL, self._take_answer)
        vehicle.add_port_callback(_LINK, self._take_echo)
        vehicle.param.add_update_callback(cb=self._count)
        vehicle.open_link(self.uri)
        if not self.wait(lambda: self._ready.is_set() or self.lost is not None, timeout_s) or self.lost:
            lost = (self.lost or "").removeprefix("Exception: ")  # the class name does not help the user
            raise LinkError(f"{self.uri}: no Crazyflie: {lost or f'no answer within {timeout_s:g} s'}")
        if self.protocol < OLDEST_PROTOCOL:
            raise LinkError(
                f"{self.uri}: the firmware is too old: CRTP {self.protocol}, not {OLDEST_PROTOCOL}"
            )
        vehicle.link_statistics.stop()  # it pings ten times a second, in a thread that outlives the program
        self._sender = threading.Thread(target=self._send_all, name="crazyflie-sender", daemon=True)
        self._sender.start()

    def wait(self, is_done: Callable[[], bool], timeout_s: float) -> bool:
        """Block until a condition holds, at most `timeout_s` [s]; returns whether it holds."""
        clock = self.options.clock
        end_s = clock() + timeout_s
        while not is_done():
            if clock() >= end_s:
                return False
            self.options.sleep(_POLL_S)
        return True

    def names(self, group: str) -> list[str]:
        """Names of the parameters of a group."""
        return list(self._vehicle.param.toc.toc.get(group, ()))

    def read(self, name: str) -> float | None:
        """Value of a parameter; None if the vehicle does not have it."""
        group, _, rest = name.partition(".")
        value = self._vehicle.param.values.get(group, {}).get(rest)
        return None if value is None else float(value)

    def write(self, name: str, value: float, timeout_s: float = _ANSWER_S, keeps: bool = True) -> bool:
        """Set a parameter; returns whether the vehicle reports the new value.

        The answer to a write only repeats the value. A value that the firmware rejects, such as the number of
        a controller that it does not have, changes back a moment later. So the parameter is read again.

        Args:
            name: `group.name`.
            keeps: whether the parameter keeps its value; if not, it is not read again.
        """
        end_s = self.options.clock() + timeout_s
        parameters = self._vehicle.param
        try:
            is_answered = self._request(name, end_s, lambda: parameters.set_value(name, value))
        except (KeyError, AttributeError, ValueError, struct.error):
            return False
        if not is_answered or not keeps:
            return is_answered
        self.options.sleep(_SETTLE_S)
        is_answered = self._request(name, end_s, lambda: parameters.request_param_update(name))
        return is_answered and _is_same(self.read(name), value)

    def _request(self, name: str, end_s: float, send: Callable[[], None]) -> bool:
        """Send something; returns whether the vehicle answers with the value of a parameter."""
        before = self._updates.get(name, 0)
        send()
        return self.wait(lambda: self._updates.get(name, 0) > before, max(end_s - self.options.clock(), 0.0))

    def _count(self, name: str, _value: str) -> None:
        self._updates[name] = self._updates.get(name, 0) + 1

    def logs(self, name: str) -> bool:
        """Return whether the vehicle has a log variable."""
        group, _, rest = name.partition(".")
        return rest in self._vehicle.log.toc.toc.get(group, ())

    def log(self, name: str, period_s: float, variables: list[str], take: Callable[[int, Any], None]) -> None:
        """Start a log block.

        Args:
            take: called in cflib's thread with the vehicle's clock [ms] and the values.

        Raises:
            LinkError: the vehicle does not have them.
        """
        from cflib.crazyflie.log import LogConfig

        block = LogConfig(name, max(10, round(1e3 * period_s)))
        for variable in variables:
            block.add_variable(variable)
        block.data_received_cb.add_callback(lambda stamp_ms, values, _: take(stamp_ms, values))
        try:
            self._vehicle.log.add_config(block)
        except (KeyError, AttributeError) as error:
            raise LinkError(f"{self.uri}: cannot log {name}: {str(error).strip(chr(39))}") from error
        block.start()

    def post(self, send: Callable[[Any], None]) -> None:
        """Queue a call with cflib's vehicle as its argument for the sending thread."""
        self._queue.put(lambda: send(self._vehicle))

    def post_newest(self, what: str, send: Callable[[Any], None]) -> None:
        """Queue a call like `post`; it replaces a waiting one of the same kind, which would be stale."""
        self._newest[what] = send
        if what not in self._waiting:
            self._waiting.add(what)
            self._queue.put(lambda: self._send_newest(what))

    def arm(self, arms: bool) -> None:
        """Send a request to arm or disarm."""
        if self.protocol >= _SUPERVISOR_PROTOCOL:
            self.post(lambda vehicle: vehicle.supervisor.send_arming_request(arms))
        else:
            self.post(lambda vehicle: _send_raw(vehicle, _PLATFORM, 0, bytes([_ARM, arms])))

    def notice(self) -> None:
        """Send a notice of the emergency watchdog; after the first it is required every second."""
        if self.protocol >= _SUPERVISOR_PROTOCOL:
            self.post(lambda vehicle: vehicle.supervisor.send_emergency_stop_watchdog())
        else:
            self.post(lambda vehicle: _send_raw(vehicle, _LOCALIZATION, 1, bytes([_WATCHDOG])))

    def request_echo(self, now_s: float) -> None:
        """Send a request that the vehicle's firmware returns unchanged."""
        self._echo = (self._echo + 1) & 0xFFFFFFFF
        self._echoes[self._echo] = now_s
        if len(self._echoes) > 64:
            self._echoes.pop(next(iter(self._echoes)), None)
        data = _ECHO + struct.pack("<I", self._echo)
        self.post(lambda vehicle: _send_raw(vehicle, _LINK, 0, data))

    def latency_s(self, now_s: float) -> float:
        """Minimum round trip of the echo requests of the last 5 s [s]; NaN if none was answered.

        The fastest state took at most that long, because the answer came the same way.
        """
        return min(
            (trip_s for sent_s, trip_s in list(self.round_trips) if now_s - sent_s <= _ROUND_TRIPS_S),
            default=math.nan,
        )

    def texts(self) -> list[str]:
        """Lines of the vehicle's console since the last call."""
        return _drained(self._texts)

    def answers(self) -> list[tuple[int, int]]:
        """Answers of the high-level commander since the last call: command and error number."""
        return _drained(self._answers)

    def flush(self, timeout_s: float) -> None:
        """Block until all queued calls are sent, at most `timeout_s` [s]."""
        if self._sender is None or not self._sender.is_alive():
            return
        done = threading.Event()
        self._queue.put(done.set)
        self.wait(done.is_set, timeout_s)

    def close(self) -> None:
        """Disconnect without the zero-thrust set-point of cflib's own `close`, which stops the motors."""
        self._queue.put(None)
        vehicle = self._vehicle
        if vehicle is None:
            return
        if self._sender is not None:
            self._sender.join(timeout=3.0)
        vehicle.link_statistics.stop()
        if vehicle.incoming.is_alive():
            vehicle.incoming.stop()
            vehicle.incoming.join(timeout=2.0)
        link, vehicle.link = vehicle.link, None
        if link is not None:
            link.close()
        vehicle.close_link()

    def _send_newest(self, what: str) -> None:
        self._waiting.discard(what)
        self._newest[what](self._vehicle)

    def _send_all(self) -> None:
        while (call := self._queue.get()) is not None:
            try:
                call()
            except Exception as error:  # noqa: BLE001  cflib raises plain ones; the loop must learn of it
                self._lose(f"{type(error).__name__}: {error}")

    def _lose(self, why: str) -> None:
        if self.lost is None:
            self.lost = str(why).strip().splitlines()[-1] if str(why).strip() else "connection lost"

    def _note_packet(self, _packet: Any) -> None:
        self.heard_s = self.options.clock()

    def _take_text(self, text: str) -> None:
        *lines, self._text = (self._text + text)[-_MAX_TEXT:].split("\n")
        for line in lines:
            shown = "".join(each for each in line if each.isprintable()).strip()
            if shown:
                self._texts.put(shown)

    def _take_echo(self, packet: Any) -> None:
        data = bytes(packet.data)
        if packet.channel == 0 and data[:-4] == _ECHO:
            sent_s = self._echoes.pop(struct.unpack("<I", data[-4:])[0], None)
            if sent_s is not None:
                self.round_trips.append((sent_s, self.options.clock() - sent_s))

    def _take_answer(self, packet: Any) -> None:
        if len(packet.data) >= 4:
            self._answers.put((int(packet.data[0]), int(packet.data[3])))


def _drained(queue: SimpleQueue[Any]) -> list[Any]:
    found: list[Any] = []
    while True:
        try:
            found.append(queue.get_nowait())
        except Empty:
            return found


def _send_raw(vehicle: Any, port: int, channel: int, data: bytes) -> None:
    from cflib.crtp.crtpstack import CRTPPacket

    packet = CRTPPacket()
    packet.set_header(port, channel)
    packet.data = data
    vehicle.send_packet(packet)


def _is_same(a: float | None, b: float) -> bool:
    """Compare two values as single-precision floats, which is how they are sent."""
    return a is not None and math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-9)
