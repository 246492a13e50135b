"""Messages that all logs share: numbers, vectors and quaternions as they are rounded, paths and shapes.

Times of messages are log times: nanoseconds since 1970-01-01 UTC.
"""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
from msgspec.structs import asdict, astuple
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.log.foxglove import (
    ERROR,
    INFO,
    ORIGIN,
    WARNING,
    Color,
    FrameTransform,
    KeyValuePair,
    Log,
    Point3,
    Pose,
    PosesInFrame,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    SpherePrimitive,
    Time,
    TriangleListPrimitive,
    Vector3,
)

DECIMALS = 6  # micrometres; the record has the exact figures
BODY_FRAME = "body"  # name of the vehicle's frame: x forward, y left, z up
_OBSTACLE_COLOR = Color(0.8, 0.3, 0.1, 0.9)
_TRACK_COLOR = Color(0.1, 0.45, 0.8, 0.35)
_VEHICLE_COLOR = Color(0.98, 0.82, 0.16, 0.9)


def number(value: Any) -> float | None:
    """Round to six digits after the point; None for a value that is not finite."""
    scalar = float(value)
    # Adding zero turns a rounded -0.0 into 0.0.
    return round(scalar, DECIMALS) + 0.0 if math.isfinite(scalar) else None


def xyz(vector: NDArray[Any]) -> Point3:
    """Round a vector or point; components that are not finite are None.

    Args:
        vector: shape (3,).
    """
    x, y, z = vector.tolist()
    return Point3(number(x), number(y), number(z))


def quaternion(wxyz: NDArray[Any]) -> Quaternion:
    """Round a quaternion.

    Args:
        wxyz: shape (4,), finite.
    """
    w, x, y, z = (round(float(value), DECIMALS) + 0.0 for value in wxyz)
    return Quaternion(x, y, z, w)


def quaternion_of_mrp(sigma: FloatArray) -> Quaternion:
    """Attitude, body to world, of Modified Rodrigues Parameters of the body in the world.

    q = (1 - n, 2 sigma) / (1 + n) with n = |sigma|^2 turns the world's axes into the body's.

    Args:
        sigma: shape (3,).
    """
    n = float(sigma @ sigma)
    return quaternion(np.array([1 - n, *(2 * sigma)]) / (1 + n))


def rounded(value: Any) -> Any:
    """Round the numbers of a message: of vectors to six digits, others to nine; None where not finite.

    Args:
        value: a message, or a part of one.
    """
    kind = type(value)
    if kind is float:
        return round(value, 9) if math.isfinite(value) else None
    if kind is Vector3 or kind is Quaternion:
        return kind(*map(number, astuple(value)))
    if kind is list:
        return [rounded(one) for one in value]
    if isinstance(value, msgspec.Struct):
        return kind(**{name: rounded(one) for name, one in asdict(value).items()})
    return value


def nanoseconds(time_s: float) -> int:
    """Duration [ns] of a duration [s]."""
    return round(time_s * 1e9)


def transform_message(pose: Pose, frame: str, time_ns: int) -> FrameTransform:
    """T_frame_body of the vehicle.

    Args:
        frame: name of the parent frame.
    """
    return FrameTransform(Time.of(time_ns), frame, BODY_FRAME, pose.position, pose.orientation)


def path_message(points: FloatArray, frame: str, time_ns: int) -> PosesInFrame:
    """A whole path.

    Args:
        points: shape (T, 3) [m].
    """
    return PosesInFrame(Time.of(time_ns), frame, [Pose(xyz(point)) for point in points])


def verdict_message(words: str, time_ns: int, *, is_good: bool, collided: bool) -> Log:
    """Line about a trial.

    Args:
        is_good: the trial ended well; otherwise the line is a warning.
        collided: the line is an error and says so.
    """
    level = INFO if is_good else WARNING
    if collided:
        level, words = ERROR, words + ", COLLISION"
    return Log(Time.of(time_ns), level, words, "simulate")


def entity(name: str, frame: str, time_ns: int, **shapes: Any) -> SceneEntity:
    """Shapes that stay until they are replaced.

    Args:
        shapes: lists of `SceneEntity`, by name.
    """
    return SceneEntity(timestamp=Time.of(time_ns), frame_id=frame, id=name, **shapes)


def facts(**values: int) -> list[KeyValuePair]:
    """Metadata of an entity."""
    return [KeyValuePair(key, str(value)) for key, value in values.items()]


def triangle_list(points: FloatArray, triangles: NDArray[Any], color: Color) -> TriangleListPrimitive:
    """Triangles of one colour.

    Args:
        points: corners, shape (V, 3), in the frame of the entity [m].
        triangles: their indices, shape (T, 3), counter-clockwise from outside.
    """
    indices = triangles.ravel().tolist()
    return TriangleListPrimitive(ORIGIN, [xyz(point) for point in points], color, [], indices)


def obstacle_message(
    obstacles: FloatArray, tracks: FloatArray, radii_m: list[float], frame: str, time_ns: int
) -> SceneUpdate:
    """Moving obstacles: a sphere for each, and one twice as large at each track.

    Args:
        obstacles: true positions, shape (n, 3), world frame [m].
        tracks: shape (n, 3), NaN without a track [m].
        radii_m: of the obstacles [m].
    """
    is_tracked = [bool(np.isfinite(track).all()) for track in tracks]
    true = [_ball(p, r, _OBSTACLE_COLOR) for p, r in zip(obstacles, radii_m, strict=True)]
    tracked = [
        _ball(p, 2 * r, _TRACK_COLOR) for p, r, t in zip(tracks, radii_m, is_tracked, strict=True) if t
    ]
    entities = [entity("obstacles", frame, time_ns, spheres=true)]
    return SceneUpdate(entities=[*entities, entity("tracks", frame, time_ns, spheres=tracked)])


def vehicle_message(radius_m: float, time_ns: int) -> SceneUpdate:
    """The vehicle's sphere in its own frame, which `/tf` moves.

    Args:
        radius_m: of the vehicle [m].
    """
    ball = _ball(np.zeros(3), radius_m, _VEHICLE_COLOR)
    return SceneUpdate(entities=[entity("vehicle", BODY_FRAME, time_ns, spheres=[ball])])


def _ball(position: FloatArray, radius_m: float, color: Color) -> SpherePrimitive:
    width = 2 * radius_m
    return SpherePrimitive(Pose(xyz(position)), Vector3(width, width, width), color)
