"""Writer of MCAP logs with JSON channels.

Foxglove publishes each of its message types both as Protobuf and as JSON Schema. alula writes JSON, through
Foxglove's `mcap` library. The other choice is `foxglove-sdk`, whose typed channels write Protobuf, with equal
bytes for equal calls. It is not used for files: it cannot read its messages back, which reports, replays and
the salvage of truncated logs do; it writes its own version into the header, so that the bytes of a run would
depend on the installed version; and it adds 54 MB to each installation. Tests build each message with the
classes of `foxglove-sdk`, which know the fields. The live channels are served by it (`fly --foxglove`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import BinaryIO

import msgspec

from alula.schemas.artifacts.provenance import RUN_METADATA
from alula.schemas.log.channels import schema_name, struct_of
from alula.schemas.log.json_schema import json_schema
from alula.schemas.log.run import RunRecord

_CHUNK_BYTES = 2**20


class LogWriter:
    """MCAP log that is being written; equal calls give equal bytes.

    Args:
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
        """Add a message."""
        self._writer.add_message(self._channels[topic], time_ns, msgspec.json.encode(message), time_ns)

    def note(self, name: str, texts: Mapping[str, str]) -> None:
        """Add metadata, at once."""
        self._writer.add_metadata(name, dict(texts))

    def attach(self, name: str, time_ns: int, data: bytes) -> None:
        """Add a file."""
        self._writer.add_attachment(time_ns, time_ns, name, "application/octet-stream", data)

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
