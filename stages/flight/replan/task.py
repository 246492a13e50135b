"""A new plan from the motion of a flying vehicle to what remains of its mission, proven before it is used."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from alula.schemas.artifacts.artifact import Artifact, encode_manifest
from alula.schemas.artifacts.kinds import PLAN
from alula.schemas.decimals import exact
from alula.schemas.decode import decode_json
from alula.schemas.errors import AlulaError, InfeasibleError
from alula.schemas.parameters.configs.plan import PlanConfig, Point
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.flight.links.own_safety import OwnSafety
from alula.stages.flight.loop.departures import departures_of
from alula.stages.flight.loop.failsafe_check import failsafe_faults
from alula.stages.planning.endpoints import nearest_free_point
from alula.stages.planning.fastest import MovingState
from alula.stages.planning.plan import plan
from alula.stages.planning.space import PlanSpace, plan_space, room_around

REST_M_S = 0.1  # a slower vehicle counts as standing still
_START_ROOM_M = 0.02  # that the start of a plan keeps beyond the distance, so that the curve can leave it
_START_ROOM = 0.25  # the same, at most this part of the distance within which a plan is joined
_ALIKE = (  # parameters of `plan` that a new plan takes from the one before the flight
    *("speed_m_s", "acceleration_m_s2", "jerk_m_s3", "snap_m_s4", "tilt_rad", "body_rate_rad_s"),
    *("smooth", "yaw", "interface", "beyond_map_m"),
)


class ReplanRequest(msgspec.Struct, frozen=True, kw_only=True):
    """What a new plan is asked for.

    Attributes:
        position: of the vehicle, world frame [m].
        velocity, acceleration: of the vehicle, world frame [m/s, m/s^2].
        via: via points that remain, in their order [m].
        home: position at take-off, world frame [m]; None if it is unknown.
    """

    number: int
    position: Point
    velocity: Point
    acceleration: Point
    via: tuple[Point, ...]
    home: Point | None = None


class ReplanAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """A new plan, or why there is none.

    Attributes:
        reason: why there is no plan, in words; empty if there is one.
        manifest: of the plan, as JSON.
        arrays: of the plan: type, shape and bytes of each, by name.
    """

    number: int
    reason: str
    planning_s: float = 0.0
    manifest: bytes = b""
    arrays: dict[str, tuple[str, tuple[int, ...], bytes]] = msgspec.field(default_factory=dict)

    @property
    def plan(self) -> Artifact:
        """The plan, of kind `alula/plan`."""
        arrays = {
            name: np.frombuffer(raw, dtype).reshape(shape)
            for name, (dtype, shape, raw) in self.arrays.items()
        }
        return Artifact(decode_json(self.manifest, PLAN.manifest), arrays)


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptMap:
    """A map that new plans keep from.

    Attributes:
        role: cover, scene or within, as of `plan`.
    """

    role: str
    keep_m: float
    sigma: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ReplanFacts:
    """What all new plans of a flight have in common.

    Attributes:
        parameters: of the plan before the flight, as its manifest records them: new plans are made alike.
        goal: end of all plans, world frame [m].
        fence: box that the vehicle must not leave: lower corner, upper corner [m].
        fence_room_m: distance that plans keep from its sides [m].
        lowest_m: height of the lowest point of the plan before the flight [m]; new plans lead no lower, since
            the map need not contain the ground.
        join_m: maximum distance of the vehicle from a plan at which it can be joined [m].
        foot_m: last part of a way home, to leave out the ground [m].
    """

    parameters: Mapping[str, Any]
    goal: Point
    maps: tuple[KeptMap, ...]
    fence: tuple[float, float, float, float, float, float]
    fence_room_m: float
    lowest_m: float
    join_m: float
    foot_m: float
    speed_m_s: float


class ReplanTask:
    """Makes new plans in the map of a flight, which is loaded once.

    The distance to keep is the filter's, so that a plan leads where the filter lets the vehicle be. A vehicle
    that was stopped at that distance may be a little nearer. Then the plan begins at the nearest free point.

    Args:
        artifacts: maps by role, see `KeptMap`.

    Raises:
        ArtifactError, InputError: a map is damaged, or the maps do not fit each other.
    """

    def __init__(self, facts: ReplanFacts, vehicle: Vehicle, artifacts: Mapping[str, Artifact]) -> None:
        self.facts, self.vehicle = facts, vehicle
        self._within = artifacts.get("within")
        spaces = [_space(each, artifacts[each.role]) for each in facts.maps]
        self._space = PlanSpace.of([part for space in spaces for part in space.maps], spaces[0].frame)
        self._obstacles = [
            (part.words, part.solids) for part in self._space.maps if part.role in ("cover", "scene")
        ]

    def plan(self, request: ReplanRequest, own: OwnSafety | None = None) -> Artifact:
        """Plan from a motion to the remaining via points and the goal.

        Args:
            own: failsafes and fence of the vehicle, which must be as harmless on this plan as on the first.

        Raises:
            AlulaError: there is no plan, with the reason.
        """
        config, motion = self._config(request)
        made = plan(
            config,
            within=self._within,
            space=self._space,
            vehicle=self.vehicle,
            motion=motion,
            jobs=1,
        )
        if own is not None and request.home is not None:
            self._require_harmless(made, own, np.array(request.home))
        return made

    def _config(self, request: ReplanRequest) -> tuple[PlanConfig, MovingState | None]:
        """The request as parameters of `plan`, and the motion at the start; None at rest."""
        facts, room = self.facts, self.facts.fence_room_m
        start, via, goal = request.position, request.via, facts.goal
        points = np.array([start, *via, goal])
        lower, upper = np.array(facts.fence[:3]) + room, np.array(facts.fence[3:]) - room
        lower[2] = max(lower[2], facts.lowest_m)
        bounds = (
            *np.minimum(lower, points.min(axis=0)).tolist(),
            *np.maximum(upper, points.max(axis=0)).tolist(),
        )
        config = PlanConfig(
            start=start,
            via=via,
            goal=goal,
            radius_m=self._space.keep_m,
            bounds=bounds,
            **{name: value for name, value in facts.parameters.items() if name in _ALIKE},
        )
        velocity = np.array(request.velocity)
        if np.linalg.norm(velocity) > REST_M_S:
            return config, MovingState(velocity, np.array(request.acceleration), np.zeros(3))
        return dataclasses.replace(config, start=self._free_start(config, start)), None

    def _free_start(self, config: PlanConfig, start: Point) -> Point:
        """The point itself, or the nearest from which a curve can leave."""
        space, facts = self._space, self.facts
        keep = space.keep_m + min(_START_ROOM_M, _START_ROOM * facts.join_m)
        if float(space.map.distance(np.array([start]), keep + 1)[0]) >= keep:
            return start
        lower, upper = room_around(config, space, config.points)
        found = nearest_free_point(space, lower, upper, start, keep)
        if found is None or math.dist(found, start) > facts.join_m:
            raise InfeasibleError("the vehicle is nearer to an obstacle than a plan may begin")
        return found

    def _require_harmless(self, made: Artifact, own: OwnSafety, home: Any) -> None:
        law, limit = self.vehicle.following.horizontal_lag, self.facts.speed_m_s
        faults, _ = failsafe_faults(
            own,
            departures_of(made, limit, law),
            home,
            self._obstacles,
            radius_m=self.vehicle.body.radius_m,
            foot_m=self.facts.foot_m,
        )
        if faults:
            raise InfeasibleError(f"the new plan is not safe with the vehicle's failsafes: {faults[0]}")


def answer_to(task: ReplanTask, request: ReplanRequest, own: OwnSafety | None, clock: Any) -> ReplanAnswer:
    """Plan, and pack the plan or the reason why there is none."""
    before = clock()
    try:
        made = task.plan(request, own)
    except (AlulaError, ArithmeticError, ValueError) as error:
        return ReplanAnswer(number=request.number, reason=str(error), planning_s=clock() - before)
    arrays = {
        name: (array.dtype.str, array.shape, np.ascontiguousarray(array).tobytes())
        for name, array in made.arrays.items()
    }
    return ReplanAnswer(
        number=request.number,
        reason="",
        planning_s=clock() - before,
        manifest=encode_manifest(made.manifest),
        arrays=arrays,
    )


def words_of(made: Artifact) -> str:
    """A plan in words, for messages."""
    summary = made.manifest.summary
    via = len(made.manifest.via_m)  # type: ignore[attr-defined]
    through = "" if not via else f" through {via} via point{'s'[: via > 1]}"
    keep = exact(float(made.manifest.radius_m))  # type: ignore[attr-defined]
    return (
        f"{summary['length_m']:.1f} m{through} in {summary['duration_s']:.1f} s, proven to keep {keep} m "
        "from the map"
    )


def _space(kept: KeptMap, artifact: Artifact) -> PlanSpace:
    """Obstacles of one map, of which `keep_m` is the whole distance to keep."""
    config = PlanConfig(radius_m=kept.keep_m, sigma=kept.sigma)
    by_role: dict[str, Any] = {kept.role: artifact}
    return plan_space(config, **by_role, jobs=1)


def remaining(via: Sequence[Sequence[float]], first: int) -> tuple[Point, ...]:
    """Via points from a number on, as a request holds them.

    Args:
        via: all, shape (V, 3) [m].
        first: number of the first that remains, from 0.
    """
    return tuple((float(x), float(y), float(z)) for x, y, z in via[first:])
