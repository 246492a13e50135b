"""Whether a flown path followed its plan: its via points, and the tube about it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifact import Artifact
from alula.schemas.decimals import at_least, at_most
from alula.schemas.errors import UsageError
from alula.schemas.run import Outcome, PlanResult
from alula.stages.clearance import segment_clearance
from alula.stages.planning.plan_samples import curve_of

LEAST_VIA_TOLERANCE_M = 0.1
# A flight has finished its plan within this distance of the end, when it is slower than this; then it lands.
FINISHED_M, FINISHED_M_S = 0.2, 0.3
_SPACING_M = 0.01  # of the samples of plan and path
_MOST_SAMPLES = 20_000
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
        plan: an `alula/plan`.
        obstacles: map in the plan's frame.
        radius_m: of the vehicle [m].
        via_tolerance_m: distance within which a via point counts as passed [m].
        jobs: threads, 0 for all processors.

    Attributes:
        is_proven: the plan says that it is proven to keep its distance.
        via: via points, shape (V, 3) [m], and `via_s`, the times at which the plan passes them [s].
    """

    def __init__(
        self,
        plan: Artifact,
        obstacles: Sequence[_core.PolytopeSet | _core.EllipsoidSet],
        radius_m: float,
        via_tolerance_m: float,
        jobs: int = 0,
    ) -> None:
        self.via = np.asarray(plan.manifest.via_m, np.float64).reshape(-1, 3)  # type: ignore[attr-defined]
        self.tolerance_m = via_tolerance_m
        curve = curve_of(plan)
        speed = float(plan.manifest.speed_m_s)  # type: ignore[attr-defined]
        count = min(_MOST_SAMPLES, 2 + math.ceil(curve.duration_s * speed / _SPACING_M))
        self.centre = np.ascontiguousarray(curve.at(np.linspace(0, curve.duration_s, count))[:, :3])
        self.via_s = via_times(plan)
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

    def result(self, path: FloatArray, later: Sequence[tuple[int, PlanJudge]] = ()) -> PlanResult:
        """Compare a path with the plan.

        Via points are passed in their order: each is looked for where the one before was passed, or later.

        Args:
            path: shape (T, 3), T >= 1, joined by chords, world frame [m].
            later: plans through the rest of the via points that replace this one, each from a point of the
                path on, in their order.
        """
        closest: list[float] = []
        missed: list[int] = []
        begin, end = path[: max(len(path) - 1, 1)], path[min(1, len(path) - 1) :]
        first = 0
        for number, point in enumerate(self.via, 1):
            distance = _distances(begin[first:], end[first:], point)
            closest.append(float(distance.min()))
            near = np.flatnonzero(distance <= self.tolerance_m)
            if len(near):
                first += int(near[0])
            else:
                missed.append(number)
        return PlanResult(
            via_tolerance_m=self.tolerance_m,
            closest_m=closest,
            missed=missed,
            outside_m=max(
                judge._outside(path[first:end])
                for (first, judge), end in zip(
                    [(0, self), *later], [*(first for first, _ in later), len(path)], strict=True
                )
            ),
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


def via_times(plan: Artifact) -> list[float]:
    """Times at which a plan passes its via points, which are ends of its pieces, in their order [s].

    Args:
        plan: an `alula/plan`.
    """
    points = np.asarray(plan.manifest.via_m, np.float64).reshape(-1, 3)  # type: ignore[attr-defined]
    ends_s = np.asarray(plan["time"], np.float64)
    ends = curve_of(plan).at(ends_s)[:, :3]
    found: list[float] = []
    first = 0
    for point in points:
        first += int(np.linalg.norm(ends[first:] - point, axis=1).argmin())
        found.append(float(ends_s[first]))
    return found


def _distances(begin: FloatArray, end: FloatArray, point: FloatArray) -> FloatArray:
    """Distances of chords, shape (S, 3), to a point; shape (S,)."""
    chord, to = end - begin, point - begin
    length2 = np.einsum("ij,ij->i", chord, chord)
    along = np.einsum("ij,ij->i", to, chord) / np.where(length2 > 0, length2, 1)
    apart: FloatArray = np.linalg.norm(to - np.clip(along, 0, 1)[:, None] * chord, axis=1)
    return apart


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
        plan: judge with the maps.
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
    """Outcome of a flight along a plan: one that reached the goal may still have missed what came before.

    Args:
        outcome: end of the flight.
        result: comparison with its plan, if it had one.
    """
    if outcome != "reached" or result is None:
        return outcome
    if result.missed:
        return "missed-via"
    return "off-plan" if result.outside_m > 0 else outcome


def complaint(result: PlanResult | None) -> str | None:
    """What a flight missed of its plan, in words; None if nothing.

    Args:
        result: comparison with the plan, if there was one.
    """
    if result is None:
        return None
    if result.missed:
        first = result.missed[0]
        return (
            f"via point {first} was missed: the closest approach was {result.closest_m[first - 1]:.3g} m, "
            f"{result.via_tolerance_m:.3g} m are allowed (--via-tolerance)"
        )
    if result.outside_m > 0:
        return f"the flight left the tube about the plan, by {result.outside_m:.3g} m"
    return None
