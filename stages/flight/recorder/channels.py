"""Messages of a flight's channels, built from the samples that the flying process sends."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.provenance import Provenance
from alula.schemas.log.channels import (
    LINE_TOPIC,
    MAP_TOPIC,
    PLAN_TOPIC,
    REPLAY_TOPIC,
    SAFETY_TOPIC,
    STATE_TOPIC,
    SUPERVISOR_TOPIC,
    State,
)
from alula.schemas.log.foxglove import UPRIGHT, Log, PointCloud, Pose, PoseInFrame, SceneUpdate, Time
from alula.stages.flight.recorder.samples import (
    LineSample,
    PlanSample,
    Sample,
    StepSample,
    Three,
    TickSample,
)
from alula.stages.runlog.messages import (
    nanoseconds,
    path_message,
    rounded,
    transform_message,
    vehicle_message,
)

_PATH_POINTS = 2000

Sent = tuple[str, int, msgspec.Struct]  # topic, log time [ns], message


class FlightHead(msgspec.Struct, frozen=True, kw_only=True):
    """First message to the processes beside the flight: all facts that are known before it.

    Attributes:
        is_splat: the filter uses ellipsoids.
        log_every: the log holds every so many ticks.
        map_message: the map; the start of the flight becomes its time.
        cloud: Gaussians, with the time as of the map; None without a scene.
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
    map_message: SceneUpdate
    cloud: PointCloud | None = None
    plan: list[Three] = []


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
        began = Time.of(start)
        entities = [msgspec.structs.replace(one, timestamp=began) for one in head.map_message.entities]
        yield MAP_TOPIC, start, SceneUpdate(entities=entities)
        yield "/vehicle", start, vehicle_message(head.radius_m, start)
        if head.cloud is not None:
            yield "/splat", start, msgspec.structs.replace(head.cloud, timestamp=began)
        if head.plan:
            yield PLAN_TOPIC, start, path_message(np.array(head.plan), head.frame, start)

    def of(self, sample: Sample) -> Iterator[Sent]:
        """Messages of a sample: none of the start, files and the end."""
        if isinstance(sample, TickSample):
            yield from self._tick(sample)
        elif isinstance(sample, StepSample):
            step = sample.supervisor
            yield SUPERVISOR_TOPIC, self._log_time(step.time_s), rounded(step)
        elif isinstance(sample, LineSample):
            now = self._log_time(sample.time_s)
            yield LINE_TOPIC, now, Log(Time.of(now), sample.level, sample.words, "fly")
        elif isinstance(sample, PlanSample):  # it replaces the one before
            now = self._log_time(sample.time_s)
            yield PLAN_TOPIC, now, path_message(np.array(sample.points), self._head.frame, now)

    def _tick(self, sample: TickSample) -> Iterator[Sent]:
        """Messages of a tick; only `/replay` has each."""
        self._last_s = sample.supervisor.time_s
        now = self._log_time(self._last_s)
        self._ticks += 1
        if sample.safety is not None and sample.state is not None:
            self._path.append(sample.state.position_m.tuple)
        if sample.replay is not None:
            yield REPLAY_TOPIC, now, sample.replay
        if self._ticks % self._head.log_every:
            return
        yield SUPERVISOR_TOPIC, now, rounded(sample.supervisor)
        if sample.state is None:
            return
        state: State = rounded(sample.state)
        pose = Pose(state.position_m, state.attitude or UPRIGHT)
        yield STATE_TOPIC, now, state
        yield "/pose", now, PoseInFrame(Time.of(now), self._head.frame, pose)
        yield "/tf", now, transform_message(pose, self._head.frame, now)
        if sample.safety is not None:
            yield SAFETY_TOPIC, now, rounded(sample.safety)

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
