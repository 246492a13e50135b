"""Contents of a run's log: its channels, and states, margins, commands and moving obstacles over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import DamagedError
from alula.schemas.log.channels import (
    LINE_TOPIC,
    MAP_TOPIC,
    OBSTACLES_TOPIC,
    PLAN_TOPIC,
    SAFETY_TOPIC,
    STATE_TOPIC,
    SUPERVISOR_TOPIC,
    Safety,
    State,
    Supervisor,
    decoded,
)
from alula.schemas.log.foxglove import Log, PosesInFrame, SceneUpdate, Time
from alula.schemas.log.mcap import entries, messages, open_log
from alula.schemas.log.samples import Commands, Moving, attitudes, commands_of, measured, moving

_READ = (MAP_TOPIC, STATE_TOPIC, SAFETY_TOPIC, OBSTACLES_TOPIC, SUPERVISOR_TOPIC, LINE_TOPIC, PLAN_TOPIC)
_MOST_OBSTACLES = 2**40


@dataclass(frozen=True, slots=True)
class Flight:
    """One trial of a run, as logged.

    Attributes:
        time_s: times of the states, shape (n,) [s].
        position_world: shape (n, 3) [m].
        speed_m_s: shape (n,) [m/s].
        margin_time_s: times of the filter's answers, shape (m,) [s].
        margin: clearance of moving obstacles, where there are any, or margin that the filter reported; NaN
            where it had none, shape (m,).
        margin_unit: "m", or the quantity in words.
        status: status that the filter reported, m words.
        regulation: regulation function lambda of a geofence, NaN where unknown, shape (m,); None elsewhere.
        fence_distance_m: minimum true distance to the fence since the answer before, less the radius, NaN
            where unknown, shape (m,) [m]; None elsewhere.
        quat_world_body_wxyz: attitudes, body to world, shape (n, 4); None of a vehicle without one.
        moving: obstacles that moved; None without any.
        commands: nominal and filtered inputs; None of filters whose inputs are not logged as vectors.
        each_status: status of each filter of a list of several, by name, as `status`.
        active: number of the obstacle that decides, by name of each filter of several, or under
            the empty name of the only one; -1 for none, shape (m,).
    """

    time_s: NDArray[np.float64]
    position_world: NDArray[np.float64]
    speed_m_s: NDArray[np.float64]
    margin_time_s: NDArray[np.float64]
    margin: NDArray[np.float64]
    margin_unit: str
    status: tuple[str, ...]
    regulation: NDArray[np.float64] | None = None
    fence_distance_m: NDArray[np.float64] | None = None
    quat_world_body_wxyz: NDArray[np.float64] | None = None
    moving: Moving | None = None
    commands: Commands | None = None
    each_status: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    active: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Step:
    """Step of a real flight's supervisor: its new state, the event, and the action that it ordered."""

    time_s: float
    state: str
    event: str
    action: str


@dataclass(frozen=True, slots=True)
class Line:
    """Message to the operator of a real flight; `level` as in `foxglove.Log`, where 3 is a warning."""

    time_s: float
    level: int
    words: str


@dataclass(frozen=True, slots=True)
class NewPlan:
    """Plan along which a real flight continued from a time on: its points, shape (n, 3) [m]."""

    time_s: float
    position_world: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Course:
    """Course of a real flight by its supervisor, and its new plans.

    `end_s` is the time of its last message [s].
    """

    steps: tuple[Step, ...]
    lines: tuple[Line, ...]
    end_s: float
    plans: tuple[NewPlan, ...] = ()


@dataclass(frozen=True, slots=True)
class Flights:
    """Flights of a run by trial, number of hulls of its map if the log has it, and course of a real one."""

    by_trial: dict[int, Flight]
    hulls: int | None
    course: Course | None = None


def read_flights(log: Path) -> Flights:
    """Read the flights in a run's log; none when it holds no states.

    Raises:
        InputError: the log cannot be read.
        DamagedError: truncated or corrupt, or a message does not have the documented fields.
    """
    with open_log(log) as file:
        return flights_of(messages(file))


def flights_of(found: Iterable[tuple[str, bytes]]) -> Flights:
    """Gather the flights in messages.

    Args:
        found: topics and contents, in the order of the log; other topics are skipped.

    Raises:
        ValueError: a time, position, velocity or margin is too large to be a measurement.
    """
    states: dict[int, list[State]] = {}
    bodies: dict[int, dict[int, SceneUpdate]] = {}  # by trial and number of the state
    last = None
    safety: dict[int, list[Safety]] = {}
    each: dict[int, dict[str, list[Safety]]] = {}
    supervised: list[Supervisor] = []
    lines: list[Log] = []
    plans: list[PosesInFrame] = []
    hulls, start = None, Time(0, 0)
    for topic, data in found:
        if topic not in _READ and not topic.startswith(f"{SAFETY_TOPIC}/"):
            continue
        message = decoded(topic, data)
        if isinstance(message, State):
            states.setdefault(message.trial, []).append(message)
            last = message.trial
        elif isinstance(message, Safety):
            if topic == SAFETY_TOPIC:
                safety.setdefault(message.trial, []).append(message)
            else:
                own = each.setdefault(message.trial, {})
                own.setdefault(topic[len(SAFETY_TOPIC) + 1 :], []).append(message)
        elif isinstance(message, Supervisor):
            supervised.append(message)
        elif isinstance(message, Log):
            lines.append(message)
        elif isinstance(message, PosesInFrame):
            plans.append(message)
        elif isinstance(message, SceneUpdate) and topic == MAP_TOPIC:
            hulls, start = _hull_count(message), _start(message)
        elif isinstance(message, SceneUpdate) and last is not None:
            bodies.setdefault(last, {})[len(states[last]) - 1] = message
    flights = {
        trial: _flight(states[trial], safety.get(trial, []), bodies.get(trial, {}), each.get(trial, {}))
        for trial in sorted(states)
    }
    return Flights(flights, hulls, _course(supervised, lines, plans, start) if supervised else None)


def _start(message: SceneUpdate) -> Time:
    """Log time of the start of a flight: that of its map."""
    return message.entities[0].timestamp if message.entities else Time(0, 0)


def _course(supervised: list[Supervisor], found: list[Log], plans: list[PosesInFrame], start: Time) -> Course:
    lines = tuple(Line(line.timestamp.since_s(start), line.level, line.message) for line in found)
    new = tuple(
        NewPlan(
            plan.timestamp.since_s(start),
            measured("position", [pose.position.tuple for pose in plan.poses], is_known=True),
        )
        for plan in plans
        if plan.timestamp != start and plan.poses  # else the plan before the flight
    )
    steps = tuple(
        Step(one.time_s, one.state_name, one.event_name, one.action_name or "")
        for one in supervised
        if one.event_name
    )
    return Course(steps, lines, max(one.time_s for one in supervised), new)


def _hull_count(message: SceneUpdate) -> int | None:
    counts = [count for entity in message.entities if (count := entity.count("hulls")) is not None]
    return counts[0] if counts else None


def _flight(
    states: list[State], safety: list[Safety], bodies: dict[int, SceneUpdate], each: dict[str, list[Safety]]
) -> Flight:
    order = sorted(range(len(states)), key=lambda i: states[i].time_s)
    states = [states[i] for i in order]
    safety.sort(key=lambda answer: answer.time_s or 0.0)
    position = [state.position_m.tuple for state in states]
    velocity = measured("velocity", [state.velocity_m_s.tuple for state in states], is_known=True)
    answered = {
        name: own for name, own in each.items() if len(own) == len(safety)
    }  # in the order of the answers
    active = {name: _active(own) for name, own in answered.items()} or {"": _active(safety)}
    return Flight(
        time_s=measured("time", [state.time_s for state in states]),
        position_world=measured("position", position, is_known=True),
        speed_m_s=np.sqrt(np.square(velocity).sum(axis=1)),
        margin_time_s=measured("time", [answer.time_s for answer in safety], is_known=True),
        margin=measured("margin", [_margin(answer) for answer in safety]),
        margin_unit=_unit(safety[0]) if safety else "m",
        status=tuple(answer.status_name for answer in safety),
        regulation=_known([a.regulation for a in safety]),
        fence_distance_m=_known([a.fence_distance_m for a in safety]),
        quat_world_body_wxyz=attitudes(states),
        moving=moving([bodies.get(i) for i in order]) if bodies else None,
        commands=commands_of(safety),
        each_status={name: tuple(one.status_name for one in own) for name, own in answered.items()},
        active=active,
    )


def _active(answers: list[Safety]) -> NDArray[np.int64]:
    """Numbers of the obstacles that decide, -1 for none."""
    found = [-1 if answer.active is None else answer.active for answer in answers]
    if not all(-1 <= one <= _MOST_OBSTACLES for one in found):
        raise ValueError("a number of an obstacle is out of range")
    return np.array(found, np.int64)


def _known(values: list[float | None]) -> NDArray[np.float64] | None:
    """Convert to an array, None to NaN; None where all are."""
    return None if all(value is None for value in values) else measured("distance", values)


def _margin(answer: Safety) -> float | None:
    """The true clearance of moving obstacles, or else what the filter reported."""
    if answer.moving_clearance_m is not None:
        return answer.moving_clearance_m
    return answer.h_m if answer.margin_unit is None else answer.margin


def _unit(answer: Safety) -> str:
    return "m" if answer.moving_clearance_m is not None else answer.margin_unit or "m"


def count_messages(log: Path) -> tuple[dict[str, int], bool]:
    """Count the messages per topic as far as a log can be read; the second value is True at its end.

    Raises:
        InputError: the log cannot be opened.
    """
    counts: dict[str, int] = {}
    with suppress(DamagedError), open_log(log) as file:
        for kind, topic, _ in entries(file):
            if kind == "message":
                counts[topic] = counts.get(topic, 0) + 1
            elif kind == "end":
                return counts, True
    return counts, False
