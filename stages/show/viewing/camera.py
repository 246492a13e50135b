"""The first camera: what flies fills the picture, or else the scene."""

from __future__ import annotations

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.show.drawing.content import Camera
from alula.stages.show.drawing.sight import FIELD_RAD

_FROM = np.array((-0.55, -0.8, 0.62)) / np.linalg.norm((-0.55, -0.8, 0.62))  # towards the camera
_CORE = (0.03, 0.97)  # quantiles: a splat has far outliers
_SURROUNDINGS = 2.5  # a scene at most so many times as large is shown whole
_LEAST_M = 0.5
_CLOSER = 0.86  # boxes seldom fill their spheres
_LOWER = 0.1  # plots stand in the lower part of the picture
_TURNS = {
    "+z": np.eye(3),
    "-z": np.diag((1.0, -1.0, -1.0)),
    "+y": np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], np.float64).T,
    "-y": np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float64).T,
    "+x": np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], np.float64),
    "-x": np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]], np.float64),
}
UPS = tuple(_TURNS)


def upright(up: str) -> FloatArray:
    """Rotation that turns +z into the axis `up`, shape (3, 3)."""
    found: FloatArray = _TURNS[up]
    return found


def view_direction(up: str) -> FloatArray:
    """Direction of sight of the first camera, a unit vector, shape (3,)."""
    found: FloatArray = -(upright(up) @ _FROM)
    return found


def fitted(solid: FloatArray, flown: FloatArray, up: str = "+z") -> Camera:
    """Fit a camera to flights and plans, or to the scene where there are none.

    Args:
        solid: points of the scene, shape (n, 3) [m].
        flown: points of flights and plans, shape (m, 3) [m].
    """
    boxes = [np.stack([points.min(axis=0), points.max(axis=0)]) for points in (flown,) if len(points)]
    if len(solid):
        core = np.quantile(solid, _CORE, axis=0)
        flown_m = max(float(np.ptp(boxes[0], axis=0).max()), 2.0) if boxes else np.inf
        if float(np.ptp(core, axis=0).max()) <= _SURROUNDINGS * flown_m:
            boxes.append(core)
    if not boxes:
        boxes = [np.array([[-1.0, -1, -1], [1, 1, 1]])]
    whole = np.concatenate(boxes)
    low, high = whole.min(axis=0), whole.max(axis=0)
    least = _LEAST_M if len(flown) else 1e-6  # a splat without scale may be small
    centre, reach = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, least)
    away = reach / np.sin(FIELD_RAD / 2) * _CLOSER
    centre = centre - _LOWER * reach * upright(up)[:, 2]
    everything = max((float(np.ptp(p, axis=0).max()) for p in (solid, flown) if len(p)), default=reach)
    return Camera(centre - away * view_direction(up), centre, 4 * (away + everything))
