"""Maps and fences as Foxglove draws them: hulls and faces as triangles, ellipsoids as spheres."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.kinds import SCENE
from alula.schemas.log.foxglove import Color, Pose, SceneEntity, SceneUpdate, SpherePrimitive
from alula.stages.compression.facets import mesh
from alula.stages.compression.hulls import Hulls
from alula.stages.runlog.cloud import nearest
from alula.stages.runlog.messages import entity, facts, quaternion, triangle_list, xyz

SHOWN_ELLIPSOIDS = 3000  # maximum number; those nearest to the paths are shown
SHOWN_BEYOND_M = 20.0  # around the paths, where an open fence is cut
_MAP_COLOR = Color(0.55, 0.6, 0.68, 0.6)
_FENCE_COLOR = Color(0.1, 0.55, 0.8, 0.12)


def map_message(
    flown_through: Artifact, summary: Mapping[str, Any], paths: list[FloatArray], frame: str, time_ns: int
) -> SceneUpdate:
    """Map: hulls, or ellipsoids near the paths at `summary["sigma"]`.

    Args:
        flown_through: an `alula/cover` or an `alula/scene`.
        paths: flown positions, each of shape (T, 3) [m].
    """
    if flown_through.kind is SCENE:
        shape = _ellipsoids(flown_through, float(summary["sigma"]), paths)
    else:
        shape = _cover_hulls(flown_through)
    return SceneUpdate(entities=[entity("map", frame, time_ns, **shape)])


def world_message(
    hulls: Hulls | None,
    scene: Artifact | None,
    sigma: float,
    faces: FloatArray,
    paths: list[FloatArray],
    frame: str,
    time_ns: int,
) -> SceneUpdate:
    """All static obstacles: hulls, ellipsoids near the paths, and the fence.

    Args:
        hulls: of cover and walls; None without any.
        scene: with ellipsoids; None without one.
        faces: of the fence, shape (L, 4), rows (n, d) with unit n and n . p <= d [m].
        paths: flown positions, each of shape (T, 3) [m].
    """
    entities = _fence(faces, paths, frame, time_ns)
    if hulls is not None:
        entities.append(_hulls(hulls, frame, time_ns))
    if scene is not None:
        entities.append(entity("ellipsoids", frame, time_ns, **_ellipsoids(scene, sigma, paths)))
    return SceneUpdate(entities=entities)


def _fence(faces: FloatArray, paths: list[FloatArray], frame: str, time_ns: int) -> list[SceneEntity]:
    """The shell of a fence; none without faces."""
    if not len(faces):
        return []
    corners, triangles = fence_shell(faces, paths)
    shell = triangle_list(corners, triangles, _FENCE_COLOR)
    return [entity("fence", frame, time_ns, triangles=[shell])]


def fence_shell(faces: FloatArray, paths: list[FloatArray]) -> tuple[FloatArray, IntArray]:
    """Surface of the polytope {p : n . p <= d} as triangles; none where it is empty.

    A polytope that is not bounded by a box is cut `SHOWN_BEYOND_M` around the paths, and drawn open there.

    Args:
        faces: shape (L, 4), rows (n, d) with unit n, world frame [m].
        paths: flown positions, each of shape (T, 3), world frame [m].

    Returns:
        Corners, shape (V, 3) [m], and triangles, shape (T, 3), counter-clockwise from outside.
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
    triangles = _surface(corners)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    center = (a + b + c) / 3
    is_cut = (np.abs(center @ cut[:, :3].T - cut[:, 3]) < 1e-6).any(axis=1)
    is_face = (np.abs(center @ normal.T - offset) < 1e-6).any(axis=1)
    return corners, triangles[is_face | ~is_cut]


def _hulls(hulls: Hulls, frame: str, time_ns: int) -> SceneEntity:
    starts = hulls.vertex_start
    corners = [hulls.vertices_world[starts[k] : starts[k + 1]] for k in range(len(hulls))]
    solids = [triangle_list(points, _surface(points), _MAP_COLOR) for points in corners]
    return entity("map", frame, time_ns, metadata=facts(hulls=len(hulls)), triangles=solids)


def _surface(corners: FloatArray) -> IntArray:
    """Triangles of the convex hull of points (V, 3), turned outwards; shape (T, 3)."""
    from scipy.spatial import ConvexHull

    faces = ConvexHull(corners)
    triangles: IntArray = faces.simplices.astype(np.int64)
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    is_inward = (np.cross(b - a, c - a) * faces.equations[:, :3]).sum(axis=1) < 0
    triangles[is_inward] = triangles[is_inward][:, ::-1]
    return triangles


def _cover_hulls(cover: Artifact) -> dict[str, Any]:
    """The surface of each hull of a cover, with its facets as the cover stores them."""
    surface = mesh(cover)
    points = surface.points_voxel * float(cover.manifest.voxel_size_m)  # type: ignore[attr-defined]
    triangles = []
    for k in range(len(surface)):
        first, end = surface.point_start[k], surface.point_start[k + 1]
        rows = surface.triangles[surface.triangle_start[k] : surface.triangle_start[k + 1]] - first
        triangles.append(triangle_list(points[first:end], rows, _MAP_COLOR))
    return {"metadata": facts(hulls=len(surface)), "triangles": triangles}


def _ellipsoids(scene: Artifact, sigma: float, paths: list[FloatArray]) -> dict[str, Any]:
    """Ellipsoids at the level as spheres, those nearest to the paths when there are too many."""
    shown = nearest(scene, sigma, paths, SHOWN_ELLIPSOIDS)
    spheres = []
    for i in shown:
        reach = sigma * np.asarray(scene["scale"][i], np.float64)
        red, green, blue = (round(int(value) / 255, 3) for value in scene["color"][i])
        attitude = quaternion(scene["quat_wxyz"][i].astype(np.float64))
        pose = Pose(xyz(scene["mean"][i].astype(np.float64)), attitude)
        spheres.append(SpherePrimitive(pose, xyz(2 * reach), Color(red, green, blue, 0.6)))
    return {"metadata": facts(ellipsoids=len(scene["mean"]), shown=len(shown)), "spheres": spheres}
