"""Centres of a scene's Gaussians in their colours, as Foxglove draws them: a point cloud."""

from __future__ import annotations

import numpy as np

from alula.schemas.arrays import FloatArray, IntArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.log.foxglove import ORIGIN, PackedElementField, PointCloud, Time

SHOWN_POINTS = 10_000  # maximum number; those nearest to the paths are shown
_UINT8, _FLOAT32 = 1, 7  # numbers of Foxglove's types
_CHUNK = 1 << 16  # Gaussians that are measured at once
_COMMON = 0.98  # quantile of the radii up to which balls are measured together
# Blue, green, red and opacity are also the packed colour of ROS 2.
POINT = np.dtype([("mean", "<f4", 3), ("blue", "u1"), ("green", "u1"), ("red", "u1"), ("alpha", "u1")])


def cloud_message(scene: Artifact, paths: list[FloatArray], frame: str, time_ns: int) -> PointCloud:
    """Gaussians nearest to the paths.

    Args:
        paths: flown or planned positions, each of shape (T, 3) [m].
    """
    shown = nearest(scene, 0.0, paths, SHOWN_POINTS)
    points = np.empty(len(shown), POINT)
    points["mean"] = scene["mean"][shown]
    for i, name in enumerate(("red", "green", "blue")):
        points[name] = scene["color"][shown, i]
    points["alpha"] = np.rint(255 * scene["opacity"][shown].astype(np.float64))
    places = [(axis, 4 * i, _FLOAT32) for i, axis in enumerate("xyz")]
    places += [(name, 12 + i, _UINT8) for i, name in enumerate(("blue", "green", "red", "alpha"))]
    fields = [PackedElementField(name, offset, kind) for name, offset, kind in places]
    return PointCloud(Time.of(time_ns), frame, ORIGIN, POINT.itemsize, fields, points.tobytes())


def nearest(scene: Artifact, sigma: float, paths: list[FloatArray], most: int) -> IntArray:
    """Numbers of the Gaussians nearest to paths, in ascending order; all if there are not more than `most`.

    The distance is that to a ball around the ellipsoid. Memory and time grow with those that may be among the
    nearest, not with all: what is farther than the nearest so far is passed over.

    Args:
        sigma: level of the ellipsoids; 0 for the centres.
        paths: each of shape (T, 3) [m].
    """
    from scipy.spatial import cKDTree

    count = len(scene["mean"])
    if count <= most:
        return np.arange(count)
    tree = cKDTree(np.concatenate(paths))
    kept, kept_apart, limit = np.empty(0, np.int64), np.empty(0), np.inf
    for first in range(0, count, _CHUNK):
        rows = slice(first, first + _CHUNK)
        mean = np.asarray(scene["mean"][rows], np.float64)
        reach = sigma * np.asarray(scene["scale"][rows].max(axis=1), np.float64)
        apart = np.empty(len(mean))
        is_large = reach > np.quantile(reach, _COMMON)  # a few huge ones would widen the search of all
        for some in (np.flatnonzero(~is_large), np.flatnonzero(is_large)):
            bound = max(0.0, limit + reach[some].max(initial=0.0)) * (1 + 1e-9) + 1e-9
            apart[some] = tree.query(mean[some], distance_upper_bound=bound)[0] - reach[some]
        near = np.flatnonzero(np.isfinite(apart))
        kept, kept_apart = np.append(kept, first + near), np.append(kept_apart, apart[near])
        best = np.sort(np.argsort(kept_apart, kind="stable")[:most])
        kept, kept_apart = kept[best], kept_apart[best]
        limit = float(kept_apart.max()) if len(kept) == most else np.inf
    return kept
