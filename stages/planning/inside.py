"""Where a flight is meant to begin and end: above the floor, and in the closed space of a map that has one.

Start and goal of `init`, free points, random pairs and moved points all come from here.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.manifest import LevelManifest, SceneManifest

_WAYS = np.array([w for w in itertools.product((-1, 0, 1), repeat=3) if any(w)])
ENCLOSED = 0.9  # of the ways from a point, along the axes and diagonals, that end at an obstacle
_ROOM = 10.0  # of a closed space: its horizontal diagonal, in radii
_SHARE = 0.01  # of a closed space: its part of the free points above the floor
_MOST_POINTS = 60_000  # of the lattice on which a closed space is looked for
_GRAIN_M = 1e-3


@dataclass(frozen=True, slots=True)
class Lattice:
    """Free points of a lattice.

    Attributes:
        point: shape (N, 3) [m].
        index: of each on the lattice, shape (N, 3).
        distance: from the nearest obstacle, at most one that is larger than the radius by the spacing [m].
        enclosed: fraction of the 26 ways along its axes and diagonals that end at an obstacle, shape (N,).
    """

    point: FloatArray
    index: NDArray[np.int64]
    distance: FloatArray
    shape: tuple[int, int, int]
    spacing_m: float
    enclosed: FloatArray


@dataclass(frozen=True, slots=True)
class Inside:
    """The part of a box in which flights are meant to be.

    Attributes:
        map: obstacles.
        lower, upper: corners of the box, whose lower face is not below the floor, shape (3,) [m].
        radius_m: distance that flights keep [m].
        is_closed: there is a closed space: points of which nearly all ways lead to an obstacle.
    """

    map: _core.ObstacleMap
    lower: FloatArray
    upper: FloatArray
    radius_m: float
    is_closed: bool
    diagonal_m: float

    def holds(self, points: FloatArray) -> NDArray[np.bool_]:
        """Whether points are inside, shape (N,).

        Args:
            points: shape (N, 3) [m].
        """
        found: NDArray[np.bool_] = np.all((points >= self.lower) & (points <= self.upper), axis=1)
        if self.is_closed and found.any():
            found[found] = (
                enclosed(self.map, points[found], self.lower, self.upper, self.radius_m) >= ENCLOSED
            )
        return found


def floor_of(map_: Artifact) -> float | None:
    """Height of the floor that the scene of a map was levelled to [m]; None where it was not.

    Args:
        map_: scene, voxels, seen space or cover.
    """
    manifest = map_.manifest
    return manifest.floor_m if isinstance(manifest, LevelManifest | SceneManifest) else None


def inside_of(
    map_: _core.ObstacleMap, lower: FloatArray, upper: FloatArray, radius_m: float, floor_m: float | None
) -> Inside:
    """Find the part of a box in which flights are meant to be.

    Above the floor, if it is known. Where the map has a closed space, in this: free points from which at
    least nine in ten of 26 ways end at an obstacle; the largest connected set of them that is wide enough for
    a flight. Else in the whole box.

    Args:
        lower: corner of the box for centres, shape (3,) [m].
        upper: the other corner [m].
        radius_m: distance that flights keep [m].
        floor_m: height of the floor; None if it is not known [m].
    """
    low = lower.copy()
    if floor_m is not None:
        low[2] = min(max(low[2], floor_m), upper[2])
    found = lattice_of(map_, low, upper, radius_m, _MOST_POINTS)
    chosen = np.flatnonzero(found.enclosed >= ENCLOSED)
    is_closed, points = False, found.point
    if len(chosen):
        part = _largest(found, chosen)
        wide = float(np.linalg.norm(np.ptp(found.point[part, :2], axis=0)))
        is_closed = wide >= _ROOM * radius_m and len(part) >= _SHARE * len(found.point)
        points = found.point[part] if is_closed else points
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0))) if len(points) else 0.0
    return Inside(map_, low, upper, radius_m, is_closed, diagonal)


def lattice_of(
    map_: _core.ObstacleMap,
    lower: FloatArray,
    upper: FloatArray,
    radius_m: float,
    most: int,
    least: float = 0.5,
) -> Lattice:
    """Lattice points of a box that keep a distance and a millimetre from all obstacles.

    Args:
        lower: corner of the box, shape (3,) [m].
        upper: the other corner [m].
        most: number of lattice points.
        least: spacing, in radii.
    """
    coarse = float(np.prod(np.maximum(upper - lower, _GRAIN_M)) / most) ** (1 / 3)
    spacing = _GRAIN_M * np.ceil(max(least * radius_m, coarse) / _GRAIN_M)
    pad = int(np.ceil(radius_m / spacing))  # of points around the box, for obstacles at its faces
    axes = [
        np.round(
            (a - pad * spacing) + spacing * np.arange(2 * pad + 1 + max(0, int((b - a + 1e-9) / spacing))), 3
        )
        for a, b in zip(np.ceil(lower / _GRAIN_M) * _GRAIN_M, upper, strict=True)
    ]
    nx, ny, nz = map(len, axes)
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    radius = radius_m + _GRAIN_M
    distance = map_.distance(np.ascontiguousarray(grid), radius + spacing)
    shape = (nx, ny, nz)
    # A wall between two points of a coarse lattice is nearer to one of them than half a diagonal.
    blocked = (distance < max(radius, 0.5 * np.sqrt(3) * spacing)).reshape(shape)
    within = ((grid >= lower) & (grid <= upper)).all(axis=1)
    free = np.flatnonzero((distance >= radius) & within)
    index = np.stack(np.unravel_index(free, shape), axis=1)
    share = _enclosed_on(blocked).reshape(-1)[free]
    return Lattice(grid[free], index, distance[free], shape, float(spacing), share)


def enclosed(
    map_: _core.ObstacleMap, points: FloatArray, lower: FloatArray, upper: FloatArray, radius_m: float
) -> FloatArray:
    """Fraction of 26 ways, along axes and diagonals, on which a ball meets an obstacle within a box, (N,).

    Args:
        points: shape (N, 3) [m].
        lower: corner of the box that holds all obstacles, less a radius, shape (3,) [m].
        upper: the other corner [m].
        radius_m: of the ball: gaps between Gaussians that it does not pass are none [m].
    """
    way = _WAYS / np.linalg.norm(_WAYS, axis=1)[:, None] * 1.5 * float(np.linalg.norm(upper - lower))
    start = np.repeat(points, len(way), axis=0)
    end = start + np.tile(way, (len(points), 1))
    clear = map_.is_clear(
        np.ascontiguousarray(start), np.ascontiguousarray(end), max(radius_m - _GRAIN_M, 0.0)
    )
    ends: FloatArray = 1 - np.asarray(clear).reshape(len(points), len(way)).mean(axis=1)
    return ends


def _enclosed_on(blocked: NDArray[np.bool_]) -> FloatArray:
    """Fraction of the 26 ways from each point of a lattice that come to a blocked one."""
    count = np.zeros(blocked.shape, np.int8)
    for way in _WAYS:
        axis = int(np.flatnonzero(way)[0])
        turned, rest = np.moveaxis(blocked, axis, 0), np.delete(way, axis)
        layers = range(len(turned)) if way[axis] < 0 else range(len(turned) - 1, -1, -1)
        ends = np.zeros_like(turned)  # where a way, without its first point, comes to a blocked one
        before: NDArray[np.bool_] | None = None
        for layer in layers:
            if before is not None:
                ends[layer] = _moved(before, *rest)
            before = turned[layer] | ends[layer]
        count += np.moveaxis(ends, 0, axis)
    share: FloatArray = count / len(_WAYS)
    return share


def _moved(plane: NDArray[np.bool_], i: int, j: int) -> NDArray[np.bool_]:
    """The plane in which each point has the value of its neighbour by (i, j); false beyond the rim."""
    found = np.zeros_like(plane)
    n, m = plane.shape
    to = slice(max(0, -i), n - max(0, i)), slice(max(0, -j), m - max(0, j))
    of = slice(max(0, i), n - max(0, -i)), slice(max(0, j), m - max(0, -j))
    found[to] = plane[of]
    return found


def _largest(lattice: Lattice, chosen: NDArray[np.int64]) -> NDArray[np.int64]:
    """The largest set of chosen points that are neighbours on the lattice."""
    from scipy import ndimage

    mask = np.zeros(lattice.shape, np.bool_)
    mask[tuple(lattice.index[chosen].T)] = True
    label, _ = ndimage.label(mask)
    of = label[tuple(lattice.index[chosen].T)]
    return np.asarray(chosen[of == np.bincount(of).argmax()])
