"""Writer of MCAP logs with JSON channels, and of the trials of a run one after another."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, BinaryIO

import msgspec

from alula.schemas.arrays import FloatArray
from alula.schemas.provenance import RUN_METADATA
from alula.schemas.run import RunRecord, TrialResult
from alula.stages.runlog.messages import log_message, nanoseconds, path_message
from alula.stages.runlog.schemas import SCHEMAS

_GAP_S = 1.0  # between trials, which follow one another in log time
_CHUNK_BYTES = 2**20
_OF_TRIAL = ("/state", "/safety")  # messages that begin with the trial and its time


class LogWriter:
    """MCAP log that is being written; equal calls give equal bytes.

    Args:
        stream: binary stream to write to.
        channels: name of the schema, a key of `SCHEMAS`, by topic.
        chunk_bytes: bytes that are written together; a crash loses those that are not written yet.
    """

    def __init__(
        self, stream: BinaryIO, channels: Mapping[str, str], *, chunk_bytes: int = _CHUNK_BYTES
    ) -> None:
        from mcap.writer import Writer

        self._writer = Writer(stream, chunk_size=chunk_bytes)
        self._writer.start(profile="", library="alula")
        self._channels = {}
        for topic, schema in channels.items():
            data = msgspec.json.encode(SCHEMAS[schema], order="sorted")
            schema_id = self._writer.register_schema(schema, "jsonschema", data)
            self._channels[topic] = self._writer.register_channel(topic, "json", schema_id)

    def send(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        """Add a message.

        Args:
            topic: one of the channels.
            time_s: log time [s].
            message: its fields.
        """
        now = nanoseconds(time_s)
        self._writer.add_message(self._channels[topic], now, msgspec.json.encode(message), now)

    def note(self, name: str, texts: Mapping[str, str]) -> None:
        """Add metadata, at once.

        Args:
            name: of the metadata.
            texts: values by key.
        """
        self._writer.add_metadata(name, dict(texts))

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
        messages: topics and messages of sample i, from i and its log time [s]; of `/state` and `/safety` only
            the fields beyond trial and time.
    """

    result: TrialResult
    words: str
    is_good: bool
    time_s: FloatArray
    path: FloatArray
    messages: Callable[[int, float], Iterable[tuple[str, dict[str, Any]]]]


def write_trials(
    stream: BinaryIO,
    channels: Mapping[str, str],
    record: RunRecord,
    map_: dict[str, Any],
    trials: Iterable[LoggedTrial],
    frame: str,
) -> None:
    """Write the log of a run; equal arguments give equal bytes.

    `/map` comes once; `/path` and `/log` per trial; the other channels per sample. Log time starts at 0 and
    trials follow one another with a second between them. The metadata `alula/summary` holds the record
    without its measured times, and its provenance.

    Args:
        stream: binary stream to write to.
        channels: see `LogWriter`.
        record: summary of the run.
        map_: the message of `/map`.
        trials: those that are shown.
        frame: name of the frame of all positions.
    """
    log = LogWriter(stream, channels)
    log.send("/map", 0.0, map_)
    begin_s = 0.0
    for trial in trials:
        log.send("/path", begin_s, path_message(trial.path, frame, begin_s))
        for i, time_s in enumerate(trial.time_s.tolist()):
            begins = {"trial": trial.result.index, "time_s": round(time_s, 9)}
            for topic, message in trial.messages(i, begin_s + time_s):
                log.send(topic, begin_s + time_s, begins | message if topic in _OF_TRIAL else message)
        begin_s += float(trial.time_s[-1])
        line = log_message(trial.words, begin_s, is_good=trial.is_good, collided=trial.result.collision)
        log.send("/log", begin_s, line)
        begin_s += _GAP_S
    log.finish(record)
