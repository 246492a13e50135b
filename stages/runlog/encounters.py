"""Logs of encounters with moving obstacles: vehicle, obstacles, tracks and commands."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, BinaryIO

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.run import RunRecord, TrialResult
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.runlog.maps import walls_message
from alula.stages.runlog.messages import UPRIGHT, entity, number, pose_message, scene_message, sphere, xyz
from alula.stages.runlog.schemas import ENCOUNTER_CHANNELS
from alula.stages.runlog.writer import LoggedTrial, write_trials
from alula.stages.simulation.result import WorldFlight

MODES = ("nominal", "avoid", "hover")
_OBSTACLE_COLOR = {"r": 0.8, "g": 0.3, "b": 0.1, "a": 0.9}
_TRACK_COLOR = {"r": 0.1, "g": 0.45, "b": 0.8, "a": 0.35}


def write_encounter_log(
    stream: BinaryIO,
    record: RunRecord,
    flights: list[WorldFlight],
    walls: Hulls | None,
    frame: str,
    *,
    dt_s: float,
    radii_m: list[float],
    radius_m: float,
) -> None:
    """Write the log of the trials that are shown; see `write_trials`.

    `/obstacles` has a sphere for each obstacle, and one of twice its radius at each track. The margin of
    `/safety` is the minimum true distance to an obstacle less both radii.

    Args:
        stream: binary stream to write to.
        record: summary of all trials.
        flights: samples of those that are shown.
        walls: static obstacles.
        frame: name of the frame of all positions.
        dt_s: duration of a tick [s].
        radii_m: of the obstacles [m].
        radius_m: of the vehicle [m].
    """
    trials = (
        _logged(record.trials[flight.trial], flight, frame, dt_s, radii_m, radius_m) for flight in flights
    )
    write_trials(stream, ENCOUNTER_CHANNELS, record, walls_message(walls, frame), trials, frame)


def _logged(
    trial: TrialResult,
    flight: WorldFlight,
    frame: str,
    dt_s: float,
    radii_m: list[float],
    radius_m: float,
) -> LoggedTrial:
    state, obstacles, tracks = flight.rows("state"), flight.rows("obstacles"), flight.rows("tracks")
    command, nominal = flight.rows("command"), flight.rows("nominal")
    mode = flight.mode()
    reach = np.array(radii_m, np.float64) + radius_m
    gap = np.linalg.norm(obstacles - state[:, None, :3], axis=2) - reach

    def messages(i: int, now_s: float) -> Iterator[tuple[str, dict[str, Any]]]:
        position = xyz(state[i, :3])
        yield "/pose", pose_message(position, UPRIGHT, frame, now_s)
        yield "/state", {"position_m": position, "velocity_m_s": xyz(state[i, 6:9])}
        status = FilterStatus(flight.status[i])
        margin = number(gap[i].min(initial=np.inf))
        yield (
            "/safety",
            {
                **({} if margin is None else {"margin": margin}),
                "margin_unit": "m",
                "status": int(status),
                "status_name": status.name.lower(),
                "mode_name": MODES[mode[i]],
                "a_nom_m_s2": xyz(nominal[i]),
                "a_safe_m_s2": xyz(command[i, :3]),
            },
        )
        yield "/obstacles", obstacle_message(obstacles[i], tracks[i], radii_m, frame, now_s)

    is_good = trial.outcome == "passed"
    return LoggedTrial(trial, _words(trial), is_good, flight.time_s(dt_s), state[:, :3], messages)


def _words(trial: TrialResult) -> str:
    near = [f"{obstacle.closest_m:.2f}" for obstacle in trial.obstacles or []]
    words = f"trial {trial.index}: {trial.outcome} after {trial.duration_s:.2f} s"
    return f"{words}, minimum distance to obstacles {' and '.join(near)} m" if near else words


def obstacle_message(
    obstacles: FloatArray, tracks: FloatArray, radii_m: list[float], frame: str, time_s: float
) -> dict[str, Any]:
    """`foxglove.SceneUpdate` of moving obstacles: a sphere for each, and one twice as large at each track.

    Args:
        obstacles: true positions, shape (n, 3), world frame [m].
        tracks: shape (n, 3), NaN without a track [m].
        radii_m: of the obstacles [m].
        frame: name of the frame.
        time_s: log time [s].
    """
    is_tracked = [bool(np.isfinite(track).all()) for track in tracks]
    true = [_ball(p, r, _OBSTACLE_COLOR) for p, r in zip(obstacles, radii_m, strict=True)]
    tracked = [
        _ball(p, 2 * r, _TRACK_COLOR) for p, r, t in zip(tracks, radii_m, is_tracked, strict=True) if t
    ]
    return scene_message(
        entity("obstacles", frame, time_s) | {"spheres": true},
        entity("tracks", frame, time_s) | {"spheres": tracked},
    )


def _ball(position: FloatArray, radius_m: float, color: dict[str, float]) -> dict[str, Any]:
    size = dict.fromkeys("xyz", 2 * radius_m)
    return sphere(xyz(position), UPRIGHT, size, color)
