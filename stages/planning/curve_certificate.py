"""Proof that a trajectory keeps a distance from every obstacle, over the continuous time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from alula._core import ObstacleMap, PolytopeSet, check_curves
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InputError
from alula.stages.planning.space import PlanSpace
from alula.stages.planning.trajectory import DEGREE, control_points

METHOD = "separating planes of Bernstein control hulls, by subdivision"
MAP_METHOD = "distances of chords less those of Bernstein control points from them, by subdivision"
_DEPTH = 14  # of the subdivision of a piece
_JOINED_M = 1e-6  # consecutive pieces meet up to this, with all errors of the arithmetic


@dataclass(frozen=True, slots=True)
class Certificate:
    """Result of `certify_curve`.

    Attributes:
        proven: per piece, True when all of it keeps the radius, shape (K,).
        clearance_m: per piece, a proven lower bound on its distance to all obstacles, at most twice the
            radius; of a piece that is not proven, a distance below the radius, shape (K,) [m].
        pairs: number of decided pairs of a sub-piece and a hull, or sub-pieces in a map.
        depth: maximum depth of the subdivision.
    """

    proven: NDArray[np.bool_]
    clearance_m: FloatArray
    pairs: int
    depth: int

    @property
    def holds(self) -> bool:
        """True when every piece is proven."""
        return bool(self.proven.all())


def certify_curve(
    time: ArrayLike,
    coefficient: ArrayLike,
    obstacles: PolytopeSet | ObstacleMap,
    radius_m: float,
    *,
    jobs: int = 0,
    extent_m: float = 0.0,
) -> Certificate:
    """Prove that a trajectory keeps `radius_m` from every obstacle at every instant, not only at samples.

    Each piece lies in the convex hull of its Bernstein control points; a sub-piece is clear of a hull when a
    plane separates its control points from the hull's vertices with a gap of at least the radius plus a bound
    on all rounding errors. Sub-pieces are halved until that decides. A proof is never wrong; a curve within
    about 1e-9 m of the radius may stay unproven. A piece that ends more than 1e-6 m from where the next
    begins is not proven.

    In an obstacle map, as of ellipsoids, a sub-piece is clear when the distance of the chord between its ends
    is at least the radius, the largest distance of a control point from the chord, and the errors.

    The bound on rounding errors of piece k, in metres, is 1e-12 + 2^-44 X with
    X = max_d sum_j |c_kdj| T^j + max |vertex|. Converting to control points takes fewer than 32
    roundings of terms that sum to at most X, the length of the interval errs by one, halving 14
    times adds 14 * 7, and the planes and vertices of the hulls another 64, each of at most
    2^-53 X and in three components: below sqrt(3) * 256 * 2^-53 X.

    Args:
        time: knots, shape (K + 1,) [s].
        coefficient: shape (K, D, 8) with D >= 3, see `trajectory`; position in the first three rows, world
            frame [m].
        obstacles: hulls or a map, world frame [m].
        radius_m: distance to keep, positive [m].
        extent_m: largest coordinate of the obstacles of a map, in place of vertices [m].

    Raises:
        InputError: the radius is not positive, or the trajectory has no finite bounds.
    """
    if not (0 < radius_m < math.inf):
        raise InputError(f"the radius must be positive, not {radius_m}")
    knots, c = np.asarray(time, np.float64), np.asarray(coefficient, np.float64)[:, :3]
    reach = extent_m
    if isinstance(obstacles, PolytopeSet) and len(obstacles):
        lower, upper = obstacles.bounds()
        reach = max(map(abs, (*lower, *upper)))
    powers = np.diff(knots)[:, None] ** np.arange(DEGREE + 1)
    size = (np.abs(c) * powers[:, None, :]).sum(axis=2).max(axis=1) + reach
    points = np.ascontiguousarray(control_points(knots, c).transpose(0, 2, 1))
    slack = 1e-12 + 2.0**-44 * size
    if not (np.isfinite(points).all() and np.isfinite(slack).all()):
        raise InputError("the trajectory has no finite bounds in double precision")
    proven, clearance, pairs, depth = check_curves(obstacles, points, slack, radius_m, _DEPTH, jobs)
    # A jump between pieces is no part of any of them.
    jump = (
        np.abs(points[1:, 0] - points[:-1, -1]).max(axis=1, initial=0.0) + slack[1:] + slack[:-1] > _JOINED_M
    )
    clear = proven.astype(np.bool_)
    clear[:-1] &= ~jump
    return Certificate(clear, clearance, pairs, depth)


def certify_in(
    time: ArrayLike, coefficient: ArrayLike, space: PlanSpace, *, jobs: int = 0, radius_m: float | None = None
) -> Certificate:
    """Prove that a trajectory keeps from each map of a space the distance of that map.

    Args:
        time: as for `certify_curve` [s].
        coefficient: as for `certify_curve`.
        radius_m: distance to keep from all maps instead [m].

    Returns:
        The bounds on the clearance are of the distance to the nearest map.

    Raises:
        InputError: as `certify_curve`.
    """
    found = [
        certify_curve(
            time,
            coefficient,
            one.obstacles,
            one.keep_m if radius_m is None else radius_m,
            jobs=jobs,
            extent_m=one.extent_m,
        )
        for one in space.maps
    ]
    return Certificate(
        np.logical_and.reduce([each.proven for each in found]),
        np.min([each.clearance_m for each in found], axis=0),
        sum(each.pairs for each in found),
        max(each.depth for each in found),
    )


def methods(space: PlanSpace) -> str:
    """Methods of the proofs against the maps of a space, in words."""
    return "; ".join(dict.fromkeys(METHOD if one.is_of_hulls else MAP_METHOD for one in space.maps))
