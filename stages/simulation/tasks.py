"""Missions of a scenario as tasks of the native simulation: starts, references, limits of time."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import UsageError
from alula.schemas.progress import Progress
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.clearance import segment_clearance
from alula.stages.planning.adherence import FINISHED_M, via_tolerance, waits
from alula.stages.planning.behind import Behind
from alula.stages.planning.inside import inside_of
from alula.stages.planning.joins import require_motion
from alula.stages.planning.mapped import BEYOND_KEY
from alula.stages.planning.plan_samples import curve_of
from alula.stages.planning.rest_to_rest import rest_to_rest
from alula.stages.simulation.pairs import Pairs, central_box, check_clear, sample_pairs
from alula.stages.simulation.piloted import pilots_starts
from alula.stages.simulation.planned import PlanMaps, margins, plan_config, planned_alone, plans_of
from alula.stages.world.obstacles import StaticWorld, require_clear

_EXTRA_TIME_S = 10.0
_TIME_FACTOR = 3.0  # time limit over the duration of the reference
_HOLD_S = 10.0  # time limit of hovering and of pilots
_STOP_FLOOR_M = {True: 1e-3, False: 0.05}  # by whether a point is moved by velocities
_WIDE = 1.25  # diagonal that the separation of pairs counts, at most, in those of the closed space
_PLAN_FLOOR_M = 0.01  # of a plan, which may end where it begins: a point is slow from there on

Clearance = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True)
class Missions:
    """Tasks of all trials, with what their judge needs.

    Attributes:
        missions: what makes the nominal command of each, as in its task.
        start, goal: shapes (N, 3), world frame [m]; the goal of a pilot is its start.
        curves: reference of each trial; None where it flies without one.
        plans: plan of each trial; None without one.
        counts: of sampled points and pairs, by the keys of the summary.
    """

    tasks: list[_core.Task]
    missions: list[_core.Mission]
    start: FloatArray
    goal: FloatArray
    curves: list[_core.ReferenceCurve | None]
    plans: list[Artifact | None]
    counts: dict[str, int]
    notes: list[str] = field(default_factory=list)


def missions_of(
    scenario: Scenario,
    world: StaticWorld,
    *,
    count: int,
    speed_m_s: float,
    max_speed_m_s: float,
    plan: Artifact | None,
    maps: PlanMaps,
    vehicle: Vehicle,
    behind: Behind | None,
    given: Pairs | None,
    geofence: _core.Geofence | None,
    psi: Clearance | None,
    jobs: int,
    progress: Progress | None = None,
) -> Missions:
    """Make the tasks of all trials.

    Args:
        speed_m_s: of the nominal command [m/s].
        max_speed_m_s: limit of velocity commands [m/s].
        behind: filters behind which plans will be flown.
        given: starts and goals of another run, or None.
        geofence: in which a pilot's start is safe; None without a pilot.
        psi: of the hulls at points, shape (N, 3) to (N,), where the vehicle is flown by velocities among
            them; pairs are then drawn around the hulls, by psi instead of the distance from them [m].

    Raises:
        ArtifactError: the given plan is no motion, see `require_motion`.
        UsageError: a start touches an obstacle, or there are no bounds.
        InfeasibleError: no clear pairs were found, or no plan for any of them.
    """
    mission, model = scenario.mission, vehicle.model
    around = world.centres if psi is None else world.vertices
    plans: list[Artifact | None]
    counts: dict[str, int]
    notes: list[str] = []
    if mission.kind == "pilot":
        assert geofence is not None
        return _piloted(scenario, world, count, geofence, jobs)
    if mission.kind == "hover":
        assert mission.start_m is not None
        return _hovering(scenario, world, np.array(mission.start_m), count, model, speed_m_s, jobs)
    if mission.kind == "plan":
        assert plan is not None
        require_motion(plan)
        _require_mapped(world, plan)
        curve = curve_of(plan)
        ends = curve.at(np.array([0.0, curve.duration_s]))[:, :3]
        pairs, counts = Pairs(ends[:1], ends[1:], 0, 0), {}
        if mission.start_m is not None:
            require_clear(world, np.array([mission.start_m]), "`$.mission.start_m`: the start", jobs)
        plans = [plan]
    else:
        pairs, counts = _pairs(scenario, world, around, count, given, psi, jobs)
        plans = [None] * len(pairs.start)
        if mission.planned:
            plans = plans_of(
                pairs,
                maps,
                vehicle=vehicle,
                config=plan_config(scenario, world, speed_m_s),
                margin_m=margins(world, pairs, mission.margin_m, jobs),
                behind=behind,
                jobs=jobs,
                progress=progress,
            )
            pairs, plans, found, notes = planned_alone(pairs, plans)
            counts |= found
            count = len(pairs.start) if notes else count
    made = _along(scenario, around, pairs, plans, count, speed_m_s, max_speed_m_s, counts, model)
    return dataclasses.replace(made, notes=notes)


def _require_mapped(world: StaticWorld, plan: Artifact) -> None:
    """Refuse a plan that leads out of the mapped box, beyond what counts as free around it."""
    if world.mapped is None:
        return
    if (words := world.mapped.refusal_of_plan(plan, world.radius_m, BEYOND_KEY)) is not None:
        raise UsageError(words)


def _along(
    scenario: Scenario,
    around: FloatArray,
    pairs: Pairs,
    plans: list[Artifact | None],
    count: int,
    speed_m_s: float,
    max_speed_m_s: float,
    counts: dict[str, int],
    model: str,
) -> Missions:
    """Tasks from starts to goals: along plans, through waypoints, or straight."""
    mission, rules = scenario.mission, scenario.rules
    by_velocity = scenario.vehicle.interface == "velocity"
    is_point = model == "single-integrator"
    gain = mission.controller.gain_per_s
    tasks, curves, missions = [], [], []
    many = len(pairs.start) == 1 and count > 1  # the same mission, with other noise
    pick = [0] * count if many else list(range(len(pairs.start)))
    for i in pick:
        start, goal, own = pairs.start[i], pairs.goal[i], plans[i]
        yaw = _heading(goal - start)
        curve: _core.ReferenceCurve | None = None
        if own is not None:
            curve = curve_of(own)
        elif mission.kind == "waypoints":
            curve = _through([start, *map(np.array, mission.waypoints_m)], speed_m_s)
        elif not is_point:
            curve = _core.ReferenceCurve(*rest_to_rest(start, goal, speed_m_s, yaw_rad=yaw))
        moves_by = _start_velocity(scenario, start)
        if own is None and _flies_straight(scenario, model):
            assert curve is not None
            flown = _core.Mission.to(goal.tolist(), gain_per_s=gain, speed_m_s=speed_m_s)
            allowed, curve = _TIME_FACTOR * curve.duration_s, None
        elif curve is None:
            flown = _core.Mission.to(goal.tolist(), gain_per_s=gain, speed_m_s=max_speed_m_s)
            allowed = 5 * _diagonal(scenario, around, pairs) / max_speed_m_s + _EXTRA_TIME_S
        else:
            clock = _clock(scenario, own)
            flown = _core.Mission.along(curve, gain_per_s=gain, speed_m_s=max_speed_m_s, clock=clock)
            slow = curve.duration_s + _EXTRA_TIME_S if by_velocity else _TIME_FACTOR * curve.duration_s
            allowed = slow if clock is None else _TIME_FACTOR * curve.duration_s + _EXTRA_TIME_S
            yaw = float(curve.at(np.array([0.0]))[0, 15])
        floor_m = FINISHED_M if own is not None and mission.waits else _STOP_FLOOR_M[is_point]
        if own is not None:
            floor_m = max(floor_m, _PLAN_FLOOR_M)
        stop = max(mission.stop_fraction * float(np.linalg.norm(goal - start)), floor_m)
        state = _at_rest(start, yaw if model == "quadrotor" else 0.0)  # a point has no attitude
        if mission.kind == "plan" and mission.start_m is not None:
            state[:3] = mission.start_m
        state[6:9] = moves_by
        tasks.append(
            _core.Task(
                state,
                flown,
                max_time_s=max(rules.max_time_s or allowed, rules.dt_s),
                stop_distance_m=stop,
                # An obstacle is drawn to meet the vehicle as it begins, which a straight flight goes on with.
                expected_velocity_m_s=moves_by.tolist() if curve is None and moves_by.any() else None,
            )
        )
        curves.append(curve)
        missions.append(flown)
    index = np.array(pick)
    return Missions(
        tasks,
        missions,
        pairs.start[index],
        pairs.goal[index],
        curves,
        [plans[i] for i in pick],
        counts,
    )


def _clock(scenario: Scenario, plan: Artifact | None) -> _core.PlanClockOptions | None:
    """How time along a plan waits for the vehicle; None where it runs with the clock."""
    radius_m = scenario.vehicle.radius_m
    if not scenario.mission.waits or plan is None or radius_m is None:
        return None
    return waits(plan, radius_m, via_tolerance(scenario.mission.via_tolerance_m, radius_m))


def _flies_straight(scenario: Scenario, model: str) -> bool:
    """Whether the nominal command is an acceleration straight to the goal, or back to where it hovers."""
    mission = scenario.mission
    is_own = mission.kind in ("goal", "hover") and not mission.planned
    return is_own and model == "double-integrator" and scenario.vehicle.interface == "acceleration"


def _start_velocity(scenario: Scenario, start: FloatArray) -> FloatArray:
    """Velocity of the first state of a flight to goals, shape (3,) [m/s]."""
    mission = scenario.mission
    if mission.start_velocity_m_s is not None:
        return np.array(mission.start_velocity_m_s)
    if mission.kind not in ("goal", "waypoints"):
        return np.zeros(3)
    way = np.array(mission.waypoints_m[0] if mission.kind == "waypoints" else mission.goal_m) - start
    course: FloatArray = 1 / math.sqrt(sum(way * way)) * way
    return mission.start_speed_m_s * course


def _diagonal(scenario: Scenario, around: FloatArray, pairs: Pairs) -> float:
    """Diagonal of the box of starts and goals [m]."""
    mission = scenario.mission
    if mission.start_m is not None and mission.goal_m is not None:
        return max(1.0, math.dist(mission.start_m, mission.goal_m))
    points = around if len(around) else np.concatenate([pairs.start, pairs.goal])
    lower, upper = central_box(points, mission.bounds_m, "obstacles")
    return float(np.linalg.norm(upper - lower))


def _pairs(
    scenario: Scenario,
    world: StaticWorld,
    around: FloatArray,
    count: int,
    given: Pairs | None,
    psi: Clearance | None,
    jobs: int,
) -> tuple[Pairs, dict[str, int]]:
    mission = scenario.mission
    keep = world.most_keep_m

    def distance(points: FloatArray) -> FloatArray:
        return world.clearance(points, points, keep + mission.margin_m + 1e-3, jobs)

    def is_clear(points: FloatArray, apart: FloatArray, margin_m: float) -> NDArray[np.bool_]:
        known = np.ones(len(points), np.bool_)
        if world.mapped is not None:
            known = world.mapped.beyond(points, keep + margin_m) == 0
        if psi is None:
            return np.asarray(known & (apart >= keep + margin_m))
        clear = (
            known
            & (apart >= world.keeps_m("hulls") + margin_m)
            & (world.inside(points) >= world.radius_m + margin_m)
        )
        if world.ellipsoids is not None and clear.any():
            needed, left = world.keeps_m("ellipsoids") + margin_m, np.ascontiguousarray(points[clear])
            clear[clear] = segment_clearance(left, left, world.ellipsoids, jobs, needed) >= needed
        return clear

    apart_of = distance if psi is None else psi

    def is_blocked(start: FloatArray, goal: FloatArray) -> NDArray[np.bool_]:
        return np.asarray(world.clearance(start, goal, keep, jobs) < keep)

    if mission.kind in ("goal", "waypoints"):
        assert mission.start_m is not None
        goal = mission.goal_m if mission.kind == "goal" else mission.waypoints_m[-1]
        assert goal is not None
        start = np.array([mission.start_m])
        require_clear(world, start, "`$.mission.start_m`: the start", jobs)
        if world.mapped is not None:
            named = [(f"`$.mission.{mission.kind}`: the goal", goal)]
            if (words := world.mapped.refusal(named, world.radius_m, BEYOND_KEY)) is not None:
                raise UsageError(words)
        return Pairs(start, np.array([goal]), 0, 0), {}
    if given is not None:
        check_clear(given, lambda points: is_clear(points, apart_of(points), 0.0))
        found = given
    else:
        lower, upper = central_box(around, mission.bounds_m, "obstacles")
        inside, diagonal = None, float(np.linalg.norm(upper - lower))
        if mission.bounds_m is None and world.mapped is not None and world.map is not None:
            room = world.mapped.room(keep + mission.margin_m)
            inside = inside_of(world.map, *room, keep + mission.margin_m, world.floor_m)
            diagonal = min(diagonal, _WIDE * inside.diagonal_m)

        found = sample_pairs(
            count,
            scenario.rules.seed,
            (lower, upper),
            mission.separation * diagonal,
            apart_of,
            lambda points, apart: is_clear(points, apart, mission.margin_m),
            is_blocked if mission.which == "blocked" else None,
            None if inside is None else inside.holds,
        )
    counts = {"blocked_pairs": int(is_blocked(found.start, found.goal).sum())}
    if given is None:
        counts |= {
            "sampled_points": found.sampled,
            "sampled_inside_obstacles": found.sampled_inside_hulls,
            "sampled_pairs": found.candidates,
        }
    return found, counts


def _hovering(
    scenario: Scenario,
    world: StaticWorld,
    start: FloatArray,
    count: int,
    model: str,
    speed_m_s: float,
    jobs: int,
) -> Missions:
    require_clear(world, start[None], "`$.mission.start_m`: the start", jobs)
    yaw = math.radians(scenario.mission.start_yaw_deg)
    gain = scenario.mission.controller.gain_per_s
    curve: _core.ReferenceCurve | None = None
    if _flies_straight(scenario, model):
        flown = _core.Mission.to(start.tolist(), gain_per_s=gain, speed_m_s=speed_m_s, hovers=True)
    else:
        rest = np.zeros((1, 4, 8))
        rest[0, :, 0] = [*start, yaw]
        curve = _core.ReferenceCurve(np.array([0.0, 1.0]), rest)
        flown = _core.Mission.along(curve, gain_per_s=gain, speed_m_s=speed_m_s, hovers=True)
    state = _at_rest(start, yaw)
    if scenario.mission.start_velocity_m_s is not None:
        state[6:9] = scenario.mission.start_velocity_m_s
    task = _core.Task(state, flown, max_time_s=scenario.rules.max_time_s or _HOLD_S)
    many = np.tile(start, (count, 1))
    return Missions([task] * count, [flown] * count, many, many, [curve] * count, [None] * count, {})


def _piloted(
    scenario: Scenario,
    world: StaticWorld,
    count: int,
    geofence: _core.Geofence,
    jobs: int,
) -> Missions:
    table = scenario.mission.pilot
    pilot = _core.Pilot(
        kind=table.kind,
        heading_rad=math.radians(table.heading_deg),
        tilt_rad=math.radians(table.tilt_deg),
        climb_m_s2=table.climb_m_s2,
        silent_after_s=table.silent_after_s,
    )
    allowed = scenario.rules.max_time_s or _HOLD_S
    states = pilots_starts(scenario, world, geofence, count, jobs)
    flown = _core.Mission.by_sticks()
    tasks = [_core.Task(state, flown, pilot=pilot, max_time_s=allowed) for state in states]
    start = states[:, :3]
    return Missions(tasks, [flown] * count, start, start, [None] * count, [None] * count, {})


def _at_rest(position: FloatArray, yaw_rad: float) -> FloatArray:
    state = np.zeros(12)
    state[:3], state[5] = position, math.tan(yaw_rad / 4)
    n = state[5] ** 2
    if n > 1:
        state[5] = -state[5] / n
    return state


def _through(points: list[FloatArray], speed_m_s: float) -> _core.ReferenceCurve:
    """Straight legs from rest to rest through points."""
    times, pieces = [np.zeros(1)], []
    yaw = _heading(points[-1] - points[0])
    for a, b in pairwise(points):
        time, coefficient = rest_to_rest(a, b, speed_m_s, yaw_rad=yaw)
        pieces.append(coefficient)
        times.append(times[-1][-1] + np.asarray(time)[1:])
    return _core.ReferenceCurve(np.concatenate(times), np.concatenate(pieces))


def _heading(direction: FloatArray) -> float:
    return math.atan2(direction[1], direction[0])
