"""Program of the watchdog process, which is started as a file and imports only small built-in modules.

It stands alone, without any other module of alula, so that it starts in some hundredths of a second and stays
small. `watchdog.py` starts it and describes the messages between the two.
"""

from __future__ import annotations

import marshal
import mmap
import os
import select
import signal
import socket
import struct
import sys
import time

TYPE_CHECKING = False
if TYPE_CHECKING:  # typing takes long to import
    from typing import Any

STALL_S = 0.2  # without a sign of life for this long the loop has stalled; ordinary lateness is far less
REACTION_S = STALL_S + 0.05  # maximum time from the last set-point to the order to stop: one repeat included
STOPPING_S = 2.0  # from the order to stop until the order to land; vehicles brake from 5 m/s in less

# Sign of life in the shared memory: number, time [s], whether the loop is in control, reported mode, when
# that report arrived [s], newest time stamp, and the number again, which differs while it is being written.
BEAT = struct.Struct("<QdBIdQQ")
TAKEN_AT = 64  # place of the byte that is not 0 after a takeover
MEMORY_BYTES = 4096
SETTINGS, LINE, FAREWELL, READY = b"S", b"L", b"F", b"R"
MESSAGE_BYTES = 4096

_LOOK_S = 0.02  # between looks at the shared memory: the loop wakes nobody
_REPEAT_S = 0.05  # between orders until the vehicle reports the mode
_BEAT_S = 0.1  # between heartbeats
_UNHEARD_S = 1.0  # to stop is ordered for this long, then to land; heartbeats arrive at least once a second
_LANDING_S = 10.0  # to land is ordered for this long
_SETTLED_S = 1.0  # the ordered mode must last this long, and a resumed loop may not change it
_GRACE_S = 0.06  # for the loop, if this process was held up, too; more than a tick of the slowest loop
_HELD_UP_S = 0.03
_READS = 2000
_REST = 300  # more than the largest frame

_V1, _V2, _SIGNED = 0xFE, 0xFD, 1
_CRCS = {0: 50, 77: 143}  # HEARTBEAT, COMMAND_ACK
_SIGNATURE, _STAMP_BYTES = 13, 6
_SET_MODE, _ACCEPTED, _IN_PROGRESS = 176, 0, 5
_ARMED = 128
_CLOSED_S = 2.0  # for the first messages


class Frames:
    """Frames to and from the vehicle; signed in a stream of its own if there is a key.

    The stream has another link number than that of the flight, so neither can make the other's time stamps
    look old. Its time stamps continue from the newest one of the flight.

    Args:
        settings: `system`, `component`, `vehicle`, `key` (None without) and `link`, its number.

    Attributes:
        mode: custom_mode of the vehicle's newest heartbeat; None before.
    """

    def __init__(self, settings: dict[str, Any]) -> None:
        self._source = bytes((settings["system"], settings["component"]))
        self._vehicle = bytes((settings["vehicle"], 1))
        self._key = settings["key"]
        if self._key is not None:
            import hashlib  # it takes longer than all the rest

            self._sha256 = hashlib.sha256
        self._link = bytes((settings["link"],))
        self._sequence = self.stamp = 0
        self._heard: dict[int, int] = {}  # newest time stamps of the vehicle, by link
        self._rest = b""
        self.forget()

    def forget(self) -> None:
        """Forget what was heard."""
        self.mode: int | None = None
        self.is_armed = True
        self.is_refused = False

    def pack(self, number: int, crc_extra: int, payload: bytes) -> bytes:
        """Frame of a message."""
        flags = 0 if self._key is None else _SIGNED
        head = bytes((len(payload), flags, 0, self._sequence)) + self._source + number.to_bytes(3, "little")
        self._sequence = (self._sequence + 1) % 256
        body = head + payload
        frame = bytes((_V2,)) + body + checksum(body, crc_extra).to_bytes(2, "little")
        if self._key is None:
            return frame
        self.stamp += 1
        frame += self._link + self.stamp.to_bytes(_STAMP_BYTES, "little")
        return frame + self._signature(frame)

    def take(self, data: bytes, *, is_datagram: bool) -> None:
        """Read the vehicle's heartbeats and refusals of modes; other bytes are ignored.

        Args:
            data: received bytes.
        """
        data = data if is_datagram else self._rest + data
        for magic in (_V1, _V2):
            at = data.find(magic)
            while at >= 0:
                at = data.find(magic, at + (self._frame(data, at) or 1))
        self._rest = b"" if is_datagram else data[-_REST:]

    def _frame(self, data: bytes, at: int) -> int:
        """Read the frame that begins at a position; returns its length, 0 if there is none."""
        magic = data[at]
        header = 10 if magic == _V2 else 6
        if magic not in (_V1, _V2) or len(data) < at + header:
            return 0
        size = data[at + 1]
        flags = data[at + 2] if magic == _V2 else 0
        source = data[at + 5 : at + 7] if magic == _V2 else data[at + 3 : at + 5]
        number = int.from_bytes(data[at + 7 : at + 10], "little") if magic == _V2 else data[at + 5]
        end = at + header + size
        length = header + size + 2 + (_SIGNATURE if flags & _SIGNED else 0)
        if source != self._vehicle or number not in _CRCS or flags & ~_SIGNED or len(data) < at + length:
            return 0
        if checksum(data[at + 1 : end], _CRCS[number]) != int.from_bytes(data[end : end + 2], "little"):
            return 0
        if self._key is not None and not (flags & _SIGNED and self._is_authentic(data[at : at + length])):
            return 0
        payload = data[at + header : end] + bytes(9)  # zeros at the end of a payload are not sent
        if number == 0:
            self.mode = int.from_bytes(payload[:4], "little")
            self.is_armed = bool(payload[6] & _ARMED)
        elif int.from_bytes(payload[:2], "little") == _SET_MODE:
            self.is_refused = self.is_refused or payload[2] not in (_ACCEPTED, _IN_PROGRESS)
        return length

    def _is_authentic(self, frame: bytes) -> bool:
        if self._signature(frame[:-_STAMP_BYTES]) != frame[-_STAMP_BYTES:]:
            return False
        link, stamp = frame[-_SIGNATURE], int.from_bytes(frame[-_SIGNATURE + 1 : -_STAMP_BYTES], "little")
        if stamp < self._heard.get(link, 0):  # the same frame may be read twice
            return False
        self._heard[link] = stamp
        return True

    def _signature(self, frame: bytes) -> bytes:
        assert isinstance(self._key, bytes)
        return self._sha256(self._key + frame).digest()[:_STAMP_BYTES]


def checksum(data: bytes, crc_extra: int) -> int:
    """CRC-16/MCRF4XX of a frame without its first byte. Source: MAVLink guide, "Packet Serialization".

    Args:
        data: the bytes.
        crc_extra: of the message's definition, which is appended.
    """
    crc = 0xFFFF
    for byte in (*data, crc_extra):
        step = (byte ^ crc) & 0xFF
        step = (step ^ (step << 4)) & 0xFF
        crc = (crc >> 8) ^ (step << 8) ^ (step << 3) ^ (step >> 4)
    return crc


class Takeover:
    """Decides whether the loop is missing, and what is then sent; without a clock and without a line.

    The vehicle is ordered to stop, and `STOPPING_S` later to land. Each order is repeated until a heartbeat
    shows its mode, and again if the mode that follows set-points comes back. A mode that nobody here ordered
    ends it: the pilot, or a failsafe, has the vehicle.

    Args:
        settings: those of `Frames`; `control`, `stopping` and `landing`, values of custom_mode, `stopping`
            None to land at once; `stop_name` and `land_name`; `heartbeat`, `stop` and
            `land`, arguments of `Frames.pack`.

    Attributes:
        began_s: when it took over; None before [s].
    """

    def __init__(self, settings: dict[str, Any]) -> None:
        self.frames = Frames(settings)
        self._settings = settings
        self.is_over = False
        self.words: list[str] = []
        self.began_s: float | None = None
        self._beat_s, self._is_in_control, self._is_gone = 0.0, False, False
        self._lands_s = self._ends_s = self._sent_s = self._heartbeat_s = 0.0
        self._has_stopped = False
        self._seen_s: float | None = None  # since when the ordered mode is reported

    def beat(self, data: bytes) -> None:
        """Process a sign of life of the loop, `BEAT`; one that is being written is ignored."""
        number, beat_s, is_in_control, mode, heard_s, stamp, again = BEAT.unpack(data)
        if number != again:
            return
        self._beat_s, self._is_in_control = beat_s, bool(is_in_control)
        self.frames.stamp = max(self.frames.stamp, stamp)
        if self.began_s is not None and heard_s > self.began_s:
            self.frames.mode = mode  # the loop goes on and reads the line again

    def take(self, message: bytes) -> None:
        """Process the loop's farewell; an empty message means that it ended without."""
        if self.began_s is None and message == FAREWELL:
            self.is_over = True
        elif not message:
            self._is_gone = True
            self.is_over = self.is_over or (self.began_s is None and not self._is_in_control)

    def is_missing(self, now_s: float) -> bool:
        """Return whether the loop should be in control of the vehicle, and is not."""
        if self.began_s is not None or self.is_over or not self._is_in_control:
            return False
        return self._is_gone or now_s - self._beat_s > STALL_S

    def is_loop_alive(self, now_s: float) -> bool:
        """Return whether the loop gives signs of life: then the line is read by it, and not here."""
        return not self._is_gone and now_s - self._beat_s <= STALL_S

    def begin(self, now_s: float) -> None:
        """Take over, unless what was heard since the loop's last sign of life shows that somebody has."""
        settings = self._settings
        how = "ended" if self._is_gone else "stalled"
        after = f"the loop {how}, {now_s - self._beat_s:.2f} s after its last tick"
        if self.frames.mode not in (None, settings["control"]):
            lands = self.frames.mode == settings["landing"]
            found = "it lands already" if lands else "somebody else has already taken the vehicle over"
            self.words.append(f"watchdog: {after}; {found}")
            self.is_over = True
            return
        stops = settings["stopping"] is not None
        orders = f"{settings['stop_name']}, then {settings['land_name']}" if stops else settings["land_name"]
        self.words.append(f"watchdog: {after}; taking the vehicle over: {orders}")
        self.began_s = self._lands_s = now_s
        self._lands_s += STOPPING_S if stops else 0.0
        self._ends_s = self._lands_s + _LANDING_S
        self._sent_s = self._heartbeat_s = -1e9

    def poll(self, now_s: float) -> list[bytes]:
        """Frames to send now."""
        if self.began_s is None or self.is_over:
            return []
        settings, frames, mode = self._settings, self.frames, self.frames.mode
        lands = now_s >= self._lands_s
        ordered = settings["landing" if lands else "stopping"]
        ours = (None, settings["control"], settings["stopping"], settings["landing"])
        if not frames.is_armed or mode not in ours:
            who = "the vehicle is disarmed" if not frames.is_armed else "somebody else has the vehicle now"
            return self._end(f"watchdog: {who}")
        if not lands and mode != ordered:
            unheard = mode is None or mode == settings["control"]
            is_late = not self._has_stopped and now_s - self.began_s > _UNHEARD_S
            is_vain = frames.is_refused or (unheard and is_late)
            if is_vain or mode == settings["landing"]:
                self._lands_s, self._ends_s = now_s, now_s + _LANDING_S
                return self.poll(now_s)
        self._has_stopped = self._has_stopped or mode == settings["stopping"]
        self._seen_s = (now_s if self._seen_s is None else self._seen_s) if mode == ordered else None
        if lands and self._seen_s is not None and now_s - max(self._seen_s, self._lands_s) > _SETTLED_S:
            return self._end("watchdog: the vehicle lands")
        if now_s > self._ends_s:
            return self._end("watchdog: the vehicle did not confirm that it lands")
        found = []
        if now_s - self._heartbeat_s >= _BEAT_S:
            self._heartbeat_s = now_s
            found.append(frames.pack(*settings["heartbeat"]))
        if mode != ordered and now_s - self._sent_s >= _REPEAT_S:
            self._sent_s = now_s
            found.append(frames.pack(*settings["land" if lands else "stop"]))
        return found

    def _end(self, words: str) -> list[bytes]:
        self.words.append(words)
        self.is_over = True
        return []


class Line:
    """The flight's line to the vehicle, by a duplicate of its descriptor.

    Args:
        file: descriptor.
        place: `kind`: "udp" (connected), "udp to" (with `peer`), "stream"; and the peer.
    """

    def __init__(self, file: int, place: tuple[str, Any]) -> None:
        self._kind, self._peer = place
        self._file, self._rest = file, b""
        self._socket = socket.socket(fileno=file) if self._kind == "udp to" else None
        self.is_datagram = self._kind != "stream"

    def send(self, frames: list[bytes]) -> None:
        """Send frames; those for which the line has no room now are dropped, whole."""
        for frame in frames:
            try:
                if self._socket is not None:
                    self._socket.sendto(frame, self._peer)
                elif self.is_datagram:
                    os.write(self._file, frame)
                else:
                    rest = self._rest
                    written = os.write(self._file, rest + frame)
                    self._rest = (rest + frame if written > len(rest) else rest)[written:]
            except OSError:  # no room, or the line is gone: the orders are repeated
                continue

    def receive(self) -> bytes:
        """Received bytes of the vehicle; empty if there are none."""
        try:
            if self._socket is None:
                return os.read(self._file, MESSAGE_BYTES)
            data, peer = self._socket.recvfrom(MESSAGE_BYTES)
            return data if peer == self._peer else b"\0"
        except OSError:
            return b""

    def close(self) -> None:
        """Close the duplicate."""
        if self._socket is not None:
            self._socket.close()
        else:
            os.close(self._file)


class Process:
    """The process: a socket to the loop, a line to the vehicle, and the clock.

    Args:
        memory: descriptor of the shared memory.
    """

    def __init__(self, loop: socket.socket, memory: int) -> None:
        self._loop, self._memory = loop, mmap.mmap(memory, MEMORY_BYTES)
        self._line: Line | None = None
        self._takeover: Takeover | None = None
        self._poll = select.poll()
        self._poll.register(loop, select.POLLIN)
        self._is_open = True

    def run(self) -> None:
        """Watch until the flight is over or the vehicle lands."""
        now_s = time.monotonic()
        while self._takeover is None or not self._takeover.is_over:
            self._wait(_CLOSED_S if self._takeover is None else _LOOK_S)
            before_s, now_s = now_s, time.monotonic()
            if self._takeover is None:  # nobody is there
                return
            if now_s - before_s > _LOOK_S + _HELD_UP_S:
                self._wait(_GRACE_S)  # this process was held up; the loop may have been, too, and go on now
                now_s = time.monotonic()
            self.step(now_s)

    def step(self, now_s: float) -> None:
        """Process what the loop has sent, and do what is due."""
        self._wait(0.0)
        if (takeover := self._takeover) is None or takeover.is_over:
            return
        takeover.beat(self._memory[: BEAT.size])
        if takeover.is_missing(now_s):
            takeover.frames.forget()
            self._hear(takeover)
            takeover.begin(now_s)
            self._memory[TAKEN_AT] = takeover.began_s is not None  # before the first order
        elif takeover.began_s is not None and not takeover.is_loop_alive(now_s):
            self._hear(takeover)
        if self._line is not None:
            self._line.send(takeover.poll(now_s))
        for words in takeover.words:
            self.say(words)
        takeover.words.clear()

    def _wait(self, seconds: float) -> None:
        """Wait for messages of the loop at most this long, and process all that are there."""
        if not self._is_open:
            if seconds > 0:
                time.sleep(seconds)
            return
        if not self._poll.poll(seconds * 1e3):
            return
        while True:
            try:
                message, attached, _, _ = self._loop.recvmsg(MESSAGE_BYTES, 64, socket.MSG_DONTWAIT)
            except BlockingIOError:
                return
            except OSError:
                message, attached = b"", []
            self._take(message, attached)
            if not message:
                self._is_open = False
                return

    def _take(self, message: bytes, attached: list[tuple[int, int, bytes]]) -> None:
        if message[:1] == SETTINGS:
            self._takeover = Takeover(marshal.loads(message[1:]))
        elif message[:1] == LINE and attached:
            if self._line is not None:
                self._line.close()
            self._line = Line(struct.unpack("i", attached[0][2][:4])[0], marshal.loads(message[1:]))
            self._loop.send(READY)
        elif self._takeover is not None:
            self._takeover.take(message)

    def _hear(self, takeover: Takeover) -> None:
        """Read what waits on the line; the loop does not read it now."""
        for _ in range(_READS):
            if self._line is None or not (data := self._line.receive()):
                return
            takeover.frames.take(data, is_datagram=self._line.is_datagram)

    def say(self, words: str) -> None:
        """Print a line."""
        try:
            os.write(2, f"{words}\n".encode())
        except OSError:  # the terminal was closed
            return


def _run_first() -> None:
    """Run before ordinary processes, as far as it is allowed: also when the machine is too busy."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(2))
    except (AttributeError, OSError):  # macOS has no such call
        try:
            os.setpriority(os.PRIO_PROCESS, 0, -15)
        except OSError:
            return


def main() -> None:
    """Run the process; its arguments are the descriptors of its end of the socket pair and of the memory."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGTSTP):
        signal.signal(number, signal.SIG_IGN)
    _run_first()
    Process(socket.socket(fileno=int(sys.argv[1])), int(sys.argv[2])).run()


if __name__ == "__main__":
    main()
