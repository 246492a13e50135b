"""Centres of a scene's Gaussians in their colours, as Foxglove draws them: a point cloud."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.artifact import Artifact
from alula.stages.runlog.messages import UPRIGHT, stamp

SHOWN_POINTS = 10_000  # maximum number; those nearest to the paths are shown
_UINT8, _FLOAT32 = 1, 7  # numbers of Foxglove's types
# Blue, green, red and opacity are also the packed colour of ROS 2.
POINT = np.dtype([("mean", "<f4", 3), ("blue", "u1"), ("green", "u1"), ("red", "u1"), ("alpha", "u1")])


def cloud_message(scene: Artifact, paths: list[FloatArray], frame: str, time_ns: int) -> dict[str, Any]:
    """`foxglove.PointCloud` of the Gaussians nearest to the paths.

    Args:
        scene: an `alula/scene`.
        paths: flown or planned positions, each of shape (T, 3) [m].
        frame: name of the frame of all positions.
        time_ns: log time [ns].
    """
    mean = np.asarray(scene["mean"], np.float64)
    shown = nearest(mean, np.zeros(len(mean)), paths, SHOWN_POINTS)
    points = np.empty(len(shown), POINT)
    points["mean"] = scene["mean"][shown]
    for i, name in enumerate(("red", "green", "blue")):
        points[name] = scene["color"][shown, i]
    points["alpha"] = np.rint(255 * scene["opacity"][shown].astype(np.float64))
    places = [(axis, 4 * i, _FLOAT32) for i, axis in enumerate("xyz")]
    places += [(name, 12 + i, _UINT8) for i, name in enumerate(("blue", "green", "red", "alpha"))]
    return {
        "timestamp": stamp(time_ns),
        "frame_id": frame,
        "pose": {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": UPRIGHT},
        "point_stride": POINT.itemsize,
        "fields": [{"name": name, "offset": offset, "type": kind} for name, offset, kind in places],
        "data": base64.b64encode(points.tobytes()).decode(),
    }


def nearest(mean: FloatArray, reach: FloatArray, paths: list[FloatArray], most: int) -> IntArray:
    """Numbers of the balls nearest to paths, in ascending order; all if there are not more than `most`.

    Args:
        mean: centres, shape (N, 3) [m].
        reach: radii, shape (N,) [m].
        paths: each of shape (T, 3) [m].
        most: maximum number.
    """
    from scipy.spatial import cKDTree

    if len(mean) <= most:
        return np.arange(len(mean))
    apart = cKDTree(np.concatenate(paths)).query(mean)[0] - reach
    return np.sort(np.argsort(apart, kind="stable")[:most])
