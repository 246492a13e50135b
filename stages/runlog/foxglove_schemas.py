"""JSON Schemas of Foxglove's message types that logs have: all fields, all of which Foxglove requires."""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]

NUMBER: Schema = {"type": "number"}
INTEGER: Schema = {"type": "integer"}
TEXT: Schema = {"type": "string"}
FLAG: Schema = {"type": "boolean"}


def fields(**properties: Schema) -> Schema:
    """Schema of an object, any field of which may be missing."""
    return {"type": "object", "properties": properties}


def array(items: Schema) -> Schema:
    """Schema of a list of items of one kind."""
    return {"type": "array", "items": items}


def _foxglove(name: str, /, **properties: Schema) -> Schema:
    """Type of Foxglove, all fields of which are required."""
    return {"title": f"foxglove.{name}", **fields(**properties), "required": list(properties)}


_COUNT: Schema = {"type": "integer", "minimum": 0}
_NSEC: Schema = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
_TIME: Schema = {"title": "time", **fields(sec=_COUNT, nsec=_NSEC)}
_DURATION: Schema = {"title": "duration", **fields(sec=INTEGER, nsec=_NSEC)}
_BYTES: Schema = {"type": "string", "contentEncoding": "base64"}
VECTOR = _foxglove("Vector3", x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = _foxglove("Quaternion", x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
_POINT = _foxglove("Point3", x=NUMBER, y=NUMBER, z=NUMBER)
_POSE = _foxglove("Pose", position=VECTOR, orientation=QUATERNION)
_COLOR = _foxglove("Color", r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
_ENTITY = _foxglove(
    "SceneEntity",
    timestamp=_TIME,
    frame_id=TEXT,
    id=TEXT,
    lifetime=_DURATION,
    frame_locked=FLAG,
    metadata=array(_foxglove("KeyValuePair", key=TEXT, value=TEXT)),
    arrows=array(
        _foxglove(
            "ArrowPrimitive",
            pose=_POSE,
            shaft_length=NUMBER,
            shaft_diameter=NUMBER,
            head_length=NUMBER,
            head_diameter=NUMBER,
            color=_COLOR,
        )
    ),
    cubes=array(_foxglove("CubePrimitive", pose=_POSE, size=VECTOR, color=_COLOR)),
    spheres=array(_foxglove("SpherePrimitive", pose=_POSE, size=VECTOR, color=_COLOR)),
    cylinders=array(
        _foxglove(
            "CylinderPrimitive", pose=_POSE, size=VECTOR, bottom_scale=NUMBER, top_scale=NUMBER, color=_COLOR
        )
    ),
    lines=array(
        _foxglove(
            "LinePrimitive",
            type=INTEGER,
            pose=_POSE,
            thickness=NUMBER,
            scale_invariant=FLAG,
            points=array(_POINT),
            color=_COLOR,
            colors=array(_COLOR),
            indices=array(_COUNT),
        )
    ),
    triangles=array(
        _foxglove(
            "TriangleListPrimitive",
            pose=_POSE,
            points=array(_POINT),
            color=_COLOR,
            colors=array(_COLOR),
            indices=array(_COUNT),
        )
    ),
    texts=array(
        _foxglove(
            "TextPrimitive",
            pose=_POSE,
            billboard=FLAG,
            font_size=NUMBER,
            scale_invariant=FLAG,
            color=_COLOR,
            text=TEXT,
        )
    ),
    models=array(
        _foxglove(
            "ModelPrimitive",
            pose=_POSE,
            scale=VECTOR,
            color=_COLOR,
            override_color=FLAG,
            url=TEXT,
            media_type=TEXT,
            data=_BYTES,
        )
    ),
)

FOXGLOVE_SCHEMAS = {
    schema["title"]: schema
    for schema in (
        _foxglove("PosesInFrame", timestamp=_TIME, frame_id=TEXT, poses=array(_POSE)),
        _foxglove("PoseInFrame", timestamp=_TIME, frame_id=TEXT, pose=_POSE),
        _foxglove(
            "PointCloud",
            timestamp=_TIME,
            frame_id=TEXT,
            pose=_POSE,
            point_stride=_COUNT,
            fields=array(_foxglove("PackedElementField", name=TEXT, offset=_COUNT, type=INTEGER)),
            data=_BYTES,
        ),
        _foxglove(
            "FrameTransform",
            timestamp=_TIME,
            parent_frame_id=TEXT,
            child_frame_id=TEXT,
            translation=VECTOR,
            rotation=QUATERNION,
        ),
        _foxglove(
            "SceneUpdate",
            deletions=array(_foxglove("SceneEntityDeletion", timestamp=_TIME, type=INTEGER, id=TEXT)),
            entities=array(_ENTITY),
        ),
        _foxglove("Log", timestamp=_TIME, level=INTEGER, message=TEXT, name=TEXT, file=TEXT, line=_COUNT),
    )
}
