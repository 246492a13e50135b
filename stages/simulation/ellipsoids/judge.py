"""Verdict on a flight among ellipsoids: exact clearance of its path, motion, and steps of the filter."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifact import Artifact
from alula.schemas.run import TrialResult
from alula.stages.clearance import (
    hull_obstacles,
    is_collision,
    scene_obstacles,
    segment_clearance,
    sphere_clearance,
)
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.planning.adherence import PlanJudge, outcome_of_plan
from alula.stages.simulation.ellipsoids.closed_loop import SplatFlown


class SplatJudge:
    """Clearances of the vehicle's sphere to the ellipsoids of a scene and, when there is one, to a cover.

    The path consists of the plant's steps, 1 ms each, joined by chords. A chord is at most a dt^2 / 8 off the
    true path, below 1e-5 m up to an acceleration of 80 m/s^2. Along it the distance is exact. Only contact
    with the ellipsoids, which are the map of the filter, is a collision; clearance to the hulls is reported.

    Args:
        scene: metric scene.
        sigma: level of its ellipsoids.
        cover: an `alula/cover` in the same frame, if there is one.
        radius_m: of the vehicle [m].
        jobs: threads, 0 for all processors.
    """

    def __init__(
        self, scene: Artifact, sigma: float, cover: Artifact | None, radius_m: float, jobs: int
    ) -> None:
        self.scene = scene_obstacles(scene, sigma)
        self.hulls = None if cover is None else hull_obstacles(Hulls.from_cover(cover))
        self.radius_m = radius_m
        self.jobs = jobs

    def distance(self, points: FloatArray, cap_m: float) -> FloatArray:
        """Signed distance of points to the nearest ellipsoid.

        Args:
            points: shape (M, 3), world frame [m].
            cap_m: larger distances are returned as this [m].

        Returns:
            Shape (M,) [m].
        """
        rows = np.ascontiguousarray(points)
        return segment_clearance(rows, rows, self.scene, self.jobs, cap_m)

    def is_blocked(self, start: FloatArray, goal: FloatArray, keep_m: float) -> NDArray[np.bool_]:
        """Find the straight lines that come closer to an ellipsoid than `keep_m`.

        Args:
            start: shape (S, 3), world frame [m].
            goal: shape (S, 3), world frame [m].
            keep_m: distance to keep [m].

        Returns:
            Shape (S,).
        """
        return np.asarray(segment_clearance(start, goal, self.scene, self.jobs, keep_m) < keep_m)

    def trial(
        self,
        index: int,
        reference: FloatArray,
        goal: FloatArray,
        flown: SplatFlown,
        dt_s: float,
        grown: _core.EllipsoidIndex,
        along: PlanJudge | None = None,
    ) -> TrialResult:
        """Judge one flight.

        Args:
            index: number of the trial.
            reference: reference at the times of the ticks, shape (S + 1, 18).
            goal: shape (3,), world frame [m].
            flown: the flight.
            dt_s: duration of a tick [s].
            grown: ellipsoids as the filter grew them.
            along: of the plan that it flew, if any.
        """
        followed = None if along is None else along.result(_finite(flown.position))
        steps = len(flown.status)
        position, velocity = flown.state[:, :3], flown.state[:, 6:9]
        speed = np.linalg.norm(velocity, axis=1)
        acceleration = np.linalg.norm(np.diff(velocity, axis=0), axis=1) / dt_s
        jerk = np.linalg.norm(np.diff(velocity, n=2, axis=0), axis=1) / dt_s**2
        status = np.bincount(flown.status, minlength=len(FilterStatus))
        clearance = self._clearance(flown.position, self.scene)
        gamma = _core.least_gamma(grown, np.ascontiguousarray(_finite(position)))
        margin = flown.margin[np.isfinite(flown.margin)]
        duration = steps * dt_s
        length = float(np.linalg.norm(np.diff(_finite(flown.position), axis=0), axis=1).sum())
        return TrialResult(
            index=index,
            start_m=position[0].tolist(),
            goal_m=goal.tolist(),
            outcome=outcome_of_plan(flown.outcome, followed),
            collision=is_collision(clearance),
            steps=steps,
            duration_s=duration,
            path_length_m=length,
            straight_length_m=float(np.linalg.norm(goal - position[0])),
            map_clearance_m=None if self.hulls is None else self._clearance(flown.position, self.hulls),
            scene_clearance_m=clearance,
            max_speed_m_s=_most(speed),
            filtered_steps=int(steps - status[FilterStatus.OK]),
            shortened_steps=int(status[FilterStatus.SHORTENED]),
            infeasible_steps=int((flown.infeasible | (flown.status == FilterStatus.REFUSED)).sum()),
            fallback_steps=int(status[FilterStatus.RECOVERING]),
            mean_jerk_m_s3=float(jerk[np.isfinite(jerk)].mean()) if np.isfinite(jerk).any() else 0.0,
            max_jerk_m_s3=_most(jerk),
            reference_speed_m_s=_most(np.linalg.norm(reference[:, 3:6], axis=1)),
            mean_speed_m_s=length / duration,
            max_acceleration_m_s2=_most(acceleration),
            max_tracking_error_m=_most(np.linalg.norm(position - reference[:, :3], axis=1)),
            peak_realisation_error_m_s2=_most(flown.a_error),
            min_margin=float(margin.min()) if len(margin) else None,
            min_gamma=gamma if math.isfinite(gamma) else None,
            backup_steps=int(status[FilterStatus.BACKUP]),
            certified_steps=int(flown.certified.sum()),
            capped_steps=int(flown.capped.sum()),
            saturated_steps=int(flown.saturated.sum()),
            line_clearance_m=self._clearance(np.array([position[0], goal]), self.scene),
            plan=followed,
        )

    def _clearance(
        self, position: FloatArray, obstacles: _core.EllipsoidSet | _core.PolytopeSet
    ) -> float | None:
        return sphere_clearance(_finite(position), obstacles, self.radius_m, jobs=self.jobs)


def _finite(points: FloatArray) -> FloatArray:
    """The path up to its first value that is not finite; such a flight is refused at once."""
    bad = ~np.isfinite(points).all(axis=1)
    return points[: int(np.argmax(bad))] if bad.any() else points


def _most(values: FloatArray) -> float:
    return float(values[np.isfinite(values)].max(initial=0.0))
