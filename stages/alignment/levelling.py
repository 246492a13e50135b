"""Which way is up: a rotation that makes it +z, from a given direction or from the floor."""

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

_TRIALS = 3000
_MOST = 20_000  # points after thinning
_SCORED = 4000
_REFITS = 30
_TILT = radians(40.0)  # how far the floor may lean from the direction that was expected to be up
_BELOW = 0.2  # share of points that may be under a floor
_THIN = 0.02  # of the tolerance: no floor is taken for thinner
_FILLED = 0.6  # thickness over tolerance: 0.74 when points fill the slab evenly, as of walls
_HINT = "--up says where to look, and rough ground needs a larger --threshold"
_SHARED = 0.1  # of the thickness: what stands on a floor pulls all of it alike
_SUPPORT = 0.05  # least share of points that lie on it


@dataclass(frozen=True, slots=True)
class Level:
    """A rigid motion that levels a frame, with what is known of it.

    `error` holds the errors of the floor's height and two tilts; None when up was simply given.
    """

    motion: Similarity
    facts: dict[str, Any]
    error: Uncertainty | None = None
    warnings: tuple[str, ...] = ()


def turn_up(up: FloatArray) -> FloatArray:
    """The smallest rotation that takes a direction to +z; about x when it is -z.

    With m half way between up and z, the product of two reflections, (I - 2 m m') (I - 2 up up'). Below the
    horizon 1 + up_z is (up_x^2 + up_y^2) / (1 - up_z), which loses no digits.
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
    """Turn a direction of the present frame upwards; the origin stays."""
    rotation = turn_up(up)
    facts = {"by": "direction", "up": (up / np.linalg.norm(up)).tolist(), "turned_deg": _turned(rotation)}
    return Level(Similarity(scale=1.0, rotation=rotation.tolist(), translation_m=[0.0] * 3), facts)


def level_by_floor(points: FloatArray, up: FloatArray, tolerance: float, seed: int) -> Level:
    """Find the floor, turn its normal upwards and make its height zero; x and y of the origin stay.

    Planes through three random points within 40 degrees of level are rated by how many points of the
    scene, averaged in cubes, are within the tolerance, less those further below: a ceiling or a table
    has much below it, a floor nothing but noise. The best is fitted by least squares to its points
    until these no longer change. Blocks of space say how well it is known (see `jackknife`).

    Args:
        points: shape (n, 3) [m].
        up: roughly; shape (3,).
        tolerance: how thick a floor is, to either side [m].
        seed: of the random triples.

    Raises:
        CheckError: no plane is a floor.
    """
    kept, edge = thinned_to(points, tolerance, _MOST)
    up = up / np.linalg.norm(up)
    if len(kept) < 10:
        raise InputError(f"--floor: only {len(kept)} places of {edge:g} m hold Gaussians")
    rng = np.random.default_rng(seed)
    normal, offset = _best_plane(kept, up, tolerance, rng)
    inlier = np.abs(kept @ normal - offset) <= tolerance
    spread = tolerance
    for _ in range(_REFITS):
        if inlier.sum() < 3:
            break
        centre = kept[inlier].mean(axis=0)
        _, _, vt = np.linalg.svd(kept[inlier] - centre, full_matrices=False)
        normal = vt[2] * np.sign(vt[2] @ up)
        height = kept @ normal
        # Walls and furniture stand in the slab too: what lies flat is where the median is.
        near = np.abs(height - np.median(height[inlier])) <= tolerance
        offset = float(np.median(height[near]))
        spread = 1.4826 * float(np.median(np.abs(height[near] - offset)))
        again = np.abs(height - offset) <= min(max(3 * spread, _THIN * tolerance), tolerance)
        if (again == inlier).all():
            break
        inlier = again
    offset = float((kept[inlier] @ normal).mean()) if inlier.any() else offset
    height = kept @ normal - offset
    share, below = float(inlier.mean()), float((height < -2 * tolerance).mean())
    if spread > _FILLED * tolerance:
        raise CheckError(
            f"alignment: no floor was found: the best plane is {spread:.2g} m thick, too much for "
            f"--threshold {tolerance:g} m; {_HINT}"
        )
    if share < _SUPPORT or below > _BELOW or normal @ up < cos(_TILT):
        raise CheckError(
            f"alignment: no floor was found: the best plane within {degrees(_TILT):.0f} deg of level holds "
            f"{share:.1%} of the scene ({_SUPPORT:.0%} are needed) and has {below:.1%} below it (at most "
            f"{_BELOW:.0%}); {_HINT}"
        )
    rotation = turn_up(normal)
    thickness = float(np.sqrt((height[inlier] ** 2).mean()))
    error = _known(kept[inlier] @ rotation.T, offset, 4 * edge, thickness)
    motion = Similarity(scale=1.0, rotation=rotation.tolist(), translation_m=[0.0, 0.0, -offset])
    facts: dict[str, Any] = {
        "by": "floor",
        "up": normal.tolist(),
        "turned_deg": _turned(rotation),
        "sought_around": up.tolist(),
        "lean_deg": degrees(float(np.arccos(np.clip(normal @ up, -1, 1)))),
        "height_m": offset,
        "share": share,
        "below": below,
        "tolerance_m": tolerance,
        "sigma_m": thickness,
    }
    if error is None:
        return Level(motion, facts, None, ("the floor is too small to say how level it is",))
    sigma = np.sqrt(np.diag(error.covariance))
    facts |= {
        "tilt_sigma_deg": [float(sigma[4] * 180 / pi), float(sigma[5] * 180 / pi)],
        "height_sigma_m": float(sigma[2]),
    }
    return Level(motion, facts, error)


def _turned(rotation: FloatArray) -> float:
    return degrees(float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1))))


def _best_plane(
    points: FloatArray, up: FloatArray, tolerance: float, rng: np.random.Generator
) -> tuple[FloatArray, float]:
    drawn = points[rng.integers(0, len(points), (_TRIALS, 3))]
    normals = np.cross(drawn[:, 1] - drawn[:, 0], drawn[:, 2] - drawn[:, 0])
    length = np.linalg.norm(normals, axis=1)
    sound = length > 1e-9 * max(float(np.ptp(points)), 1e-300) ** 2
    normals, through = normals[sound] / length[sound, None], drawn[sound, 0]
    rise = normals @ up
    normals = normals * np.sign(rise)[:, None]
    level = np.abs(rise) >= cos(_TILT)
    normals, through = normals[level], through[level]
    if not len(normals):
        raise CheckError(
            "alignment: no floor was found: the scene has nothing level; --up says where to look"
        )
    offsets = (normals * through).sum(axis=1)
    some = points if len(points) <= _SCORED else points[np.sort(rng.permutation(len(points))[:_SCORED])]
    best, most = 0, -np.inf
    for i, (normal, offset) in enumerate(zip(normals, offsets.tolist(), strict=True)):
        height = some @ normal - offset
        score = float((np.abs(height) <= tolerance).sum() - 2 * (height < -2 * tolerance).sum())
        if score > most:
            best, most = i, score
    return normals[best], float(offsets[best])


def _known(levelled: FloatArray, height: float, least: float, thickness: float) -> Uncertainty | None:
    """Errors of the floor's height and tilts, from blocks of it; None when there are too few.

    A tenth of the thickness is added to the height's: what stands on a floor pulls all blocks alike.
    """
    label, count, _ = blocks(levelled * np.array([1.0, 1.0, 0.0]), least)
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
    small[0, 0] += (_SHARED * thickness) ** 2
    covariance = np.zeros((7, 7))
    index = np.array([2, 4, 5])
    covariance[np.ix_(index, index)] = small
    return Uncertainty(np.array([*centre[:2], 0.0]), covariance, float(count - 3))
