"""Whether a flown path followed its plan: its waypoints and gates, and the tube about it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import PlanPass
from alula.schemas.decimals import at_least, at_most, exact
from alula.schemas.errors import UsageError
from alula.schemas.log.run import Outcome, PassResult, PlanResult
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.clearance import segment_clearance
from alula.stages.planning.passes import laps_of, name_of
from alula.stages.planning.passing import passed_of
from alula.stages.planning.plan_samples import curve_of

LEAST_VIA_TOLERANCE_M = 0.1
# A flight has finished its plan within this distance of the end, when it is slower than this; then it lands.
FINISHED_M, FINISHED_M_S = 0.2, 0.3
_SPACING_M = 0.01  # of the samples of plan and path
_MOST_SAMPLES = 20_000
_ALIGNING_S, _ALIGNING_STEP_S = 2.0, 0.005  # before a gate, where its clock looks for a place to wait
_CAP_M = 5.0  # the tube is at most this wide


def via_tolerance(given_m: float | None, radius_m: float) -> float:
    """Distance within which a via point counts as passed [m].

    Args:
        given_m: that of the user, if any.
        radius_m: of the vehicle [m].
    """
    return max(radius_m, LEAST_VIA_TOLERANCE_M) if given_m is None else given_m


class PlanJudge:
    """Compares flown paths with a plan.

    The tube of a plan is the union of balls about its points. The radius of a ball is the distance of its
    centre to the map less the vehicle's radius, at most 5 m, where the vehicle is proven clear of the map; it
    is at least the distance r that the plan keeps. A filter that keeps psi >= r, which beside the corner of a
    box is r only at a distance of sqrt(3) r, leads the vehicle at most (sqrt(3) - 1) r aside. A plan that is
    not proven has no tube: its filter leads the vehicle aside where the plan is blocked.

    Args:
        obstacles: map in the plan's frame.
        via_tolerance_m: distance within which a via point counts as passed [m].

    Attributes:
        is_proven: the plan says that it is proven to keep its distance.
        via: where the plan passes waypoints and gates, shape (V, 3) [m].
        passes: waypoints and gates of all laps, in their order.
        allowed_m: distance within which each of them counts as passed [m].
    """

    def __init__(
        self,
        plan: Artifact,
        obstacles: Sequence[_core.PolytopeSet | _core.EllipsoidSet],
        radius_m: float,
        via_tolerance_m: float,
        jobs: int = 0,
    ) -> None:
        self.passes: Sequence[PlanPass] = plan.manifest.passes  # type: ignore[attr-defined]
        self.via = np.asarray(plan.manifest.via_m, np.float64).reshape(-1, 3)  # type: ignore[attr-defined]
        self.allowed_m = [allowed_m(each, radius_m, via_tolerance_m) for each in self.passes]
        self.tolerance_m = via_tolerance_m
        curve = curve_of(plan)
        speed = float(plan.manifest.speed_m_s)  # type: ignore[attr-defined]
        count = min(_MOST_SAMPLES, 2 + math.ceil(curve.duration_s * speed / _SPACING_M))
        self.centre = np.ascontiguousarray(curve.at(np.linspace(0, curve.duration_s, count))[:, :3])
        self.waits = waits(plan, radius_m, via_tolerance_m)
        cap = radius_m + _CAP_M
        distance = [segment_clearance(self.centre, self.centre, each, jobs, cap) for each in obstacles]
        self.distances_m = [float(each.min()) for each in distance]  # of the plan, or the cap
        nearest = np.min([np.full(count, cap), *distance], axis=0)
        self.width = np.maximum(nearest - radius_m, plan.manifest.radius_m)  # type: ignore[attr-defined]
        self.is_proven = bool(plan.manifest.is_proven)  # type: ignore[attr-defined]
        if not self.is_proven:
            self.width[:] = math.inf
        gaps = np.linalg.norm(np.diff(self.centre, axis=0), axis=1)
        self.gap_m = float(gaps.max(initial=0.0))

    def result(
        self,
        path: FloatArray,
        time_s: FloatArray | None = None,
        later: Sequence[tuple[int, PlanJudge]] = (),
    ) -> PlanResult:
        """Compare a path with the plan.

        Waypoints and gates are passed in their order, see `passed_of`.

        Args:
            path: shape (T, 3), T >= 1, joined by chords, world frame [m].
            time_s: of its points, shape (T,) [s]; without it the time at waypoints is not judged.
            later: plans through the rest of the via points that replace this one, each from a point of the
                path on, in their order.
        """
        found, closest = passed_of(self.passes, self.allowed_m, path, time_s)
        return PlanResult(
            via_tolerance_m=self.tolerance_m,
            closest_m=closest,
            missed=[number for number, one in enumerate(found, 1) if not one.passed],
            outside_m=max(
                judge._outside(path[first:end])
                for (first, judge), end in zip(
                    [(0, self), *later], [*(first for first, _ in later), len(path)], strict=True
                )
            ),
            passes=found,
        )

    def _outside(self, path: FloatArray) -> float:
        """Largest distance of a point of the path from the tube, from below; 0 within it [m]."""
        from scipy.spatial import cKDTree

        if len(path) == 0:
            return 0.0
        length = np.concatenate([[0.0], np.linalg.norm(np.diff(path, axis=0), axis=1).cumsum()])
        step = max(_SPACING_M, length[-1] / _MOST_SAMPLES)
        points = path[
            np.unique(np.searchsorted(length, np.arange(0, length[-1] + step, step)).clip(0, len(path) - 1))
        ]
        apart, at = cKDTree(self.centre).query(points)
        doubtful = points[apart - self.width[at] > self.gap_m]  # others are in their nearest ball
        worst = 0.0
        for point in doubtful:
            outside = (np.linalg.norm(self.centre - point, axis=1) - self.width).min()
            worst = max(worst, float(outside) - self.gap_m)
        return worst


def waits(plan: Artifact, radius_m: float, via_tolerance_m: float) -> _core.PlanClockOptions:
    """How the time along a plan waits at waypoints and gates for a vehicle that is not there.

    Of a gate it waits before the plane, for a vehicle that is farther from the plan than the opening leaves
    room about the plan, but not for one within a tenth of a metre: aligned, it then crosses the plane.

    Args:
        via_tolerance_m: distance within which a via point without its own tolerance counts as passed [m].
    """
    curve = curve_of(plan)
    at_s: list[float] = []
    own: list[float] = []
    for each in plan.manifest.passes:  # type: ignore[attr-defined]
        room, when = allowed_m(each, radius_m, via_tolerance_m), each.time_s
        if each.kind == "gate":
            at = curve.at(np.array([each.time_s]))[0, :3]
            room = max(room - float(np.linalg.norm(at - each.point_m)), LEAST_VIA_TOLERANCE_M)
            times = each.time_s - np.arange(0.0, min(_ALIGNING_S, each.time_s), _ALIGNING_STEP_S)
            height = (curve.at(times)[:, :3] - each.point_m) @ np.array(each.normal)
            when = float(times[int(np.argmax(height <= -room))]) if (height <= -room).any() else when
        at_s.append(max([when, *at_s[-1:]]))
        own.append(room)
    return _core.PlanClockOptions(via_s=at_s, own_via_m=own)


def allowed_m(each: PlanPass, radius_m: float, via_tolerance_m: float) -> float:
    """Distance from the plan's point within which a vehicle passes it [m].

    Args:
        via_tolerance_m: of waypoints without their own [m].
    """
    if each.kind == "gate":
        return each.radius_m - radius_m
    return via_tolerance_m if each.tolerance_m is None else each.tolerance_m


def require_fit(plan: Artifact, vehicle: Vehicle) -> None:
    """Refuse a plan through a gate that the vehicle does not fit through.

    Raises:
        UsageError: names the first such gate.
    """
    passes: Sequence[PlanPass] = plan.manifest.passes  # type: ignore[attr-defined]
    for each in passes:
        if each.kind == "gate" and each.radius_m <= vehicle.body.radius_m:
            name, own = name_of(each, laps_of(passes)), exact(vehicle.body.radius_m)
            raise UsageError(
                f"{name} has a radius of {exact(each.radius_m)} m, and {vehicle.name} one of {own} m: "
                "it does not fit through"
            )


def require_room(
    plan: PlanJudge,
    keeps_m: Sequence[float | None],
    filter_name: str,
    *,
    allow_tight: bool,
    insist: str = "--allow-tight",
) -> list[str]:
    """Refuse a plan that is nearer to a map than the filter lets the vehicle be.

    Args:
        keeps_m: distance that the filter keeps from each map [m]; None from one that it does not see.
        filter_name: its name; `none` keeps nothing.
        allow_tight: warn instead.
        insist: what sets this on the command line, for the message.

    Returns:
        Notes for the summary.

    Raises:
        UsageError: the plan is too near, with the option of `plan` that mends it.
    """
    if not plan.is_proven:
        return ["the plan is not proven: only the filter keeps the vehicle from the map"]
    if filter_name == "none":
        return []
    notes = []
    for distance, keep in zip(plan.distances_m, keeps_m, strict=True):
        if keep is None or distance >= keep - 1e-9:
            continue
        words = (
            f"the plan is {at_least(distance)} m from the map, and {filter_name} keeps {at_most(keep)} m: it "
            "will hold the vehicle back"
        )
        if not allow_tight:
            raise UsageError(f"{words}; plan with --radius {at_most(keep)}, or insist with {insist}")
        notes.append(words)
    return notes


def outcome_of_plan(outcome: Outcome, result: PlanResult | None) -> Outcome:
    """Outcome of a flight along a plan: one that reached the goal may still have missed what came before."""
    if outcome != "reached" or result is None:
        return outcome
    if result.missed:
        return "missed-via"
    return "off-plan" if result.outside_m > 0 else outcome


def complaint(result: PlanResult | None) -> str | None:
    """What a flight missed of its plan, in words; None if nothing."""
    if result is None:
        return None
    if result.missed:
        first = result.missed[0] - 1
        if first < len(result.passes):
            return _words(result.passes[first], result.via_tolerance_m)
        return (
            f"via point {first + 1} was missed: the closest approach was {result.closest_m[first]:.3g} m, "
            f"{result.via_tolerance_m:.3g} m are allowed (--via-tolerance)"
        )
    if result.outside_m > 0:
        return f"the flight left the tube about the plan, by {result.outside_m:.3g} m"
    return None


def _words(missed: PassResult, via_tolerance_m: float) -> str:
    """How a waypoint or gate was missed."""
    begin = f"{missed.name} was missed"
    if not missed.name.startswith("gate"):
        if missed.held_s is not None and missed.off_m is not None and missed.off_m <= missed.allowed_m:
            return f"{begin}: the vehicle left it after {missed.held_s:.3g} s"
        option = " (--via-tolerance)" if missed.allowed_m == via_tolerance_m else ""
        off = f"the closest approach was {missed.off_m:.3g} m"
        return f"{begin}: {off}, {missed.allowed_m:.3g} m are allowed{option}"
    if missed.backwards:
        return f"{begin}: it was flown through against its direction"
    if missed.off_m is None:
        return f"{begin}: its plane was not crossed in its direction"
    if missed.allowed_m <= 0:
        return f"{begin}: the vehicle does not fit through it"
    return (
        f"{begin}: the vehicle crossed its plane {missed.off_m:.3g} m from the centre, "
        f"{missed.off_m - missed.allowed_m:.3g} m more than fits through"
    )
