"""Layout of Foxglove for runs: 3D scene, margins, speeds, commands, states and messages.

Foxglove and Lichtblick import it from a file. A layout names channels and fields, which `present` limits to
those of one run.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any

import msgspec
from msgspec import inspect

from alula.schemas.decode import json_decoder
from alula.schemas.log.channels import CHANNELS, MAP_TOPIC
from alula.schemas.log.foxglove import PointCloud, PosesInFrame, SceneUpdate
from alula.stages.runlog.messages import BODY_FRAME

Present = Mapping[str, Collection[str]]  # fields by topic

_SHAPES = (SceneUpdate, PointCloud, PosesInFrame)  # messages that the 3D panel shows
_PLAN_COLOR, _PATH_COLOR = "#286edc", "#1f9d55"


def contents(found: Iterable[tuple[str, bytes]]) -> tuple[str, dict[str, set[str]]]:
    """Name of the frame of a run's map, and the fields of its messages by topic.

    Args:
        found: topics and contents of the messages of its log.

    Raises:
        ValueError: a message is not of the documented form.
    """
    frame, present = "world", dict[str, set[str]]()
    decode = json_decoder(dict[str, msgspec.Raw]).decode
    for topic, data in found:
        present.setdefault(topic, set()).update(decode(data))
        if topic == MAP_TOPIC and (entities := json_decoder(SceneUpdate).decode(data).entities):
            frame = entities[0].frame_id
    return frame, present


def foxglove_layout(frame: str, present: Present | None = None) -> dict[str, Any]:
    """Layout, as a JSON value.

    Args:
        present: fields by topic; None shows all that a run can have.
    """

    def known(panel: str) -> list[str]:
        return [path for path in _paths(panel) if present is None or _is_in(path, present)]

    panels: dict[str, Any] = {"3D!alula": _scene(frame, present)}
    for name, title, unit in (
        ("margin", "Margin to the obstacles", "m, or of the filter's barrier"),
        ("speed", "Speed", "m/s"),
        ("command", "Command, nominal and sent", "m/s, m/s² or a fraction"),
    ):
        if found := known(name):
            panels[f"Plot!{name}"] = _plot(title, unit, found)
    if found := known("states"):
        states = [_series(path) for path in found]
        panels["StateTransitions!states"] = {
            "foxglovePanelTitle": "States",
            "isSynced": True,
            "paths": states,
        }
    if present is None or "/log" in present:
        panels["RosOut!log"] = {"topicToRender": "/log", "minLogLevel": 1, "searchTerms": []}
    scene, *others = panels
    second = _column(others)
    split = {"direction": "row", "first": scene, "second": second, "splitPercentage": 60}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": split if others else scene,
    }


def _paths(panel: str) -> Iterator[str]:
    """Fields that a panel shows, in the order of channels and fields; of a vector its norm."""
    for topic, channel in CHANNELS.items():
        for field in inspect.type_info(channel.struct).fields:  # type: ignore[attr-defined]
            extra = getattr(field.type, "extra", None) or {}
            if extra.get("panel") == panel:
                yield f"{topic}.{field.encode_name}{extra['modifier']}"


def _is_in(path: str, present: Present) -> bool:
    topic, field, *_ = path.split(".")
    return field in present.get(topic, ())


def _scene(frame: str, present: Present | None) -> dict[str, Any]:
    topics: dict[str, Any] = {
        topic: {"visible": True}
        for topic, channel in CHANNELS.items()
        if channel.struct in _SHAPES and (present is None or topic in present)
    }
    for topic, color in (("/plan", _PLAN_COLOR), ("/path", _PATH_COLOR)):
        if topic in topics:
            topics[topic] |= {"type": "line", "lineWidth": 0.03, "gradient": [color, color]}
    if "/splat" in topics:
        topics["/splat"] |= {"colorMode": "rgba-fields", "pointSize": 4.0}
    return {
        "cameraState": {
            "perspective": True,
            "distance": 12.0,
            "phi": 50.0,
            "thetaOffset": 45.0,
            "target": [0.0, 0.0, 0.0],
            "targetOffset": [0.0, 0.0, 0.0],
            "targetOrientation": [0.0, 0.0, 0.0, 1.0],
            "fovy": 45.0,
            "near": 0.05,
            "far": 5000.0,
        },
        "fixedFrame": frame,
        "followTf": BODY_FRAME,
        "followMode": "follow-position",
        "scene": {"transforms": {"axisScale": 0.5, "showLabel": False}},
        "transforms": {f"frame:{BODY_FRAME}": {"visible": True}, f"frame:{frame}": {"visible": True}},
        "topics": topics,
        "layers": {
            "grid": {
                "layerId": "foxglove.Grid",
                "instanceId": "grid",
                "label": "Grid",
                "visible": True,
                "frameId": frame,
                "size": 50.0,
                "divisions": 50.0,
                "lineWidth": 1.0,
                "color": "#8c99ad40",
            }
        },
    }


def _series(path: str) -> dict[str, Any]:
    return {"value": path, "enabled": True, "timestampMethod": "receiveTime"}


def _plot(title: str, unit: str, paths: list[str]) -> dict[str, Any]:
    return {
        "foxglovePanelTitle": title,
        "paths": [_series(path) for path in paths],
        "yAxisLabel": unit,
        "xAxisVal": "timestamp",
        "isSynced": True,
        "showLegend": True,
        "legendDisplay": "floating",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
    }


def _column(names: list[str]) -> Any:
    """Panels below each other, equally high."""
    if len(names) < 2:
        return names[0] if names else None
    first, *rest = names
    return {
        "direction": "column",
        "first": first,
        "second": _column(rest),
        "splitPercentage": 100 / len(names),
    }
