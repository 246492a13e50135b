"""Logs of flights among ellipsoids, which Foxglove opens without configuration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, BinaryIO

from alula.schemas.artifact import Artifact
from alula.schemas.run import RunRecord, TrialResult
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.runlog.maps import map_message
from alula.stages.runlog.messages import number, pose_message, quaternion_of_mrp, xyz
from alula.stages.runlog.schemas import FLIGHT_CHANNELS
from alula.stages.runlog.writer import LoggedTrial, write_trials
from alula.stages.simulation.result import SplatFlightLog

Messages = Iterator[tuple[str, dict[str, Any]]]


def write_log(
    stream: BinaryIO,
    record: RunRecord,
    flights: Sequence[SplatFlightLog],
    flown_through: Artifact,
    frame: str,
) -> None:
    """Write the log of a run; see `write_trials`. The map is hulls as triangles, or ellipsoids as spheres.

    Args:
        stream: binary stream to write to.
        record: summary of the run.
        flights: the samples of each trial, in the order of `record.trials`.
        flown_through: the map, an `alula/cover` or an `alula/scene`.
        frame: name of the frame of all positions.
    """
    map_ = map_message(flown_through, record.summary, [flight.position for flight in flights], frame)
    trials = (_logged(*pair, frame) for pair in zip(record.trials, flights, strict=True))
    write_trials(stream, FLIGHT_CHANNELS, record, map_, trials, frame)


def _logged(trial: TrialResult, flight: SplatFlightLog, frame: str) -> LoggedTrial:
    def messages(i: int, now_s: float) -> Messages:
        return _among_ellipsoids(flight, i, frame, now_s)

    return LoggedTrial(
        trial, _words(trial), trial.outcome == "reached", flight.time_s, flight.position, messages
    )


def _words(trial: TrialResult) -> str:
    words = f"trial {trial.index}: {trial.outcome} after {trial.duration_s:.2f} s"
    is_rigid = trial.peak_realisation_error_m_s2 is not None
    clearance = trial.scene_clearance_m if is_rigid else trial.map_clearance_m
    if clearance is None:
        clearance = trial.map_clearance_m
    return words if clearance is None else f"{words}, minimum clearance {clearance:.4f} m"


def _among_ellipsoids(flight: SplatFlightLog, i: int, frame: str, now_s: float) -> Messages:
    """Messages of a rigid body; no margin where no obstacle gives one."""
    state = flight.state[i]
    row = {name: array[i] for name, array in flight.flown.items()}
    position, attitude = xyz(flight.position[i]), quaternion_of_mrp(state[3:6])
    yield "/pose", pose_message(position, attitude, frame, now_s)
    yield (
        "/state",
        {
            "position_m": position,
            "velocity_m_s": xyz(state[6:9]),
            "attitude": attitude,
            "omega_body_rad_s": xyz(state[9:12]),
            "rotor_thrust_n": [number(value) for value in row["rotor_thrust"]],
            "thrust_n": number(row["u"][0]),
            "torque_body_nm": xyz(row["u"][1:]),
        },
    )
    status, margin = FilterStatus(int(row["status"])), number(row["margin"])
    yield (
        "/safety",
        {
            **({} if margin is None else {"margin": margin}),
            "margin_unit": "of the filter's barrier",
            "status": int(status),
            "status_name": status.name.lower(),
            **{name: bool(row[name]) for name in ("infeasible", "certified", "capped", "saturated")},
            **{name: int(row[name]) for name in ("active", "candidates", "rows", "iterations")},
            "gate_m": number(row["gate_m"]),
            "a_nom_m_s2": xyz(row["a_nominal"]),
            "a_safe_m_s2": xyz(row["a_command"]),
            "realisation_error_m_s2": number(row["a_error"]),
            "thrust_nom_n": number(row["u_nominal"][0]),
            "torque_nom_body_nm": xyz(row["u_nominal"][1:]),
        },
    )
