"""Log of a real flight: a recorder that never waits, and the process that writes the file."""

from __future__ import annotations

import os
import secrets
import signal
import sys
import time
from array import array
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

import msgspec
import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import OutputError
from alula.schemas.log.channels import FLIGHT_TOPICS, Supervisor
from alula.schemas.log.run import FLIGHT_METADATA, RunRecord, record_path
from alula.schemas.log.start_time import utc_text
from alula.schemas.text import one_line
from alula.stages.flight.loop.supervisor import State, Taken
from alula.stages.flight.recorder.channels import FlightChannels, FlightHead, Sent
from alula.stages.flight.recorder.pipe import FlightPipe, next_message
from alula.stages.flight.recorder.samples import (
    NUMBERS,
    BeginSample,
    FileSample,
    FinishSample,
    LineSample,
    PlanSample,
    Sample,
    StepSample,
    Three,
    TickSample,
    decoded,
    encoded,
)
from alula.stages.runlog.messages import nanoseconds
from alula.stages.runlog.writer import LogWriter

_CHUNK_BYTES = 2**14  # some ticks: the maximum loss in a crash
_SYNC_S = 1.0  # the maximum loss in a power cut
_HEAD_S = 60.0  # maximum time for the writer to start
_WORDS = 1000  # maximum number of characters of a message
_COLUMNS = 13
_VIEW_HZ = 25.0  # rate of samples for a live view


class FlightRecorder:
    """`Recorder` of the loop that passes samples and messages to a writer process.

    No method waits for disk or terminal. A sample for which the pipe has no room is dropped and counted. If
    the writer dies the log is lost, and the flight continues. Samples of flying and holding are also kept in
    `rows`, for the verdict.

    Args:
        path: file of the log; it must not exist unless `replaces`. With None no log is written, and messages
            are only printed.
        head: facts that are known before the flight.
        replaces: the file may exist. The log is then written beside it under a temporary name. When the
            vehicle takes off, the log replaces the file, and the record beside it is removed.
        echo: the writer also prints messages on its standard error.
        views: processes of live views. They also receive messages, steps and about 25 ticks a second, if
            they have room for them.
        start_ns: log time of the start of the flight, nanoseconds since 1970-01-01 UTC; None: by the clock of
            this machine.

    Attributes:
        has_flown: the vehicle has taken off, or is taking off.

    Raises:
        OutputError: the log cannot be written.
    """

    def __init__(
        self,
        path: Path | None,
        head: FlightHead,
        *,
        replaces: bool = False,
        echo: bool = True,
        views: Sequence[FlightPipe] = (),
        rate_hz: float = 100.0,
        start_ns: int | None = None,
    ) -> None:
        self._path, self._temporary = path, None if path is None else _temporary(path, replaces=replaces)
        self.has_flown = self._has_begun = False
        self._start_ns = start_ns
        try:
            log = path if self._temporary is None else self._temporary
            where, how = (os.devnull, 0) if log is None else (log, os.O_CREAT | os.O_EXCL)
            file = os.open(where, os.O_WRONLY | how, 0o644)
        except OSError as error:
            raise OutputError(f"{path}: cannot write: {error.strerror}") from error
        code = "from alula.stages.flight.recorder.log import main; main()"
        names = () if path is None or self._temporary is None else (str(self._temporary), str(path))
        self._pipe = FlightPipe(code, (str(file), str(int(echo)), *names), files=(file,))
        os.close(file)
        self._views, self._view_every, self._ticks = views, max(1, round(rate_hz / _VIEW_HZ)), 0
        try:
            self._pipe.put(msgspec.msgpack.encode(head), _HEAD_S)
        except OSError as error:
            self.finish(None)
            self.discard()
            raise OutputError(f"{path}: the process that writes the log does not run") from error
        self.dropped = self.unseen = 0
        self._rows = array("d")

    @property
    def pid(self) -> int:
        """Process id of the writer."""
        return self._pipe.process.pid

    @property
    def is_viewed(self) -> bool:
        """True with a live view."""
        return bool(self._views)

    @property
    def rows(self) -> FloatArray:
        """Ticks of flying and holding, shape (n, 13), world frame, SI units.

        Columns: time, position (3), velocity (3), status of the filter (-1 while the vehicle holds by
            itself),
        infeasible + 2 certified, margin, error, duration of the decision, time along the plan.
        """
        return np.array(self._rows, np.float64).reshape(-1, _COLUMNS)

    def tick(self, sample: TickSample) -> None:
        """See `Recorder`."""
        self._ticks += 1
        is_seen = self._ticks % self._view_every == 0
        self._put(sample.supervisor.time_s, sample, is_seen=is_seen)
        self._rows.extend(row_of(sample))

    def step(self, time_s: float, taken: Taken) -> None:
        """See `Recorder`."""
        step = taken.step
        self.has_flown = self.has_flown or step.state is State.TAKE_OFF
        supervisor = Supervisor(
            time_s=time_s,
            state=NUMBERS[step.state],
            state_name=step.state.value,
            event_name=taken.event.value,
            action_name=step.action.value,
        )
        self._put(time_s, StepSample(supervisor, step.words[:_WORDS]))

    def plan(self, time_s: float, points: list[Three]) -> None:
        """See `Recorder`."""
        self._put(time_s, PlanSample(time_s, points))

    def say(self, time_s: float, level: int, words: str) -> None:
        """See `Recorder`."""
        self._put(time_s, LineSample(time_s, level, words[:_WORDS]))

    def attach(self, name: str, time_s: float, data: bytes, timeout_s: float = 30.0) -> None:
        """Add a file to the log, after the flight: this waits for the writer.

        Args:
            data: its bytes.
        """
        with suppress(OSError):  # then `finish` reports that the log is not complete
            self._pipe.put(encoded(FileSample(time_s, name, data)), timeout_s)

    def finish(self, record: RunRecord | None, timeout_s: float = 30.0) -> bool:
        """Let the writer complete the log and end.

        Args:
            record: of the flight, to store in the log, if there is one.

        Returns:
            True if the log is complete.
        """
        try:
            if record is not None:
                self._pipe.put(encoded(FinishSample(record)), timeout_s)
        except OSError:
            self._pipe.process.kill()
        has_ended = self._pipe.close(timeout_s)
        if self.has_flown and self._path is not None and self._temporary is not None:
            _replace(self._temporary, self._path)  # in case the writer died before it did
        return has_ended

    @property
    def where(self) -> Path | None:
        """File of the log at present."""
        return self._temporary if self._temporary is not None and self._temporary.exists() else self._path

    def discard(self) -> None:
        """Remove the log of a flight that never took off; an earlier log stays unchanged; after `finish`."""
        if self._path is not None and not self.has_flown:
            (self._path if self._temporary is None else self._temporary).unlink(missing_ok=True)

    def _put(self, time_s: float, sample: Sample, *, is_seen: bool = True) -> None:
        try:
            message = encoded(sample)
        except (TypeError, ValueError):  # a value that cannot be encoded
            self.dropped += 1
            return
        if not self._has_begun:
            self._begin(time_s)
        self.dropped += not (self._has_begun and self._pipe.offer(message))
        if is_seen:
            self.unseen += sum(not view.offer(message) for view in self._views)

    def _begin(self, time_s: float) -> None:
        """Send the start of the flight, `time_s` ago; it is repeated until the writer has it."""
        if self._start_ns is None:
            self._start_ns = time.time_ns() - nanoseconds(time_s)
        message = encoded(BeginSample(self._start_ns))
        self._has_begun = self._pipe.offer(message)
        if self._has_begun:
            for view in self._views:
                view.offer(message)


def row_of(sample: TickSample) -> tuple[float, ...]:
    """Row of `FlightRecorder.rows`; empty for a tick that has none."""
    loop, state, done = sample.supervisor, sample.state, sample.safety
    if state is None or (done is None and loop.state_name not in (State.FLY.value, State.HOLD.value)):
        return ()
    last: tuple[float | None, ...] = (-1, 0, None, None, None, None)
    if done is not None:
        flags = bool(done.infeasible) + 2 * bool(done.certified)
        margin = done.h_m if done.margin_unit is None else done.margin
        last = (done.status, flags, margin, loop.error_m, done.solve_time_s, loop.plan_s)
    known = (np.nan if value is None else value for value in last)
    return (loop.time_s, *state.position_m.tuple, *state.velocity_m_s.tuple, *known)


def _temporary(path: Path, *, replaces: bool) -> Path | None:
    """Temporary path of a log until it replaces an earlier log or record; None if there is neither."""
    if not replaces or not (os.path.lexists(path) or os.path.lexists(record_path(path))):
        return None
    return path.with_name(f".{path.name}.{secrets.token_hex(6)}.tmp")


def _replace(temporary: Path, path: Path) -> None:
    """Move a log from its temporary path to its final one, and remove the earlier record; only once."""
    with suppress(OSError):  # then the log stays at its temporary path
        temporary.replace(path)
        record_path(path).unlink(missing_ok=True)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


class _Writer:
    """Log in the writer process; `moves` is empty, or the temporary and the final path of the log."""

    def __init__(self, stream: BinaryIO, head: FlightHead, *, echo: bool, moves: list[Path]) -> None:
        self.head, self.echo, self.moves = head, echo, moves
        self.log = LogWriter(stream, FLIGHT_TOPICS, chunk_bytes=_CHUNK_BYTES)
        self.channels: FlightChannels | None = None
        self.start_ns = 0

    def begin(self, start_ns: int) -> None:
        """Write what is known before the flight."""
        self.start_ns = start_ns
        facts = msgspec.structs.asdict(self.head)
        del facts["map_message"], facts["cloud"], facts["plan"]
        texts = {
            key: value if isinstance(value, str) else msgspec.json.encode(value).decode()
            for key, value in facts.items()
        }
        self.log.note(FLIGHT_METADATA, texts | {"start_time": utc_text(start_ns)})
        self.channels = FlightChannels(self.head, start_ns)
        self._send(self.channels.first())

    def take(self, message: bytes) -> bool:
        """Process a message; False after the last one."""
        sample = decoded(message)
        if isinstance(sample, BeginSample):
            self.begin(sample.start_ns)
            return True
        if isinstance(sample, FinishSample):
            if self.channels is not None:
                self._send(self.channels.path())
            self.log.finish(sample.record)
            return False
        assert self.channels is not None  # samples follow the start
        self._send(self.channels.of(sample))
        if isinstance(sample, StepSample) and sample.supervisor.state_name == State.TAKE_OFF.value:
            if self.moves:
                _replace(*self.moves)
        elif isinstance(sample, LineSample) and self.echo:
            self._say(f"{sample.time_s:7.2f} s  {one_line(sample.words)}\n")
        elif isinstance(sample, FileSample):
            self.log.attach(sample.name, self.start_ns + nanoseconds(sample.time_s), sample.data)
        return True

    def _send(self, found: Iterable[Sent]) -> None:
        for topic, time_ns, message in found:
            self.log.send(topic, time_ns, message)

    def _say(self, text: str) -> None:
        """Print a message; if the terminal was closed, the log continues without it."""
        try:
            os.write(2, text.encode(errors="replace"))
        except OSError:
            self.echo = False


def main() -> None:
    """Run the writer process: read messages from standard input, write the log to a file descriptor.

    If the pipe ends without a record, because the flying process was killed, the log is closed without one. A
    full disk ends the process with a message.
    """
    try:
        _write()
    except OSError as error:
        with suppress(OSError):
            os.write(2, f"the log ends here: {error.strerror}\n".encode())
        os._exit(1)  # buffered data cannot be written


def _write() -> None:
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # it ends with the pipe
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
                head = msgspec.msgpack.decode(body, type=FlightHead)
                writer = _Writer(stream, head, echo=echo, moves=moves)
            elif not writer.take(body):
                break
            if time.monotonic() - synced > _SYNC_S:
                _sync(stream)
                synced = time.monotonic()
        _sync(stream)


def _sync(stream: BinaryIO) -> None:
    stream.flush()
    with suppress(OSError):  # a pipe or /dev/null is not on a disk
        os.fsync(stream.fileno())
