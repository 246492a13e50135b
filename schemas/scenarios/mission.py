"""Missions: what a plan passes on its way, in one TOML file, `alula/mission`.

schema = "alula/mission"      # optional, as is the version
version = "1.0"
name = "two laps"
start_m = [0.8, 0.8, 1.0]     # or options of `alula plan`, as is the goal
goal_m = [0.8, 0.8, 1.0]
loops = 2                     # the passes are flown so many times, one lap after the other
yaw = "along"                 # the motion; or yaw_rad = 1.57, or look_at_m = [4, 3, 1]

[[pass]]                      # in the order in which they are flown
gate_m = [3.0, 2.0, 1.2]      # centre of a hoop,
normal = [1.0, 0.0, 0.0]      # which is flown through in this direction
radius_m = 0.5                # of its opening

[[pass]]
point_m = [6.0, 4.0, 1.0]     # a waypoint
tolerance_m = 0.3             # distance within which it counts as passed; default: that of the flight
hold_s = 2.0                  # stay there
look_at_m = [6.0, 6.0, 1.0]   # on the way to it and there; or yaw, yaw_rad

[[zone]]
box_m = [4, 0, 0, 5, 5, 3]    # XMIN YMIN ZMIN XMAX YMAX ZMAX
speed_m_s = 0.5               # top speed in it
"""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from alula.schemas.artifacts.manifest import VERSION
from alula.schemas.errors import UsageError
from alula.schemas.scenarios.types import Box, SparseTable
from alula.schemas.toml_file import first_beyond, read_toml

MISSION_SCHEMA: Literal["alula/mission"] = "alula/mission"
MOST_PASSES = 1000  # of all laps
_LARGEST_M = 1e6

Vector = tuple[float, float, float]
Size = Annotated[float, Meta(ge=1e-3, le=1e3)]


class PassTable(SparseTable, frozen=True, kw_only=True):
    """A waypoint, `point_m`, or a gate, `gate_m` with `normal` and `radius_m`."""

    point_m: Annotated[Vector | None, Meta(description="a point to pass [m]")] = None
    gate_m: Annotated[Vector | None, Meta(description="centre of a hoop to fly through [m]")] = None
    normal: Annotated[Vector | None, Meta(description="direction in which a gate is flown through")] = None
    radius_m: Annotated[Size | None, Meta(description="of the opening of a gate [m]")] = None
    tolerance_m: Annotated[
        Size | None,
        Meta(
            description="distance within which a waypoint counts as passed; default: that of the flight [m]"
        ),
    ] = None
    hold_s: Annotated[
        Annotated[float, Meta(ge=0, le=1e3)], Meta(description="time to stay at a waypoint [s]")
    ] = 0.0
    yaw: Annotated[Literal["along"] | None, Meta(description="on the way to it: along the motion")] = None
    yaw_rad: Annotated[
        Annotated[float, Meta(ge=-7, le=7)] | None, Meta(description="on the way to it: this heading [rad]")
    ] = None
    look_at_m: Annotated[Vector | None, Meta(description="on the way to it: towards this point [m]")] = None


class ZoneTable(SparseTable, frozen=True, kw_only=True):
    """A box with a lower top speed."""

    box_m: Annotated[Box, Meta(description="XMIN YMIN ZMIN XMAX YMAX ZMAX [m]")]
    speed_m_s: Annotated[float, Meta(ge=1e-3, le=1e3, description="top speed in it [m/s]")]


class Mission(SparseTable, frozen=True, kw_only=True):
    """A mission file.

    Attributes:
        schema: kind of the file.
        version: of the kind.
        name: of the mission.
        start_m: first point of the flight; null: that of `plan --start` [m].
        goal_m: last point of the flight; null: that of `plan --goal` [m].
    """

    schema: Literal["alula/mission"] = MISSION_SCHEMA
    version: str = VERSION
    name: str = ""
    start_m: Vector | None = None
    goal_m: Vector | None = None
    loops: Annotated[int, Meta(ge=1, le=100, description="laps")] = 1
    yaw: Annotated[Literal["along"] | None, Meta(description="along the motion")] = None
    yaw_rad: Annotated[Annotated[float, Meta(ge=-7, le=7)] | None, Meta(description="heading [rad]")] = None
    look_at_m: Annotated[Vector | None, Meta(description="the heading is towards this point [m]")] = None
    passes: Annotated[tuple[PassTable, ...], Meta(description="flown in this order in each lap")] = (
        msgspec.field(default=(), name="pass")
    )
    zones: Annotated[tuple[ZoneTable, ...], Meta(description="boxes with a lower top speed")] = msgspec.field(
        default=(), name="zone"
    )


def read_mission(path: Path) -> Mission:
    """Read a mission.

    Raises:
        InputError: the file cannot be read or is not TOML.
        VersionError: it was written for a later major version.
        UsageError: a key is unknown, missing, of the wrong type or out of range; the message has its path.
    """
    mission = read_toml(path, Mission, MISSION_SCHEMA)
    if wrong := first_beyond(msgspec.to_builtins(mission), "$", _LARGEST_M):
        raise UsageError(f"{path}: {wrong} must be below {_LARGEST_M:g}")
    if wrong := complaint(mission):
        raise UsageError(f"{path}: {wrong}")
    return mission


def complaint(mission: Mission) -> str | None:
    """What is wrong with a mission beyond the types of its values, in one line; None if nothing is."""
    if wrong := _heading_complaint(mission, "$"):
        return wrong
    for i, each in enumerate(mission.passes):
        if wrong := _pass_complaint(each, f"$.pass[{i}]"):
            return wrong
    for i, zone in enumerate(mission.zones):
        if not all(low < high for low, high in zip(zone.box_m[:3], zone.box_m[3:], strict=True)):
            return f"`$.zone[{i}].box_m` needs XMIN < XMAX, YMIN < YMAX and ZMIN < ZMAX"
    if mission.loops > 1 and not mission.passes:
        return "`$.loops`: there is nothing to fly again; add [[pass]]"
    if mission.loops * len(mission.passes) > MOST_PASSES:
        return f"`$.loops`: more than {MOST_PASSES} passes in all laps"
    points = [each.point_m for each in mission.passes]
    round_trip = [*points, points[0]] if mission.loops > 1 else points
    ends: list[Vector | None] = [mission.start_m, *round_trip, mission.goal_m]
    for before, after in [*pairwise(ends), (points[-1] if points else mission.start_m, mission.goal_m)]:
        if before is not None and before == after:
            return (
                f"two consecutive points of the flight are the same, ({' '.join(f'{x:g}' for x in before)})"
            )
    return None


def _heading_complaint(table: Mission | PassTable, where: str) -> str | None:
    given = [name for name in ("yaw", "yaw_rad", "look_at_m") if getattr(table, name) is not None]
    if len(given) > 1:
        return f"`{where}.{given[1]}`: give {given[0]} or {given[1]}, not both"
    return None


def _pass_complaint(each: PassTable, where: str) -> str | None:
    if (each.point_m is None) == (each.gate_m is None):
        return f"`{where}` needs point_m, a waypoint, or gate_m, a gate, and not both"
    of_gates = ("normal", "radius_m")
    if each.gate_m is None:
        for name in of_gates:
            if getattr(each, name) is not None:
                return f"`{where}.{name}`: is for gates, and this is a waypoint"
        return _heading_complaint(each, where)
    for name in of_gates:
        if getattr(each, name) is None:
            return f"`{where}.{name}`: a gate needs it"
    assert each.normal is not None
    if not math.hypot(*each.normal) >= 1e-6:
        return f"`{where}.normal`: has no direction"
    if each.tolerance_m is not None:
        return f"`{where}.tolerance_m`: is for waypoints, and this is a gate"
    if each.hold_s:
        return f"`{where}.hold_s`: is for waypoints, and this is a gate"
    return _heading_complaint(each, where)
