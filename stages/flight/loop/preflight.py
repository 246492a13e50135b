"""What must hold before the motors start: named checks, each a function of what was observed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from alula._core import EllipsoidSet, Fence, PolytopeSet
from alula.schemas.arrays import FloatArray
from alula.stages.clearance import path_clearance
from alula.stages.flight.links.protocol import HIGHEST_M, Setpoint, VehicleState, VehicleStatus
from alula.stages.rotation import matrix_from_quat_wxyz

Obstacles = PolytopeSet | EllipsoidSet

_LEAST_CLIMB_M = 0.1  # to the start: without a climb there is no take-off, and set-points come on the ground
_UNIT = 1e-2  # how far from 1 the square of a quaternion may be
_THRUST_RATIO = 1.5  # between the vehicle's thrust and its file's: another vehicle's file
_PROBE_M = 1e-3  # a step up, which leads that far away from what is straight below
_FOOT = 1.5  # of the clearance needed: so far above its feet a vehicle on the ground must be clear of all


@dataclass(frozen=True, slots=True, kw_only=True)
class Needs:
    """What a flight needs of its vehicle and of where it stands.

    Attributes:
        setpoints: kinds of which the link must accept one.
        start, goal: of the plan, each of shape (3,) [m].
        obstacles: what a path must stay clear of, by name.
        radius_m: of the vehicle; margin_m: more than that for where it stands and climbs.
        fence: where it may fly.
        plan: whether the plan is proven clear of the map, and how that was found, in words.
        most_thrust_m_s2: per mass, as the vehicle's file has it; gravity_m_s2: of the same.
        near_m: how far from below the start it may stand, sideways.
        state_hz: least rate of states; loop_hz: wanted rate of the loop.
        silence_s, stale_s: oldest word and state.
        battery_share: least charge, of 1; with 0 one that tells none will do.
        max_tilt_rad: of where it stands.
        frame: verdict of the check by hand, in words of what is wrong; empty when right, None when not made.
    """

    setpoints: frozenset[type[Setpoint]]
    start: FloatArray
    goal: FloatArray
    obstacles: Sequence[tuple[str, Obstacles]]
    radius_m: float
    margin_m: float
    fence: Fence
    plan: tuple[bool, str]
    most_thrust_m_s2: float = math.inf
    gravity_m_s2: float = 9.81
    near_m: float = 0.5
    state_hz: float = 20.0
    loop_hz: float = 100.0
    silence_s: float = 1.5
    stale_s: float = 0.15
    battery_share: float = 0.3
    max_tilt_rad: float = 0.35
    frame: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Observed:
    """What was seen of a vehicle for `seconds`, up to `now_s`.

    Attributes:
        status, state: the newest; accepts: of the link.
        changed: parameters that the link had to set, a line each; trouble: why it could not, if so.
        hover: throttle that carries the weight, as the vehicle says; None where it does not.
        states: how many came; ticks: of the loop; worst_late_s: of a tick.
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
    """Of one check: its name, whether it holds, what was found.

    `of_link` when the vehicle is the cause; `is_untold` when it has not said what is needed, and still may.
    `room_m`, of the clearance, is how far off its way up the vehicle's sphere still touches nothing.
    """

    name: str
    holds: bool
    words: str
    of_link: bool = False
    is_untold: bool = False
    room_m: float = math.inf


def _untold(name: str, what: str) -> Verdict:
    return Verdict(name, False, f"not told: the vehicle says nothing of its {what}", True, True)


def _heartbeat(seen: Observed, needs: Needs) -> Verdict:
    heard = seen.status.heard_s
    age = math.inf if heard is None else seen.now_s - heard
    words = "nothing was heard" if heard is None else f"heard {age:.2f} s ago"
    return Verdict("heartbeat", age <= needs.silence_s, words, of_link=True)


def _parameters(seen: Observed, needs: Needs) -> Verdict:
    words = seen.trouble or "; ".join(seen.changed) or "all as needed"
    return Verdict("parameters", not seen.trouble, words, of_link=True)


def _setpoints(seen: Observed, needs: Needs) -> Verdict:
    wanted = " or ".join(sorted(kind.__name__ for kind in needs.setpoints))
    holds = not needs.setpoints.isdisjoint(seen.accepts)
    return Verdict("set-points", holds, f"{wanted} {'accepted' if holds else 'not accepted'}")


def _thrust(seen: Observed, needs: Needs) -> Verdict:
    """Full throttle makes g / hover; controller, filter and fence reckon with the file's."""
    if seen.hover is None or not math.isfinite(needs.most_thrust_m_s2):
        return Verdict("thrust", True, "not told")
    most = needs.gravity_m_s2 / seen.hover
    holds = 1 / _THRUST_RATIO <= most / needs.most_thrust_m_s2 <= _THRUST_RATIO
    words = f"hover at {seen.hover:.2f} of full throttle makes {most:.1f} m/s^2 at most"
    return Verdict("thrust", holds, f"{words}, the vehicle's file {needs.most_thrust_m_s2:.1f}")


def _position(seen: Observed, needs: Needs) -> Verdict:
    if seen.state is None:
        return Verdict("state", False, "no complete and finite state was seen", of_link=True)
    state, age = seen.state, seen.now_s - seen.state.received_s
    if not all(np.isfinite(part).all() for part in (state.position, state.velocity, state.omega)):
        return Verdict("state", False, "position, velocity or rates are not finite", of_link=True)
    if not _is_attitude(state):
        return Verdict("state", False, "the attitude is no unit quaternion", of_link=True)
    x, y, z = state.position
    holds = abs(age) <= needs.stale_s  # what comes from the future never grows old
    return Verdict("state", holds, f"at ({x:.2f} {y:.2f} {z:.2f}), {age:.3f} s old", True)


def _is_attitude(state: VehicleState) -> bool:
    return abs(float(state.attitude_wxyz @ state.attitude_wxyz) - 1.0) < _UNIT


def _rate(seen: Observed, needs: Needs) -> Verdict:
    states = seen.states / seen.seconds if seen.seconds > 0 else 0.0
    holds = states >= needs.state_hz
    return Verdict("rate", holds, f"{states:.0f} states/s, {needs.state_hz:.0f} needed", of_link=True)


def _loop(seen: Observed, needs: Needs) -> Verdict:
    ticks = seen.ticks / seen.seconds if seen.seconds > 0 else 0.0
    words = f"{ticks:.0f} ticks/s of {needs.loop_hz:.0f}, at most {1e3 * seen.worst_late_s:.1f} ms late"
    return Verdict("loop", ticks >= 0.9 * needs.loop_hz, words)


def _estimator(seen: Observed, needs: Needs) -> Verdict:
    ready = seen.status.is_estimator_ready
    if ready is None:
        return _untold("estimator", "estimate of where it is")
    return Verdict("estimator", ready, "ready" if ready else "not ready")


def _battery(seen: Observed, needs: Needs) -> Verdict:
    share = seen.status.battery_share
    if share is None and needs.battery_share == 0:
        return Verdict("battery", True, "not told, and none is needed")
    if share is None:
        return _untold("battery", "battery's charge")
    holds = needs.battery_share <= share <= 1
    return Verdict("battery", holds, f"{share:.0%}, {needs.battery_share:.0%} needed")


def _on_ground(seen: Observed, needs: Needs) -> Verdict:
    status = seen.status
    if status.is_failsafe:
        return Verdict("on the ground", False, "the vehicle is in a failsafe of its own")
    if status.armed or status.landed is False:
        return Verdict("on the ground", False, "armed" if status.armed else "in the air")
    if status.armed is None or status.landed is None:
        return _untold("on the ground", "motors" if status.armed is None else "being landed or not")
    return Verdict("on the ground", True, "disarmed")


def _level(seen: Observed, needs: Needs) -> Verdict:
    """At rest gravity says where up is: an attitude in another convention does not stand level."""
    if seen.state is None:
        return Verdict("level", False, "no state")
    if not _is_attitude(seen.state):
        return Verdict("level", False, "the attitude is no unit quaternion")
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
    holds = sideways <= needs.near_m and _LEAST_CLIMB_M <= away[2] <= HIGHEST_M
    words = f"the plan starts {sideways:.2f} m away sideways and {away[2]:.2f} m above"
    wanted = f"at most {needs.near_m:g} m sideways, {_LEAST_CLIMB_M:g} to {HIGHEST_M:g} m above"
    return Verdict("start", holds, f"{words}; {wanted}")


def climb(position: FloatArray, start: FloatArray, foot_m: float) -> FloatArray:
    """The way up to the height of the start and over to it, shape (3, 3): the first `foot_m` are left out,
    for the ground is there.
    """
    low = min(position[2] + foot_m, max(start[2], position[2]))
    return np.array([[position[0], position[1], low], [position[0], position[1], start[2]], start])


def _clearance(seen: Observed, needs: Needs) -> Verdict:
    """By distances to the map, not by the filter."""
    if seen.state is None:
        return Verdict("clearance", False, "no state")
    needed = needs.radius_m + needs.margin_m
    way = climb(seen.state.position, needs.start, _FOOT * needed)
    if not np.isfinite(way).all():
        return Verdict("clearance", False, "no finite position")
    room = math.inf
    for name, obstacles in needs.obstacles:
        least = float(path_clearance(way, obstacles, jobs=1).min())
        if not least >= needed:
            words = f"{least:.3f} m to {name} on the way up to the start, {needed:.3f} m needed"
            return Verdict(
                "clearance", False, words + _underfoot(way, seen.state.position[2], obstacles, least)
            )
        room = min(room, least - needs.radius_m)
    return Verdict("clearance", True, f"the way up to the start is {needed:.3f} m clear", room_m=room)


def _underfoot(way: FloatArray, ground_m: float, obstacles: Obstacles, least_m: float) -> str:
    """Where what blocks a way up is straight below its beginning: how far, and what helps."""
    probe = way[:1] + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, _PROBE_M]])
    here, above = (float(path_clearance(point[None], obstacles, jobs=1)[0]) for point in probe)
    if here > least_m + 1e-9 or above - here < 0.9 * _PROBE_M:
        return ""
    top_m = float(way[0, 2]) - here - ground_m
    return (
        f": that is below the way, which begins {way[0, 2] - ground_m:.3f} m up, and reaches "
        f"{top_m:.3f} m above where it stands; if it is the floor as the map has it, finer voxels help, "
        "or a start further up"
    )


def _fence(seen: Observed, needs: Needs) -> Verdict:
    if seen.state is None:
        return Verdict("fence", False, "no state")
    _, top, start = (tuple(row) for row in climb(seen.state.position, needs.start, 0.0).tolist())
    least = needs.fence.clearance(top, start) - needs.radius_m
    return Verdict("fence", least > 0, f"{least:.2f} m from the fence at the start")


def _landing(seen: Observed, needs: Needs) -> Verdict:
    """Straight down from the end of the plan, where it lands by itself and no filter sees it."""
    if seen.state is None:
        return Verdict("landing", False, "no state")
    down = needs.goal.copy()
    foot_m = _FOOT * (
        needs.radius_m + needs.margin_m
    )  # of the way up, too: the ground, as thick as the map has it
    down[2] = min(seen.state.position[2] + foot_m, needs.goal[2])
    way = np.array([needs.goal, down])
    if not np.isfinite(way).all():
        return Verdict("landing", False, "no finite position")
    for name, obstacles in needs.obstacles:
        least = float(path_clearance(way, obstacles, jobs=1).min())
        if not least >= needs.radius_m:
            words = f"{least:.3f} m to {name} on the way down from the goal, {needs.radius_m:.3f} m needed"
            return Verdict("landing", False, words)
    return Verdict("landing", True, f"the way down from the goal is {needs.radius_m:.3f} m clear")


def _plan(seen: Observed, needs: Needs) -> Verdict:
    return Verdict("plan", *needs.plan)


def _frame(seen: Observed, needs: Needs) -> Verdict:
    if needs.frame is None:
        return Verdict("frame", True, "watched from take-off on")
    return Verdict("frame", not needs.frame, needs.frame or "as moved by hand")


CHECKS: tuple[Callable[[Observed, Needs], Verdict], ...] = (
    *(
        _heartbeat,
        _parameters,
        _setpoints,
        _thrust,
        _position,
        _rate,
        _loop,
        _estimator,
        _battery,
        _on_ground,
    ),
    *(_level, _start, _clearance, _landing, _fence, _plan, _frame),
)


def verdicts(seen: Observed, needs: Needs) -> list[Verdict]:
    """All checks in order; each of them, whatever the others found."""
    return [check(seen, needs) for check in CHECKS]
