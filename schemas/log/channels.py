"""Channels of logs: one Struct for each, from which its writer, reader and JSON Schema follow.

Runs of `simulate` and flights of `fly` have the same channels; each log has some of them. A new channel
needs an entry of `CHANNELS` and, unless Foxglove has its type, a Struct here. The docstring of a Struct is
the description in its JSON Schema, names of fields end with the unit, an unknown value is None and left out
of the log, and `_shown` names the panel of Foxglove's layout that shows a field. ROS 2 gets a Struct as JSON
text, and as the message of the same meaning if `ros_messages.py` has a function for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import msgspec

from alula.schemas.decode import json_decoder
from alula.schemas.log.foxglove import (
    FrameTransform,
    Log,
    PointCloud,
    PoseInFrame,
    PosesInFrame,
    Quaternion,
    SceneUpdate,
    Vector3,
)

MAP_TOPIC = "/map"
STATE_TOPIC = "/state"
SAFETY_TOPIC = "/safety"
SUPERVISOR_TOPIC = "/supervisor"
LINE_TOPIC = "/log"
OBSTACLES_TOPIC = "/obstacles"
PLAN_TOPIC = "/plan"
REPLAY_TOPIC = "/replay"

OF_BARRIER = "of the filter's barrier"  # margin_unit of a margin that is no distance


def _shown(panel: str, modifier: str = "") -> msgspec.Meta:
    """Field that Foxglove's layout shows in a panel, in the order of the fields; `.@norm` of a vector."""
    return msgspec.Meta(extra={"panel": panel, "modifier": modifier})


_Margin = Annotated[float | None, _shown("margin")]
_Command = Annotated[Vector3 | None, _shown("command", ".@norm")]
_Throttle = Annotated[float | None, _shown("command")]


class State(msgspec.Struct, kw_only=True, omit_defaults=True, gc=False):
    """Position and velocity in the world frame; time_s counts from the trial's start.

    For a rigid body also attitude (body to world), body rates, and thrusts of its rotors.
    """

    trial: int
    time_s: float
    position_m: Vector3
    velocity_m_s: Annotated[Vector3, _shown("speed", ".@norm")]
    attitude: Quaternion | None = None
    omega_body_rad_s: Vector3 | None = None
    thrust_n: float | None = None
    torque_body_nm: Vector3 | None = None
    rotor_thrust_n: list[float | None] | None = None


class Safety(msgspec.Struct, kw_only=True, omit_defaults=True, gc=False):
    """The filter's margin and status, the nominal and the filtered input.

    Among hulls: h_m and velocities. Among ellipsoids: the filter's own barrier, not in metres, and
    accelerations. Among moving obstacles: the mode of a filter that sees them, and their true clearance. Of a
    pilot in a geofence: the true distance as fence_distance_m, h_I as h_m after subtracting allowance_m, the
    regulation function lambda, throttles and rates. In a real flight also the set-point sent (rates: thrust
    per mass and body rates; acceleration, velocity: world frame, and the yaw), the time of the filter, the
    acceleration that the vehicle's model leaves out, as estimated, a bound on what is missing in the
    estimate, and the margin that the filter keeps in addition because of that bound, where there is the room.
    """

    trial: int
    time_s: float | None = None  # only `/safety/NAME` has none: its messages are those of `/safety` in order
    h_m: _Margin = None
    margin: _Margin = None
    margin_unit: str | None = None  # None among hulls, where h_m is the margin
    status: int
    status_name: Annotated[str, _shown("states")]
    mode_name: Annotated[str | None, _shown("states")] = None
    infeasible: bool | None = None
    certified: bool | None = None
    certified_moving: bool | None = None
    capped: bool | None = None
    active: int | None = None
    candidates: int | None = None
    rows: int | None = None
    iterations: int | None = None
    gate_m: float | None = None
    saturated: bool | None = None
    u_nom_m_s: _Command = None
    u_safe_m_s: _Command = None
    a_nom_m_s2: _Command = None
    a_safe_m_s2: _Command = None
    realisation_error_m_s2: float | None = None
    thrust_nom_n: float | None = None
    torque_nom_body_nm: Vector3 | None = None
    throttle_nom: _Throttle = None
    throttle_safe: _Throttle = None
    rates_nom_rad_s: Vector3 | None = None
    rates_safe_rad_s: Vector3 | None = None
    moving_clearance_m: _Margin = None
    fence_distance_m: _Margin = None
    regulation: float | None = msgspec.field(default=None, name="lambda")
    allowance_m: float | None = None
    towards_m_s: float | None = None
    disturbance_m_s2: Vector3 | None = None
    disturbance_bound_m_s2: float | None = None
    added_margin_m: float | None = None
    sent: str | None = None
    sent_values: list[float | None] | None = None
    solve_time_s: float | None = None


class Supervisor(msgspec.Struct, kw_only=True, omit_defaults=True, gc=False):
    """The supervisor's state, the vehicle's reports and the times of the loop, per tick.

    A step has the event that caused it and the action that was taken.
    """

    time_s: float
    state: int
    state_name: Annotated[str, _shown("states")]
    event_name: str | None = None
    action_name: str | None = None
    mode: Annotated[str | None, _shown("states")] = None
    armed: bool | None = None
    landed: bool | None = None
    battery_share: float | None = None
    state_age_s: float | None = None
    late_s: float | None = None
    tick_s: float | None = None
    slip_m: float | None = None
    fence_m: float | None = None
    fence_h_m: float | None = None
    fence_share: float | None = None
    fence_flies: bool | None = None
    plan_s: float | None = None
    plan_rate: float | None = None
    error_m: float | None = None


class Replay(msgspec.Struct, kw_only=True, gc=False):
    """Inputs and set-points of each tick of a real flight, not rounded:

    the native flight repeats it bit by bit: the number of the tick since set-points began, the ticks left out
    before it; the age of the measured state (position, attitude as MRP, velocity, body rates), and its slip,
    which older logs lack; the reference (position to snap, yaw and its rates); the set-point decided, whether
    it was sent so, and the one sent.
    """

    time_s: float
    number: int
    repeats: int
    age_s: float
    slip_m: float = 0.0
    measured: tuple[float, ...]
    target: tuple[float, ...]
    decided: str
    decided_values: tuple[float, ...]
    is_own: bool
    sent: str
    sent_values: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Channel:
    """Channel of logs.

    Attributes:
        struct: of its messages.
        is_latched: it has messages seldom, and late subscribers need the last one.
        is_live: `fly --foxglove` serves it.
    """

    struct: type[msgspec.Struct]
    is_latched: bool = False
    is_live: bool = True


CHANNELS = {  # by topic; their order is that in a file
    MAP_TOPIC: Channel(SceneUpdate, is_latched=True),
    "/vehicle": Channel(SceneUpdate, is_latched=True),
    "/path": Channel(PosesInFrame),
    STATE_TOPIC: Channel(State),
    SAFETY_TOPIC: Channel(Safety),
    LINE_TOPIC: Channel(Log),
    "/pose": Channel(PoseInFrame),
    "/tf": Channel(FrameTransform),
    OBSTACLES_TOPIC: Channel(SceneUpdate),
    "/splat": Channel(PointCloud, is_latched=True),
    PLAN_TOPIC: Channel(PosesInFrame, is_latched=True),
    SUPERVISOR_TOPIC: Channel(Supervisor),
    REPLAY_TOPIC: Channel(Replay, is_live=False),  # of use only with each tick
}
SIMULATED_TOPICS = ("/map", "/vehicle", "/path", "/state", "/safety", "/log", "/pose", "/tf")
FLIGHT_TOPICS = tuple(topic for topic in CHANNELS if topic != OBSTACLES_TOPIC)


def struct_of(topic: str) -> type[msgspec.Struct]:
    """Struct of the messages of a channel; `/safety/NAME` has that of `/safety`."""
    return CHANNELS[SAFETY_TOPIC if topic.startswith(f"{SAFETY_TOPIC}/") else topic].struct


def decoded(topic: str, data: bytes) -> msgspec.Struct:
    """Read a message of a channel; its errors are those of `json_decoder`."""
    return json_decoder(struct_of(topic)).decode(data)


def schema_name(struct: type[msgspec.Struct]) -> str:
    """Name of a Struct's schema in a log, such as `alula.State`."""
    package = "foxglove" if struct.__module__.endswith(".foxglove") else "alula"
    return f"{package}.{struct.__name__}"
