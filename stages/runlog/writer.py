"""An MCAP log with JSON channels: how messages, times and the record of the run are written."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, BinaryIO

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.provenance import RUN_METADATA
from alula.schemas.run import RunRecord
from alula.stages.runlog.schemas import SCHEMAS

GAP_S = 1.0  # between trials, which follow one another in log time
DECIMALS = 6  # micrometres; the record has the exact figures
UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_CHUNK_BYTES = 2**20
_LEVEL_INFO, _LEVEL_WARNING, _LEVEL_ERROR = 2, 3, 4


def logged_ticks(last: int, dt_s: float, rate_hz: float) -> NDArray[np.int64]:
    """Every so many ticks of `dt_s` as the rate says, from 0 on, and the last one."""
    stride = max(1, round(1 / (rate_hz * dt_s)))
    return np.append(np.arange(0, last, stride, dtype=np.int64), np.int64(last))


class LogWriter:
    """A log that is being written; equal calls give equal bytes.

    Args:
        stream: where to write; the caller makes the file appear.
        channels: topic to the name of its schema in `log_schemas.SCHEMAS`.
        chunk_bytes: how much is written at once; what is not yet written is lost in a crash.
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
        """Add a message."""
        nanoseconds = _nanoseconds(time_s)
        self._writer.add_message(
            self._channels[topic], nanoseconds, msgspec.json.encode(message), nanoseconds
        )

    def note(self, name: str, texts: Mapping[str, str]) -> None:
        """Add metadata, at once."""
        self._writer.add_metadata(name, dict(texts))

    def close(self) -> None:
        """Close the log without a record."""
        self._writer.finish()

    def finish(self, record: RunRecord) -> None:
        """Add the record without its measured times, and its provenance, as metadata; close the log."""
        bare = msgspec.structs.replace(record, timing=None)
        texts = {"record": bare, "provenance": bare.provenance}
        encoded = {key: msgspec.json.encode(value, order="sorted").decode() for key, value in texts.items()}
        self._writer.add_metadata(RUN_METADATA, encoded)
        self._writer.finish()


def _nanoseconds(time_s: float) -> int:
    return round(time_s * 1e9)


def stamp(time_s: float) -> dict[str, int]:
    """A time as Foxglove writes it."""
    sec, nsec = divmod(_nanoseconds(time_s), 10**9)
    return {"sec": sec, "nsec": nsec}


def point_message(vector: NDArray[np.float64]) -> dict[str, float]:
    """A finite point as Foxglove writes it."""
    # adding zero turns a rounded -0.0 into 0.0
    x, y, z = (round(float(value), DECIMALS) + 0.0 for value in vector)
    return {"x": x, "y": y, "z": z}


def path_message(points: NDArray[np.float64], frame: str, time_s: float) -> dict[str, Any]:
    """A whole path, shape (T, 3)."""
    poses = [{"position": point_message(point), "orientation": UPRIGHT} for point in points]
    return {"timestamp": stamp(time_s), "frame_id": frame, "poses": poses}


def log_message(said: tuple[str, bool, bool], time_s: float) -> dict[str, Any]:
    """A line about a trial: its words, whether it ended well, and whether it collided."""
    words, is_good, collided = said
    level = _LEVEL_INFO if is_good else _LEVEL_WARNING
    if collided:
        level, words = _LEVEL_ERROR, words + ", COLLISION"
    return {
        "timestamp": stamp(time_s),
        "level": level,
        "message": words,
        "name": "simulate",
        "file": "",
        "line": 0,
    }
