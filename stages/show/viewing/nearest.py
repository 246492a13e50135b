"""Distance and nearest point of each part of the world to a flown path."""

from __future__ import annotations

from typing import Any

import numpy as np

from alula._core import EllipsoidSet, PolytopeSet
from alula.schemas.arrays import FloatArray
from alula.stages.clearance import segment_clearance
from alula.stages.show.drawing.solids import Solids

_STEP_M = 1e-4


def solid_obstacles(solids: Solids) -> PolytopeSet | None:
    """Search tree of convex solids, with a plane for each of their triangles; None without any.

    Args:
        solids: world frame [m]; triangles counter-clockwise from outside.
    """
    if len(solids) == 0:
        return None
    a, b, c = (solids.corners[solids.triangles[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    good = length > 1e-12
    count = np.add.reduceat(good.astype(np.int64), solids.triangle_start[:-1])
    is_solid = count >= 4
    if not is_solid.any():
        return None
    good &= np.repeat(is_solid, np.diff(solids.triangle_start))
    normal = normal[good] / length[good, None]
    corner = np.repeat(is_solid, np.diff(solids.corner_start))
    corner_count = np.diff(solids.corner_start)[is_solid]
    return PolytopeSet(
        normals=np.ascontiguousarray(normal),
        offsets=np.ascontiguousarray((normal * a[good]).sum(axis=1)),
        plane_start=np.concatenate([[0], np.cumsum(count[is_solid])]),
        vertices=np.ascontiguousarray(solids.corners[corner]),
        vertex_start=np.concatenate([[0], np.cumsum(corner_count)]),
    )


def to_obstacles(points: FloatArray, obstacles: PolytopeSet | EllipsoidSet) -> tuple[FloatArray, FloatArray]:
    """Signed distance of points to the nearest obstacle, and its nearest point p - d grad d.

    The gradient is a central difference of the exact distance, so the point is exact to its step but on
    ridges between obstacles, where it lies between the nearest points.

    Args:
        points: shape (n, 3) [m].
        obstacles: in the same frame.

    Returns:
        Distances, shape (n,) [m], and points, shape (n, 3) [m].
    """
    steps = _STEP_M * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    asked = (points[:, None] + steps).reshape(-1, 3)
    found = segment_clearance(asked, asked, obstacles).reshape(len(points), 7)
    gradient = (found[:, 1:4] - found[:, 4:7]) / (2 * _STEP_M)
    length = np.linalg.norm(gradient, axis=1, keepdims=True)
    gradient = np.divide(gradient, length, out=np.zeros_like(gradient), where=length > 1e-6)
    return found[:, 0], points - found[:, :1] * gradient


def to_faces(points: FloatArray, faces: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance to the nearest face of a fence, negative outside, and the nearest point on its plane.

    Args:
        points: shape (n, 3) [m].
        faces: rows (n, d) with unit n and n . p <= d inside, shape (L, 4).
    """
    slack = faces[:, 3] - points @ faces[:, :3].T
    face = slack.argmin(axis=1)
    distance = slack[np.arange(len(points)), face]
    return distance, points + distance[:, None] * faces[face, :3]


def to_balls(points: FloatArray, centers: FloatArray, radius_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance of points to the nearest of the balls at the same row, and its nearest point.

    Args:
        points: shape (n, 3) [m].
        centers: NaN for one that is not there, shape (n, k, 3) [m].
        radius_m: shape (k,) [m].

    Returns:
        Distances, shape (n,) [m], and points, shape (n, 3); NaN where there is no ball.
    """
    away = centers - points[:, None]
    length = np.linalg.norm(away, axis=2)
    distance = length - radius_m
    which = np.where(np.isfinite(distance), distance, np.inf).argmin(axis=1)
    row = np.arange(len(points))
    d = distance[row, which]
    return d, points + away[row, which] * (d / np.maximum(length[row, which], 1e-12))[:, None]


def closest(each: list[tuple[FloatArray, FloatArray]], count: int) -> FloatArray:
    """Nearest point of all parts, NaN where no part is known, shape (count, 3)."""
    if not each:
        return np.full((count, 3), np.nan)
    distance: Any = np.stack([np.where(np.isfinite(d), d, np.inf) for d, _ in each])
    which = distance.argmin(axis=0)
    points: FloatArray = np.stack([p for _, p in each])[which, np.arange(count)]
    points[~np.isfinite(distance.min(axis=0))] = np.nan
    return points
