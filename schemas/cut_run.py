"""Logs of real flights that ended with a crash or a power cut, read up to their last whole chunk."""

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
    """A run and its flights; `damage` says how much there is of a log that was cut, else it is empty."""

    record: RunRecord
    flights: Flights
    damage: str = ""


class _Supervisor(msgspec.Struct):
    time_s: float
    state_name: str


def read_logged(log: Path) -> LoggedRun:
    """A run with its flights, or what is left of the log of a real flight that nobody ended.

    Raises:
        InputError: the log cannot be read.
        ArtifactError: it is not a run of alula's.
        DamagedError: truncated or corrupt, and no log of a real flight.
    """
    try:
        return LoggedRun(read_run(log), read_flights(log))
    except ArtifactError:
        found = salvage_run(log)
        if found is None:
            raise
        return found


def salvage_run(log: Path) -> LoggedRun | None:
    """What can be read of the log of a real flight without its end; None of any other file.

    The record has no trial, for nobody has judged the flight.

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
        known = [decode(data) for topic, data in messages if topic == "/supervisor"]
    except (KeyError, ValueError, msgspec.MsgspecError):
        return None
    ended = f"after {known[-1].time_s:.2f} s, in the state {known[-1].state_name}" if known else "at once"
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
        guarantee=Guarantee("Nobody has judged this flight: its log was cut.", {}),
    )
    return LoggedRun(record, flights, damage)


def _records(log: Path) -> Iterator[tuple[str, bytes | dict[str, str]]]:
    """Messages by topic and metadata by name, in the order of the file, up to where it is damaged."""
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
