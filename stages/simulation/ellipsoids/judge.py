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
    is_collision,
    scene_obstacles,
    segment_clearance,
    sphere_clearance,
)
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.planning.adherence import PlanJudge, outcome_of_plan
from alula.stages.simulation.ellipsoids.closed_loop import SplatFlown
from alula.stages.verdict import minimum


class SplatJudge:
    """Clearances of the vehicle's sphere to the ellipsoids of a scene and to the hulls of a cover.

    The path consists of the plant's steps, 1 ms each, joined by chords. A chord is at most a dt^2 / 8 off the
    true path, below 1e-5 m up to an acceleration of 80 m/s^2. Along it the distance is exact. A collision is
    contact with an ellipsoid, and with a hull where the filter avoids them; else their clearance is reported.

    Args:
        scene: metric scene; None without one.
        sigma: level of its ellipsoids.
        hulls: of a cover in the same frame, if there is one.
        radius_m: of the vehicle [m].
        jobs: threads, 0 for all processors.
        avoids_hulls: whether the filter keeps clear of the hulls.
    """

    def __init__(
        self,
        scene: Artifact | None,
        sigma: float,
        hulls: _core.PolytopeSet | None,
        radius_m: float,
        jobs: int,
        *,
        avoids_hulls: bool = False,
    ) -> None:
        self.scene = None if scene is None else scene_obstacles(scene, sigma)
        self.hulls = hulls
        self.avoids_hulls = avoids_hulls
        avoided = [self.scene, self.hulls if avoids_hulls else None]
        self.avoided = [each for each in avoided if each is not None]
        self.radius_m = radius_m
        self.jobs = jobs

    def distance(self, points: FloatArray, cap_m: float) -> FloatArray:
        """Signed distance of points to the nearest obstacle that counts as a collision.

        Args:
            points: shape (M, 3), world frame [m].
            cap_m: larger distances are returned as this [m].

        Returns:
            Shape (M,) [m].
        """
        rows = np.ascontiguousarray(points)
        return self._least(rows, rows, cap_m)

    def is_blocked(self, start: FloatArray, goal: FloatArray, keep_m: float) -> NDArray[np.bool_]:
        """Find the straight lines that come closer to such an obstacle than `keep_m`.

        Args:
            start: shape (S, 3), world frame [m].
            goal: shape (S, 3), world frame [m].
            keep_m: distance to keep [m].

        Returns:
            Shape (S,).
        """
        return np.asarray(self._least(start, goal, keep_m) < keep_m)

    def _least(self, start: FloatArray, end: FloatArray, cap_m: float) -> FloatArray:
        each = [segment_clearance(start, end, obstacles, self.jobs, cap_m) for obstacles in self.avoided]
        least: FloatArray = np.min(each, axis=0)
        return least

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
        to_scene, to_hulls = (self._clearance(flown.position, part) for part in (self.scene, self.hulls))
        gamma = _core.least_gamma(grown, np.ascontiguousarray(_finite(position)))
        margin = flown.margin[np.isfinite(flown.margin)]
        duration = steps * dt_s
        length = float(np.linalg.norm(np.diff(_finite(flown.position), axis=0), axis=1).sum())
        return TrialResult(
            index=index,
            start_m=position[0].tolist(),
            goal_m=goal.tolist(),
            outcome=outcome_of_plan(flown.outcome, followed),
            collision=is_collision(to_scene, to_hulls if self.avoids_hulls else None),
            steps=steps,
            duration_s=duration,
            path_length_m=length,
            straight_length_m=float(np.linalg.norm(goal - position[0])),
            map_clearance_m=to_hulls,
            scene_clearance_m=to_scene,
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
            line_clearance_m=minimum(
                self._clearance(np.array([position[0], goal]), part) for part in self.avoided
            ),
            plan=followed,
        )

    def _clearance(
        self, position: FloatArray, obstacles: _core.EllipsoidSet | _core.PolytopeSet | None
    ) -> float | None:
        if obstacles is None:
            return None
        return sphere_clearance(_finite(position), obstacles, self.radius_m, jobs=self.jobs)


def _finite(points: FloatArray) -> FloatArray:
    """The path up to its first value that is not finite; such a flight is refused at once."""
    bad = ~np.isfinite(points).all(axis=1)
    return points[: int(np.argmax(bad))] if bad.any() else points


def _most(values: FloatArray) -> float:
    return float(values[np.isfinite(values)].max(initial=0.0))
