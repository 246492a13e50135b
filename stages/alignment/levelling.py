"""Levelling of a frame: a rigid motion that makes up +z, from a given direction or from the floor."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, degrees, e, log, pi, radians, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import CheckError, InputError
from alula.stages.alignment.plane_search import SLAB, Plane, best_level_plane, fit_plane
from alula.stages.alignment.sampling import blocks, jackknife, thinned
from alula.stages.alignment.uncertainty import Uncertainty

_MAX_POINTS = 200_000  # after thinning
_SEARCHED_POINTS = 2500  # that rank the planes
_MAX_TILT = radians(40.0)  # between the floor's normal and the expected up direction
_MAX_BELOW = 0.35  # fraction of the points that may lie under a floor
_MAX_THICKNESS = 0.6  # of the tolerance; points that fill the slab evenly, as those of walls do, have more
_SCALES = (1.0, 0.5, 0.25)  # of the tolerance: thinner slabs in which the floor is sought
_CLEARLY_BETTER = 1.5  # times the information of a thicker plane
_OTHER_FLOOR = 0.5  # of the floor's points: a plane that has as many could be the floor
_MAX_OTHERS = 4
_STOREY_M = 1.5  # a plane higher above the floor with almost nothing above it is a ceiling
_CEILING = 0.1  # fraction of the points above a plane that is no ceiling
_COMMON_ERROR = 0.1  # of the thickness: objects on the floor shift its height everywhere alike
_MIN_SUPPORT = 0.05  # fraction of the points that must lie on the floor


@dataclass(frozen=True, slots=True)
class Level:
    """A rigid motion that levels a frame, with its record.

    Attributes:
        motion: levelled from present frame, scale 1.
        error: uncertainty of the floor's height and of its two tilts; None when up was given, or when the
            floor is too small for an estimate.
    """

    motion: Similarity
    facts: dict[str, Any]
    error: Uncertainty | None = None
    warnings: tuple[str, ...] = ()


def turn_up(up: FloatArray) -> FloatArray:
    """Smallest rotation that takes a direction to +z; a half turn about x for -z.

    It is the product of two reflections, (I - 2 m m') (I - 2 up up'), with m half way between up and z. Below
    the horizon 1 + up_z is evaluated as (up_x^2 + up_y^2) / (1 - up_z), which loses no digits.

    Args:
        up: a direction of any length above zero, shape (3,).

    Returns:
        Shape (3, 3).
    """
    u = up / np.linalg.norm(up)
    sideways = u[0] ** 2 + u[1] ** 2
    half = np.array([u[0], u[1], 1 + u[2] if u[2] >= 0 else sideways / (1 - u[2])])
    if not np.linalg.norm(half) > 0:
        return np.diag([1.0, -1.0, -1.0])
    m = half / np.linalg.norm(half)
    rotation: FloatArray = (np.eye(3) - 2 * np.outer(m, m)) @ (np.eye(3) - 2 * np.outer(u, u))
    return rotation


def level_by_direction(up: FloatArray) -> Level:
    """Turn a direction of the present frame upwards; the origin stays.

    Args:
        up: the direction, of any length above zero, shape (3,), present frame.
    """
    rotation = turn_up(up)
    facts = {"by": "direction", "up": (up / np.linalg.norm(up)).tolist(), "turned_deg": _turned(rotation)}
    return Level(Similarity(scale=1.0, rotation=rotation.tolist(), translation_m=[0.0] * 3), facts)


def level_by_floor(points: FloatArray, up: FloatArray, tolerance: float) -> Level:
    """Find the floor, turn its normal upwards and make its height zero; x and y of the origin stay.

    The points of the scene are averaged in cubes, so that dense objects do not outweigh a smooth floor.
    Branch and bound finds the best of all planes tilted by at most 40 degrees (see `best_level_plane`), and
    MLESAC fits it (see `fit_plane`). A ceiling or a table has many points below it, a floor has only noise.
    The result depends on the points only. The uncertainty comes from blocks of space (see `jackknife`).

    Args:
        points: shape (n, 3) [m].
        up: approximate up direction, shape (3,), frame of the points.
        tolerance: half the thickness of a floor [m].

    Raises:
        CheckError: no plane qualifies as a floor.
        InputError: there are fewer than ten points after averaging.
    """
    kept = _sampled(thinned(points, tolerance), _MAX_POINTS)
    up = up / np.linalg.norm(up)
    if len(kept) < 10:
        raise InputError(f"--floor: only {len(kept)} cubes of {tolerance:g} m hold Gaussians; 10 are needed")
    search = _Search(kept, up)
    floor = search.floor(tolerance)
    if floor is None or floor.refusal:
        tilt = degrees(_MAX_TILT)
        reason = (
            floor.refusal if floor else f"all planes within {tilt:.0f} deg of level have too much below them"
        )
        raise CheckError(f"alignment: no floor was found: {reason}; {_advice(search, tolerance)}")
    normal, offset = floor.plane.normal, floor.plane.offset
    height = kept @ normal - offset
    inlier = np.abs(height) <= min(3 * floor.plane.sigma, tolerance)
    rotation = turn_up(normal)
    thickness = float(np.sqrt((height[inlier] ** 2).mean()))
    error = _floor_uncertainty(kept[inlier] @ rotation.T, offset, 4 * tolerance, thickness)
    motion = Similarity(scale=1.0, rotation=rotation.tolist(), translation_m=[0.0, 0.0, -offset])
    others = _other_floors(height, tolerance)
    facts: dict[str, Any] = {
        "by": "floor",
        "up": normal.tolist(),
        "turned_deg": _turned(rotation),
        "sought_around": up.tolist(),
        "lean_deg": degrees(float(np.arccos(np.clip(normal @ up, -1, 1)))),
        "height_m": offset,
        "share": floor.share,
        "below": floor.below,
        "tolerance_m": tolerance,
        "sigma_m": floor.plane.sigma,
        "score_bound": floor.bound,
        "others": [{"height_m": at, "relative_share": share} for at, share in others],
    }
    warnings = [
        f"a second level plane, {abs(at):.2f} m {'above' if at > 0 else 'below'} the floor, has {share:.0%} "
        "of its points; if that is the floor, crop the other away at the import (--crop-box)"
        for at, share in others
    ]
    if error is None:
        warnings.append("the floor is too small to estimate the error of its tilt")
    else:
        sigma = np.sqrt(np.diag(error.covariance))
        facts |= {
            "tilt_sigma_deg": [float(sigma[4] * 180 / pi), float(sigma[5] * 180 / pi)],
            "height_sigma_m": float(sigma[2]),
        }
    return Level(motion, facts, error, tuple(warnings))


@dataclass(frozen=True, slots=True)
class _Floor:
    """A level plane, the fractions of the points in and below it, and why it is no floor (empty if it is)."""

    plane: Plane
    share: float
    below: float
    bound: float
    refusal: str

    def information(self, tolerance: float) -> float:
        """Gain in log-likelihood per point over heights that fill the slab of the fit evenly."""
        normal = self.plane.sigma * sqrt(2 * pi * e)  # entropy of a normal distribution, as a length
        return self.share * log(max(2 * SLAB * tolerance / normal, 1.0))


class _Search:
    """Level planes of the points, found once per thickness."""

    def __init__(self, points: FloatArray, up: FloatArray) -> None:
        self._points, self._up, self._rotation = points, up, turn_up(up)
        self._sample = _sampled(points, _SEARCHED_POINTS) @ self._rotation.T
        self._found: dict[float, tuple[FloatArray, float, float] | None] = {}

    def floor(self, tolerance: float) -> _Floor | None:
        """Find the floor, or the best level plane if none qualifies; None when no plane has a positive score.

        A slab as thick as the tolerance can hold more of two floors at different heights, at a tilt between
        them, than of one. So the search is repeated in thinner slabs. A thinner plane replaces a thicker one
        if it describes the heights clearly better.
        """
        planes: list[_Floor] = []
        for scale in _SCALES:
            half = scale * tolerance
            if half not in self._found:
                self._found[half] = best_level_plane(self._sample, half, _MAX_TILT)
            found = self._found[half]
            if found is not None:
                normal, offset, bound = found
                plane = fit_plane(self._points, self._rotation.T @ normal, offset, half / 2, tolerance)
                planes.append(_judged(plane, bound, self._points, self._up, tolerance))
        good = [each for each in planes if not each.refusal]
        if not good:
            return planes[0] if planes else None
        best = good[0]
        for each in good[1:]:
            if each.information(tolerance) > _CLEARLY_BETTER * best.information(tolerance):
                best = each
        return best


def _judged(plane: Plane, bound: float, points: FloatArray, up: FloatArray, tolerance: float) -> _Floor:
    height = points @ plane.normal - plane.offset
    share, below = float(plane.weight.mean()), float((height < -2 * tolerance).mean())
    limit, refusal = _MAX_THICKNESS * tolerance, ""
    if plane.sigma > limit:
        refusal = (
            f"the best plane's points scatter by {plane.sigma:.2g} m (standard deviation), more than "
            f"{limit:.2g} m, which is {_MAX_THICKNESS:g} of --threshold {tolerance:g}"
        )
    elif share < _MIN_SUPPORT or below > _MAX_BELOW or plane.normal @ up < cos(_MAX_TILT):
        refusal = (
            f"the best plane within {degrees(_MAX_TILT):.0f} deg of level holds {share:.1%} of the scene "
            f"({_MIN_SUPPORT:.0%} are needed) and has {below:.1%} below it (at most {_MAX_BELOW:.0%})"
        )
    return _Floor(plane, share, below, bound, refusal)


def _advice(search: _Search, tolerance: float) -> str:
    """What to do where no floor was found: a larger threshold that finds one, if there is one."""
    for factor in (2.0, 4.0):
        floor = search.floor(factor * tolerance)
        if floor is not None and not floor.refusal:
            return f"--threshold {factor * tolerance:g} finds one with {floor.share:.0%} of the scene"
    return f"--threshold up to {4 * tolerance:g} finds none either; --up sets the search direction"


def _other_floors(height: FloatArray, tolerance: float) -> list[tuple[float, float]]:
    """Planes parallel to the floor that could be one too: their heights and points relative to the floor's.

    Such a plane stands out by at least half as many points as the floor. One with less than a tenth of the
    scene above it, and more than 1.5 m above the floor, is a ceiling.

    Args:
        height: heights of the points above the floor [m].
        tolerance: half the thickness of a floor [m].
    """
    ordered = np.sort(height)

    def between(low: FloatArray, high: FloatArray) -> FloatArray:
        found: FloatArray = np.subtract(
            np.searchsorted(ordered, high, "right"), np.searchsorted(ordered, low), dtype=np.float64
        )
        return found

    def prominence(at: FloatArray) -> FloatArray:
        inside = between(at - tolerance, at + tolerance)
        sides = between(at - 3 * tolerance, at - tolerance), between(at + tolerance, at + 3 * tolerance)
        found: FloatArray = inside - np.minimum(*sides)
        return found

    own = float(prominence(np.zeros(1))[0])
    lowest, highest = np.quantile(height, [0.01, 0.99])
    steps = np.arange(np.floor(lowest / tolerance * 4), np.ceil(highest / tolerance * 4) + 1) * tolerance / 4
    steps = steps[np.abs(steps) >= 2 * tolerance]
    stands_out = prominence(steps)
    found: list[tuple[float, float]] = []
    for k in np.argsort(-stands_out, kind="stable").tolist():
        at, points = float(steps[k]), float(stands_out[k])
        if points < _OTHER_FLOOR * own or len(found) == _MAX_OTHERS:
            break
        above = float((height > at + 2 * tolerance).mean())
        if (at > _STOREY_M and above < _CEILING) or any(
            abs(at - other) < 2 * tolerance for other, _ in found
        ):
            continue
        found.append((float(np.median(height[np.abs(height - at) <= tolerance])), points / own))
    return sorted(found)


def _turned(rotation: FloatArray) -> float:
    return degrees(float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


def _sampled(points: FloatArray, count: int) -> FloatArray:
    """The points, or as many of them chosen by a fixed permutation."""
    if len(points) <= count:
        return points
    return points[np.sort(np.random.default_rng(0).permutation(len(points))[:count])]


def _floor_uncertainty(
    levelled: FloatArray, height: float, min_edge: float, thickness: float
) -> Uncertainty | None:
    """Uncertainty of the floor's height and tilts, from blocks of it; None when there are fewer than six.

    A tenth of the thickness is added to that of the height: objects on the floor shift all blocks alike.
    """
    label, count, _ = blocks(levelled * np.array([1.0, 1.0, 0.0]), min_edge)
    if count < 6:
        return None
    centre = levelled.mean(axis=0)
    d = levelled - centre
    # z = tau + omega_x y - omega_y x
    jacobian = np.stack([np.ones(len(d)), d[:, 1], -d[:, 0]], axis=1)
    residual: NDArray[np.float64] = levelled[:, 2] - height
    score = np.zeros((count, 3))
    np.add.at(score, label, jacobian * residual[:, None])
    information = np.zeros((count, 3, 3))
    np.add.at(information, label, jacobian[:, :, None] * jacobian[:, None, :])
    if np.linalg.matrix_rank(information.sum(axis=0)) < 3:
        return None
    small = jackknife(information, score)
    small[0, 0] += (_COMMON_ERROR * thickness) ** 2
    covariance = np.zeros((7, 7))
    index = np.array([2, 4, 5])
    covariance[np.ix_(index, index)] = small
    return Uncertainty(np.array([*centre[:2], 0.0]), covariance, float(count - 3))
