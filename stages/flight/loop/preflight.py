"""Pre-flight checks: named functions of what was observed and of what the flight requires."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from alula._core import EllipsoidSet, Fence, PolytopeSet
from alula.schemas.arrays import FloatArray
from alula.stages.clearance import path_clearance
from alula.stages.flight.links.own_safety import OwnSafety
from alula.stages.flight.links.protocol import HIGHEST_M, VehicleState, VehicleStatus
from alula.stages.flight.loop.departures import Departures
from alula.stages.flight.loop.failsafe_check import failsafe_faults
from alula.stages.rotation import matrix_from_quat_wxyz
from alula.stages.vehicles.setpoints import Setpoint

Obstacles = PolytopeSet | EllipsoidSet

_MIN_CLIMB_M = 0.1  # to the start: with a lower start set-points would be sent on the ground
_UNIT_TOLERANCE = 1e-2  # of the squared norm of a quaternion
_THRUST_RATIO = 1.5  # between the measured maximum thrust and the file's; more means a wrong file
_PROBE_M = 1e-3  # a step up; it increases the distance by as much if the obstacle is straight below
_FOOT = 1.5  # required clearance times this is the height from which on the climb path must be clear


@dataclass(frozen=True, slots=True, kw_only=True)
class Needs:
    """Requirements of a flight for the vehicle and its position on the ground.

    Attributes:
        setpoints: kinds of set-points; the link must accept one of them.
        start, goal: ends of the plan, each of shape (3,), world frame [m].
        departures: instants of the flight from which the vehicle may turn home, world frame.
        obstacles: obstacles by name, world frame.
        map_origin_m: position in the world that became the map's origin [m]; None where it is its own.
        margin_m: additional clearance of the climb path [m].
        fence: volume to fly in, world frame.
        plan: whether the plan is proven clear of the map, and how, in words.
        max_thrust_m_s2: maximum thrust per mass in the vehicle's file [m/s^2].
        near_m: maximum horizontal distance between the vehicle and the start [m].
        state_hz: minimum rate of states [Hz].
        silence_s, stale_s: maximum age of the last message and of the state [s].
        latency_s: latency for which the geofence was made; the measured one must not exceed it [s].
        battery_share: minimum charge, from 0 to 1; with 0 the vehicle need not report it.
        max_tilt_rad: maximum tilt on the ground [rad].
        frame: what the check by hand found wrong; empty when nothing is, None when it was not made.
    """

    setpoints: frozenset[type[Setpoint]]
    start: FloatArray
    goal: FloatArray
    departures: Departures
    obstacles: Sequence[tuple[str, Obstacles]]
    radius_m: float
    margin_m: float
    fence: Fence
    plan: tuple[bool, str]
    map_words: str = ""
    map_origin_m: Sequence[float] | None = None
    speed_m_s: float = math.nan
    stop_m: float = math.nan
    max_thrust_m_s2: float = math.inf
    gravity_m_s2: float = 9.81
    near_m: float = 0.5
    state_hz: float = 20.0
    loop_hz: float = 100.0
    silence_s: float = 1.5
    stale_s: float = 0.15
    latency_s: float = math.inf
    battery_share: float = 0.3
    max_tilt_rad: float = 0.35
    frame: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """Observations of a vehicle during a time before the evaluation.

    Attributes:
        now_s: end of the observation, monotonic clock [s].
        changed: parameters that the link has set, one line each.
        trouble: reason why the link could not set the parameters; empty if it could.
        hover: throttle at hover reported by the vehicle, from 0 to 1; None if it is not reported.
    """

    now_s: float
    seconds: float
    status: VehicleStatus
    state: VehicleState | None
    accepts: frozenset[type[Setpoint]]
    changed: Sequence[str] = ()
    trouble: str = ""
    states: int = 0
    ticks: int = 0
    worst_late_s: float = 0.0
    hover: float | None = None


class Verdict(NamedTuple):
    """Result of one check.

    Attributes:
        of_link: the link or the vehicle is the cause of a failure.
        is_unknown: the vehicle has not yet reported a required value.
        room_m: distance by which the vehicle may leave the climb path without touching anything [m]; only the
            check of the clearance sets it.
    """

    name: str
    holds: bool
    words: str
    of_link: bool = False
    is_unknown: bool = False
    room_m: float = math.inf


def _unknown(name: str, what: str) -> Verdict:
    return Verdict(name, False, f"not reported: the vehicle does not report {what}", True, True)


def _heartbeat(seen: Observed, needs: Needs) -> Verdict:
    last_s = seen.status.heard_s
    age = math.inf if last_s is None else seen.now_s - last_s
    words = "no message was received" if last_s is None else f"last message {age:.2f} s ago"
    return Verdict("heartbeat", age <= needs.silence_s, words, of_link=True)


def _parameters(seen: Observed, needs: Needs) -> Verdict:
    words = seen.trouble or "; ".join(seen.changed) or "all as required"
    return Verdict("parameters", not seen.trouble, words, of_link=True)


def _setpoints(seen: Observed, needs: Needs) -> Verdict:
    kinds = " or ".join(sorted(kind.__name__ for kind in needs.setpoints))
    holds = not needs.setpoints.isdisjoint(seen.accepts)
    return Verdict("set-points", holds, f"{kinds} {'accepted' if holds else 'not accepted'}")


def _thrust(seen: Observed, needs: Needs) -> Verdict:
    """The maximum thrust is g / hover; controller, filter and fence use the one in the vehicle's file."""
    if seen.hover is None or not math.isfinite(needs.max_thrust_m_s2):
        return Verdict("thrust", True, "not reported")
    max_m_s2 = needs.gravity_m_s2 / seen.hover
    holds = 1 / _THRUST_RATIO <= max_m_s2 / needs.max_thrust_m_s2 <= _THRUST_RATIO
    words = f"hover at {seen.hover:.2f} of full throttle means at most {max_m_s2:.1f} m/s^2"
    return Verdict("thrust", holds, f"{words}; the vehicle's file has {needs.max_thrust_m_s2:.1f}")


def _position(seen: Observed, needs: Needs) -> Verdict:
    if seen.state is None:
        lacks = seen.status.without_position
        words = "no complete and finite state was received"
        return Verdict("state", False, f"{words}: {lacks}" if lacks else words, of_link=True)
    state, age = seen.state, seen.state.age_s(seen.now_s)
    if not all(np.isfinite(part).all() for part in (state.position, state.velocity, state.omega)):
        return Verdict("state", False, "position, velocity or rates are not finite", of_link=True)
    if not _is_attitude(state):
        return Verdict("state", False, "the attitude is not a unit quaternion", of_link=True)
    x, y, z = state.position
    where = f"at ({x:.2f} {y:.2f} {z:.2f})"
    if math.isnan(age):
        return Verdict("state", False, f"{where}, of unknown age: the latency was not measured", True, True)
    holds = abs(age) <= needs.stale_s  # a time in the future is an error, too
    return Verdict("state", holds, f"{where}, at most {age:.3f} s old", True)


def _latency(seen: Observed, needs: Needs) -> Verdict:
    """A delay that all packets share shows in no packet, only in the answers to time requests."""
    latency_s = math.nan if seen.state is None else seen.state.latency_s
    if math.isnan(latency_s):
        return _unknown("latency", "its time when asked for it")
    words = f"the fastest states and commands take {latency_s:.3f} s together"
    holds = latency_s <= needs.latency_s
    advice = "" if holds else f"; --latency has {needs.latency_s:.3f} s"
    return Verdict("latency", holds, words + advice, of_link=True)


def _is_attitude(state: VehicleState) -> bool:
    return abs(float(state.attitude_wxyz @ state.attitude_wxyz) - 1.0) < _UNIT_TOLERANCE


def _rate(seen: Observed, needs: Needs) -> Verdict:
    states = seen.states / seen.seconds if seen.seconds > 0 else 0.0
    holds = states >= needs.state_hz
    return Verdict("rate", holds, f"{states:.0f} states/s, {needs.state_hz:.0f} required", of_link=True)


def _loop(seen: Observed, needs: Needs) -> Verdict:
    ticks = seen.ticks / seen.seconds if seen.seconds > 0 else 0.0
    words = f"{ticks:.0f} ticks/s of {needs.loop_hz:.0f}, at most {1e3 * seen.worst_late_s:.1f} ms late"
    return Verdict("loop", ticks >= 0.9 * needs.loop_hz, words)


def _estimator(seen: Observed, needs: Needs) -> Verdict:
    ready = seen.status.is_estimator_ready
    if ready is None:
        return _unknown("estimator", "the state of its position estimate")
    why = seen.status.estimator
    return Verdict("estimator", ready, "ready" if ready else f"not ready: {why}" if why else "not ready")


def _battery(seen: Observed, needs: Needs) -> Verdict:
    charge = seen.status.battery_share
    if charge is None and needs.battery_share == 0:
        return Verdict("battery", True, "not reported, and not required")
    if charge is None:
        return _unknown("battery", "the charge of its battery")
    holds = needs.battery_share <= charge <= 1
    return Verdict("battery", holds, f"{charge:.0%}, {needs.battery_share:.0%} required")


def _on_ground(seen: Observed, needs: Needs) -> Verdict:
    status = seen.status
    if status.is_failsafe:
        return Verdict("on the ground", False, "the vehicle is in one of its own failsafes")
    if status.armed or status.landed is False:
        return Verdict("on the ground", False, "armed" if status.armed else "in the air")
    if status.armed is None or status.landed is None:
        what = "whether it is armed" if status.armed is None else "whether it has landed"
        return _unknown("on the ground", what)
    return Verdict("on the ground", True, "disarmed")


def _arming(seen: Observed, needs: Needs) -> Verdict:
    status = seen.status
    if status.can_arm is None:
        return Verdict("arming", True, "the vehicle does not report checks of its own")
    words = "the vehicle's own checks hold" if status.can_arm else "the vehicle refuses"
    return Verdict("arming", status.can_arm, ": ".join(filter(None, (words, status.arming))), of_link=True)


def _failsafes(seen: Observed, needs: Needs) -> Verdict:
    """What the vehicle does by itself must be clear of the map, from every instant of the plan."""
    own = seen.status.own_safety
    if own is None:
        return Verdict("failsafes", True, "the vehicle's own failsafes are not known, and not judged")
    if seen.state is None or not np.isfinite(seen.state.position).all():
        return Verdict("failsafes", False, "no state")
    foot_m = _FOOT * (needs.radius_m + needs.margin_m)  # as for the landing path, to leave out the ground
    faults, found = failsafe_faults(
        own,
        needs.departures,
        seen.state.position,
        needs.obstacles,
        radius_m=needs.radius_m,
        foot_m=foot_m,
        map_words=needs.map_words or "the map",
    )
    return Verdict("failsafes", not faults, "; ".join(faults) or found + _coasting(own, needs))


def _coasting(own: OwnSafety, needs: Needs) -> str:
    """How far it flies when nobody sends set-points; empty if unknown."""
    watched_m, alone_m = (needs.speed_m_s * time_s + needs.stop_m for time_s in (own.watched_s, own.alone_s))
    ends = [f"{watched_m:.1f} m when this program dies"] if math.isfinite(watched_m) else []
    if math.isfinite(alone_m):
        ends.append(f"{alone_m:.1f} m when {'its computer does' if ends else 'this program dies'}")
    return f"; from {needs.speed_m_s:g} m/s it coasts at most {', '.join(ends)}" if ends else ""


def _level(seen: Observed, needs: Needs) -> Verdict:
    """A vehicle at rest is level; an attitude in another convention is not."""
    if seen.state is None:
        return Verdict("level", False, "no state")
    if not _is_attitude(seen.state):
        return Verdict("level", False, "the attitude is not a unit quaternion")
    up = float(matrix_from_quat_wxyz(seen.state.attitude_wxyz)[2, 2])
    tilt = math.acos(max(-1.0, min(1.0, up)))
    resting = (
        float(np.linalg.norm(seen.state.velocity)) < 0.5 and float(np.linalg.norm(seen.state.omega)) < 0.5
    )
    words = f"tilted {math.degrees(tilt):.0f} degrees" + ("" if resting else ", and moving")
    return Verdict("level", tilt <= needs.max_tilt_rad and resting, words)


def _start(seen: Observed, needs: Needs) -> Verdict:
    if seen.state is None:
        return Verdict("start", False, "no state")
    away = needs.start - seen.state.position
    sideways = math.hypot(away[0], away[1])
    holds = sideways <= needs.near_m and _MIN_CLIMB_M <= away[2] <= HIGHEST_M
    words = f"the plan starts {sideways:.2f} m away sideways and {away[2]:.2f} m above"
    allowed = f"at most {needs.near_m:g} m sideways, {_MIN_CLIMB_M:g} to {HIGHEST_M:g} m above"
    advice = "" if holds else "; move the vehicle, or say by --origin where the map's origin is in its frame"
    return Verdict("start", holds, f"{words}; {allowed}{advice}{_origin_words(needs)}")


def _origin_words(needs: Needs) -> str:
    """Which point of the world `--origin` is the place of; empty where it is the world's own origin."""
    if needs.map_origin_m is None:
        return ""
    place = " ".join(f"{c:.12g}" for c in needs.map_origin_m)
    return f"; the map's origin, which --origin places, is ({place}) m of the world"


def climb(position: FloatArray, start: FloatArray, foot_m: float) -> FloatArray:
    """Climb path: straight up to the height of the start and over to it, three points, shape (3, 3) [m].

    Args:
        position: of the vehicle on the ground, shape (3,), world frame [m].
        start: of the plan, shape (3,), world frame [m].
        foot_m: height of the path's first point above the position, to leave out the ground [m].
    """
    low = min(position[2] + foot_m, max(start[2], position[2]))
    return np.array([[position[0], position[1], low], [position[0], position[1], start[2]], start])


def _clearance(seen: Observed, needs: Needs) -> Verdict:
    """Exact distance of the climb path to the map, independent of the filter."""
    if seen.state is None:
        return Verdict("clearance", False, "no state")
    needed = needs.radius_m + needs.margin_m
    path = climb(seen.state.position, needs.start, _FOOT * needed)
    if not np.isfinite(path).all():
        return Verdict("clearance", False, "no finite position")
    room = math.inf
    for name, obstacles in needs.obstacles:
        distance = float(path_clearance(path, obstacles, jobs=1).min())
        if not distance >= needed:
            words = f"{distance:.3f} m to {name} on the climb path to the start, {needed:.3f} m required"
            return Verdict(
                "clearance", False, words + _underfoot(path, seen.state.position[2], obstacles, distance)
            )
        room = min(room, distance - needs.radius_m)
    return Verdict("clearance", True, f"the climb path to the start is {needed:.3f} m clear", room_m=room)


def _underfoot(path: FloatArray, ground_m: float, obstacles: Obstacles, distance_m: float) -> str:
    """Advice for an obstacle straight below the beginning of a climb path; empty for any other obstacle."""
    probe = path[:1] + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, _PROBE_M]])
    here, above = (float(path_clearance(point[None], obstacles, jobs=1)[0]) for point in probe)
    if here > distance_m + 1e-9 or above - here < 0.9 * _PROBE_M:
        return ""
    top_m = float(path[0, 2]) - here - ground_m
    return (
        f": the obstacle is below the path, which begins {path[0, 2] - ground_m:.3f} m up, and reaches "
        f"{top_m:.3f} m above where the vehicle stands; if it is the floor as mapped, use finer voxels "
        "or a higher start"
    )


def _fence(seen: Observed, needs: Needs) -> Verdict:
    if seen.state is None:
        return Verdict("fence", False, "no state")
    _, top, start = (tuple(row) for row in climb(seen.state.position, needs.start, 0.0).tolist())
    distance = needs.fence.clearance(top, start) - needs.radius_m
    return Verdict("fence", distance > 0, f"{distance:.2f} m from the fence at the start")


def _landing(seen: Observed, needs: Needs) -> Verdict:
    """Distance of the landing path, straight down from the end of the plan; no filter is active there."""
    if seen.state is None:
        return Verdict("landing", False, "no state")
    down = needs.goal.copy()
    foot_m = _FOOT * (needs.radius_m + needs.margin_m)  # as for the climb path, to leave out the ground
    down[2] = min(seen.state.position[2] + foot_m, needs.goal[2])
    path = np.array([needs.goal, down])
    if not np.isfinite(path).all():
        return Verdict("landing", False, "no finite position")
    for name, obstacles in needs.obstacles:
        distance = float(path_clearance(path, obstacles, jobs=1).min())
        if not distance >= needs.radius_m:
            words = f"{distance:.3f} m to {name} on the landing path from the goal"
            return Verdict("landing", False, f"{words}, {needs.radius_m:.3f} m required")
    return Verdict("landing", True, f"the landing path from the goal is {needs.radius_m:.3f} m clear")


def _plan(seen: Observed, needs: Needs) -> Verdict:
    return Verdict("plan", *needs.plan)


def _frame(seen: Observed, needs: Needs) -> Verdict:
    if needs.frame is None:
        return Verdict("frame", True, "watched from take-off on")
    return Verdict("frame", not needs.frame, needs.frame or "as moved by hand")


CHECKS: tuple[Callable[[Observed, Needs], Verdict], ...] = (
    _heartbeat,
    _parameters,
    _setpoints,
    _thrust,
    _position,
    _latency,
    _rate,
    _loop,
    _estimator,
    _battery,
    _on_ground,
    _arming,
    _failsafes,
    _level,
    _start,
    _clearance,
    _landing,
    _fence,
    _plan,
    _frame,
)


def verdicts(seen: Observed, needs: Needs) -> list[Verdict]:
    """Run all checks, whatever the results of the others.

    Returns:
        One verdict per check, in the order of `CHECKS`.
    """
    return [check(seen, needs) for check in CHECKS]
