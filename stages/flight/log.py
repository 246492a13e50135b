"""A run as an MCAP log that Foxglove opens without configuration."""

from __future__ import annotations

from typing import Any, BinaryIO

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifact import Artifact
from alula.schemas.provenance import RUN_METADATA
from alula.schemas.run import RunRecord, TrialResult
from alula.stages.compression.facets import mesh
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.log_schemas import SCHEMAS
from alula.stages.flight.simulate import FlightLog

_CHANNELS = {
    "/map": "foxglove.SceneUpdate",
    "/path": "foxglove.PosesInFrame",
    "/state": "alula.State",
    "/safety": "alula.Safety",
    "/log": "foxglove.Log",
}
_GAP_S = 1.0  # between trials, which follow one another in log time
_DECIMALS = 6  # micrometres; the record has the exact figures
_LEVEL_INFO, _LEVEL_WARNING, _LEVEL_ERROR = 2, 3, 4
_UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_MAP_COLOR = {"r": 0.55, "g": 0.6, "b": 0.68, "a": 0.6}


def write_log(
    stream: BinaryIO, record: RunRecord, flights: list[FlightLog], cover: Artifact, frame: str
) -> None:
    """Write a log; equal arguments give equal bytes.

    Channels, all JSON: `/map` once, `/path` per trial, `/state` and `/safety` per sample, `/log` per trial.
    Log time starts at 0 and trials follow one another with a second between them. The metadata
    `alula/summary` holds the record without its measured times, and its provenance.

    Args:
        stream: where to write; the caller makes the file appear.
        record: the summary.
        flights: the samples of each trial, in the order of `record.trials`.
        cover: the map, an `alula/cover`.
        frame: name of the frame of all positions.
    """
    from mcap.writer import Writer

    writer = Writer(stream)
    writer.start(profile="", library="alula")
    channels = {}
    for topic, schema in _CHANNELS.items():
        data = msgspec.json.encode(SCHEMAS[schema], order="sorted")
        schema_id = writer.register_schema(schema, "jsonschema", data)
        channels[topic] = writer.register_channel(topic, "json", schema_id)

    def send(topic: str, time_s: float, message: dict[str, Any]) -> None:
        nanoseconds = _nanoseconds(time_s)
        writer.add_message(channels[topic], nanoseconds, msgspec.json.encode(message), nanoseconds)

    send("/map", 0.0, _map_message(cover, frame))
    begin_s = 0.0
    for trial, flight in zip(record.trials, flights, strict=True):
        send("/path", begin_s, _path_message(flight, frame, begin_s))
        for i in range(len(flight.time_s)):
            now_s = begin_s + float(flight.time_s[i])
            send("/state", now_s, _state_message(trial.index, flight, i))
            send("/safety", now_s, _safety_message(trial.index, flight, i))
        begin_s += float(flight.time_s[-1])
        send("/log", begin_s, _log_message(trial, begin_s))
        begin_s += _GAP_S
    bare = msgspec.structs.replace(record, timing=None)
    texts = {"record": bare, "provenance": bare.provenance}
    encoded = {key: msgspec.json.encode(value, order="sorted").decode() for key, value in texts.items()}
    writer.add_metadata(RUN_METADATA, encoded)
    writer.finish()


def _nanoseconds(time_s: float) -> int:
    return round(time_s * 1e9)


def _stamp(time_s: float) -> dict[str, int]:
    sec, nsec = divmod(_nanoseconds(time_s), 10**9)
    return {"sec": sec, "nsec": nsec}


def _xyz(vector: NDArray[np.float64]) -> dict[str, float]:
    # adding zero turns a rounded -0.0 into 0.0
    x, y, z = (round(float(value), _DECIMALS) + 0.0 for value in vector)
    return {"x": x, "y": y, "z": z}


def _state_message(trial: int, flight: FlightLog, i: int) -> dict[str, Any]:
    return {
        "trial": trial,
        "time_s": round(float(flight.time_s[i]), 9),
        "position_m": _xyz(flight.position[i]),
        "velocity_m_s": _xyz(flight.velocity[i]),
    }


def _safety_message(trial: int, flight: FlightLog, i: int) -> dict[str, Any]:
    status = FilterStatus(int(flight.status[i]))
    return {
        "trial": trial,
        "time_s": round(float(flight.time_s[i]), 9),
        "h_m": round(float(flight.margin[i]), _DECIMALS),
        "status": int(status),
        "status_name": status.name.lower(),
        "u_nom_m_s": _xyz(flight.u_nom[i]),
        "u_safe_m_s": _xyz(flight.velocity[i]),
    }


def _path_message(flight: FlightLog, frame: str, time_s: float) -> dict[str, Any]:
    poses = [{"position": _xyz(point), "orientation": _UPRIGHT} for point in flight.position]
    return {"timestamp": _stamp(time_s), "frame_id": frame, "poses": poses}


def _log_message(trial: TrialResult, time_s: float) -> dict[str, Any]:
    level = _LEVEL_INFO if trial.outcome == "reached" else _LEVEL_WARNING
    words = f"trial {trial.index}: {trial.outcome} after {trial.duration_s:.2f} s"
    if trial.map_clearance_m is not None:
        words += f", least clearance {trial.map_clearance_m:.4f} m"
    if trial.collision:
        level, words = _LEVEL_ERROR, words + ", COLLISION"
    return {
        "timestamp": _stamp(time_s),
        "level": level,
        "message": words,
        "name": "simulate",
        "file": "",
        "line": 0,
    }


def _map_message(cover: Artifact, frame: str) -> dict[str, Any]:
    """The surface of each hull as a triangle list, counter-clockwise from outside."""
    surface = mesh(cover)
    points = surface.points_voxel * float(cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
    triangles = []
    for k in range(len(surface)):
        first, end = surface.point_start[k], surface.point_start[k + 1]
        rows = surface.triangles[surface.triangle_start[k] : surface.triangle_start[k + 1]] - first
        triangles.append(
            {
                "pose": {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": _UPRIGHT},
                "points": [_xyz(point) for point in points[first:end]],
                "color": _MAP_COLOR,
                "colors": [],
                "indices": rows.ravel().tolist(),
            }
        )
    entity = {
        "timestamp": _stamp(0.0),
        "frame_id": frame,
        "id": "map",
        "lifetime": _stamp(0.0),
        "frame_locked": True,
        "metadata": [{"key": "hulls", "value": str(len(surface))}],
        "triangles": triangles,
    }
    return {"deletions": [], "entities": [entity]}
