"""Layout of Foxglove for runs: 3D scene, margins, speeds, commands, states and messages.

Foxglove and Lichtblick import it from a file. A layout names channels and fields, which `present` limits to
those of one run.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import msgspec

from alula.schemas.decode import json_decoder
from alula.schemas.flights import MAP_TOPIC
from alula.stages.runlog.messages import BODY_FRAME

Present = Mapping[str, Collection[str]]  # fields by topic

_SCENES = ("/map", "/vehicle", "/splat", "/plan", "/path", "/obstacles")
_PLAN_COLOR, _PATH_COLOR = "#286edc", "#1f9d55"
_MARGINS = ("/safety.h_m", "/safety.margin", "/safety.moving_clearance_m", "/safety.fence_distance_m")
_SPEEDS = ("/state.velocity_m_s.@norm",)
_COMMANDS = (
    *("/safety.u_nom_m_s.@norm", "/safety.u_safe_m_s.@norm"),
    *("/safety.a_nom_m_s2.@norm", "/safety.a_safe_m_s2.@norm"),
    *("/safety.throttle_nom", "/safety.throttle_safe"),
)
_STATES = ("/safety.status_name", "/safety.mode_name", "/supervisor.state_name", "/supervisor.mode")


class _Entity(msgspec.Struct):
    frame_id: str = "world"


class _Map(msgspec.Struct):
    entities: list[_Entity] = []


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
        if topic == MAP_TOPIC and (entities := json_decoder(_Map).decode(data).entities):
            frame = entities[0].frame_id
    return frame, present


def foxglove_layout(frame: str, present: Present | None = None) -> dict[str, Any]:
    """Layout, as a JSON value.

    Args:
        frame: name of the frame of the map.
        present: fields by topic; None shows all that a run can have.
    """

    def known(paths: tuple[str, ...]) -> list[str]:
        return [path for path in paths if present is None or _is_in(path, present)]

    panels: dict[str, Any] = {"3D!alula": _scene(frame, present)}
    for name, title, unit, paths in (
        ("margin", "Margin to the obstacles", "m, or of the filter's barrier", _MARGINS),
        ("speed", "Speed", "m/s", _SPEEDS),
        ("command", "Command, nominal and sent", "m/s, m/s² or a fraction", _COMMANDS),
    ):
        if found := known(paths):
            panels[f"Plot!{name}"] = _plot(title, unit, found)
    if found := known(_STATES):
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


def _is_in(path: str, present: Present) -> bool:
    topic, field, *_ = path.split(".")
    return field in present.get(topic, ())


def _scene(frame: str, present: Present | None) -> dict[str, Any]:
    topics: dict[str, Any] = {
        topic: {"visible": True} for topic in _SCENES if present is None or topic in present
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
