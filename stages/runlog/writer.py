"""Writer of MCAP logs with JSON channels, and of the trials of a run one after another.

Foxglove publishes each of its message types both as Protobuf and as JSON Schema. alula writes JSON, through
Foxglove's `mcap` library. The other choice is `foxglove-sdk`, whose typed channels write Protobuf, with equal
bytes for equal calls. It is not used for files: it cannot read its messages back, which reports, replays and
the salvage of truncated logs do; it writes its own version into the header, so that the bytes of a run would
depend on the installed version; and it adds 54 MB to each installation. Tests build each message with the
classes of `foxglove-sdk`, which know the fields. The live channels are served by it (`fly --foxglove`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import BinaryIO

import msgspec

from alula.schemas.arrays import FloatArray
from alula.schemas.log.channels import schema_name, struct_of
from alula.schemas.log.json_schema import json_schema
from alula.schemas.provenance import RUN_METADATA
from alula.schemas.run import RunRecord, TrialResult
from alula.stages.runlog.messages import nanoseconds, path_message, verdict_message

SIMULATED_EPOCH_NS = 946_684_800 * 10**9  # 2000-01-01T00:00:00Z, when each simulated run starts
_GAP_S = 1.0  # between trials, which follow one another in log time
_CHUNK_BYTES = 2**20


class LogWriter:
    """MCAP log that is being written; equal calls give equal bytes.

    Args:
        stream: binary stream to write to.
        topics: of `CHANNELS`, in the order in which the file lists its channels.
        chunk_bytes: bytes that are written together; a crash loses those that are not written yet.
    """

    def __init__(self, stream: BinaryIO, topics: Iterable[str], *, chunk_bytes: int = _CHUNK_BYTES) -> None:
        from mcap.writer import Writer

        self._writer = Writer(stream, chunk_size=chunk_bytes)
        self._writer.start(profile="", library="alula")
        self._channels = {}
        for topic in topics:
            struct = struct_of(topic)
            data = msgspec.json.encode(json_schema(struct), order="sorted")
            schema_id = self._writer.register_schema(schema_name(struct), "jsonschema", data)
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)

    def send(self, topic: str, time_ns: int, message: msgspec.Struct) -> None:
        """Add a message.

        Args:
            topic: one of the channels.
            time_ns: log time: nanoseconds since 1970-01-01 UTC.
            message: of its Struct.
        """
        self._writer.add_message(self._channels[topic], time_ns, msgspec.json.encode(message), time_ns)

    def note(self, name: str, texts: Mapping[str, str]) -> None:
        """Add metadata, at once.

        Args:
            name: of the metadata.
            texts: values by key.
        """
        self._writer.add_metadata(name, dict(texts))

    def attach(self, name: str, time_ns: int, data: bytes) -> None:
        """Add a file.

        Args:
            name: of the file.
            time_ns: log time: nanoseconds since 1970-01-01 UTC.
            data: its bytes.
        """
        self._writer.add_attachment(time_ns, time_ns, name, "application/octet-stream", data)

    def close(self) -> None:
        """Close the log without a record."""
        self._writer.finish()

    def finish(self, record: RunRecord) -> None:
        """Add the record without its measured times, and its provenance, as metadata; close the log.

        Args:
            record: of the run.
        """
        bare = msgspec.structs.replace(record, timing=None)
        texts = {"record": bare, "provenance": bare.provenance}
        encoded = {key: msgspec.json.encode(value, order="sorted").decode() for key, value in texts.items()}
        self._writer.add_metadata(RUN_METADATA, encoded)
        self._writer.finish()


@dataclass(frozen=True, slots=True)
class LoggedTrial:
    """Trial as a log shows it.

    Attributes:
        result: the verdict.
        words: a line about it.
        is_good: it ended well.
        time_s: times of the samples from the trial's start, shape (T,) [s].
        path: positions, shape (T, 3), world frame [m].
        messages: topics and messages of sample i, from i and its log time [ns].
    """

    result: TrialResult
    words: str
    is_good: bool
    time_s: FloatArray
    path: FloatArray
    messages: Callable[[int, int], Iterable[tuple[str, msgspec.Struct]]]


def write_trials(
    stream: BinaryIO,
    topics: Iterable[str],
    record: RunRecord,
    once: Mapping[str, msgspec.Struct],
    trials: Iterable[LoggedTrial],
    frame: str,
) -> None:
    """Write the log of a run; equal arguments give equal bytes.

    `/path` and `/log` come per trial, channels of `once` at the start, and the others per sample. Log time
    starts at `SIMULATED_EPOCH_NS` and trials follow one another with a second between them. The metadata
    `alula/summary` holds the record without its measured times, and its provenance.

    Args:
        stream: binary stream to write to.
        topics: see `LogWriter`.
        record: summary of the run.
        once: messages at the start, by channel.
        trials: those that are shown.
        frame: name of the frame of all positions.
    """
    log = LogWriter(stream, topics)
    begin_s = 0.0

    def log_time(time_s: float) -> int:
        return SIMULATED_EPOCH_NS + nanoseconds(time_s)

    for topic, message in once.items():
        log.send(topic, log_time(0.0), message)
    for trial in trials:
        log.send("/path", log_time(begin_s), path_message(trial.path, frame, log_time(begin_s)))
        for i, time_s in enumerate(trial.time_s.tolist()):
            now = log_time(begin_s + time_s)
            for topic, message in trial.messages(i, now):
                log.send(topic, now, message)
        begin_s += float(trial.time_s[-1])
        now, result = log_time(begin_s), trial.result
        line = verdict_message(trial.words, now, is_good=trial.is_good, collided=result.collision)
        log.send("/log", now, line)
        begin_s += _GAP_S
    log.finish(record)
