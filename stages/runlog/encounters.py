"""What a log says of an encounter with moving obstacles: who was where, what was tracked, what was flown."""

from __future__ import annotations

from typing import Any, BinaryIO, Self

import msgspec
import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.run import RunRecord, TrialResult
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.runlog.ellipsoids import number, xyz
from alula.stages.runlog.writer import GAP_S, LogWriter, log_message, logged_ticks, path_message, stamp

CHANNELS = {
    "/map": "foxglove.SceneUpdate",
    "/obstacles": "foxglove.SceneUpdate",
    "/path": "foxglove.PosesInFrame",
    "/state": "alula.State",
    "/safety": "alula.Safety",
    "/log": "foxglove.Log",
}
MODES = ("nominal", "avoid", "hover")
_STILL = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_WALL_COLOR = {"r": 0.55, "g": 0.6, "b": 0.68, "a": 0.6}
_OBSTACLE_COLOR = {"r": 0.8, "g": 0.3, "b": 0.1, "a": 0.9}
_TRACK_COLOR = {"r": 0.1, "g": 0.45, "b": 0.8, "a": 0.35}


class EncounterFlight(msgspec.Struct, frozen=True, kw_only=True):
    """One trial at the log's rate: T rows of numbers, as bytes so that a journal can hold them.

    `vehicle` has position, velocity and acceleration, shape (T, 9); `obstacles` and `tracks` positions,
    shape (T, n, 3), NaN without a track; `command` and `nominal` accelerations, shape (T, 3); `mode`
    and `status` a byte for each.
    """

    trial: int
    tick: bytes
    vehicle: bytes
    obstacles: bytes
    tracks: bytes
    command: bytes
    nominal: bytes
    mode: bytes
    status: bytes

    @classmethod
    def of(cls, trial: int, flown: dict[str, Any], dt_s: float, rate_hz: float) -> Self:
        """Every so many ticks as the rate says, and the last one."""
        sample = logged_ticks(len(flown["mode"]) - 1, dt_s, rate_hz)
        names = ("vehicle", "obstacles", "tracks", "command", "nominal", "mode", "status")
        return cls(
            trial=trial, tick=sample.tobytes(), **{name: flown[name][sample].tobytes() for name in names}
        )

    def rows(self, name: str) -> FloatArray:
        """Of the vehicle, command or nominal, shape (T, columns); of obstacles or tracks, shape (T, n, 3)."""
        flat: FloatArray = np.frombuffer(getattr(self, name), np.float64)
        if name in ("obstacles", "tracks"):
            return flat.reshape(len(self.mode), -1, 3)
        return flat.reshape(len(self.mode), -1)

    def time_s(self, dt_s: float) -> FloatArray:
        """When the samples are, shape (T,) [s]."""
        return np.frombuffer(self.tick, np.int64).astype(np.float64) * dt_s


def write_encounter_log(
    stream: BinaryIO,
    record: RunRecord,
    flights: list[EncounterFlight],
    walls: Hulls | None,
    frame: str,
    *,
    dt_s: float,
    radii_m: list[float],
    radius_m: float,
) -> None:
    """Write a log of the trials that are shown; equal arguments give equal bytes.

    Channels as `write_log` writes them, and `/obstacles`: a sphere for each obstacle, and a larger one for
    the track next to it.
    The margin of `/safety` is the least true distance to an obstacle less both radii.

    Args:
        stream: where to write; the caller makes the file appear.
        record: the summary, of all trials.
        flights: some of them.
        walls: static obstacles.
        frame: name of the frame of all positions.
        dt_s: of a tick.
        radii_m: of the obstacles.
        radius_m: of the vehicle.
    """
    log = LogWriter(stream, CHANNELS)
    log.send("/map", 0.0, _map_message(walls, frame))
    begin_s = 0.0
    for flight in flights:
        time, vehicle, obstacles = flight.time_s(dt_s), flight.rows("vehicle"), flight.rows("obstacles")
        reach = np.array(radii_m, np.float64) + radius_m
        gap = np.linalg.norm(obstacles - vehicle[:, None, :3], axis=2) - reach
        log.send("/path", begin_s, path_message(vehicle[:, :3], frame, begin_s))
        tracks, command, nominal = flight.rows("tracks"), flight.rows("command"), flight.rows("nominal")
        for i in range(len(time)):
            now_s = begin_s + float(time[i])
            common = {"trial": flight.trial, "time_s": round(float(time[i]), 9)}
            state = {"position_m": xyz(vehicle[i, :3]), "velocity_m_s": xyz(vehicle[i, 3:6])}
            log.send("/state", now_s, common | state)
            status = FilterStatus(flight.status[i])
            margin = number(gap[i].min(initial=np.inf))
            answer = {
                **({} if margin is None else {"margin": margin}),
                "margin_unit": "m",
                "status": int(status),
                "status_name": status.name.lower(),
                "mode_name": MODES[flight.mode[i]],
                "a_nom_m_s2": xyz(nominal[i]),
                "a_safe_m_s2": xyz(command[i]),
            }
            log.send("/safety", now_s, common | answer)
            log.send("/obstacles", now_s, _obstacle_message(obstacles[i], tracks[i], radii_m, frame, now_s))
        begin_s += float(time[-1])
        log.send("/log", begin_s, log_message(_words(record.trials[flight.trial]), begin_s))
        begin_s += GAP_S
    log.finish(record)


def _words(trial: TrialResult) -> tuple[str, bool, bool]:
    near = [f"{obstacle.closest_m:.2f}" for obstacle in trial.obstacles or []]
    words = f"trial {trial.index}: {trial.outcome} after {trial.duration_s:.2f} s"
    if near:
        words += f", obstacles came as near as {' and '.join(near)} m"
    return words, trial.outcome == "passed", trial.collision


def _entity(name: str, frame: str, time_s: float) -> dict[str, Any]:
    return {
        "timestamp": stamp(time_s),
        "frame_id": frame,
        "id": name,
        "lifetime": stamp(0.0),
        "frame_locked": True,
    }


def _sphere(position: FloatArray, radius_m: float, color: dict[str, float]) -> dict[str, Any]:
    size = {"x": 2 * radius_m, "y": 2 * radius_m, "z": 2 * radius_m}
    return {"pose": {"position": xyz(position), "orientation": _STILL}, "size": size, "color": color}


def _obstacle_message(
    obstacles: FloatArray, tracks: FloatArray, radii_m: list[float], frame: str, time_s: float
) -> dict[str, Any]:
    seen = [bool(np.isfinite(track).all()) for track in tracks]
    true = [_sphere(p, r, _OBSTACLE_COLOR) for p, r in zip(obstacles, radii_m, strict=True)]
    tracked = [_sphere(p, 2 * r, _TRACK_COLOR) for p, r, s in zip(tracks, radii_m, seen, strict=True) if s]
    entities = [
        _entity("obstacles", frame, time_s) | {"spheres": true},
        _entity("tracks", frame, time_s) | {"spheres": tracked},
    ]
    return {"deletions": [], "entities": entities}


def _map_message(walls: Hulls | None, frame: str) -> dict[str, Any]:
    """The surfaces of the walls as triangles."""
    if walls is None:
        return {"deletions": [], "entities": []}
    from scipy.spatial import ConvexHull

    triangles = []
    for k in range(len(walls)):
        corners = walls.vertices_world[walls.vertex_start[k] : walls.vertex_start[k + 1]]
        faces = ConvexHull(corners)
        a, b, c = (corners[faces.simplices[:, i]] for i in range(3))
        is_inward = (np.cross(b - a, c - a) * faces.equations[:, :3]).sum(axis=1) < 0
        faces.simplices[is_inward] = faces.simplices[is_inward][:, ::-1]
        triangles.append(
            {
                "pose": {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": _STILL},
                "points": [xyz(point) for point in corners],
                "color": _WALL_COLOR,
                "colors": [],
                "indices": faces.simplices.ravel().tolist(),
            }
        )
    shape = {"metadata": [{"key": "hulls", "value": str(len(walls))}], "triangles": triangles}
    return {"deletions": [], "entities": [_entity("map", frame, 0.0) | shape]}
