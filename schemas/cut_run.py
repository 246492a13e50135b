"""Truncated logs of real flights, read up to their last complete chunk.

A log is truncated when the flight ended with a crash or a power cut.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from alula.schemas.errors import ArtifactError, DamagedError
from alula.schemas.flights import Flights, flights_of, read_flights
from alula.schemas.manifest import Guarantee
from alula.schemas.provenance import Provenance
from alula.schemas.run import (
    FLIGHT_METADATA,
    RUN_SCHEMA,
    RUN_VERSION,
    RunRecord,
    open_log,
    read_run,
)


@dataclass(frozen=True, slots=True)
class LoggedRun:
    """Run and its flights.

    Attributes:
        record: of the run.
        flights: by trial.
        damage: where a truncated log ends, in words; empty for a complete log.
    """

    record: RunRecord
    flights: Flights
    damage: str = ""


class _Supervisor(msgspec.Struct):
    time_s: float
    state_name: str


def read_logged(log: Path) -> LoggedRun:
    """Read a run with its flights, or the readable part of a truncated log of a real flight.

    Args:
        log: file of the run.

    Raises:
        InputError: the log cannot be read.
        ArtifactError: the file is not a run.
        DamagedError: the file is truncated or corrupt, and is not the log of a real flight.
    """
    try:
        return LoggedRun(read_run(log), read_flights(log))
    except ArtifactError:
        found = salvage_run(log)
        if found is None:
            raise
        return found


def salvage_run(log: Path) -> LoggedRun | None:
    """Read the complete chunks of a truncated log of a real flight; None for any other file.

    The record has no trial, because the flight was not judged.

    Args:
        log: file of the log.

    Raises:
        InputError: the log cannot be opened.
    """
    head: dict[str, str] = {}
    messages: list[tuple[str, bytes]] = []
    for name, data in _records(log):
        if isinstance(data, dict):
            head = data if name == FLIGHT_METADATA else head
        else:
            messages.append((name, data))
    try:
        provenance = msgspec.json.decode(head["provenance"], type=Provenance)
        flights = flights_of(messages)
        decode = msgspec.json.Decoder(_Supervisor).decode
        ticks = [decode(data) for topic, data in messages if topic == "/supervisor"]
    except (KeyError, ValueError, msgspec.MsgspecError):
        return None
    ended = (
        f"after {ticks[-1].time_s:.2f} s, in the state {ticks[-1].state_name}" if ticks else "at its start"
    )
    damage = f"the log of this flight was cut: it ends {ended}"
    record = RunRecord(
        schema=RUN_SCHEMA,
        version=RUN_VERSION,
        provenance=provenance,
        name=head.get("name", ""),
        filter=head.get("filter", ""),
        vehicle=head.get("vehicle", ""),
        trials=[],
        summary={"trials": 0, "notes": [f"{damage}; the flight was not judged"]},
        guarantee=Guarantee("This flight was not judged, because its log was cut.", {}),
    )
    return LoggedRun(record, flights, damage)


def _records(log: Path) -> Iterator[tuple[str, bytes | dict[str, str]]]:
    """Messages by topic and metadata by name, in the order of the file, up to the first damage."""
    from mcap.records import Channel, Message, Metadata
    from mcap.stream_reader import StreamReader

    topics: dict[int, str] = {}
    with suppress(DamagedError), open_log(log) as file:
        for record in StreamReader(file, validate_crcs=True).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                yield topics.get(record.channel_id, "?"), record.data
            elif isinstance(record, Metadata):
                yield record.name, record.metadata
