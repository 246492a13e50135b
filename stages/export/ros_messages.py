"""Messages of a run's log as messages of ROS 2.

Channels of Foxglove's types become the type of ROS 2 with the same meaning. State and commands become
odometry, velocities and accelerations; all of alula's own channels are there as JSON text, too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import msgspec
import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.decode import json_decoder
from alula.schemas.log.channels import CHANNELS, Safety, State, schema_name
from alula.schemas.log.foxglove import (
    ORIGIN,
    UPRIGHT,
    Color,
    FrameTransform,
    Log,
    PointCloud,
    Pose,
    PoseInFrame,
    PosesInFrame,
    Quaternion,
    SceneUpdate,
    Time,
)
from alula.stages.rotation import matrix_from_quat_wxyz
from alula.stages.runlog.cloud import POINT

LATCHED = frozenset(topic for topic, channel in CHANNELS.items() if channel.is_latched)
_TEXT_PREFIX = "/alula"
_LEVELS = {1: 10, 2: 20, 3: 30, 4: 40, 5: 50}  # of rcl_interfaces/msg/Log, by those of foxglove.Log

RosMessage = tuple[str, str, Any]  # topic, type, message


class RosMessages:
    """Converter of the messages of one log, which are given in their order.

    Args:
        types: classes of ROS 2 messages by type, such as `nav_msgs/msg/Path`.
    """

    def __init__(self, types: Mapping[str, Any]) -> None:
        self._types = types
        self._frame = "world"  # until the map names it
        self._by_struct: dict[type[msgspec.Struct], Callable[[str, Any, int], Iterator[RosMessage]]] = {
            SceneUpdate: self._markers,
            PosesInFrame: self._path,
            PointCloud: self._cloud,
            PoseInFrame: self._pose,
            FrameTransform: self._transform,
            Log: self._line,
            State: self._state,
            Safety: self._safety,
        }

    def of(self, topic: str, data: bytes, time_ns: int) -> Iterator[RosMessage]:
        """Messages of ROS 2 for one of the log.

        Raises:
            ValueError: the text is not of the documented form.
        """
        channel = CHANNELS.get(topic)
        if channel is not None and (convert := self._by_struct.get(channel.struct)) is not None:
            yield from convert(topic, json_decoder(channel.struct).decode(data), time_ns)
        if channel is None or schema_name(channel.struct).startswith("alula."):
            name = re.sub(r"[^A-Za-z0-9_/]", "_", topic)  # ROS 2 allows no other characters
            text = self._new("std_msgs/msg/String", data.decode())
            yield f"{_TEXT_PREFIX}{name}", "std_msgs/msg/String", text

    def _new(self, kind: str, *values: Any) -> Any:
        return self._types[kind](*values)

    def _stamp(self, time: Time) -> Any:
        if time.sec >= 2**31:
            raise ValueError(f"the time {time.sec} s is beyond those of ROS 2")
        return self._new("builtin_interfaces/msg/Time", time.sec, time.nsec)

    def _header(self, time: Time, frame: str) -> Any:
        return self._new("std_msgs/msg/Header", self._stamp(time), frame)

    def _vector(self, vector: FloatArray, kind: str = "Vector3") -> Any:
        return self._new(f"geometry_msgs/msg/{kind}", *vector.tolist())

    def _quaternion(self, q: Quaternion) -> Any:
        return self._new("geometry_msgs/msg/Quaternion", q.x, q.y, q.z, q.w)

    def _bare_pose(self, pose: Pose) -> Any:
        position = self._vector(pose.position.array, "Point")
        return self._new("geometry_msgs/msg/Pose", position, self._quaternion(pose.orientation))

    def _stamped(self, header: Any, pose: Pose) -> Any:
        return self._new("geometry_msgs/msg/PoseStamped", header, self._bare_pose(pose))

    def _pose(self, topic: str, found: PoseInFrame, time_ns: int) -> Iterator[RosMessage]:
        header = self._header(found.timestamp, found.frame_id)
        yield topic, "geometry_msgs/msg/PoseStamped", self._stamped(header, found.pose)

    def _path(self, topic: str, found: PosesInFrame, time_ns: int) -> Iterator[RosMessage]:
        header = self._header(found.timestamp, found.frame_id)
        poses = [self._stamped(header, pose) for pose in found.poses]
        yield topic, "nav_msgs/msg/Path", self._new("nav_msgs/msg/Path", header, poses)

    def _transform(self, topic: str, found: FrameTransform, time_ns: int) -> Iterator[RosMessage]:
        moved = self._new(
            "geometry_msgs/msg/Transform",
            self._vector(found.translation.array),
            self._quaternion(found.rotation),
        )
        header = self._header(found.timestamp, found.parent_frame_id)
        stamped = self._new("geometry_msgs/msg/TransformStamped", header, found.child_frame_id, moved)
        yield topic, "tf2_msgs/msg/TFMessage", self._new("tf2_msgs/msg/TFMessage", [stamped])

    def _cloud(self, topic: str, found: PointCloud, time_ns: int) -> Iterator[RosMessage]:
        """The same bytes: opacity, red, green and blue are the packed colour of RViz."""
        step = POINT.itemsize
        count, rest = divmod(len(found.data), step)
        if rest:
            raise ValueError("a point cloud ends within a point")
        float32 = 7
        places = [
            self._new("sensor_msgs/msg/PointField", name, 4 * i, float32, 1)
            for i, name in enumerate(("x", "y", "z", "rgb"))
        ]
        points = np.frombuffer(found.data, np.uint8)
        header, kind = self._header(found.timestamp, found.frame_id), "sensor_msgs/msg/PointCloud2"
        whole = (header, 1, count, places, False, step, step * count, points, True)
        yield topic, kind, self._new(kind, *whole)

    def _line(self, topic: str, found: Log, time_ns: int) -> Iterator[RosMessage]:
        level, stamp = _LEVELS.get(found.level, 20), self._stamp(found.timestamp)
        kind = "rcl_interfaces/msg/Log"
        yield "/rosout", kind, self._new(kind, stamp, level, f"alula.{found.name}", found.message, "", "", 0)

    def _markers(self, topic: str, found: SceneUpdate, time_ns: int) -> Iterator[RosMessage]:
        """Markers of all shapes, after one that deletes those of the message before."""
        if topic == "/map" and found.entities:
            self._frame = found.entities[0].frame_id
        markers: list[Any] = []
        for entity in found.entities:
            header = self._header(entity.timestamp, entity.frame_id)
            if not markers:
                markers.append(self._marker(header, "", 0, 0, ORIGIN, action=3))
            for ball in entity.spheres:
                where = (header, entity.id, len(markers))
                markers.append(self._marker(*where, 2, ball.pose, ball.size.array, ball.color))
            for part in entity.triangles:
                if part.indices and max(part.indices) >= len(part.points):
                    raise ValueError("a triangle has a corner that does not exist")
                points = [self._vector(point.array, "Point") for point in part.points]
                corners = [points[i] for i in part.indices]
                where = (header, entity.id, len(markers))
                markers.append(self._marker(*where, 11, part.pose, np.ones(3), part.color, corners))
        yield (
            topic,
            "visualization_msgs/msg/MarkerArray",
            self._new("visualization_msgs/msg/MarkerArray", markers),
        )

    def _marker(
        self,
        header: Any,
        namespace: str,
        number: int,
        kind: int,
        pose: Pose,
        scale: FloatArray | None = None,
        color: Color | None = None,
        points: list[Any] | None = None,
        *,
        action: int = 0,
    ) -> Any:
        shade = Color(0.0, 0.0, 0.0, 0.0) if color is None else color
        nothing = np.empty(0, np.uint8)
        return self._new(
            "visualization_msgs/msg/Marker",
            header,
            namespace,
            number,
            kind,
            action,
            self._bare_pose(pose),
            self._vector(np.zeros(3) if scale is None else scale),
            self._new("std_msgs/msg/ColorRGBA", shade.r, shade.g, shade.b, shade.a),
            self._new("builtin_interfaces/msg/Duration", 0, 0),  # it stays
            True,  # it moves with its frame
            points or [],
            [],
            "",
            self._new("sensor_msgs/msg/CompressedImage", header, "", nothing),
            [],
            "",
            "",
            self._new("visualization_msgs/msg/MeshFile", "", nothing),
            False,
        )

    def _state(self, topic: str, found: State, time_ns: int) -> Iterator[RosMessage]:
        """Odometry, whose twist is in the body frame, and the velocity in the frame of the map."""
        q, header = (
            UPRIGHT if found.attitude is None else found.attitude,
            self._header(Time.of(time_ns), self._frame),
        )
        R_world_body = matrix_from_quat_wxyz(np.array((q.w, q.x, q.y, q.z)))
        v_world = found.velocity_m_s.array
        omega_body = np.zeros(3) if found.omega_body_rad_s is None else found.omega_body_rad_s.array
        unknown = np.zeros(36)
        pose = self._bare_pose(Pose(found.position_m, q))
        twist = self._new(
            "geometry_msgs/msg/Twist", self._vector(R_world_body.T @ v_world), self._vector(omega_body)
        )
        yield (
            "/odom",
            "nav_msgs/msg/Odometry",
            self._new(
                "nav_msgs/msg/Odometry",
                header,
                "body",
                self._new("geometry_msgs/msg/PoseWithCovariance", pose, unknown),
                self._new("geometry_msgs/msg/TwistWithCovariance", twist, unknown),
            ),
        )
        yield self._motion("/velocity", "Twist", header, v_world, R_world_body @ omega_body)

    def _safety(self, topic: str, found: Safety, time_ns: int) -> Iterator[RosMessage]:
        header = self._header(Time.of(time_ns), self._frame)
        margin = found.h_m if found.margin is None else found.margin
        if margin is not None:
            yield "/safety/margin", "std_msgs/msg/Float64", self._new("std_msgs/msg/Float64", margin)
        for name, vector, kind in (
            ("nominal_velocity", found.u_nom_m_s, "Twist"),
            ("safe_velocity", found.u_safe_m_s, "Twist"),
            ("nominal_acceleration", found.a_nom_m_s2, "Accel"),
            ("safe_acceleration", found.a_safe_m_s2, "Accel"),
        ):
            if vector is not None:
                yield self._motion(f"/command/{name}", kind, header, vector.array, np.zeros(3))

    def _motion(
        self, topic: str, kind: str, header: Any, linear: FloatArray, angular: FloatArray
    ) -> RosMessage:
        both = self._new(f"geometry_msgs/msg/{kind}", self._vector(linear), self._vector(angular))
        name = f"geometry_msgs/msg/{kind}Stamped"
        return topic, name, self._new(name, header, both)
