"""JSON messages that all logs share: numbers, vectors, quaternions, times, poses, paths and shapes.

Times of messages are log times: nanoseconds since 1970-01-01 UTC.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray

DECIMALS = 6  # micrometres; the record has the exact figures
BODY_FRAME = "body"  # name of the vehicle's frame: x forward, y left, z up
# Lists of a scene entity, all of which Foxglove's schema requires.
SHAPES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
UPRIGHT = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
_OBSTACLE_COLOR = {"r": 0.8, "g": 0.3, "b": 0.1, "a": 0.9}
_TRACK_COLOR = {"r": 0.1, "g": 0.45, "b": 0.8, "a": 0.35}
_VEHICLE_COLOR = {"r": 0.98, "g": 0.82, "b": 0.16, "a": 0.9}
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
    """Duration [ns] of a duration [s]."""
    return round(time_s * 1e9)


def stamp(time_ns: int) -> dict[str, int]:
    """Foxglove's time of a log time, or its duration of a duration [ns]."""
    sec, nsec = divmod(time_ns, 10**9)
    return {"sec": sec, "nsec": nsec}


def pose_message(
    position: dict[str, Any], orientation: dict[str, Any], frame: str, time_ns: int
) -> dict[str, Any]:
    """`foxglove.PoseInFrame`.

    Args:
        position: from `xyz` [m].
        orientation: from `quaternion`, body to frame.
        frame: name of the frame.
        time_ns: log time [ns].
    """
    pose = {"position": position, "orientation": orientation}
    return {"timestamp": stamp(time_ns), "frame_id": frame, "pose": pose}


def transform_message(
    position: dict[str, Any], orientation: dict[str, Any], frame: str, time_ns: int
) -> dict[str, Any]:
    """`foxglove.FrameTransform` T_frame_body of the vehicle.

    Args:
        position: of the vehicle, from `xyz` [m].
        orientation: from `quaternion`, body to frame.
        frame: name of the parent frame.
        time_ns: log time [ns].
    """
    return {
        "timestamp": stamp(time_ns),
        "parent_frame_id": frame,
        "child_frame_id": BODY_FRAME,
        "translation": position,
        "rotation": orientation,
    }


def path_message(points: FloatArray, frame: str, time_ns: int) -> dict[str, Any]:
    """`foxglove.PosesInFrame` of a whole path.

    Args:
        points: shape (T, 3) [m].
        frame: name of their frame.
        time_ns: log time [ns].
    """
    poses = [{"position": xyz(point), "orientation": UPRIGHT} for point in points]
    return {"timestamp": stamp(time_ns), "frame_id": frame, "poses": poses}


def line_message(words: str, level: int, program: str, time_ns: int) -> dict[str, Any]:
    """`foxglove.Log`.

    Args:
        words: the line.
        level: 2 info, 3 warning, 4 error.
        program: name of the command.
        time_ns: log time [ns].
    """
    return {
        "timestamp": stamp(time_ns),
        "level": level,
        "message": words,
        "name": program,
        "file": "",
        "line": 0,
    }


def verdict_message(words: str, time_ns: int, *, is_good: bool, collided: bool) -> dict[str, Any]:
    """`foxglove.Log` about a trial.

    Args:
        words: the line.
        time_ns: log time [ns].
        is_good: the trial ended well; otherwise the line is a warning.
        collided: the line is an error and says so.
    """
    level = _LEVEL_INFO if is_good else _LEVEL_WARNING
    if collided:
        level, words = _LEVEL_ERROR, words + ", COLLISION"
    return line_message(words, level, "simulate", time_ns)


def scene_message(*entities: dict[str, Any]) -> dict[str, Any]:
    """`foxglove.SceneUpdate` of entities."""
    return {"deletions": [], "entities": list(entities)}


def entity(name: str, frame: str, time_ns: int) -> dict[str, Any]:
    """`foxglove.SceneEntity` without shapes; it stays until it is replaced.

    Args:
        name: its id.
        frame: name of its frame.
        time_ns: log time [ns].
    """
    return {
        "timestamp": stamp(time_ns),
        "frame_id": frame,
        "id": name,
        "lifetime": stamp(0),
        "frame_locked": True,
        "metadata": [],
        **{shapes: [] for shapes in SHAPES},
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
    obstacles: FloatArray, tracks: FloatArray, radii_m: list[float], frame: str, time_ns: int
) -> dict[str, Any]:
    """`foxglove.SceneUpdate` of moving obstacles: a sphere for each, and one twice as large at each track.

    Args:
        obstacles: true positions, shape (n, 3), world frame [m].
        tracks: shape (n, 3), NaN without a track [m].
        radii_m: of the obstacles [m].
        frame: name of the frame.
        time_ns: log time [ns].
    """
    is_tracked = [bool(np.isfinite(track).all()) for track in tracks]
    true = [_ball(p, r, _OBSTACLE_COLOR) for p, r in zip(obstacles, radii_m, strict=True)]
    tracked = [
        _ball(p, 2 * r, _TRACK_COLOR) for p, r, t in zip(tracks, radii_m, is_tracked, strict=True) if t
    ]
    return scene_message(
        entity("obstacles", frame, time_ns) | {"spheres": true},
        entity("tracks", frame, time_ns) | {"spheres": tracked},
    )


def vehicle_message(radius_m: float, time_ns: int) -> dict[str, Any]:
    """`foxglove.SceneUpdate` of the vehicle's sphere in its own frame, which `/tf` moves.

    Args:
        radius_m: of the vehicle [m].
        time_ns: log time [ns].
    """
    ball = _ball(np.zeros(3), radius_m, _VEHICLE_COLOR)
    return scene_message(entity("vehicle", BODY_FRAME, time_ns) | {"spheres": [ball]})


def _ball(position: FloatArray, radius_m: float, color: dict[str, float]) -> dict[str, Any]:
    size = dict.fromkeys("xyz", 2 * radius_m)
    return sphere(xyz(position), UPRIGHT, size, color)
