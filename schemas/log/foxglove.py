"""Foxglove's message types that logs have, with all of their fields, which Foxglove requires.

Times of messages are log times: nanoseconds since 1970-01-01 UTC. A field with a default may be missing in a
log that is read; all are written.
"""

from __future__ import annotations

import math
from typing import Annotated, Self

import msgspec
import numpy as np

from alula.schemas.arrays import FloatArray

INFO, WARNING, ERROR = 2, 3, 4  # levels of `Log`

_Count = Annotated[int, msgspec.Meta(ge=0)]
_Nanoseconds = Annotated[int, msgspec.Meta(ge=0, le=999_999_999)]


class Time(msgspec.Struct, frozen=True, gc=False):
    """Log time."""

    sec: _Count
    nsec: _Nanoseconds

    @classmethod
    def of(cls, time_ns: int) -> Self:
        """Make it from a log time [ns]."""
        return cls(*divmod(time_ns, 10**9))

    def since_s(self, start: Time) -> float:
        """Time since another [s]."""
        return self.sec - start.sec + 1e-9 * (self.nsec - start.nsec)


class Duration(msgspec.Struct, frozen=True, gc=False):
    """Duration; 0 stands for ever."""

    sec: int
    nsec: _Nanoseconds


class Vector3(msgspec.Struct, frozen=True, gc=False):
    """Vector; None for a component that is not finite."""

    x: float | None
    y: float | None
    z: float | None

    @property
    def array(self) -> FloatArray:
        """Shape (3,), NaN where unknown."""
        return np.array(self.tuple)

    @property
    def tuple(self) -> tuple[float, float, float]:
        """Its components, NaN where unknown."""
        x, y, z = (math.nan if value is None else value for value in (self.x, self.y, self.z))
        return x, y, z


class Point3(Vector3, frozen=True, gc=False):
    """Point of a shape."""


class Quaternion(msgspec.Struct, frozen=True, gc=False):
    """Attitude, body to the frame."""

    x: float
    y: float
    z: float
    w: float


UPRIGHT = Quaternion(0.0, 0.0, 0.0, 1.0)


class Pose(msgspec.Struct, frozen=True, gc=False):
    """Position [m] and attitude."""

    position: Vector3
    orientation: Quaternion = UPRIGHT


ORIGIN = Pose(Vector3(0.0, 0.0, 0.0))


class Color(msgspec.Struct, frozen=True, gc=False):
    """Red, green, blue and opacity, 0 to 1."""

    r: float
    g: float
    b: float
    a: float


class KeyValuePair(msgspec.Struct, frozen=True, gc=False):
    """Fact about an entity."""

    key: str
    value: str


class ArrowPrimitive(msgspec.Struct, gc=False):
    """Arrow [m]."""

    pose: Pose
    shaft_length: float
    shaft_diameter: float
    head_length: float
    head_diameter: float
    color: Color


class CubePrimitive(msgspec.Struct, gc=False):
    """Box; `size` are its edges [m]."""

    pose: Pose
    size: Vector3
    color: Color


class SpherePrimitive(msgspec.Struct, gc=False):
    """Ellipsoid; `size` are the diameters along its axes [m]."""

    pose: Pose
    size: Vector3
    color: Color


class CylinderPrimitive(msgspec.Struct, gc=False):
    """Cylinder or cone [m]."""

    pose: Pose
    size: Vector3
    bottom_scale: float
    top_scale: float
    color: Color


class LinePrimitive(msgspec.Struct):
    """Lines through points [m]."""

    type: int
    pose: Pose
    thickness: float
    scale_invariant: bool
    points: list[Point3]
    color: Color
    colors: list[Color]
    indices: list[_Count]


class TriangleListPrimitive(msgspec.Struct):
    """Triangles: corners in the entity's frame [m], and their indices, counter-clockwise from outside."""

    pose: Pose
    points: list[Point3]
    color: Color
    colors: list[Color]
    indices: list[_Count]


class TextPrimitive(msgspec.Struct):
    """Text."""

    pose: Pose
    billboard: bool
    font_size: float
    scale_invariant: bool
    color: Color
    text: str


class ModelPrimitive(msgspec.Struct):
    """Mesh of another format, by its address or its bytes."""

    pose: Pose
    scale: Vector3
    color: Color
    override_color: bool
    url: str
    media_type: str
    data: bytes


class SceneEntity(msgspec.Struct, kw_only=True):
    """Shapes by one name; they stay until they are replaced."""

    timestamp: Time
    frame_id: str
    id: str
    lifetime: Duration = Duration(0, 0)
    frame_locked: bool = True
    metadata: list[KeyValuePair] = []
    arrows: list[ArrowPrimitive] = []
    cubes: list[CubePrimitive] = []
    spheres: list[SpherePrimitive] = []
    cylinders: list[CylinderPrimitive] = []
    lines: list[LinePrimitive] = []
    triangles: list[TriangleListPrimitive] = []
    texts: list[TextPrimitive] = []
    models: list[ModelPrimitive] = []

    def count(self, name: str) -> int | None:
        """Number that its metadata have by a name; None without one."""
        for pair in self.metadata:
            if pair.key == name and pair.value.isascii() and pair.value.isdecimal():
                return int(pair.value)
        return None


class SceneEntityDeletion(msgspec.Struct):
    """Entities to remove."""

    timestamp: Time
    type: int
    id: str


class SceneUpdate(msgspec.Struct):
    """Entities that are new or replaced."""

    deletions: list[SceneEntityDeletion] = []
    entities: list[SceneEntity] = []


class PackedElementField(msgspec.Struct):
    """Place of a number in each element of packed data; `type` is Foxglove's number of its type."""

    name: str
    offset: _Count
    type: int


class PointCloud(msgspec.Struct):
    """Points, `point_stride` bytes each."""

    timestamp: Time
    frame_id: str
    pose: Pose
    point_stride: _Count
    fields: list[PackedElementField]
    data: bytes


class PosesInFrame(msgspec.Struct):
    """Path."""

    timestamp: Time
    frame_id: str
    poses: list[Pose]


class PoseInFrame(msgspec.Struct):
    """Pose."""

    timestamp: Time
    frame_id: str
    pose: Pose


class FrameTransform(msgspec.Struct):
    """T_parent_child of two frames."""

    timestamp: Time
    parent_frame_id: str
    child_frame_id: str
    translation: Vector3
    rotation: Quaternion


class Log(msgspec.Struct):
    """Line about a run; `level` is `INFO`, `WARNING` or `ERROR`."""

    timestamp: Time
    level: int
    message: str
    name: str
    file: str = ""
    line: _Count = 0
