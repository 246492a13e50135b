"""Ground of a simulated vehicle: the height of a map below it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from alula._core import EllipsoidSet, PolytopeSet
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import LevelManifest, SceneManifest
from alula.stages.clearance import hull_obstacles, scene_obstacles, segment_clearance
from alula.stages.compression.hulls import Hulls

_PARTS = 16  # of a vertical line that are looked at together
_FINE_M = 1e-6  # length of the part that holds the top of an obstacle; it counts as this top
_NEAR_M = 1e-3  # distances of lines are wanted no farther than this
_MOVED_M = 0.02  # a vehicle that moved by less has the same ground


@dataclass(frozen=True, slots=True)
class Ground:
    """What a vehicle can stand on.

    Attributes:
        obstacles: search trees of all obstacles, world frame.
        lowest_m: height of the lowest point of all obstacles [m]; infinity without any.
        floor_m: height of the floor that the scene was levelled to; None where it was not [m].
    """

    obstacles: Sequence[PolytopeSet | EllipsoidSet]
    lowest_m: float
    floor_m: float | None = None

    def below(self, position: FloatArray) -> float:
        """Height of the first obstacle vertically below a point [m].

        At most 1 micrometre above its surface, never below it.

        Args:
            position: shape (3,), world frame [m].

        Returns:
            Minus infinity if there is none; NaN for a point in an obstacle.
        """
        if self._is_met(position, np.array([position[2]]), np.array([position[2]]))[0]:
            return math.nan
        top, bottom = float(position[2]), self.lowest_m - _FINE_M
        if bottom >= top:
            return -math.inf
        while True:
            ends = np.linspace(top, bottom, _PARTS + 1)
            met = self._is_met(position, ends[:-1], ends[1:])
            if not met.any():
                return -math.inf
            first = int(np.argmax(met))
            top, bottom = float(ends[first]), float(ends[first + 1])
            if top - bottom <= _FINE_M:
                return top

    def _is_met(self, position: FloatArray, top: FloatArray, bottom: FloatArray) -> np.ndarray:
        """Whether vertical lines through a point meet an obstacle, shape (N,)."""
        start = np.tile(position, (len(top), 1))
        end = start.copy()
        start[:, 2], end[:, 2] = top, bottom
        met = np.zeros(len(top), np.bool_)
        for each in self.obstacles:
            met |= segment_clearance(start, end, each, jobs=1, cap_m=_NEAR_M) <= 0
        return met


def ground_of(cover: Artifact | None, scene: Artifact | None = None, sigma: float = 1.0) -> Ground:
    """The ground that maps in one frame give.

    Args:
        scene: an `alula/scene` in metres, or None.
    """
    obstacles: list[PolytopeSet | EllipsoidSet] = []
    lowest = math.inf
    if cover is not None:
        hulls = Hulls.from_cover(cover)
        obstacles.append(hull_obstacles(hulls))
        lowest = float(hulls.vertices_world[:, 2].min(initial=lowest))
    if scene is not None:
        obstacles.append(scene_obstacles(scene, sigma))
        reach = sigma * np.asarray(scene["scale"], np.float64).max(axis=1)
        lowest = float((np.asarray(scene["mean"], np.float64)[:, 2] - reach).min(initial=lowest))
    floors = [
        each.manifest.floor_m
        for each in (cover, scene)
        if each is not None and isinstance(each.manifest, LevelManifest | SceneManifest)
    ]
    return Ground(obstacles, lowest, next((each for each in floors if each is not None), None))


class Footing:
    """Height of the ground below one vehicle on its way.

    This is the first obstacle vertically below its centre. Where there is none, it is the known floor, or
    else the height of the start; and below these the lowest point of the map. In an obstacle, which stops no
    simulated vehicle, it stays what it was.

    Args:
        start: where the vehicle stands at first, whatever is below, shape (3,), world frame [m].
    """

    def __init__(self, ground: Ground, start: FloatArray) -> None:
        self._ground, self._start_m = ground, float(start[2])
        self._at: FloatArray | None = None
        self._height_m = self._start_m

    def height(self, position: FloatArray) -> float:
        """Height of the ground below a position of the vehicle [m].

        Args:
            position: shape (3,), world frame [m].
        """
        if self._at is not None and np.abs(position - self._at).max() < _MOVED_M:
            return self._height_m
        self._at = position.copy()
        found = self._ground.below(position)
        if math.isnan(found):
            return self._height_m
        if math.isinf(found):
            floor = self._ground.floor_m
            levels = [self._start_m if floor is None else floor, self._start_m]
            found = next((z for z in levels if z <= position[2]), min(self._ground.lowest_m, *levels))
        self._height_m = found
        return found
