"""Levelling of a frame: a rigid motion that makes up +z, from a given direction or from the floor."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, degrees, pi, radians
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import CheckError, InputError
from alula.schemas.manifest import Similarity
from alula.stages.alignment.sampling import blocks, jackknife, thinned_to
from alula.stages.alignment.uncertainty import Uncertainty

_SAMPLES = 3000
_MAX_POINTS = 20_000  # after thinning
_SCORED_POINTS = 4000  # that rank the proposals
_REFITS = 30
_MAX_TILT = radians(40.0)  # between the floor's normal and the expected up direction
_MAX_BELOW = 0.2  # fraction of the points that may lie under a floor
_MIN_THICKNESS = 0.02  # of the tolerance
_MAX_THICKNESS = 0.6  # of the tolerance; 0.74 when points fill the slab evenly, as those of walls do
_HINT = "--up sets the search direction, and rough ground needs a larger --threshold"
_COMMON_ERROR = 0.1  # of the thickness: objects on the floor shift its height everywhere alike
_MIN_SUPPORT = 0.05  # fraction of the points that must lie on the floor


@dataclass(frozen=True, slots=True)
class Level:
    """A rigid motion that levels a frame, with its record.

    Attributes:
        motion: levelled from present frame, scale 1.
        facts: figures for the alignment's record.
        error: uncertainty of the floor's height and of its two tilts; None when up was given, or when the
            floor is too small for an estimate.
        warnings: weaknesses of the result, one sentence each.
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


def level_by_floor(points: FloatArray, up: FloatArray, tolerance: float, seed: int) -> Level:
    """Find the floor by RANSAC, turn its normal upwards and make its height zero; x and y of the origin stay.

    The points of the scene are averaged in cubes. Planes through three random points, tilted by at most 40
    degrees, are proposals. The score of a plane is the number of points within the tolerance minus twice
    the number of points more than two tolerances below it: a ceiling or a table has many points below it, a
    floor has only noise. The plane with the highest score is fitted by least squares to its points until
    these no longer change. The uncertainty comes from blocks of space (see `jackknife`).

    Args:
        points: shape (n, 3) [m].
        up: approximate up direction, shape (3,), frame of the points.
        tolerance: half the thickness of a floor [m].
        seed: seed of the random triples.

    Raises:
        CheckError: no plane qualifies as a floor.
        InputError: there are fewer than ten points after averaging.
    """
    kept, edge = thinned_to(points, tolerance, _MAX_POINTS)
    up = up / np.linalg.norm(up)
    if len(kept) < 10:
        raise InputError(f"--floor: only {len(kept)} cubes of {edge:g} m hold Gaussians; 10 are needed")
    rng = np.random.default_rng(seed)
    normal, offset = _ransac_plane(kept, up, tolerance, rng)
    inlier = np.abs(kept @ normal - offset) <= tolerance
    spread = tolerance
    for _ in range(_REFITS):
        if inlier.sum() < 3:
            break
        centre = kept[inlier].mean(axis=0)
        _, _, vt = np.linalg.svd(kept[inlier] - centre, full_matrices=False)
        normal = vt[2] * np.sign(vt[2] @ up)
        height = kept @ normal
        # Walls and furniture have points in the slab too; the median is the height of the flat part.
        near = np.abs(height - np.median(height[inlier])) <= tolerance
        offset = float(np.median(height[near]))
        spread = 1.4826 * float(np.median(np.abs(height[near] - offset)))
        again = np.abs(height - offset) <= min(max(3 * spread, _MIN_THICKNESS * tolerance), tolerance)
        if (again == inlier).all():
            break
        inlier = again
    offset = float((kept[inlier] @ normal).mean()) if inlier.any() else offset
    height = kept @ normal - offset
    support, below = float(inlier.mean()), float((height < -2 * tolerance).mean())
    if spread > _MAX_THICKNESS * tolerance:
        raise CheckError(
            f"alignment: no floor was found: the best plane is {spread:.2g} m thick, too much for "
            f"--threshold {tolerance:g} m; {_HINT}"
        )
    if support < _MIN_SUPPORT or below > _MAX_BELOW or normal @ up < cos(_MAX_TILT):
        raise CheckError(
            f"alignment: no floor was found: the best plane within {degrees(_MAX_TILT):.0f} deg of level "
            f"holds {support:.1%} of the scene ({_MIN_SUPPORT:.0%} are needed) and has {below:.1%} below it "
            f"(at most {_MAX_BELOW:.0%}); {_HINT}"
        )
    rotation = turn_up(normal)
    thickness = float(np.sqrt((height[inlier] ** 2).mean()))
    error = _floor_uncertainty(kept[inlier] @ rotation.T, offset, 4 * edge, thickness)
    motion = Similarity(scale=1.0, rotation=rotation.tolist(), translation_m=[0.0, 0.0, -offset])
    facts: dict[str, Any] = {
        "by": "floor",
        "up": normal.tolist(),
        "turned_deg": _turned(rotation),
        "sought_around": up.tolist(),
        "lean_deg": degrees(float(np.arccos(np.clip(normal @ up, -1, 1)))),
        "height_m": offset,
        "share": support,
        "below": below,
        "tolerance_m": tolerance,
        "sigma_m": thickness,
    }
    if error is None:
        return Level(motion, facts, None, ("the floor is too small to estimate the error of its tilt",))
    sigma = np.sqrt(np.diag(error.covariance))
    facts |= {
        "tilt_sigma_deg": [float(sigma[4] * 180 / pi), float(sigma[5] * 180 / pi)],
        "height_sigma_m": float(sigma[2]),
    }
    return Level(motion, facts, error)


def _turned(rotation: FloatArray) -> float:
    return degrees(float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


def _ransac_plane(
    points: FloatArray, up: FloatArray, tolerance: float, rng: np.random.Generator
) -> tuple[FloatArray, float]:
    """Normal and offset of the RANSAC plane with the highest score (see `level_by_floor`)."""
    drawn = points[rng.integers(0, len(points), (_SAMPLES, 3))]
    normals = np.cross(drawn[:, 1] - drawn[:, 0], drawn[:, 2] - drawn[:, 0])
    length = np.linalg.norm(normals, axis=1)
    usable = length > 1e-9 * max(float(np.ptp(points)), 1e-300) ** 2
    normals, through = normals[usable] / length[usable, None], drawn[usable, 0]
    rise = normals @ up
    normals = normals * np.sign(rise)[:, None]
    level = np.abs(rise) >= cos(_MAX_TILT)
    normals, through = normals[level], through[level]
    if not len(normals):
        raise CheckError(
            "alignment: no floor was found: the scene has no level plane; --up sets the search direction"
        )
    offsets = (normals * through).sum(axis=1)
    scored = points
    if len(points) > _SCORED_POINTS:
        scored = points[np.sort(rng.permutation(len(points))[:_SCORED_POINTS])]
    best, best_score = 0, -np.inf
    for i, (normal, offset) in enumerate(zip(normals, offsets.tolist(), strict=True)):
        height = scored @ normal - offset
        score = float((np.abs(height) <= tolerance).sum() - 2 * (height < -2 * tolerance).sum())
        if score > best_score:
            best, best_score = i, score
    return normals[best], float(offsets[best])


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
