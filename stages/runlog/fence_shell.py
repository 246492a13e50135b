"""How a fence is drawn in a log: its faces as one clear shell, hulls to keep out of as solids."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.stages.compression.hulls import Hulls
from alula.stages.runlog.ellipsoids import xyz
from alula.stages.runlog.writer import UPRIGHT, stamp
from alula.stages.simulation.geofence.world import FlownWorld

SHOWN_BEYOND_M = 20.0  # of a fence that is open: as far around the paths as it is drawn
_FENCE_COLOR = {"r": 0.1, "g": 0.55, "b": 0.8, "a": 0.12}
_HULL_COLOR = {"r": 0.55, "g": 0.6, "b": 0.68, "a": 0.6}


def fence_entities(world: FlownWorld, paths: list[FloatArray], frame: str) -> list[dict[str, Any]]:
    """Foxglove's entities `fence` and `map`: triangles, counter-clockwise from outside."""
    entities = []
    if len(world.faces):
        corners, triangles = fence_shell(world.faces, paths)
        entities.append(_entity("fence", frame, [_triangles(corners, triangles, _FENCE_COLOR)], {}))
    if world.hulls is not None:
        solids = [_triangles(*_solid(corners), _HULL_COLOR) for corners in _corners(world.hulls)]
        entities.append(_entity("map", frame, solids, {"hulls": str(len(world.hulls))}))
    return entities


def fence_shell(faces: FloatArray, paths: list[FloatArray]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Corners (V, 3) and triangles (T, 3) of the polytope {p : n . p <= d}; none where it is empty.

    One that no box bounds is shown as far as `SHOWN_BEYOND_M` around the paths, and open there.
    """
    from scipy.optimize import linprog
    from scipy.spatial import HalfspaceIntersection

    points = np.concatenate(paths) if paths else np.zeros((1, 3))
    low, high = points.min(axis=0) - SHOWN_BEYOND_M, points.max(axis=0) + SHOWN_BEYOND_M
    normal, offset = faces[:, :3], faces[:, 3]
    is_bounded = all((normal @ axis > 1 - 1e-12).any() for axis in (*np.eye(3), *-np.eye(3)))
    cut = (
        np.empty((0, 4))
        if is_bounded
        else np.column_stack([np.vstack([np.eye(3), -np.eye(3)]), [*high, *-low]])
    )
    rows = np.vstack([np.column_stack([normal, offset]), cut])
    ball = linprog(
        [0, 0, 0, -1], A_ub=np.column_stack([rows[:, :3], np.ones(len(rows))]), b_ub=rows[:, 3],
        bounds=[(None, None)] * 3 + [(0, None)],
    )  # fmt: skip
    if ball.status != 0 or ball.x[3] < 1e-6:
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    signed = np.column_stack([rows[:, :3], -rows[:, 3]])
    corners = np.unique(HalfspaceIntersection(signed, ball.x[:3]).intersections.round(9), axis=0)
    corners, triangles = _solid(corners)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    center = (a + b + c) / 3
    is_cut = (np.abs(center @ cut[:, :3].T - cut[:, 3]) < 1e-6).any(axis=1)
    is_face = (np.abs(center @ normal.T - offset) < 1e-6).any(axis=1)
    return corners, triangles[is_face | ~is_cut]


def _corners(hulls: Hulls) -> list[FloatArray]:
    starts = hulls.vertex_start
    return [hulls.vertices_world[starts[k] : starts[k + 1]] for k in range(len(hulls))]


def _solid(corners: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """The surface of the convex hull, its triangles turned outwards."""
    from scipy.spatial import ConvexHull

    faces = ConvexHull(corners)
    triangles = faces.simplices.astype(np.int64)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    is_inward = (np.cross(b - a, c - a) * faces.equations[:, :3]).sum(axis=1) < 0
    triangles[is_inward] = triangles[is_inward][:, ::-1]
    return corners, triangles


def _triangles(corners: FloatArray, triangles: NDArray[np.int64], color: dict[str, float]) -> dict[str, Any]:
    return {
        "pose": {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": UPRIGHT},
        "points": [xyz(point) for point in corners],
        "color": color,
        "colors": [],
        "indices": triangles.ravel().tolist(),
    }


def _entity(name: str, frame: str, triangles: list[dict[str, Any]], facts: dict[str, str]) -> dict[str, Any]:
    return {
        "timestamp": stamp(0.0),
        "frame_id": frame,
        "id": name,
        "lifetime": stamp(0.0),
        "frame_locked": True,
        "metadata": [{"key": key, "value": value} for key, value in facts.items()],
        "triangles": triangles,
    }
