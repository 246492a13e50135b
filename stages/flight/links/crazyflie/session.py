"""A connection to a Crazyflie through cflib: its threads on one side, values without waiting on the other.

cflib is the optional extra `crazyflie` (its licence is the GPL, version 3) and imported only here, by `open`.
"""

from __future__ import annotations

import logging
import math
import struct
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any

from alula.schemas.errors import LinkError
from alula.stages.flight.links.options import LinkOptions

OLDEST_PROTOCOL = 9  # velocities with the yaw rate of today
_SUPERVISOR_PROTOCOL = 12
_POLL_S = 0.01
_ANSWER_S = 3.0
_SETTLE_S = 0.03
_HIGH_LEVEL, _PLATFORM, _LOCALIZATION = 8, 13, 6  # ports of CRTP
_ARM, _WATCHDOG = 1, 4
_MOST_TEXT = 1000


class Session:
    """One vehicle. `open`, `read`, `write` and `close` wait; all else returns at once.

    What is sent goes through a thread of its own, since cflib waits for a radio that is lost; of set-points
    and poses only the newest is sent. What comes is left by cflib's thread in attributes, the newest last.

    Attributes:
        heard_s: when a packet came last.
        lost: why the connection ended.
    """

    def __init__(self, uri: str, options: LinkOptions) -> None:
        self.uri, self.options = uri, options
        self.heard_s: float | None = None
        self.lost: str | None = None
        self._vehicle: Any = None
        self._ready = threading.Event()
        self._updates: dict[str, int] = {}  # how often a parameter's value came
        self._queue: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._sender: threading.Thread | None = None
        self._newest: dict[str, Callable[[Any], None]] = {}
        self._waiting: set[str] = set()
        self._text = ""
        self._texts: SimpleQueue[str] = SimpleQueue()
        self._answers: SimpleQueue[tuple[int, int]] = SimpleQueue()

    @property
    def protocol(self) -> int:
        """Version of CRTP that the vehicle speaks."""
        return int(self._vehicle.platform.get_protocol_version())

    def open(self, timeout_s: float) -> None:
        """Connect, and read all tables and parameters.

        Raises:
            LinkError: cflib is missing, or no vehicle answers.
        """
        try:
            import cflib.crtp
            from cflib.crazyflie import Crazyflie
        except ImportError as error:
            raise LinkError(f"{self.uri}: needs cflib: pip install alula[crazyflie] ({error})") from error
        logging.getLogger("cflib").addHandler(logging.NullHandler())
        if not cflib.crtp.CLASSES:
            cflib.crtp.init_drivers()
        self._vehicle = vehicle = Crazyflie()
        vehicle.fully_connected.add_callback(lambda _: self._ready.set())
        vehicle.connection_failed.add_callback(lambda _, why: self._lose(why))
        vehicle.connection_lost.add_callback(lambda _, why: self._lose(why))
        vehicle.packet_received.add_callback(self._hear)
        vehicle.console.receivedChar.add_callback(self._take_text)
        vehicle.add_port_callback(_HIGH_LEVEL, self._take_answer)
        vehicle.param.add_update_callback(cb=self._count)
        vehicle.open_link(self.uri)
        if not self.wait(lambda: self._ready.is_set() or self.lost is not None, timeout_s) or self.lost:
            lost = (self.lost or "").removeprefix("Exception: ")  # a class's name helps nobody
            raise LinkError(f"{self.uri}: no Crazyflie: {lost or f'no answer within {timeout_s:g} s'}")
        if self.protocol < OLDEST_PROTOCOL:
            raise LinkError(
                f"{self.uri}: the firmware is too old: CRTP {self.protocol}, not {OLDEST_PROTOCOL}"
            )
        vehicle.link_statistics.stop()  # ten pings a second, from a thread that outlives the program
        self._sender = threading.Thread(target=self._send_all, name="crazyflie-sender", daemon=True)
        self._sender.start()

    def wait(self, is_done: Callable[[], bool], timeout_s: float) -> bool:
        """Until something is so; whether it became so."""
        clock = self.options.clock
        end_s = clock() + timeout_s
        while not is_done():
            if clock() >= end_s:
                return False
            self.options.sleep(_POLL_S)
        return True

    def names(self, group: str) -> list[str]:
        """Parameters of a group."""
        return list(self._vehicle.param.toc.toc.get(group, ()))

    def read(self, name: str) -> float | None:
        """A parameter; None if the vehicle has none of that name."""
        group, _, rest = name.partition(".")
        value = self._vehicle.param.values.get(group, {}).get(rest)
        return None if value is None else float(value)

    def write(self, name: str, value: float, timeout_s: float = _ANSWER_S, keeps: bool = True) -> bool:
        """Set a parameter; whether the vehicle says that it has the value.

        The answer to a write repeats it: a value that the firmware does not take, as the number of a
        controller it does not have, it changes back a moment later. So it is read again, unless it is one
        that does not keep its value.
        """
        end_s = self.options.clock() + timeout_s
        parameters = self._vehicle.param
        try:
            is_answered = self._ask(name, end_s, lambda: parameters.set_value(name, value))
        except (KeyError, AttributeError, ValueError, struct.error):
            return False
        if not is_answered or not keeps:
            return is_answered
        self.options.sleep(_SETTLE_S)
        is_answered = self._ask(name, end_s, lambda: parameters.request_param_update(name))
        return is_answered and _is_same(self.read(name), value)

    def _ask(self, name: str, end_s: float, send: Callable[[], None]) -> bool:
        """Whether the vehicle answers with the value of a parameter."""
        before = self._updates.get(name, 0)
        send()
        return self.wait(lambda: self._updates.get(name, 0) > before, max(end_s - self.options.clock(), 0.0))

    def _count(self, name: str, _value: str) -> None:
        self._updates[name] = self._updates.get(name, 0) + 1

    def logs(self, name: str) -> bool:
        """Whether the vehicle has a log variable."""
        group, _, rest = name.partition(".")
        return rest in self._vehicle.log.toc.toc.get(group, ())

    def log(self, name: str, period_s: float, variables: list[str], take: Callable[[int, Any], None]) -> None:
        """Have variables sent; `take` gets the vehicle's milliseconds and the values, in cflib's thread.

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
        """Let the sender call something with the vehicle of cflib."""
        self._queue.put(lambda: send(self._vehicle))

    def post_newest(self, what: str, send: Callable[[Any], None]) -> None:
        """... which takes the place of one of its kind that was not sent yet: it would be stale."""
        self._newest[what] = send
        if what not in self._waiting:
            self._waiting.add(what)
            self._queue.put(lambda: self._send_newest(what))

    def arm(self, wanted: bool) -> None:
        """Ask to arm or disarm."""
        if self.protocol >= _SUPERVISOR_PROTOCOL:
            self.post(lambda vehicle: vehicle.supervisor.send_arming_request(wanted))
        else:
            self.post(lambda vehicle: _send_raw(vehicle, _PLATFORM, 0, bytes([_ARM, wanted])))

    def notice(self) -> None:
        """The emergency watchdog: begin, or go on, to need this every second."""
        if self.protocol >= _SUPERVISOR_PROTOCOL:
            self.post(lambda vehicle: vehicle.supervisor.send_emergency_stop_watchdog())
        else:
            self.post(lambda vehicle: _send_raw(vehicle, _LOCALIZATION, 1, bytes([_WATCHDOG])))

    def texts(self) -> list[str]:
        """Lines of the console since the last call."""
        return _drained(self._texts)

    def answers(self) -> list[tuple[int, int]]:
        """Commands of the high-level commander that were answered, and with which error number."""
        return _drained(self._answers)

    def flush(self, timeout_s: float) -> None:
        """Wait until what was posted is sent."""
        if self._sender is None or not self._sender.is_alive():
            return
        done = threading.Event()
        self._queue.put(done.set)
        self.wait(done.is_set, timeout_s)

    def close(self) -> None:
        """Let go, without the thrust of zero that cflib would send before: it stops the motors."""
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
            except Exception as error:  # noqa: BLE001  cflib raises plain ones; the loop must hear of it
                self._lose(f"{type(error).__name__}: {error}")

    def _lose(self, why: str) -> None:
        if self.lost is None:
            self.lost = str(why).strip().splitlines()[-1] if str(why).strip() else "connection lost"

    def _hear(self, _packet: Any) -> None:
        self.heard_s = self.options.clock()

    def _take_text(self, text: str) -> None:
        *lines, self._text = (self._text + text)[-_MOST_TEXT:].split("\n")
        for line in lines:
            shown = "".join(each for each in line if each.isprintable()).strip()
            if shown:
                self._texts.put(shown)

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
    """As floats of single precision, which is how they travel."""
    return a is not None and math.isclose(a, b, rel_tol=1e-6, abs_tol=1e-9)
