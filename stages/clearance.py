"""Judgement of a flown or planned path, independent of any filter: clearance in continuous time, motion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from alula._core import EllipsoidSet, PolytopeSet
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import InputError
from alula.stages.compression.hulls import Hulls

COLLISION_TOLERANCE_M = 1e-6  # clearances are exact to far less; a touch is no collision
_COARSE = 16  # one point of a path in so many bounds the minimum along it
_ROUNDING_M = 1e-6


def is_collision(*clearances_m: float | None) -> bool:
    """True when one of the clearances of a flight is below zero, beyond rounding.

    Args:
        clearances_m: signed distances less the vehicle's radius [m]; None stands for no obstacle.
    """
    return any(c is not None and c < -COLLISION_TOLERANCE_M for c in clearances_m)


def hull_obstacles(hulls: Hulls) -> PolytopeSet:
    """Build a search tree of hulls, for many queries by `path_clearance`.

    Args:
        hulls: world frame [m].
    """
    return PolytopeSet(
        normals=np.ascontiguousarray(hulls.normal_world),
        offsets=np.ascontiguousarray(hulls.offset_m),
        plane_start=np.ascontiguousarray(hulls.plane_start),
        vertices=np.ascontiguousarray(hulls.vertices_world),
        vertex_start=np.ascontiguousarray(hulls.vertex_start),
    )


def scene_obstacles(scene: Artifact, sigma: float) -> EllipsoidSet:
    """Build a search tree of the ellipsoids {x : (x - mu)' inv(Sigma) (x - mu) <= sigma^2} of a scene.

    Each is grown by the loss of its splat file's format (`level_of` in `ellipsoid.hpp`), so that no clearance
    exceeds that of the Gaussians that the file was made from.

    Args:
        scene: an `alula/scene`; the tree is in its frame and unit, and reads its arrays, mapped ones too.

    Raises:
        InputError: `sigma` is not positive and finite.
    """
    if not (0 < sigma < math.inf):
        raise InputError(f"the level of the ellipsoids must be positive, not {sigma}")
    return EllipsoidSet(
        mean=np.ascontiguousarray(scene["mean"], np.float32),
        scale=np.ascontiguousarray(scene["scale"], np.float32),
        quat_wxyz=np.ascontiguousarray(scene["quat_wxyz"], np.float32),
        k=float(sigma),
        loss=scene.arrays.get("loss"),
    )


def kept_obstacles(scene: Artifact, sigma: float, trees: dict[float, EllipsoidSet]) -> EllipsoidSet:
    """The search tree of `scene_obstacles`, made once for each level.

    Args:
        trees: those of this scene by level; the one that is made is added.

    Raises:
        InputError: as `scene_obstacles`.
    """
    if sigma not in trees:
        trees[sigma] = scene_obstacles(scene, sigma)
    return trees[sigma]


def path_clearance(
    points: ArrayLike, obstacles: PolytopeSet | EllipsoidSet, *, jobs: int = 0, cap_m: float = math.inf
) -> FloatArray:
    """Signed distance of each segment of a path to the nearest obstacle, exactly.

    The distance of a segment is the minimum over all of its points, not over samples, of the
    signed Euclidean distance: positive outside; inside, minus the distance to the boundary, which
    for a polytope {x : n_l . x <= d_l} is max_l (n_l . p - d_l). So a path that enters an obstacle
    reports minus its deepest penetration. In double precision to a few roundings of the
    coordinates; see `native/core/include/alula/geometry/clearance.hpp`.

    Args:
        points: the path, shape (T, 3), in the frame and unit of the obstacles; T >= 1.
        obstacles: from `hull_obstacles` or `scene_obstacles`.
        cap_m: distances of at least this are returned as this; a small cap saves time.

    Returns:
        Shape (max(T - 1, 1),); a single point is a segment of length zero. Without obstacles
        `cap_m`, infinite unless given.

    Raises:
        InputError: `points` is empty, of another shape or not finite, or `cap_m` is not a number.
    """
    path = np.ascontiguousarray(points, np.float64)
    if path.ndim != 2 or path.shape[1] != 3 or len(path) == 0:
        raise InputError(f"a path has the shape (T, 3) with T >= 1, not {path.shape}")
    return segment_clearance(
        path[: max(len(path) - 1, 1)], path[min(1, len(path) - 1) :], obstacles, jobs, cap_m
    )


def segment_clearance(
    start: ArrayLike,
    end: ArrayLike,
    obstacles: PolytopeSet | EllipsoidSet,
    jobs: int = 0,
    cap_m: float = math.inf,
) -> FloatArray:
    """Signed distance of unconnected segments to the nearest obstacle, as `path_clearance` defines it.

    Args:
        start: first points, shape (S, 3), in the frame and unit of the obstacles.
        end: last points, shape (S, 3).
        obstacles: from `hull_obstacles` or `scene_obstacles`.
        cap_m: distances of at least this are returned as this.

    Returns:
        Shape (S,).

    Raises:
        InputError: the shapes differ, a coordinate is not finite, or `cap_m` is not a number.
    """
    a, b = np.ascontiguousarray(start, np.float64), np.ascontiguousarray(end, np.float64)
    if a.ndim != 2 or a.shape[1] != 3 or a.shape != b.shape:
        raise InputError(f"segments have the shapes (S, 3) and (S, 3), not {a.shape} and {b.shape}")
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        raise InputError("a path has a coordinate that is not finite")
    if math.isnan(cap_m):
        raise InputError("the cap of the clearance is not a number")
    return np.asarray(obstacles.clearance(a, b, float(cap_m), jobs))


def sphere_clearance(
    points: ArrayLike, obstacles: PolytopeSet | EllipsoidSet, radius_m: float, *, jobs: int = 0
) -> float | None:
    """Minimum clearance of a sphere along a path.

    Args:
        points: path of its centre, shape (T, 3), in the frame of the obstacles [m].
        obstacles: from `hull_obstacles` or `scene_obstacles`.

    Returns:
        The minimum of `path_clearance` less the radius [m]; None without obstacles.
    """
    path = np.asarray(points, np.float64)
    # What is farther than one of the points does not matter, and is passed over quickly.
    few = path[::_COARSE] if path.ndim == 2 else path[:0]
    cap_m = (
        float(segment_clearance(few, few, obstacles, jobs).min()) + _ROUNDING_M if len(few) > 1 else math.inf
    )
    found = float(path_clearance(path, obstacles, jobs=jobs, cap_m=cap_m).min()) - radius_m
    return found if math.isfinite(found) else None


@dataclass(frozen=True, slots=True)
class PathMetrics:
    """Length [m], speed [m/s] and jerk [m/s^3] of a path sampled at equal intervals."""

    length_m: float
    max_speed_m_s: float
    mean_jerk_m_s3: float
    max_jerk_m_s3: float


def path_metrics(points: ArrayLike, dt: float) -> PathMetrics:
    """Length, maximum speed, and mean and maximum jerk of a path sampled every `dt` seconds.

    The velocity held over a step is v_i = (p_{i+1} - p_i) / dt, and jerk is its second difference
    |v_{i+2} - 2 v_{i+1} + v_i| / dt^2; zero when there are fewer than four points.

    Args:
        points: shape (T, 3), T >= 1 [m].
        dt: sampling interval [s], positive.

    Raises:
        InputError: shape or interval is wrong, or a value is not finite.
    """
    path = np.asarray(points, np.float64)
    if path.ndim != 2 or path.shape[1] != 3 or len(path) == 0 or not np.isfinite(path).all():
        raise InputError(f"a path has the shape (T, 3) with T >= 1 and finite values, not {path.shape}")
    if not (0 < dt < math.inf):
        raise InputError(f"the sampling interval must be positive, not {dt}")
    steps = np.diff(path, axis=0)
    distance = np.linalg.norm(steps, axis=1)
    jerk = np.linalg.norm(np.diff(steps, n=2, axis=0), axis=1) / dt**3
    return PathMetrics(
        length_m=float(distance.sum()),
        max_speed_m_s=float(distance.max(initial=0.0) / dt),
        mean_jerk_m_s3=float(jerk.mean()) if len(jerk) else 0.0,
        max_jerk_m_s3=float(jerk.max(initial=0.0)),
    )
