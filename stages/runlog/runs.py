"""Logs of flights among hulls, which Foxglove opens without configuration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, BinaryIO

from alula.schemas.artifact import Artifact
from alula.schemas.run import RunRecord, TrialResult
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.runlog.maps import map_message
from alula.stages.runlog.messages import DECIMALS, UPRIGHT, pose_message, xyz
from alula.stages.runlog.schemas import FLIGHT_CHANNELS
from alula.stages.runlog.writer import LoggedTrial, write_trials
from alula.stages.simulation.result import FlightLog

Messages = Iterator[tuple[str, dict[str, Any]]]


def write_log(
    stream: BinaryIO, record: RunRecord, flights: Sequence[FlightLog], flown_through: Artifact, frame: str
) -> None:
    """Write the log of a run; see `write_trials`. The map is hulls as triangles.

    Args:
        stream: binary stream to write to.
        record: summary of the run.
        flights: the samples of each trial, in the order of `record.trials`.
        flown_through: the map, an `alula/cover`.
        frame: name of the frame of all positions.
    """
    map_ = map_message(flown_through, record.summary, [flight.position for flight in flights], frame)
    trials = (_logged(*pair, frame) for pair in zip(record.trials, flights, strict=True))
    write_trials(stream, FLIGHT_CHANNELS, record, map_, trials, frame)


def _logged(trial: TrialResult, flight: FlightLog, frame: str) -> LoggedTrial:
    def messages(i: int, now_s: float) -> Messages:
        return _among_hulls(flight, i, frame, now_s)

    return LoggedTrial(
        trial, _words(trial), trial.outcome == "reached", flight.time_s, flight.position, messages
    )


def _words(trial: TrialResult) -> str:
    words = f"trial {trial.index}: {trial.outcome} after {trial.duration_s:.2f} s"
    clearance = trial.map_clearance_m
    return words if clearance is None else f"{words}, minimum clearance {clearance:.4f} m"


def _among_hulls(flight: FlightLog, i: int, frame: str, now_s: float) -> Messages:
    position = xyz(flight.position[i])
    yield "/pose", pose_message(position, UPRIGHT, frame, now_s)
    yield "/state", {"position_m": position, "velocity_m_s": xyz(flight.velocity[i])}
    status = FilterStatus(int(flight.status[i]))
    yield (
        "/safety",
        {
            "h_m": round(float(flight.margin[i]), DECIMALS),
            "status": int(status),
            "status_name": status.name.lower(),
            "u_nom_m_s": xyz(flight.u_nom[i]),
            "u_safe_m_s": xyz(flight.velocity[i]),
        },
    )
