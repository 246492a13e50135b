"""Messages of a flight's channels, built from the samples that the flying process sends."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.provenance import Provenance
from alula.stages.flight.recorder.messages import (
    log_line,
    pose_message,
    replay_message,
    safety_message,
    state_message,
    step_message,
    tick_message,
    transform_message,
)
from alula.stages.flight.recorder.samples import Three, TickSample
from alula.stages.runlog.messages import nanoseconds, path_message, stamp, vehicle_message

CHANNELS = {
    "/map": "foxglove.SceneUpdate",
    "/vehicle": "foxglove.SceneUpdate",
    "/splat": "foxglove.PointCloud",
    "/plan": "foxglove.PosesInFrame",
    "/path": "foxglove.PosesInFrame",
    "/state": "alula.State",
    "/safety": "alula.Safety",
    "/pose": "foxglove.PoseInFrame",
    "/tf": "foxglove.FrameTransform",
    "/log": "foxglove.Log",
    "/supervisor": "alula.Supervisor",
    "/replay": "alula.Replay",
}
_PATH_POINTS = 2000

Sent = tuple[str, int, dict[str, Any]]  # topic, log time [ns], message


class FlightHead(msgspec.Struct, frozen=True, kw_only=True):
    """First message to the processes beside the flight: all facts that are known before it.

    Attributes:
        name, filter, vehicle: for reports.
        frame: name of the map's frame.
        is_splat: the filter uses ellipsoids.
        log_every: the log holds every so many ticks.
        radius_m: of the vehicle [m].
        provenance: of the log and its record.
        map_message: the map as `foxglove.SceneUpdate`; the start of the flight becomes its time.
        cloud: Gaussians as `foxglove.PointCloud`, with the time as of the map; None without a scene.
        plan: points of the plan, world frame [m].
    """

    name: str
    filter: str
    vehicle: str
    frame: str
    is_splat: bool
    log_every: int
    radius_m: float
    provenance: Provenance
    map_message: dict[str, Any]
    cloud: dict[str, Any] | None = None
    plan: list[Three] = []


class BeginSample(msgspec.Struct, array_like=True):
    """Start of the flight, from which all its times count: nanoseconds since 1970-01-01 UTC."""

    start_ns: int


class StepSample(msgspec.Struct, array_like=True):
    """A step of the supervisor."""

    time_s: float
    state: str
    event: str
    action: str
    words: str


class LineSample(msgspec.Struct, array_like=True):
    """A message for the operator."""

    time_s: float
    level: int
    words: str


class PlanSample(msgspec.Struct, array_like=True):
    """A new plan that the flight continues along: its points, world frame [m]."""

    time_s: float
    points: list[Three]


class FlightChannels:
    """Messages of all channels; each method gives them with topic and log time.

    Args:
        head: facts that are known before the flight.
        start_ns: its start, nanoseconds since 1970-01-01 UTC.
    """

    def __init__(self, head: FlightHead, start_ns: int) -> None:
        self._head, self._start_ns = head, start_ns
        self._ticks, self._last_s = 0, 0.0
        self._path = _Path()

    def first(self) -> Iterator[Sent]:
        """What is known before the flight: `/map`, `/vehicle`, `/splat` and `/plan`."""
        head, start = self._head, self._start_ns
        entities = [entity | {"timestamp": stamp(start)} for entity in head.map_message.get("entities", [])]
        yield "/map", start, head.map_message | {"entities": entities}
        yield "/vehicle", start, vehicle_message(head.radius_m, start)
        if head.cloud is not None:
            yield "/splat", start, head.cloud | {"timestamp": stamp(start)}
        if head.plan:
            yield "/plan", start, path_message(np.array(head.plan), head.frame, start)

    def tick(self, sample: TickSample) -> Iterator[Sent]:
        """Messages of a tick; only `/replay` has each."""
        now, self._last_s = self._log_time(sample.time_s), sample.time_s
        self._ticks += 1
        if sample.filter is not None and sample.position is not None:
            self._path.append(sample.position)
        if sample.filter is not None and sample.filter.replay is not None:
            yield "/replay", now, replay_message(sample.time_s, sample.filter.replay)
        if self._ticks % self._head.log_every:
            return
        yield "/supervisor", now, tick_message(sample)
        if sample.position is None:
            return
        yield "/state", now, state_message(sample)
        yield "/pose", now, pose_message(sample, self._head.frame, now)
        yield "/tf", now, transform_message(sample, self._head.frame, now)
        if sample.filter is not None:
            yield "/safety", now, safety_message(sample, sample.filter, is_splat=self._head.is_splat)

    def step(self, step: StepSample) -> Iterator[Sent]:
        """Message of a step of the supervisor."""
        message = step_message(step.time_s, step.state, step.event, step.action)
        yield "/supervisor", self._log_time(step.time_s), message

    def line(self, line: LineSample) -> Iterator[Sent]:
        """Message for the operator."""
        now = self._log_time(line.time_s)
        yield "/log", now, log_line(line.words, line.level, now)

    def plan(self, plan: PlanSample) -> Iterator[Sent]:
        """The new plan, which replaces the one before."""
        now = self._log_time(plan.time_s)
        yield "/plan", now, path_message(np.array(plan.points), self._head.frame, now)

    def path(self) -> Iterator[Sent]:
        """The path flown so far; none before it begins."""
        if len(points := self._path.points):
            now = self._log_time(self._last_s)
            yield "/path", now, path_message(points, self._head.frame, now)

    def _log_time(self, time_s: float) -> int:
        return self._start_ns + nanoseconds(time_s)


class _Path:
    """At most 4,000 evenly spaced points of a path of any length."""

    def __init__(self) -> None:
        self._points: list[Three] = []
        self._stride, self._count = 1, 0
        self._last: Three | None = None

    def append(self, point: Three) -> None:
        self._last = point
        if self._count % self._stride == 0:
            self._points.append(point)
        self._count += 1
        if len(self._points) == 2 * _PATH_POINTS:
            self._points, self._stride = self._points[::2], 2 * self._stride

    @property
    def points(self) -> FloatArray:
        """Points and the last one, shape (n, 3), world frame [m]."""
        last = [] if self._last is None else [self._last]
        return np.array(self._points + last, np.float64).reshape(-1, 3)
