"""Similarities between two point sets: closed form, robust, and how well they are known."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import InputError
from alula.schemas.manifest import Similarity

Array = NDArray[np.float64]

CONFIDENCE = 0.95
_TRIALS = 2000
_BATCH = 64
_REFITS = 20
_COLLINEAR = 1e-3  # second over first singular value below this: no rotation
_FLAT = 0.05  # below this a warning


@dataclass(frozen=True, slots=True)
class Fit:
    """A similarity with the evidence for it.

    Attributes:
        similarity: target = scale R source + t.
        inlier: shape (n,).
        residual: distance of each target from its mapped source, shape (n,) [target units].
        sigma: standard deviation of one coordinate of the inliers' residuals, 3 m - 7 degrees of
            freedom.
        scale_sigma: standard deviation of the scale, sigma / sqrt(sum |x_i - mean x|^2).
        scale_interval: 95 % interval of the scale, by Student's t.
        leave_one_out: smallest and largest scale with any one inlier left out.
        singular_values: of the centred inliers in the source, decreasing.
    """

    similarity: Similarity
    inlier: NDArray[np.bool_]
    residual: Array
    sigma: float
    scale_sigma: float
    scale_interval: tuple[float, float]
    leave_one_out: tuple[float, float]
    singular_values: Array


def umeyama(source: Array, target: Array) -> Similarity:
    """The similarity with the least sum of |target_i - (s R source_i + t)|^2; det R = +1.

    With the singular values U D V' of the cross-covariance sum y_i x_i' of centred points,
    R = U S V', s = trace(D S) / sum |x_i|^2, S = diag(1, 1, det U det V).
    Source: Umeyama 1991, eq. 40 to 42.

    Args:
        source: shape (n, 3), at least three points that are not collinear.
        target: shape (n, 3).
    """
    x, y = source - source.mean(axis=0), target - target.mean(axis=0)
    scale, rotation = _from_moments(y.T @ x, (x * x).sum())
    translation = target.mean(axis=0) - scale * rotation @ source.mean(axis=0)
    return Similarity(scale=float(scale), rotation=rotation.tolist(), translation_m=translation.tolist())


def _from_moments(cross: Array, spread: Any) -> tuple[Array, Array]:
    """Scale and rotation from cross-covariances (..., 3, 3) and sums of squares (...) of the source."""
    u, d, vt = np.linalg.svd(cross)
    sign = np.where(np.linalg.det(u) * np.linalg.det(vt) < 0, -1.0, 1.0)
    d[..., 2] *= sign
    u[..., :, 2] *= sign[..., None]
    scale: Array = d.sum(axis=-1) / spread
    return scale, u @ vt


def transform_points(similarity: Similarity, points: NDArray[Any]) -> Array:
    """Scale R p + t for points of shape (n, 3), in double precision."""
    moved: Array = np.asarray(points, np.float64) @ np.array(similarity.rotation).T
    moved = similarity.scale * moved + np.array(similarity.translation_m)
    return moved


def compose(second: Similarity, first: Similarity) -> Similarity:
    """The similarity that applies `first`, then `second`."""
    return Similarity(
        scale=second.scale * first.scale,
        rotation=(np.array(second.rotation) @ np.array(first.rotation)).tolist(),
        translation_m=transform_points(second, np.array([first.translation_m]))[0].tolist(),
    )


def fit_similarity(source: Array, target: Array, threshold: float, seed: int) -> Fit:
    """Find the similarity that most correspondences agree on, then fit it to those.

    Three correspondences at a time (all triples, or 2000 random ones) propose a similarity; the one
    with the least sum of min(residual, threshold)^2 wins, and least squares on its inliers is
    repeated until they no longer change. The result depends on the arguments only.

    Args:
        source: shape (n, 3), any units.
        target: shape (n, 3) [m].
        threshold: largest residual of an inlier [m].
        seed: of the random triples.

    Raises:
        InputError: fewer than three points, collinear ones, or sets that are mirror images.
    """
    if len(source) < 3:
        raise InputError(f"{len(source)} correspondences; three that are not collinear are needed")
    for name, points in (("scene", source), ("world", target)):
        if _is_collinear(points):
            raise InputError(f"all {len(points)} points are collinear in the {name}; the rotation is unknown")
    inlier = _consensus(source, target, threshold, seed)
    _refuse_mirrored(source, target, inlier, threshold, seed)
    if inlier.sum() < 3:
        raise InputError(f"no three of {len(source)} correspondences agree within {threshold:g} m")
    if _is_collinear(source[inlier]):
        raise InputError(
            f"the {inlier.sum()} correspondences that agree are collinear; the rotation is unknown"
        )
    return _evaluate(source, target, inlier)


def _is_collinear(points: Array) -> bool:
    singular = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(singular[1] <= _COLLINEAR * singular[0])


def _consensus(source: Array, target: Array, threshold: float, seed: int) -> NDArray[np.bool_]:
    """Inliers of the best proposal after refitting."""
    scale, rotation, translation = _proposals(source, target, seed)
    limit = threshold * threshold
    best, best_cost = 0, np.inf
    for start in range(0, len(scale), _BATCH):
        part = slice(start, start + _BATCH)
        moved = scale[part, None, None] * (source @ rotation[part].swapaxes(1, 2)) + translation[part, None]
        cost = np.minimum(((moved - target) ** 2).sum(axis=2), limit).sum(axis=1)
        lowest = int(np.argmin(cost))
        if cost[lowest] < best_cost:
            best, best_cost = start + lowest, float(cost[lowest])
    if not np.isfinite(best_cost):
        return np.zeros(len(source), np.bool_)
    squared = ((scale[best] * source @ rotation[best].T + translation[best] - target) ** 2).sum(axis=1)
    inlier: NDArray[np.bool_] = squared <= limit
    for _ in range(_REFITS):
        if inlier.sum() < 3 or _is_collinear(source[inlier]):
            break
        similarity = umeyama(source[inlier], target[inlier])
        squared = ((transform_points(similarity, source) - target) ** 2).sum(axis=1)
        again = squared <= limit
        if (again == inlier).all():
            break
        inlier = again
    return inlier


def _proposals(source: Array, target: Array, seed: int) -> tuple[Array, Array, Array]:
    """Similarities of triples: scales, rotations, translations; degenerate triples are left out."""
    count = len(source)
    if comb(count, 3) <= _TRIALS:
        triples = np.array(list(combinations(range(count), 3)))
    else:
        drawn = np.random.default_rng(seed).integers(0, count, (2 * _TRIALS, 3))
        a, b, c = drawn.T
        triples = drawn[(a != b) & (b != c) & (a != c)][:_TRIALS]
    x, y = source[triples], target[triples]
    x_mean, y_mean = x.mean(axis=1), y.mean(axis=1)
    x, y = x - x_mean[:, None], y - y_mean[:, None]
    singular = np.linalg.svd(x, compute_uv=False)
    sound = singular[:, 1] > _COLLINEAR * singular[:, 0]
    x, y, x_mean, y_mean = x[sound], y[sound], x_mean[sound], y_mean[sound]
    scale, rotation = _from_moments(y.swapaxes(1, 2) @ x, (x * x).sum(axis=(1, 2)))
    translation = y_mean - scale[:, None] * (rotation @ x_mean[:, :, None])[:, :, 0]
    return scale, rotation, translation


def _refuse_mirrored(
    source: Array, target: Array, inlier: NDArray[np.bool_], threshold: float, seed: int
) -> None:
    """A reflection that clearly explains more than every proper similarity means a mirrored set."""
    mirror = source * np.array([-1.0, 1.0, 1.0])
    singular = np.linalg.svd(source - source.mean(axis=0), compute_uv=False)
    if singular[2] <= _COLLINEAR * singular[0]:
        return  # a plane equals its mirror image
    other = _consensus(mirror, target, threshold, seed)
    more = other.sum() - inlier.sum() >= max(1, len(source) // 10)
    if not more and other.sum() >= inlier.sum() >= 5:
        proper, reflected = (
            float((r * r).mean())
            for r in (_residual(source[inlier], target[inlier]), _residual(mirror[other], target[other]))
        )
        more = reflected < proper / 9
    if more:
        raise InputError(
            f"the points are mirror images: a reflection explains {other.sum()} of {len(source)}, a rotation "
            f"{inlier.sum()}; negate one axis of one set, or swap two of its columns"
        )


def _residual(source: Array, target: Array) -> Array:
    residual: Array = np.linalg.norm(transform_points(umeyama(source, target), source) - target, axis=1)
    return residual


def _evaluate(source: Array, target: Array, inlier: NDArray[np.bool_]) -> Fit:
    from scipy.stats import t as student

    x, y = source[inlier], target[inlier]
    similarity = umeyama(x, y)
    residual = np.linalg.norm(transform_points(similarity, source) - target, axis=1)
    freedom = 3 * len(x) - 7
    sigma = float(np.sqrt((residual[inlier] ** 2).sum() / freedom))
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    spread = float((x * x).sum())
    scale_sigma = sigma / float(np.sqrt(spread))
    half = float(student.ppf((1 + CONFIDENCE) / 2, freedom)) * scale_sigma

    without = (similarity.scale, similarity.scale)
    if len(x) > 3:  # moments of all but one: the mean moves too, hence m / (m - 1)
        weight = len(x) / (len(x) - 1)
        cross = y.T @ x - weight * y[:, :, None] * x[:, None, :]
        scales, _ = _from_moments(cross, spread - weight * (x * x).sum(axis=1))
        without = (float(scales.min()), float(scales.max()))
    return Fit(
        similarity=similarity,
        inlier=inlier,
        residual=residual,
        sigma=sigma,
        scale_sigma=scale_sigma,
        scale_interval=(similarity.scale - half, similarity.scale + half),
        leave_one_out=without,
        singular_values=np.linalg.svd(x, compute_uv=False),
    )


def position_error(fit: Fit, source: Array, corners: Array) -> float:
    """How far any point of a box may be off, with 95 % confidence for all of the box at once.

    With the mapped, centred inliers y_i and d a point relative to their mean, the covariance of its
    error is sigma^2 (I / m + d d' / sum |y_i|^2 + [d] inv(sum |y_i|^2 I - y_i y_i') [d]'), the terms of
    translation, scale and rotation. Its largest eigenvalue is convex in d, so a corner has the
    largest of the box; sqrt(7 F) of its root bounds the error (F: 7 and 3 m - 7 degrees of freedom).
    Source: Scheffe 1959, simultaneous intervals for a linear model.

    Args:
        fit: of `source`.
        source: all points of the fit, shape (n, 3).
        corners: of the box, shape (8, 3), source units.

    Returns:
        The bound [target units].
    """
    from scipy.stats import f as fisher

    inliers = transform_points(fit.similarity, source[fit.inlier])
    centre = inliers.mean(axis=0)
    y, d = inliers - centre, transform_points(fit.similarity, corners) - centre
    spread = float((y * y).sum())
    inverse = np.linalg.inv(spread * np.eye(3) - y.T @ y)
    zero = np.zeros(len(d))
    cross = np.stack([zero, -d[:, 2], d[:, 1], d[:, 2], zero, -d[:, 0], -d[:, 1], d[:, 0], zero], axis=1)
    cross = cross.reshape(-1, 3, 3)
    covariance = np.eye(3) / len(y) + d[:, :, None] * d[:, None, :] / spread
    covariance = covariance + cross @ inverse @ cross.swapaxes(1, 2)
    largest = float(np.linalg.eigvalsh(covariance)[:, -1].max())
    factor = 7.0 * float(fisher.ppf(CONFIDENCE, 7, 3 * len(y) - 7))
    return fit.sigma * float(np.sqrt(factor * largest))


def shape_warnings(fit: Fit) -> list[str]:
    """What is weak about the arrangement of the inliers."""
    first, second, third = fit.singular_values
    ratio = "singular values " + ", ".join(f"{value:.3g}" for value in fit.singular_values)
    if second < _FLAT * first:
        return [f"the correspondences are nearly collinear ({ratio}): rotation about the line is weak"]
    if third < _FLAT * first:
        return [f"the correspondences are nearly planar ({ratio}): a mirrored set would not be noticed"]
    return []
