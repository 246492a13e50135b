"""A run as an MCAP log that Foxglove opens without configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifact import Artifact
from alula.schemas.kinds import SCENE
from alula.schemas.run import RunRecord, TrialResult
from alula.stages.compression.facets import mesh
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.runlog.ellipsoids import SplatFlightLog, ellipsoid_entity, safety_fields, state_fields
from alula.stages.runlog.writer import (
    DECIMALS,
    GAP_S,
    UPRIGHT,
    LogWriter,
    log_message,
    path_message,
    point_message,
    stamp,
)
from alula.stages.simulation.hulls.simulate import FlightLog

AnyFlight = FlightLog | SplatFlightLog

_CHANNELS = {
    "/map": "foxglove.SceneUpdate",
    "/path": "foxglove.PosesInFrame",
    "/state": "alula.State",
    "/safety": "alula.Safety",
    "/log": "foxglove.Log",
}
_RIGID_CHANNELS = {"/pose": "foxglove.PoseInFrame"}
_MAP_COLOR = {"r": 0.55, "g": 0.6, "b": 0.68, "a": 0.6}


def write_log(
    stream: BinaryIO, record: RunRecord, flights: Sequence[AnyFlight], flown_through: Artifact, frame: str
) -> None:
    """Write a log; equal arguments give equal bytes.

    Channels, all JSON: `/map` once, `/path` per trial, `/state` and `/safety` per sample, `/log` per trial;
    of a rigid body also `/pose` per sample. The map is hulls as triangles, or ellipsoids as spheres.
    Log time starts at 0 and trials follow one another with a second between them. The metadata
    `alula/summary` holds the record without its measured times, and its provenance.

    Args:
        stream: where to write; the caller makes the file appear.
        record: the summary.
        flights: the samples of each trial, in the order of `record.trials`.
        flown_through: the map, an `alula/cover` or an `alula/scene`.
        frame: name of the frame of all positions.
    """
    rigid = any(isinstance(flight, SplatFlightLog) for flight in flights)
    log = LogWriter(stream, _CHANNELS | (_RIGID_CHANNELS if rigid else {}))
    log.send("/map", 0.0, map_message(flown_through, record.summary, [f.position for f in flights], frame))
    begin_s = 0.0
    for trial, flight in zip(record.trials, flights, strict=True):
        log.send("/path", begin_s, path_message(flight.position, frame, begin_s))
        for i in range(len(flight.time_s)):
            now_s = begin_s + float(flight.time_s[i])
            if isinstance(flight, SplatFlightLog):
                log.send("/pose", now_s, _pose_message(flight, i, frame, now_s))
            log.send("/state", now_s, _state_message(trial.index, flight, i))
            log.send("/safety", now_s, _safety_message(trial.index, flight, i))
        begin_s += float(flight.time_s[-1])
        log.send("/log", begin_s, log_message(_words(trial), begin_s))
        begin_s += GAP_S
    log.finish(record)


def _state_message(trial: int, flight: AnyFlight, i: int) -> dict[str, Any]:
    common = {
        "trial": trial,
        "time_s": round(float(flight.time_s[i]), 9),
        "position_m": point_message(flight.position[i]),
    }
    if isinstance(flight, SplatFlightLog):
        return common | state_fields(flight, i)
    return common | {"velocity_m_s": point_message(flight.velocity[i])}


def _safety_message(trial: int, flight: AnyFlight, i: int) -> dict[str, Any]:
    common = {"trial": trial, "time_s": round(float(flight.time_s[i]), 9)}
    if isinstance(flight, SplatFlightLog):
        return common | safety_fields(flight, i)
    status = FilterStatus(int(flight.status[i]))
    return common | {
        "h_m": round(float(flight.margin[i]), DECIMALS),
        "status": int(status),
        "status_name": status.name.lower(),
        "u_nom_m_s": point_message(flight.u_nom[i]),
        "u_safe_m_s": point_message(flight.velocity[i]),
    }


def _pose_message(flight: SplatFlightLog, i: int, frame: str, time_s: float) -> dict[str, Any]:
    pose = {"position": point_message(flight.position[i]), "orientation": state_fields(flight, i)["attitude"]}
    return {"timestamp": stamp(time_s), "frame_id": frame, "pose": pose}


def _words(trial: TrialResult) -> tuple[str, bool, bool]:
    words = f"trial {trial.index}: {trial.outcome} after {trial.duration_s:.2f} s"
    clearance = (
        trial.map_clearance_m if trial.peak_realisation_error_m_s2 is None else trial.scene_clearance_m
    )
    if clearance is not None:
        words += f", least clearance {clearance:.4f} m"
    return words, trial.outcome == "reached", trial.collision


def map_message(
    flown_through: Artifact, summary: Mapping[str, Any], paths: list[NDArray[np.float64]], frame: str
) -> dict[str, Any]:
    """The map as `foxglove.SceneUpdate`: hulls, or ellipsoids near the paths at `summary["sigma"]`."""
    if flown_through.kind is SCENE:
        shape = ellipsoid_entity(flown_through, float(summary["sigma"]), paths)
    else:
        shape = _hull_entity(flown_through)
    entity = {
        "timestamp": stamp(0.0),
        "frame_id": frame,
        "id": "map",
        "lifetime": stamp(0.0),
        "frame_locked": True,
    }
    return {"deletions": [], "entities": [entity | shape]}


def _hull_entity(cover: Artifact) -> dict[str, Any]:
    """The surface of each hull as a triangle list, counter-clockwise from outside."""
    surface = mesh(cover)
    points = surface.points_voxel * float(cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
    triangles = []
    for k in range(len(surface)):
        first, end = surface.point_start[k], surface.point_start[k + 1]
        rows = surface.triangles[surface.triangle_start[k] : surface.triangle_start[k + 1]] - first
        triangles.append(
            {
                "pose": {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": UPRIGHT},
                "points": [point_message(point) for point in points[first:end]],
                "color": _MAP_COLOR,
                "colors": [],
                "indices": rows.ravel().tolist(),
            }
        )
    return {"metadata": [{"key": "hulls", "value": str(len(surface))}], "triangles": triangles}
