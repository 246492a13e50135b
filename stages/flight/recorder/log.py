"""The log of a real flight: a pipe that never waits, and the process behind it that writes the file."""

from __future__ import annotations

import os
import secrets
import signal
import sys
import time
from array import array
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

import msgspec
import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import OutputError
from alula.schemas.provenance import Provenance
from alula.schemas.run import FLIGHT_METADATA, RunRecord, record_path
from alula.stages.flight.loop.supervisor import State, Taken
from alula.stages.flight.recorder.messages import (
    CHANNELS,
    log_line,
    pose_message,
    safety_message,
    state_message,
    step_message,
    tick_message,
)
from alula.stages.flight.recorder.pipe import FlightPipe, next_message
from alula.stages.flight.recorder.samples import TickSample
from alula.stages.runlog.messages import path_message
from alula.stages.runlog.writer import LogWriter

_CHUNK_BYTES = 2**14  # some ticks: what a crash may cost
_SYNC_S = 1.0  # what a power cut may cost
_HEAD_S = 60.0  # for the writer to begin
_WORDS = 1000  # characters of a line, at most
_COLUMNS = 13
_VIEW_HZ = 25.0  # samples for a view
_PATH_POINTS = 2000


class FlightHead(msgspec.Struct, frozen=True, kw_only=True):
    """What a flight's log begins with: all that is known before it."""

    name: str
    filter: str
    vehicle: str
    frame: str
    is_splat: bool
    log_every: int
    provenance: Provenance
    map_message: dict[str, Any]


class StepSample(msgspec.Struct, array_like=True):
    """A step of the supervisor."""

    time_s: float
    state: str
    event: str
    action: str
    words: str


class LineSample(msgspec.Struct, array_like=True):
    """A line for people."""

    time_s: float
    level: int
    words: str


class FlightRecorder:
    """Hands a flight to a writer process; `Recorder` for the loop.

    Nothing here waits for disk or terminal: what the pipe has no room for is dropped and counted, and a
    writer that has died costs the log, not the flight. Samples of flying and holding are also kept here, in
    `rows`, to judge the flight by.

    Args:
        path: the log; it must not exist. None keeps no log, and only says lines.
        replaces: it may exist. It is replaced, and the record beside it removed, when the vehicle takes off:
            until then this log is written beside it, under a temporary name.
        head: what is known before the flight.
        echo: the writer also says lines of the flight on its standard error.
        view: a process that also gets lines, steps and some 25 ticks a second, if it has room for them;
            what it has not is counted as `unseen`.
        rate_hz: of ticks.

    Raises:
        OutputError: the log cannot be made.
    """

    def __init__(
        self,
        path: Path | None,
        head: FlightHead,
        *,
        replaces: bool = False,
        echo: bool = True,
        view: FlightPipe | None = None,
        rate_hz: float = 100.0,
    ) -> None:
        self._path, self._beside = path, None if path is None else _beside(path, replaces=replaces)
        self.has_flown = False  # or is taking off
        try:
            log = path if self._beside is None else self._beside
            where, how = (os.devnull, 0) if log is None else (log, os.O_CREAT | os.O_EXCL)
            file = os.open(where, os.O_WRONLY | how, 0o644)
        except OSError as error:
            raise OutputError(f"{path}: cannot write: {error.strerror}") from error
        code = "from alula.stages.flight.recorder.log import main; main()"
        names = () if path is None or self._beside is None else (str(self._beside), str(path))
        self._pipe = FlightPipe(code, (str(file), str(int(echo)), *names), files=(file,))
        os.close(file)
        self._encode = msgspec.msgpack.Encoder().encode
        self._view, self._view_every, self._ticks = view, max(1, round(rate_hz / _VIEW_HZ)), 0
        try:
            self._pipe.put(b"h" + self._encode(head), _HEAD_S)
        except OSError as error:
            self.finish(None)
            self.discard()
            raise OutputError(f"{path}: the process that writes the log does not run") from error
        self.dropped = self.unseen = 0
        self._rows = array("d")

    @property
    def pid(self) -> int:
        """Of the writer."""
        return self._pipe.process.pid

    @property
    def is_viewed(self) -> bool:
        """Whether there is a view."""
        return self._view is not None

    @property
    def rows(self) -> FloatArray:
        """Ticks of flying and holding, shape (n, 13): time, position, velocity, status (-1 while holding),
        1 infeasible + 2 certified, margin, error, time of the filter, reference's time.
        """
        return np.array(self._rows, np.float64).reshape(-1, _COLUMNS)

    def tick(self, sample: TickSample) -> None:
        """See `Recorder`."""
        self._ticks += 1
        self._put(b"t", sample, is_seen=self._ticks % self._view_every == 0)
        if sample.position is None or sample.velocity is None:
            return
        done = sample.filter
        if done is not None:
            flags = done.infeasible + 2 * done.certified
            last = (done.status, flags, done.margin, done.error_m, done.filter_s, done.plan_s)
        elif sample.state in (State.FLY.value, State.HOLD.value):
            last = (-1, 0, np.nan, np.nan, np.nan, np.nan)
        else:
            return
        self._rows.extend((sample.time_s, *sample.position, *sample.velocity, *last))

    def step(self, time_s: float, taken: Taken) -> None:
        """See `Recorder`."""
        step = taken.step
        self.has_flown = self.has_flown or step.state is State.TAKE_OFF
        self._put(
            b"s",
            StepSample(time_s, step.state.value, taken.event.value, step.action.value, step.words[:_WORDS]),
        )

    def say(self, time_s: float, level: int, words: str) -> None:
        """See `Recorder`."""
        self._put(b"l", LineSample(time_s, level, words[:_WORDS]))

    def finish(self, record: RunRecord | None, timeout_s: float = 30.0) -> bool:
        """Let the writer end the log, with the record if there is one; whether it did."""
        try:
            if record is not None:
                self._pipe.put(b"f" + self._encode(record), timeout_s)
        except OSError:
            self._pipe.process.kill()
        has_ended = self._pipe.close(timeout_s)
        if self.has_flown and self._path is not None and self._beside is not None:
            _replace(self._beside, self._path)  # where the writer has not lived to do it
        return has_ended

    @property
    def where(self) -> Path | None:
        """Where the log is now."""
        return self._beside if self._beside is not None and self._beside.exists() else self._path

    def discard(self) -> None:
        """Leave no log of what never took off, and what was there before as it was; after `finish`."""
        if self._path is not None and not self.has_flown:
            (self._path if self._beside is None else self._beside).unlink(missing_ok=True)

    def _put(self, kind: bytes, what: Any, *, is_seen: bool = True) -> None:
        try:
            message = kind + self._encode(what)
        except (TypeError, ValueError):  # no number of ours
            self.dropped += 1
            return
        self.dropped += not self._pipe.offer(message)
        if is_seen and self._view is not None:
            self.unseen += not self._view.offer(message)


def _beside(path: Path, *, replaces: bool) -> Path | None:
    """Where a log is written until it replaces another, or another's record; None if there is none."""
    if not replaces or not (os.path.lexists(path) or os.path.lexists(record_path(path))):
        return None
    return path.with_name(f".{path.name}.{secrets.token_hex(6)}.tmp")


def _replace(beside: Path, path: Path) -> None:
    """Let a log that was begun beside another take its place, once; the other's record goes with it."""
    with suppress(OSError):  # then it stays where it is, and is read there
        beside.replace(path)
        record_path(path).unlink(missing_ok=True)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


class _Writer:
    """What the other process does with what it reads; `moves` is where the log is and where it belongs."""

    def __init__(self, stream: BinaryIO, head: FlightHead, *, echo: bool, moves: list[Path]) -> None:
        self.head, self.echo, self.ticks, self.moves = head, echo, 0, moves
        self.log = LogWriter(stream, CHANNELS, chunk_bytes=_CHUNK_BYTES)
        known = msgspec.structs.asdict(head)
        known.pop("map_message")
        texts = {
            key: value if isinstance(value, str) else msgspec.json.encode(value).decode()
            for key, value in known.items()
        }
        self.log.note(FLIGHT_METADATA, texts)
        self.log.send("/map", 0.0, head.map_message)
        self.path: list[tuple[float, float, float]] = []
        self.last_s = 0.0

    def take(self, message: bytes) -> bool:
        """A message; False after the last."""
        kind, body = message[:1], message[1:]
        if kind == b"t":
            self._tick(msgspec.msgpack.decode(body, type=TickSample))
        elif kind == b"s":
            step = msgspec.msgpack.decode(body, type=StepSample)
            fields = step_message(step.time_s, step.state, step.event, step.action)
            self.log.send("/supervisor", step.time_s, fields)
            if step.state == State.TAKE_OFF.value and self.moves:
                _replace(*self.moves)
        elif kind == b"l":
            line = msgspec.msgpack.decode(body, type=LineSample)
            self.log.send("/log", line.time_s, log_line(line.time_s, line.level, line.words))
            if self.echo:
                self._say(f"{line.time_s:7.2f} s  {line.words}\n")
        elif kind == b"f":
            record = msgspec.msgpack.decode(body, type=RunRecord)
            if self.path:
                stride = max(1, len(self.path) // _PATH_POINTS)
                points = np.array(self.path[::stride] + self.path[-1:])
                self.log.send("/path", self.last_s, path_message(points, self.head.frame, self.last_s))
            self.log.finish(record)
            return False
        return True

    def _say(self, text: str) -> None:
        """To the terminal, which may have been closed: the log goes on without it."""
        try:
            os.write(2, text.encode(errors="replace"))
        except OSError:
            self.echo = False

    def _tick(self, sample: TickSample) -> None:
        now, self.last_s = sample.time_s, sample.time_s
        self.ticks += 1
        if sample.filter is not None and sample.position is not None:
            self.path.append(sample.position)
        if self.ticks % self.head.log_every:
            return
        self.log.send("/supervisor", now, tick_message(sample))
        if sample.position is None:
            return
        self.log.send("/state", now, state_message(sample))
        self.log.send("/pose", now, pose_message(sample, self.head.frame))
        if sample.filter is not None:
            self.log.send("/safety", now, safety_message(sample, sample.filter, is_splat=self.head.is_splat))


def main() -> None:
    """The writer process: reads frames from standard input, writes the log to the given file descriptor.

    When the pipe ends without a record, because whoever flew was killed, the log is closed without one. A
    disk that takes no more ends it with a line.
    """
    try:
        _write()
    except OSError as error:
        with suppress(OSError):
            os.write(2, f"the log ends here: {error.strerror}\n".encode())
        os._exit(1)  # what is buffered has nowhere to go


def _write() -> None:
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # it ends when the pipe does
    file, echo, moves = int(sys.argv[1]), sys.argv[2] == "1", [Path(name) for name in sys.argv[3:]]
    source = sys.stdin.buffer
    writer: _Writer | None = None
    synced = time.monotonic()
    with os.fdopen(file, "wb") as stream:
        while True:
            body = next_message(source)
            if not body:
                if writer is not None:
                    writer.log.close()
                break
            if writer is None:
                head = msgspec.msgpack.decode(body[1:], type=FlightHead)
                writer = _Writer(stream, head, echo=echo, moves=moves)
            elif not writer.take(body):
                break
            if time.monotonic() - synced > _SYNC_S:
                _sync(stream)
                synced = time.monotonic()
        _sync(stream)


def _sync(stream: BinaryIO) -> None:
    stream.flush()
    with suppress(OSError):  # a pipe, or no log at all, is not on a disk
        os.fsync(stream.fileno())
