"""What a plan passes on its way: waypoints and gates, lap by lap, and where the curve goes through them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import PlanPass
from alula.schemas.decimals import at_least, exact
from alula.schemas.errors import InfeasibleError, UsageError
from alula.schemas.parameters.configs.plan import PlanConfig, Point
from alula.schemas.scenarios.mission import Mission, PassTable, complaint
from alula.stages.planning.exact import THROUGH_M
from alula.stages.planning.opening import Opening
from alula.stages.planning.space import PlanSpace

_SHARE = 0.5  # of the room of a gate or a tolerance, that a curve may use where the margin would take more
_FRACTIONS = (0.0, 0.35, 0.7, 0.95)  # of the disc, where a path may go through a gate
_ANGLES = 16
_LEAST_REACH = 1.1  # of that part, in `THROUGH_M`
_REACHES = (1.0, 0.5, 0.25, 0.1, 0.03)  # of a straight part before and behind a gate, in distances to keep


@dataclass(frozen=True, slots=True)
class Passage:
    """One waypoint or gate of one lap.

    Attributes:
        number: in its lap, from 1.
        lap: from 1.
        opening: where the curve may pass; None for exactly at the waypoint.
    """

    table: PassTable
    number: int
    lap: int
    laps: int
    opening: Opening | None

    @property
    def point(self) -> Point:
        """Waypoint, or centre of the gate [m]."""
        point = self.table.point_m if self.table.gate_m is None else self.table.gate_m
        assert point is not None
        return point

    @property
    def is_gate(self) -> bool:
        """Whether it is a gate."""
        return self.table.gate_m is not None

    @property
    def name(self) -> str:
        """For messages."""
        return _name(self.is_gate, self.number, self.lap, self.laps)


def mission_of(config: PlanConfig) -> Mission:
    """The mission that options describe.

    Args:
        config: with via points or gates, loops and a heading.

    Raises:
        UsageError: it has both, or nothing to fly again.
    """
    if config.via and config.gate:
        raise UsageError("give --via or --gate, not both: a --mission file has both in their order")
    passes = tuple(PassTable(point_m=point) for point in config.via) or tuple(
        PassTable(gate_m=each[:3], normal=each[3:6], radius_m=each[6]) for each in config.gate
    )
    mission = Mission(loops=config.loops, passes=passes, **config.heading)
    if wrong := complaint(mission):
        raise UsageError(wrong.replace("`$.loops`", "--loops").replace("; add [[pass]]", ""))
    return mission


def passages_of(mission: Mission, config: PlanConfig) -> list[Passage]:
    """All passes of all laps in their order.

    The disc of a gate of radius R is shrunk by the radius r of the vehicle, and by the margin for errors of
    tracking, where that leaves half of R - r at least. The ball about a waypoint with its own tolerance is
    smaller than that in the same manner.

    Args:
        config: complete, see `resolve_plan`; of a whole distance without a margin all is the vehicle's.

    Raises:
        InfeasibleError: the vehicle does not fit through a gate.
        UsageError: a waypoint or a centre is outside of the given box, or is the point before it.
    """
    whole = msgspec.structs.replace(mission, start_m=config.start, goal_m=config.goal)
    if wrong := complaint(whole):
        raise UsageError(wrong)
    margin_m = config.margin_m or 0.0
    body_m = config.keep_m - margin_m
    found: list[Passage] = []
    for lap in range(1, mission.loops + 1):
        for number, each in enumerate(mission.passes, 1):
            room = math.inf
            if each.gate_m is not None:
                assert each.normal is not None
                assert each.radius_m is not None
                room = each.radius_m - body_m
                if room <= 0:
                    raise InfeasibleError(
                        f"gate {number} has a radius of {exact(each.radius_m)} m, and the vehicle one of "
                        f"{exact(body_m)} m: it does not fit through"
                    )
                normal = np.array(each.normal) / math.hypot(*each.normal)
                opening = Opening(np.array(each.gate_m), normal, max(room - margin_m, _SHARE * room))
            elif each.tolerance_m is not None and not each.hold_s:
                room = each.tolerance_m
                size = max(room - margin_m, _SHARE * room)
                opening = Opening(np.array(each.point_m), np.zeros(3), size)
            else:
                opening = None
            found.append(Passage(each, number, lap, mission.loops, opening))
    if config.bounds is not None:
        lower, upper = config.bounds[:3], config.bounds[3:]
        for one in found:
            if not all(a <= x <= b for a, x, b in zip(lower, one.point, upper, strict=True)):
                raise UsageError(f"{one.name}, ({exact(one.point)}), is outside --bounds")
    return found


def through(passage: Passage, space: PlanSpace, radius_m: float) -> tuple[FloatArray, float]:
    """Point of a gate's disc to go through, and how far before and behind it the way is free.

    It is the centre where that keeps the distance, else the freest of some points of the disc.

    Args:
        passage: a gate.

    Returns:
        The point, shape (3,) [m], and half the length of a straight segment about it that keeps the distance.

    Raises:
        InfeasibleError: no point of the disc has such a segment.
    """
    disc = passage.opening
    assert disc is not None
    side = np.eye(3)[int(np.abs(disc.normal).argmin())]
    u = np.cross(disc.normal, side)
    u /= np.linalg.norm(u)
    w = np.cross(disc.normal, u)
    angle = 2 * np.pi * np.arange(_ANGLES) / _ANGLES
    ring = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * w
    points = np.concatenate(
        [disc.centre[None], *(disc.centre + f * disc.radius_m * ring for f in _FRACTIONS[1:])]
    )
    enough = 2 * radius_m
    own = np.minimum(space.map.distance(np.ascontiguousarray(points), enough), enough)
    order = np.argsort(-own, kind="stable")
    if own[0] >= radius_m:
        order = np.concatenate([[0], order])
    for half_m in (max(reach * radius_m, _LEAST_REACH * THROUGH_M) for reach in _REACHES):
        half = half_m * disc.normal
        for i in order[own[order] >= radius_m]:
            ends = np.stack([points[i] - half, points[i] + half])
            if space.map.segment_distance(ends[:1], ends[1:], enough)[0] >= radius_m:
                return points[i], half_m
    best = int(order[0])
    where = f"{passage.name} at ({exact(passage.point)}) is not free"
    if own[best] >= radius_m:
        raise InfeasibleError(f"{where}: there is no way straight through it that keeps {radius_m:.6g} m")
    what = space.nearest_part(tuple(points[best].tolist()))
    freest = f"the freest is {at_least(max(float(own[best]), 0.0))} m from {what}"
    raise InfeasibleError(f"{where}: no point of its opening keeps {radius_m:.6g} m; {freest}")


def name_of(each: PlanPass, laps: int) -> str:
    """Name of a pass of a plan, for messages."""
    return _name(each.kind == "gate", each.number, each.lap, laps)


def _name(is_gate: bool, number: int, lap: int, laps: int) -> str:
    kind = "gate" if is_gate else "via point"
    return f"{kind} {number}{f' of lap {lap}' if laps > 1 else ''}"


def laps_of(passes: Sequence[PlanPass]) -> int:
    """Number of laps."""
    return max((each.lap for each in passes), default=1)
