"""Small meshes: balls, and a vehicle with its rotors."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from alula.schemas.arrays import FloatArray, IntArray
from alula.stages.show.drawing.content import Body, Color, Copies

UPRIGHT_WXYZ = (1.0, 0.0, 0.0, 0.0)
_GOLDEN = (1 + 5**0.5) / 2
_SIDES = 16  # of a rotor's disc


@cache
def ball_mesh() -> tuple[FloatArray, IntArray]:
    """An icosahedron divided once, with corners on the unit sphere: shapes (42, 3) and (80, 3), read-only."""
    from scipy.spatial import ConvexHull

    first = np.array(
        [[s * a, t * b, 0] for a, b in ((1, _GOLDEN),) for s in (-1, 1) for t in (-1, 1)], np.float64
    )
    twelve = np.concatenate([np.roll(first, k, axis=1) for k in range(3)])
    twelve /= np.linalg.norm(twelve[0])
    hull = ConvexHull(twelve)
    pairs = np.unique(np.sort(hull.simplices[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    middle = twelve[pairs].sum(axis=1)
    middle /= np.linalg.norm(middle, axis=1, keepdims=True)
    corners = np.concatenate([twelve, middle])
    triangles = _outward(corners, ConvexHull(corners).simplices.astype(np.int64))
    corners.flags.writeable = triangles.flags.writeable = False
    return corners, triangles


def _outward(corners: FloatArray, triangles: IntArray) -> IntArray:
    """Turn the triangles of a convex mesh around the origin counter-clockwise from outside."""
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    inward = (np.cross(b - a, c - a) * (a + b + c)).sum(axis=1) < 0
    found = triangles.copy()
    found[inward] = found[inward][:, ::-1]
    return found


def balls(
    name: str,
    centers: ArrayLike,
    radius_m: ArrayLike,
    color: Color | NDArray[np.uint8],
    *,
    opacity: float = 1.0,
    visible: bool = True,
    quat_wxyz: FloatArray | None = None,
) -> Copies:
    """Balls or ellipsoids of one colour.

    Args:
        centers: shape (n, 3) [m].
        radius_m: of all, or semi-axes, shape (n, 3) [m].
        color: of all, or one of each, shape (n, 3).
        opacity: 0 to 1.
        quat_wxyz: of the semi-axes, shape (n, 4); None for balls.
    """
    corners, triangles = ball_mesh()
    position = np.asarray(centers, np.float64).reshape(-1, 3)
    return Copies(
        name=name,
        corners=corners,
        triangles=triangles,
        position=position,
        scale=np.broadcast_to(np.asarray(radius_m, np.float64), position.shape).copy(),
        quat_wxyz=np.tile(UPRIGHT_WXYZ, (len(position), 1)) if quat_wxyz is None else quat_wxyz,
        color=color,
        opacity=opacity,
        visible=visible,
    )


def frame_mesh(body: Body) -> tuple[FloatArray, IntArray]:
    """Hub, arms and a nose of a vehicle at its true size, in its body frame [m].

    Without rotors it has four at the usual places within its radius. The nose points forward, along x.
    """
    rotors = rotors_of(body)
    size = float(np.linalg.norm(rotors[:, :2], axis=1).max())
    boxes = [_box(np.zeros(3), np.array([0.28, 0.22, 0.12]) * size)]
    boxes.append(_box(np.array([0.42, 0, 0.0]) * size, np.array([0.2, 0.06, 0.06]) * size))
    for rotor in rotors:
        length = float(np.linalg.norm(rotor[:2]))
        along = np.array([rotor[0], rotor[1], 0]) / length
        across = np.array([-along[1], along[0], 0])
        corners, triangles = _box(
            np.array([length / 2, 0, 0]), np.array([length / 2, 0.03 * size, 0.03 * size])
        )
        boxes.append((corners @ np.stack([along, across, [0, 0, 1.0]]), triangles))
    return _joined(boxes)


def disc_mesh(body: Body) -> tuple[FloatArray, IntArray]:
    """Discs of a vehicle's rotors in its body frame [m]: neighbours nearly touch."""
    rotors = rotors_of(body)
    apart = np.linalg.norm(rotors[:, None] - rotors[None], axis=2)
    apart[np.diag_indices(len(rotors))] = np.inf
    reach = 0.45 * float(apart.min()) if len(rotors) > 1 else 0.5 * body.radius_m
    angle = np.linspace(0, 2 * np.pi, _SIDES, endpoint=False)
    ring = reach * np.stack([np.cos(angle), np.sin(angle), np.zeros(_SIDES)], axis=1)
    each = []
    for rotor in rotors:
        corners = np.concatenate([[rotor], rotor + ring]) + np.array((0, 0, 0.08 * reach))
        around = 1 + np.arange(_SIDES)
        each.append((corners, np.stack([np.zeros(_SIDES, np.int64), around, np.roll(around, -1)], axis=1)))
    return _joined(each)


def rotors_of(body: Body) -> FloatArray:
    """Places of a vehicle's rotors, shape (k, 3) [m]; four on the diagonals where they are not known."""
    if len(body.rotors_m):
        return body.rotors_m
    each = 0.45 * body.radius_m
    return np.array([[s * each, t * each, 0.0] for s in (-1, 1) for t in (-1, 1)])


def _box(center: FloatArray, half: FloatArray) -> tuple[FloatArray, IntArray]:
    from alula.stages.show.drawing.solids import voxel_surface

    corners, triangles, _ = voxel_surface(np.zeros((1, 3), np.int64), 1.0)
    return center + (2 * corners - 1) * half, triangles


def _joined(each: list[tuple[FloatArray, IntArray]]) -> tuple[FloatArray, IntArray]:
    from alula.stages.show.drawing.solids import solids_of

    joined = solids_of(each)
    return joined.corners, joined.triangles
