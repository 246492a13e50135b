"""Verdict on a flight from its true path: clearance to each part of the world, outcome, filters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.log.run import FilterCounts, Outcome, TrialResult
from alula.stages.clearance import is_collision, sphere_clearance
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.planning.adherence import PlanJudge, outcome_of_plan
from alula.stages.simulation.encounters import encounter_figures, obstacle_results
from alula.stages.simulation.piloted import fence_result
from alula.stages.verdict import STATIC, clearance_of, minimum
from alula.stages.world.obstacles import StaticWorld

REFUSED, STALE, LIMITED = 1, 2, 4  # bits of `mark` of a native log
CAPPED, INFEASIBLE, CERTIFIED, CERTIFIED_MOVING = 1, 2, 4, 8  # bits of `flags`
_ENDS: dict[str, Outcome] = {
    **{name: name for name in ("reached", "stuck", "timeout", "refused", "passed")},
    "ended": "held",
}


@dataclass(frozen=True, slots=True)
class WorldJudge:
    """Judges flights among static and moving obstacles; nothing that a filter saw enters.

    The path consists of the plant's steps, joined by chords. A chord is at most a dt^2 / 8 off the true path.
    Along it the distance to static obstacles is exact. Encounters with moving obstacles come from the
    simulation, which measures them at every step of the plant, in continuous time.

    Attributes:
        filters: names, in their order; the guide of the controller before them.
        guides: number of guides among them, which count neither as interventions nor as the last filter.
        has_goal: whether the mission leads from a start to a goal.
        obstacle_radii_m: of the moving obstacles [m].
        seen_by: name of the filter by whose answers encounters are measured; None without one.
        via_tolerance_m: distance within which a via point counts as passed [m].
        dt_s: duration of a tick [s].
        by_ticks: whether logs have complete rows of ticks, with which references and ellipsoids are compared.
        is_point: whether the vehicle is moved by velocities, whose first one is that of the first command.
    """

    world: StaticWorld
    filters: list[str]
    guides: int
    has_goal: bool
    obstacle_radii_m: list[float]
    seen_by: str | None
    via_tolerance_m: float
    dt_s: float
    by_ticks: bool
    is_point: bool
    jobs: int

    def of_plan(self, plan: Artifact | None) -> PlanJudge | None:
        """Make the judge of flights along a plan.

        Args:
            plan: in the frame of the world; None without one.
        """
        if plan is None:
            return None
        sets = [each for each in (self.world.polytopes, self.world.ellipsoids) if each is not None]
        return PlanJudge(plan, sets, self.world.radius_m, self.via_tolerance_m, self.jobs)

    def trial(
        self,
        index: int,
        start: FloatArray,
        goal: FloatArray,
        curve: _core.ReferenceCurve | None,
        flown: dict[str, Any],
        along: PlanJudge | None,
    ) -> TrialResult:
        """Judge one flight.

        Args:
            start: shape (3,), world frame [m].
            goal: shape (3,), world frame [m].
            flown: native log of the flight; with its path where there are static obstacles or a plan, and
                with complete rows of its ticks where there is a reference.
        """
        path, steps = _finite(flown["path"]), flown["ticks"]
        hulls, ellipsoids = (
            None if each is None else sphere_clearance(path, each, self.world.radius_m, jobs=self.jobs)
            for each in (self.world.polytopes, self.world.ellipsoids)
        )
        fence = None
        if len(self.world.faces):
            fence = float(self.world.inside(path).min()) - self.world.radius_m
        met = obstacle_results(flown, [radius + self.world.radius_m for radius in self.obstacle_radii_m])
        moving = minimum(
            one.closest_m - radius - self.world.radius_m
            for one, radius in zip(met, self.obstacle_radii_m, strict=True)
        )
        times_s = np.linspace(0, steps * self.dt_s, len(flown["path"]))[: len(path)]
        followed = None if along is None else along.result(path, times_s)
        motion = self._motion(flown, path)
        length = motion["path_length_m"]
        each = [self._filter(i, name, flown) for i, name in enumerate(self.filters)]
        last = each[-1] if len(each) > self.guides else None
        status, flags, mark = (
            flown["status"][:, self.guides :],
            flown["flags"][:, self.guides :],
            flown["mark"],
        )
        is_infeasible = (flags & INFEASIBLE > 0) | (status == FilterStatus.REFUSED)
        duration = steps * self.dt_s
        times = (
            flown["plan_s"] if len(flown["plan_s"]) else np.arange(steps + 1, dtype=np.float64) * self.dt_s
        )
        reference = None if curve is None else curve.at(times)
        return TrialResult(
            index=index,
            start_m=start.tolist(),
            goal_m=goal.tolist(),
            outcome=outcome_of_plan(_ENDS[flown["end"]], followed),
            collision=is_collision(hulls, ellipsoids, fence) or any(one.collision for one in met),
            steps=steps,
            duration_s=duration,
            straight_length_m=float(np.linalg.norm(goal - start)),
            map_clearance_m=hulls,
            scene_clearance_m=ellipsoids,
            filtered_steps=int((status != FilterStatus.OK).any(axis=1).sum()),
            shortened_steps=int((status == FilterStatus.SHORTENED).sum()),
            infeasible_steps=int(is_infeasible.any(axis=1).sum()),
            fallback_steps=int((status == FilterStatus.RECOVERING).any(axis=1).sum()),
            reference_speed_m_s=(
                None if reference is None else _most(np.linalg.norm(reference[:, 3:6], axis=1))
            ),
            **motion,
            mean_speed_m_s=length / duration if duration else 0.0,
            max_tracking_error_m=(
                None
                if reference is None
                else _most(np.linalg.norm(flown["state"][:, :3] - reference[:, :3], axis=1))
            ),
            peak_realisation_error_m_s2=_peak(flown["a_error"]) if self.by_ticks else None,
            min_gamma=self._gamma(_finite(flown["state"][:, :3])) if self.by_ticks else None,
            min_margin=None if last is None else last.min_margin,
            backup_steps=None if last is None else last.backup,
            certified_steps=None if last is None else last.certified,
            capped_steps=int((flags & CAPPED > 0).any(axis=1).sum()),
            line_clearance_m=self._line_clearance(np.array([start, goal])),
            saturated_steps=int((mark & LIMITED > 0).sum()),
            obstacles=met or None,
            refused_steps=int((mark & REFUSED > 0).sum()),
            fence=fence_result(flown),
            plan=followed,
            fence_clearance_m=fence,
            moving_clearance_m=moving,
            stale_steps=int((mark & STALE > 0).sum()),
            certified_moving_steps=None if last is None else last.certified_moving,
            filters=each or None,
            **encounter_figures(flown, self.seen_by),
        )

    def _motion(self, flown: dict[str, Any], path: FloatArray) -> dict[str, Any]:
        """Length of the path and extremes of its derivatives; a point begins with its first command."""
        names = ("path_length_m", "max_speed_m_s", "max_acceleration_m_s2", "mean_jerk_m_s3", "max_jerk_m_s3")
        if not self.is_point:
            return {name: flown[name] for name in names}
        velocity = flown["state"][1:, 6:9]
        jerk = np.linalg.norm(np.diff(velocity, n=2, axis=0), axis=1) / self.dt_s**2
        jerk = jerk[np.isfinite(jerk)]
        acceleration = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / self.dt_s
        length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
        speed, mean_jerk = np.linalg.norm(velocity, axis=1), float(jerk.mean()) if len(jerk) else 0.0
        found = (length, _most(speed), _most(acceleration), mean_jerk, _most(jerk))
        return dict(zip(names, found, strict=True))

    def _gamma(self, points: FloatArray) -> float | None:
        """Minimum of r' A r - 1 over the grown ellipsoids; None without any."""
        gamma = _core.least_gamma(self.world.index, np.ascontiguousarray(points))
        return gamma if math.isfinite(gamma) else None

    def _line_clearance(self, ends: FloatArray) -> float | None:
        """Clearance of the straight line of a mission to hulls and ellipsoids [m]."""
        sets = [each for each in (self.world.polytopes, self.world.ellipsoids) if each is not None]
        if not self.has_goal:
            return None
        return minimum(sphere_clearance(ends, each, self.world.radius_m, jobs=self.jobs) for each in sets)

    def _filter(self, i: int, name: str, flown: dict[str, Any]) -> FilterCounts:
        status, flags, margin = flown["status"][:, i], flown["flags"][:, i], flown["margin"][:, i]
        known = margin[np.isfinite(margin) & (np.abs(margin) < 1e30)]

        def steps(which: FilterStatus) -> int:
            return int((status == which).sum())

        return FilterCounts(
            name=name,
            filtered=steps(FilterStatus.FILTERED) + steps(FilterStatus.SHORTENED),
            backup=steps(FilterStatus.BACKUP),
            recovering=steps(FilterStatus.RECOVERING),
            refused=steps(FilterStatus.REFUSED),
            infeasible=int((flags & INFEASIBLE > 0).sum()),
            certified=int((flags & CERTIFIED > 0).sum()),
            certified_moving=int((flags & CERTIFIED_MOVING > 0).sum()),
            min_margin=float(known.min()) if len(known) else None,
        )


def worst_clearance(trial: TrialResult) -> float:
    """Minimum clearance of a flight to anything, infinite without obstacles [m]."""
    found = clearance_of(trial)
    return math.inf if found is None else found


def hits_static(trial: TrialResult) -> bool:
    """True when a flight touched a static obstacle or left the fence."""
    return is_collision(clearance_of(trial, *STATIC))


def _finite(points: FloatArray) -> FloatArray:
    """The path up to its first value that is not finite; such a flight is refused at once."""
    bad = ~np.isfinite(points).all(axis=1)
    return points[: int(np.argmax(bad))] if bad.any() else points


def _most(values: FloatArray) -> float:
    return float(values[np.isfinite(values)].max(initial=0.0))


def _peak(values: FloatArray) -> float | None:
    """Largest finite value; None without one."""
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else None
