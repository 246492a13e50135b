"""Clearances of paths to hulls and ellipsoids."""

from __future__ import annotations

import math

from numpy.typing import ArrayLike

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.stages.clearance import hull_obstacles, path_clearance, scene_obstacles
from alula.stages.compression.hulls import Hulls


def clearance_to_hulls(
    points: ArrayLike, hulls: Hulls, *, jobs: int = 0, cap_m: float = math.inf
) -> FloatArray:
    """`path_clearance` of a path to the hulls of a cover."""
    return path_clearance(points, hull_obstacles(hulls), jobs=jobs, cap_m=cap_m)


def clearance_to_scene(
    points: ArrayLike, scene: Artifact, sigma: float, *, jobs: int = 0, cap_m: float = math.inf
) -> FloatArray:
    """`path_clearance` of a path to the ellipsoids of a scene."""
    return path_clearance(points, scene_obstacles(scene, sigma), jobs=jobs, cap_m=cap_m)
