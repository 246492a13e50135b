"""Logs of flights in a geofence: state, the pilot's command and the one flown, distance to the fence."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.run import RunRecord, TrialResult
from alula.stages.compression.hulls import Hulls
from alula.stages.runlog.maps import fence_message
from alula.stages.runlog.messages import number, pose_message, quaternion, xyz
from alula.stages.runlog.schemas import FENCE_CHANNELS
from alula.stages.runlog.writer import LoggedTrial, write_trials
from alula.stages.simulation.result import FenceFlight

STATUSES = ("passed", "blended", "backup", "no-pilot", "hand-over", "refused")  # alula_geofence_status


def write_fence_log(
    stream: BinaryIO,
    record: RunRecord,
    flights: list[FenceFlight],
    faces: FloatArray,
    keep_out: Hulls | None,
    frame: str,
    *,
    tick_s: float,
) -> None:
    """Write the log of the flights that are shown; see `write_trials`.

    In `/safety` the margin is the true distance to the fence less the vehicle's radius, h_m the filter's h_I,
    and lambda the pilot's part of the command.

    Args:
        stream: binary stream to write to.
        record: summary of all trials.
        flights: samples of those that are shown.
        faces: of the fence, shape (L, 4), as `fence_faces` returns them.
        keep_out: hulls to stay out of.
        frame: name of the frame of all positions.
        tick_s: time between two calls of the filter [s].
    """
    paths = [flight.rows("state")[:, :3] for flight in flights]
    trials = (_logged(record.trials[flight.trial], flight, frame, tick_s) for flight in flights)
    write_trials(stream, FENCE_CHANNELS, record, fence_message(faces, keep_out, paths, frame), trials, frame)


def _logged(trial: TrialResult, flight: FenceFlight, frame: str, tick_s: float) -> LoggedTrial:
    state, distance, figure = flight.rows("state"), flight.rows("distance"), flight.rows("figure")
    pilot, command = flight.rows("pilot"), flight.rows("command")

    def messages(i: int, now_s: float) -> Iterator[tuple[str, dict[str, Any]]]:
        row = state[i]
        moved = {
            "position_m": xyz(row[:3]),
            "velocity_m_s": xyz(row[3:6]),
            "attitude": quaternion(row[6:10]),
            "omega_body_rad_s": xyz(row[10:13]),
        }
        yield "/pose", pose_message(moved["position_m"], moved["attitude"], frame, now_s)
        yield "/state", moved
        yield "/safety", _safety(flight.status[i], distance[i], figure[i], pilot[i], command[i])

    is_good = not trial.collision
    return LoggedTrial(trial, _words(trial), is_good, flight.time_s(tick_s), state[:, :3], messages)


def _safety(
    status: int, distance_m: float, figure: FloatArray, pilot: FloatArray, command: FloatArray
) -> dict[str, Any]:
    lambda_, h_i, _, margin, towards = figure
    fields: dict[str, Any] = {
        "margin": number(distance_m),
        "margin_unit": "m",
        "status": status,
        "status_name": STATUSES[status],
        "lambda": number(lambda_),
        "throttle_safe": number(command[0]),
        "rates_safe_rad_s": xyz(command[1:]),
    }
    if np.isfinite(pilot).all():
        fields |= {"throttle_nom": number(pilot[0]), "rates_nom_rad_s": xyz(pilot[1:])}
    if abs(h_i) < 1e30:  # the largest float stands for one that was not evaluated
        fields |= {"h_m": number(h_i), "allowance_m": number(margin), "towards_m_s": number(towards)}
    return fields


def _words(trial: TrialResult) -> str:
    words = f"trial {trial.index}: {trial.outcome} for {trial.duration_s:.2f} s"
    if trial.map_clearance_m is not None:
        words += f", minimum distance to the fence {trial.map_clearance_m:.4f} m"
    if trial.fence is not None:
        words += f", {trial.fence.interventions} interventions"
    return words
