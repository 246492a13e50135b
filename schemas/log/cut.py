"""Truncated logs of real flights, read up to their last complete chunk.

A log is truncated when the flight ended with a crash or a power cut.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import msgspec

from alula.schemas.artifacts.manifest import Guarantee
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.decode import decode_json, json_decoder
from alula.schemas.errors import ArtifactError, DamagedError
from alula.schemas.log.channels import SUPERVISOR_TOPIC, Supervisor
from alula.schemas.log.flights import Flights, flights_of, read_flights
from alula.schemas.log.mcap import entries, open_log
from alula.schemas.log.run import FLIGHT_METADATA, RUN_SCHEMA, RUN_VERSION, RunRecord, read_run


@dataclass(frozen=True, slots=True)
class LoggedRun:
    """Run and its flights.

    Attributes:
        damage: where a truncated log ends, in words; empty for a complete log.
    """

    record: RunRecord
    flights: Flights
    damage: str = ""


def read_logged(log: Path) -> LoggedRun:
    """Read a run with its flights, or the readable part of a truncated log of a real flight.

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

    Raises:
        InputError: the log cannot be opened.
    """
    head: dict[str, str] = {}
    messages: list[tuple[str, bytes]] = []
    with suppress(DamagedError), open_log(log) as file:
        for kind, name, data in entries(file):
            if kind == "metadata" and name == FLIGHT_METADATA:
                assert isinstance(data, dict)
                head = data
            elif kind == "message":
                assert isinstance(data, bytes)
                messages.append((name, data))
    try:
        provenance = decode_json(head["provenance"].encode(), Provenance)
        flights = flights_of(messages)
        decode = json_decoder(Supervisor).decode
        ticks = [decode(data) for topic, data in messages if topic == SUPERVISOR_TOPIC]
    except (KeyError, ValueError, RecursionError, msgspec.MsgspecError):
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
