"""JSON messages that all logs share: numbers, vectors, quaternions, times, poses, paths and shapes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray

DECIMALS = 6  # micrometres; the record has the exact figures
UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_OBSTACLE_COLOR = {"r": 0.8, "g": 0.3, "b": 0.1, "a": 0.9}
_TRACK_COLOR = {"r": 0.1, "g": 0.45, "b": 0.8, "a": 0.35}
_LEVEL_INFO, _LEVEL_WARNING, _LEVEL_ERROR = 2, 3, 4


def number(value: Any) -> float | None:
    """Round to six digits after the point; None for a value that is not finite.

    Args:
        value: anything that `float` takes.
    """
    scalar = float(value)
    # Adding zero turns a rounded -0.0 into 0.0.
    return round(scalar, DECIMALS) + 0.0 if math.isfinite(scalar) else None


def xyz(vector: NDArray[Any]) -> dict[str, Any]:
    """Foxglove's Vector3 or Point3; components that are not finite are None.

    Args:
        vector: shape (3,).
    """
    x, y, z = (number(value) for value in vector)
    return {"x": x, "y": y, "z": z}


def quaternion(wxyz: NDArray[Any]) -> dict[str, Any]:
    """Foxglove's Quaternion.

    Args:
        wxyz: shape (4,).
    """
    w, x, y, z = (number(value) for value in wxyz)
    return {"x": x, "y": y, "z": z, "w": w}


def quaternion_of_mrp(sigma: FloatArray) -> dict[str, float]:
    """Foxglove's Quaternion, body to world, of Modified Rodrigues Parameters of the body in the world.

    q = (1 - n, 2 sigma) / (1 + n) with n = |sigma|^2 turns the world's axes into the body's.

    Args:
        sigma: shape (3,).
    """
    n = float(sigma @ sigma)
    x, y, z = (number(2 * value / (1 + n)) for value in sigma)
    return {"x": x or 0.0, "y": y or 0.0, "z": z or 0.0, "w": round((1 - n) / (1 + n), DECIMALS)}


def nanoseconds(time_s: float) -> int:
    """Log time [ns] of a time [s]."""
    return round(time_s * 1e9)


def stamp(time_s: float) -> dict[str, int]:
    """Foxglove's time of a log time [s]."""
    sec, nsec = divmod(nanoseconds(time_s), 10**9)
    return {"sec": sec, "nsec": nsec}


def pose_message(
    position: dict[str, Any], orientation: dict[str, Any], frame: str, time_s: float
) -> dict[str, Any]:
    """`foxglove.PoseInFrame`.

    Args:
        position: from `xyz` [m].
        orientation: from `quaternion`, body to frame.
        frame: name of the frame.
        time_s: log time [s].
    """
    pose = {"position": position, "orientation": orientation}
    return {"timestamp": stamp(time_s), "frame_id": frame, "pose": pose}


def path_message(points: FloatArray, frame: str, time_s: float) -> dict[str, Any]:
    """`foxglove.PosesInFrame` of a whole path.

    Args:
        points: shape (T, 3) [m].
        frame: name of their frame.
        time_s: log time [s].
    """
    poses = [{"position": xyz(point), "orientation": UPRIGHT} for point in points]
    return {"timestamp": stamp(time_s), "frame_id": frame, "poses": poses}


def log_message(words: str, time_s: float, *, is_good: bool, collided: bool) -> dict[str, Any]:
    """`foxglove.Log` about a trial.

    Args:
        words: the line.
        time_s: log time [s].
        is_good: the trial ended well; otherwise the line is a warning.
        collided: the line is an error and says so.
    """
    level = _LEVEL_INFO if is_good else _LEVEL_WARNING
    if collided:
        level, words = _LEVEL_ERROR, words + ", COLLISION"
    return {
        "timestamp": stamp(time_s),
        "level": level,
        "message": words,
        "name": "simulate",
        "file": "",
        "line": 0,
    }


def scene_message(*entities: dict[str, Any]) -> dict[str, Any]:
    """`foxglove.SceneUpdate` of entities."""
    return {"deletions": [], "entities": list(entities)}


def entity(name: str, frame: str, time_s: float = 0.0) -> dict[str, Any]:
    """`foxglove.SceneEntity` without shapes; it stays until it is replaced.

    Args:
        name: its id.
        frame: name of its frame.
        time_s: log time [s].
    """
    return {
        "timestamp": stamp(time_s),
        "frame_id": frame,
        "id": name,
        "lifetime": stamp(0.0),
        "frame_locked": True,
    }


def facts(**values: int) -> list[dict[str, str]]:
    """Metadata of an entity."""
    return [{"key": key, "value": str(value)} for key, value in values.items()]


def sphere(
    position: dict[str, Any], orientation: dict[str, Any], size: dict[str, Any], color: dict[str, float]
) -> dict[str, Any]:
    """`foxglove.SpherePrimitive`: an ellipsoid.

    Args:
        position: of its centre, from `xyz` [m].
        orientation: from `quaternion`.
        size: diameters along its axes, from `xyz` [m].
        color: red, green, blue and opacity, 0 to 1.
    """
    return {"pose": {"position": position, "orientation": orientation}, "size": size, "color": color}


def triangle_list(points: FloatArray, triangles: NDArray[Any], color: dict[str, float]) -> dict[str, Any]:
    """`foxglove.TriangleListPrimitive`.

    Args:
        points: corners, shape (V, 3), in the frame of the entity [m].
        triangles: their indices, shape (T, 3), counter-clockwise from outside.
        color: red, green, blue and opacity, 0 to 1.
    """
    return {
        "pose": {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": UPRIGHT},
        "points": [xyz(point) for point in points],
        "color": color,
        "colors": [],
        "indices": triangles.ravel().tolist(),
    }


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
