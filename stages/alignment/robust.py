"""Robust estimation of a similarity from point correspondences: MSAC, then least squares on the inliers.

MSAC (M-estimator sample consensus) is RANSAC with the truncated quadratic cost: it draws minimal samples as
RANSAC does, but rates a proposal by sum min(residual^2, threshold^2) and not by the number of its inliers.
Source: Fischler and Bolles 1981 (RANSAC); Torr and Zisserman 2000 (MSAC).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from math import comb, log

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.errors import InputError
from alula.stages.alignment.correlation import CORRELATED, disagreement, with_correlation
from alula.stages.alignment.similarity import COLLINEAR, from_moments, is_collinear, transform_points, umeyama
from alula.stages.alignment.uncertainty import (
    Uncertainty,
    correlation_warnings,
    shape_warnings,
    uncertainty_of_points,
    untruncated,
)

_MAX_SAMPLES = 2000
_BATCH_SAMPLES = 200
_SCORED_POINTS = 500  # maximum number of points that rank the proposals
_KEPT_PROPOSALS = 4  # the best proposals, which are refitted to their inliers
_REFITS = 30
_MISS_PROBABILITY = 1e-9  # that no sample is free of outliers


@dataclass(frozen=True, slots=True)
class Fit:
    """A fitted similarity with its residuals and its uncertainty.

    Attributes:
        similarity: target = scale R source + t.
        inlier: mask of the inliers, shape (n,).
        residual: distance of each target from its mapped source, shape (n,) [target units].
        sigma: standard deviation of one coordinate of an inlier's error, corrected for the threshold.
        leave_one_out: smallest and largest scale with any one inlier left out.
        singular_values: of the centred inliers in the source, decreasing.
        angle: angle between each target's orientation and its mapped source's [rad], shape (n,); None for
            points without orientations.
        correlated: probability that the errors of neighbours are correlated; the uncertainty contains it.
    """

    similarity: Similarity
    inlier: NDArray[np.bool_]
    residual: FloatArray
    sigma: float
    uncertainty: Uncertainty
    leave_one_out: tuple[float, float]
    singular_values: FloatArray
    angle: FloatArray | None = None
    correlated: float = 0.0
    warnings: tuple[str, ...] = ()


def fit_similarity(source: FloatArray, target: FloatArray, threshold: float, seed: int) -> Fit:
    """Estimate the similarity of the largest consistent set of correspondences by MSAC and least squares.

    Minimal samples of three correspondences (all triples, or up to 2000 random ones) propose similarities.
    The proposals with the smallest MSAC cost, sum min(residual, threshold)^2, are fitted by least squares to
    their inliers until these no longer change; the smallest cost wins. The result depends on the arguments
    only.

    The covariance assumes that the errors of the targets' coordinates are normal and of equal variance. It is
    corrected for the truncation of errors at the threshold (see `untruncated`) and for a correlation of
    neighbours' errors that the residuals show (see `with_correlation`).

    Args:
        source: points in the source frame, shape (n, 3), any units.
        target: the same points in the target frame, shape (n, 3) [m].
        threshold: maximum residual of an inlier [m].

    Returns:
        The fit to the inliers.

    Raises:
        InputError: fewer than three points, collinear ones, or sets that are mirror images.
    """
    if len(source) < 3:
        raise InputError(f"{len(source)} correspondences; three that are not collinear are needed")
    for name, points in (("scene", source), ("world", target)):
        if is_collinear(points):
            raise InputError(f"all {len(points)} points are collinear in the {name}; the rotation is unknown")
    inlier = _msac(source, target, threshold, seed)
    _refuse_mirrored(source, target, inlier, threshold, seed)
    if inlier.sum() < 3:
        raise InputError(
            f"no three of {len(source)} correspondences agree within {threshold:g} m (--threshold)"
        )
    if is_collinear(source[inlier]):
        raise InputError(
            f"the {inlier.sum()} correspondences that agree are collinear; the rotation is unknown"
        )
    return _evaluate(source, target, inlier, threshold)


def _squared_residuals(source: FloatArray, target: FloatArray, similarity: Similarity) -> FloatArray:
    squared: FloatArray = ((transform_points(similarity, source) - target) ** 2).sum(axis=1)
    return squared


def _msac(
    source: FloatArray, target: FloatArray, threshold: float, seed: int, min_fraction: float = 0.0
) -> NDArray[np.bool_]:
    """Inliers of the MSAC proposal with the smallest cost after refitting, shape (n,).

    Sampling ends early when a better proposal with at least the best inlier fraction so far, or
    `min_fraction` if that is larger, would have been missed with a probability below 1e-9.
    """
    rng = np.random.default_rng(seed)
    limit = threshold * threshold
    scored = (
        slice(None)
        if len(source) <= _SCORED_POINTS
        else np.sort(rng.permutation(len(source))[:_SCORED_POINTS])
    )
    x, y = source[scored], target[scored]
    triples = _minimal_samples(len(source), rng)
    found: list[tuple[float, int, Similarity]] = []
    tried = 0
    for start in range(0, len(triples), _BATCH_SAMPLES):
        scale, rotation, translation = _proposals(source, target, triples[start : start + _BATCH_SAMPLES])
        tried += len(scale)
        if not len(scale):
            continue
        moved = scale[:, None, None] * (x @ rotation.swapaxes(1, 2)) + translation[:, None]
        cost = np.minimum(((moved - y) ** 2).sum(axis=2), limit).sum(axis=1)
        for i in np.argsort(cost, kind="stable")[:_KEPT_PROPOSALS].tolist():
            proposal = Similarity(
                scale=float(scale[i]), rotation=rotation[i].tolist(), translation_m=translation[i].tolist()
            )
            found.append((float(cost[i]), start + i, proposal))
        found = sorted(found, key=lambda entry: entry[:2])[:_KEPT_PROPOSALS]
        # The cost bounds the best proposal's inlier fraction from below. After this many samples, all of
        # them had an outlier with a probability of (1 - fraction^3)^tried only.
        inlier_fraction = max(min_fraction, 1 - found[0][0] / (limit * len(x)))
        if tried * -log(max(1 - inlier_fraction**3, 1e-300)) > -log(_MISS_PROBABILITY):
            break
    best, best_cost = np.zeros(len(source), np.bool_), np.inf
    for _, _, proposal in found:
        inlier, refitted_cost = _refitted(source, target, limit, proposal)
        if refitted_cost < best_cost:
            best, best_cost = inlier, refitted_cost
    return best


def _refitted(
    source: FloatArray, target: FloatArray, limit: float, proposal: Similarity
) -> tuple[NDArray[np.bool_], float]:
    """Inliers after refitting until they no longer change, and the MSAC cost."""
    squared = _squared_residuals(source, target, proposal)
    inlier: NDArray[np.bool_] = squared <= limit
    for _ in range(_REFITS):
        if inlier.sum() < 3 or is_collinear(source[inlier]):
            break
        squared = _squared_residuals(source, target, umeyama(source[inlier], target[inlier]))
        again = squared <= limit
        if (again == inlier).all():
            break
        inlier = again
    return inlier, float(np.minimum(squared, limit).sum())


def _minimal_samples(count: int, rng: np.random.Generator) -> NDArray[np.intp]:
    if comb(count, 3) <= _MAX_SAMPLES:
        every = np.array(list(combinations(range(count), 3)))
        return every[rng.permutation(len(every))]
    drawn = rng.integers(0, count, (2 * _MAX_SAMPLES, 3))
    a, b, c = drawn.T
    distinct: NDArray[np.intp] = drawn[(a != b) & (b != c) & (a != c)][:_MAX_SAMPLES]
    return distinct


def _proposals(
    source: FloatArray, target: FloatArray, triples: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Similarities of minimal samples: scales, rotations, translations; degenerate triples are left out."""
    x, y = source[triples], target[triples]
    x_mean, y_mean = x.mean(axis=1), y.mean(axis=1)
    x, y = x - x_mean[:, None], y - y_mean[:, None]
    singular_values = np.linalg.svd(x, compute_uv=False)
    usable = singular_values[:, 1] > COLLINEAR * singular_values[:, 0]
    x, y, x_mean, y_mean = x[usable], y[usable], x_mean[usable], y_mean[usable]
    scale, rotation = from_moments(y.swapaxes(1, 2) @ x, (x * x).sum(axis=(1, 2)))
    positive = scale > 0
    scale, rotation, x_mean, y_mean = scale[positive], rotation[positive], x_mean[positive], y_mean[positive]
    translation = y_mean - scale[:, None] * (rotation @ x_mean[:, :, None])[:, :, 0]
    return scale, rotation, translation


def _refuse_mirrored(
    source: FloatArray, target: FloatArray, inlier: NDArray[np.bool_], threshold: float, seed: int
) -> None:
    """Refuse sets for which a reflection clearly explains more points than every proper similarity."""
    mirror = source * np.array([-1.0, 1.0, 1.0])
    singular_values = np.linalg.svd(source - source.mean(axis=0), compute_uv=False)
    if singular_values[2] <= COLLINEAR * singular_values[0]:
        return  # a plane equals its mirror image
    other = _msac(mirror, target, threshold, seed, inlier.mean())
    more = other.sum() - inlier.sum() >= max(1, len(source) // 10)
    if not more and other.sum() >= inlier.sum() >= 5:
        proper, reflected = (
            float(
                _squared_residuals(points[which], target[which], umeyama(points[which], target[which])).mean()
            )
            for points, which in ((source, inlier), (mirror, other))
        )
        more = reflected < proper / 9
    if more:
        raise InputError(
            f"the points are mirror images: a reflection explains {other.sum()} of {len(source)}, a rotation "
            f"{inlier.sum()}; negate one axis of one set, or swap two of its columns"
        )


def _evaluate(source: FloatArray, target: FloatArray, inlier: NDArray[np.bool_], threshold: float) -> Fit:
    x, y = source[inlier], target[inlier]
    similarity = umeyama(x, y)
    residual = np.sqrt(_squared_residuals(source, target, similarity))
    freedom = 3 * len(x) - 7
    observed = float(np.sqrt((residual[inlier] ** 2).sum() / freedom))
    spread = untruncated(observed, freedom, threshold)
    singular_values = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
    mapped = transform_points(similarity, x)
    independent = uncertainty_of_points(mapped, spread.fit, spread.freedom)
    uncertainty, correlated = with_correlation(independent, mapped, mapped - y, spread.fit)
    parts = disagreement(mapped, y, spread.fit) if correlated > CORRELATED else None
    if parts is not None:
        uncertainty = replace(uncertainty, covariance=parts.factor * uncertainty.covariance)
    return Fit(
        similarity=similarity,
        inlier=inlier,
        residual=residual,
        sigma=spread.error,
        uncertainty=uncertainty,
        leave_one_out=leave_one_out(x, y, similarity.scale),
        singular_values=singular_values,
        correlated=correlated,
        warnings=(
            *shape_warnings(singular_values),
            *threshold_warnings(spread.error, threshold),
            *correlation_warnings(x, mapped - y),
            *(() if parts is None else (parts.warning(),)),
        ),
    )


def leave_one_out(x: FloatArray, y: FloatArray, scale: float) -> tuple[float, float]:
    """Smallest and largest scale with one correspondence left out.

    Args:
        x: source points of the inliers, shape (m, 3).
        y: target points of the inliers, shape (m, 3).
        scale: the scale fitted to all of them, which is returned twice when there are only three.

    Returns:
        The smallest and the largest scale [target units per source unit].
    """
    if len(x) <= 3:
        return scale, scale
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    weight = len(x) / (len(x) - 1)  # leaving out a point moves the mean too
    cross = y.T @ x - weight * y[:, :, None] * x[:, None, :]
    scales, _ = from_moments(cross, (x * x).sum() - weight * (x * x).sum(axis=1))
    return float(scales.min()), float(scales.max())


def threshold_warnings(sigma: float, threshold: float) -> list[str]:
    """Warning that the residuals reach the threshold, so that it cuts off good correspondences.

    Args:
        sigma: standard deviation of one coordinate of an inlier's error [m].
        threshold: maximum residual of an inlier [m].
    """
    if sigma <= threshold / 2.5:
        return []
    return [
        f"residuals fill the threshold of {threshold:g} m (sigma of a coordinate is {sigma:.3g} m): good "
        "correspondences were left out and intervals are too narrow; raise --threshold"
    ]
