"""Contents of a run's log: its channels, and states, margins, commands and moving obstacles over time."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.decode import json_decoder
from alula.schemas.errors import DamagedError
from alula.schemas.flight_samples import (
    Bodies,
    Commands,
    Loose,
    Moving,
    Quaternion,
    attitudes,
    commands_of,
    measured,
    moving,
)
from alula.schemas.mcap_log import entries, messages
from alula.schemas.run import open_log

MAP_TOPIC = "/map"
STATE_TOPIC = "/state"
SAFETY_TOPIC = "/safety"
SUPERVISOR_TOPIC = "/supervisor"
LINE_TOPIC = "/log"
OBSTACLES_TOPIC = "/obstacles"
PLAN_TOPIC = "/plan"


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


_Active = Annotated[int, msgspec.Meta(ge=-1, le=2**40)]


class _Vector(msgspec.Struct, gc=False):
    x: float
    y: float
    z: float


class _State(msgspec.Struct, gc=False):
    trial: int
    time_s: float
    position_m: _Vector
    velocity_m_s: _Vector
    attitude: Quaternion | None = None


class _Safety(msgspec.Struct, gc=False):
    trial: int
    time_s: float
    h_m: float | None = None
    margin: float | None = None
    margin_unit: str | None = None  # absent among hulls, where h_m is the margin
    fence_distance_m: float | None = None
    moving_clearance_m: float | None = None
    status_name: str = ""
    active: _Active = -1
    regulation: float | None = msgspec.field(default=None, name="lambda")
    u_nom_m_s: Loose | None = None
    u_safe_m_s: Loose | None = None
    a_nom_m_s2: Loose | None = None
    a_safe_m_s2: Loose | None = None


class _Status(msgspec.Struct, gc=False):
    trial: int
    status_name: str = ""
    active: _Active = -1


class _Supervisor(msgspec.Struct, gc=False):
    time_s: float
    state_name: str
    event_name: str = ""  # only a step has one
    action_name: str = ""


class _Stamp(msgspec.Struct, gc=False, frozen=True):
    sec: int
    nsec: int


class _Line(msgspec.Struct, gc=False):
    timestamp: _Stamp
    level: int
    message: str


class _Pose(msgspec.Struct, gc=False):
    position: _Vector


class _Plan(msgspec.Struct):
    timestamp: _Stamp
    poses: list[_Pose]


class _Pair(msgspec.Struct):
    key: str
    value: str


class _Entity(msgspec.Struct):
    timestamp: _Stamp = _Stamp(0, 0)
    metadata: list[_Pair] = []


class _Map(msgspec.Struct):
    entities: list[_Entity] = []


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
    states: dict[int, list[_State]] = {}
    bodies: dict[int, dict[int, Bodies]] = {}  # by trial and number of the state
    last = None
    safety: dict[int, list[_Safety]] = {}
    each: dict[int, dict[str, list[_Status]]] = {}
    supervised: list[_Supervisor] = []
    lines: list[_Line] = []
    plans: list[_Plan] = []
    hulls, start = None, _Stamp(0, 0)
    decode_state = json_decoder(_State).decode
    decode_safety = json_decoder(_Safety).decode
    decode_supervisor = json_decoder(_Supervisor).decode
    decode_line = json_decoder(_Line).decode
    decode_bodies = json_decoder(Bodies).decode
    decode_status = json_decoder(_Status).decode
    decode_plan = json_decoder(_Plan).decode
    for topic, data in found:
        if topic == STATE_TOPIC:
            state = decode_state(data)
            states.setdefault(state.trial, []).append(state)
            last = state.trial
        elif topic == OBSTACLES_TOPIC:
            if last is not None:
                bodies.setdefault(last, {})[len(states[last]) - 1] = decode_bodies(data)
        elif topic == MAP_TOPIC:
            shown = json_decoder(_Map).decode(data)
            hulls, start = _hull_count(shown), _start(shown)
        elif topic == SAFETY_TOPIC:
            answer = decode_safety(data)
            safety.setdefault(answer.trial, []).append(answer)
        elif topic.startswith(f"{SAFETY_TOPIC}/"):
            own = decode_status(data)
            each.setdefault(own.trial, {}).setdefault(topic[len(SAFETY_TOPIC) + 1 :], []).append(own)
        elif topic == SUPERVISOR_TOPIC:
            supervised.append(decode_supervisor(data))
        elif topic == LINE_TOPIC:
            lines.append(decode_line(data))
        elif topic == PLAN_TOPIC:
            plans.append(decode_plan(data))
    flights = {
        trial: _flight(states[trial], safety.get(trial, []), bodies.get(trial, {}), each.get(trial, {}))
        for trial in sorted(states)
    }
    return Flights(flights, hulls, _course(supervised, lines, plans, start) if supervised else None)


def _start(message: _Map) -> _Stamp:
    """Log time of the start of a flight: that of its map."""
    return message.entities[0].timestamp if message.entities else _Stamp(0, 0)


def _since(start: _Stamp, at: _Stamp) -> float:
    return at.sec - start.sec + 1e-9 * (at.nsec - start.nsec)


def _course(supervised: list[_Supervisor], found: list[_Line], plans: list[_Plan], start: _Stamp) -> Course:
    lines = tuple(Line(_since(start, line.timestamp), line.level, line.message) for line in found)
    new = tuple(
        NewPlan(
            _since(start, plan.timestamp),
            measured("position", [(one.position.x, one.position.y, one.position.z) for one in plan.poses]),
        )
        for plan in plans
        if plan.timestamp != start and plan.poses  # else the plan before the flight
    )
    steps = tuple(
        Step(one.time_s, one.state_name, one.event_name, one.action_name)
        for one in supervised
        if one.event_name
    )
    return Course(steps, lines, max(one.time_s for one in supervised), new)


def _hull_count(message: _Map) -> int | None:
    for entity in message.entities:
        for pair in entity.metadata:
            if pair.key == "hulls" and pair.value.isdecimal():
                return int(pair.value)
    return None


def _flight(
    states: list[_State],
    safety: list[_Safety],
    bodies: dict[int, Bodies],
    each: dict[str, list[_Status]],
) -> Flight:
    order = sorted(range(len(states)), key=lambda i: states[i].time_s)
    states = [states[i] for i in order]
    safety.sort(key=lambda answer: answer.time_s)
    position = [(v.x, v.y, v.z) for v in (state.position_m for state in states)]
    velocity = [(v.x, v.y, v.z) for v in (state.velocity_m_s for state in states)]
    answered = {
        name: own for name, own in each.items() if len(own) == len(safety)
    }  # in the order of the answers
    active = {name: [one.active for one in own] for name, own in answered.items()}
    active = active or {"": [one.active for one in safety]}
    square = np.square(measured("velocity", velocity).reshape(-1, 3)).sum(axis=1)
    return Flight(
        time_s=measured("time", [state.time_s for state in states]),
        position_world=measured("position", position).reshape(-1, 3),
        speed_m_s=np.sqrt(square),
        margin_time_s=measured("time", [answer.time_s for answer in safety]),
        margin=measured("margin", [_margin(answer) for answer in safety]),
        margin_unit=_unit(safety[0]) if safety else "m",
        status=tuple(answer.status_name for answer in safety),
        regulation=_known([a.regulation for a in safety]),
        fence_distance_m=_known([a.fence_distance_m for a in safety]),
        quat_world_body_wxyz=attitudes(states),
        moving=moving([bodies.get(i) for i in order]) if bodies else None,
        commands=commands_of(safety),
        each_status={name: tuple(one.status_name for one in own) for name, own in answered.items()},
        active={name: np.array(numbers, np.int64) for name, numbers in active.items()},
    )


def _known(values: list[float | None]) -> NDArray[np.float64] | None:
    """Convert to an array, None to NaN; None where all are."""
    return None if all(value is None for value in values) else measured("distance", values)


def _margin(answer: _Safety) -> float | None:
    """The true clearance of moving obstacles, or else what the filter reported."""
    if answer.moving_clearance_m is not None:
        return answer.moving_clearance_m
    return answer.h_m if answer.margin_unit is None else answer.margin


def _unit(answer: _Safety) -> str:
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
