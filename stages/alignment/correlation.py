"""Uncertainty of a similarity when the errors of neighbouring correspondences are correlated, as in a drift.

A drift along a camera's path moves neighbours alike, so n positions have fewer than n independent errors. The
residuals do not show the part of the drift that looks like a similarity. Restricted maximum likelihood (REML)
takes this into account when it estimates the correlation from the residuals.
Source: Patterson and Thompson 1971 (REML); Conley 1999 (covariance of least squares under correlated errors).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.alignment.similarity import is_collinear, transform_points, umeyama
from alula.stages.alignment.uncertainty import Uncertainty, uncertainty_of_points
from alula.stages.quantiles import fisher_quantile

CORRELATED = 1 / 3  # probability up to which errors count as independent
_MIN_POINTS = 5
_MOST_PARTS, _MIN_PART = 4, 12  # of a path whose scales are compared, and points of each
_DISAGREE = 0.99  # probability below which parts of one similarity agree
_MIN_FREEDOM = 4.0
_MAX_POINTS = 150  # evenly spaced along the path; they determine the correlation
_LENGTHS = (0.02, 0.05, 0.12, 0.3, 0.8, 2.0)  # of the extent of the path, and of the points
_SHARES = (0.3, 0.6, 0.85, 0.97, 1.0)  # of the variance, that is correlated


def with_correlation(
    base: Uncertainty, mapped: FloatArray, error: FloatArray, sigma: float
) -> tuple[Uncertainty, float]:
    """Add the covariance that correlated errors of neighbours cause.

    Errors have the covariance sigma^2 (p exp(-d_ij / l) + (1 - p) I). d is the distance in space, or the
    difference of the rows' numbers (cameras are listed along their path). Each (p, l, d) of a grid has the
    restricted likelihood of the residuals; independent errors have half of the prior probability. The result
    is the mean over that posterior of the covariance of least squares. It is never below `base`, and the
    degrees of freedom decrease as the covariance grows. Up to a probability of 1/3 the errors count as
    independent: a long correlation, which few residuals cannot exclude, makes the mean of all errors unknown.

    Args:
        base: uncertainty for independent errors.
        mapped: the source points in the target frame, in the order of their rows, shape (m, 3).
        error: residuals as vectors, shape (m, 3).
        sigma: standard deviation of one coordinate that `base` was made with.

    Returns:
        The uncertainty, and the posterior probability that the errors are correlated.
    """
    count = len(mapped)
    if count < _MIN_POINTS or not sigma > 0:
        return base, 0.0
    chosen = np.unique(np.linspace(0, count - 1, min(count, _MAX_POINTS)).round().astype(np.intp))
    d, e = mapped[chosen] - base.centre, error[chosen]
    jacobian = _jacobian(d)
    alone = _likelihood(np.eye(len(d)), np.ones(len(d)), jacobian, e)
    if alone is None:
        return base, 0.0
    # Few points represent all: the sums over i and j of the covariance scale with the number of points.
    ratio = count / len(chosen)
    inverse = base.covariance / sigma**2
    corrected = sigma**2 / alone[1]  # `base` is corrected for the threshold
    own = ratio * np.einsum("iak,ial->kl", jacobian, jacobian)
    gains, found_covariances = [], []
    space = np.linalg.norm(d[:, None] - d[None], axis=2)
    path = np.abs(chosen[:, None] - chosen[None]).astype(np.float64)
    for distance in (space / space.max(), path / path.max()):
        for length in _LENGTHS:
            kernel = np.exp(-distance / length)
            values, vectors = np.linalg.eigh(kernel)
            off = kernel - np.eye(len(kernel))
            between = np.einsum("iak,ij,jal->kl", jacobian, off, jacobian, optimize=True)
            for share in _SHARES:
                found = _likelihood(vectors, share * np.maximum(values, 0) + 1 - share, jacobian, e)
                if found is not None:
                    gains.append(found[0] - alone[0])
                    total = own + share * ratio**2 * between
                    found_covariances.append(corrected * found[1] * inverse @ total @ inverse)
    top = max(0.0, *gains)
    weight = np.exp(np.array(gains) - top)
    odds = float(weight.mean()), float(np.exp(-top))
    probability = odds[0] / (odds[0] + odds[1])
    mean = np.einsum("k,kij->ij", weight / weight.sum(), np.array(found_covariances))
    added = max(0.0, (probability - CORRELATED) / (1 - CORRELATED)) * _positive(
        mean - base.covariance, base.covariance
    )
    covariance = base.covariance + added
    # Correlated errors are as good as fewer independent ones.
    fewer = float((np.diag(base.covariance) / np.diag(covariance)).mean())
    freedom = max(base.freedom * fewer, min(base.freedom, _MIN_FREEDOM))
    return Uncertainty(base.centre, covariance, freedom), probability


@dataclass(frozen=True, slots=True)
class Disagreement:
    """Scales of the parts of a path that differ by more than their errors allow.

    Attributes:
        factor: by which a covariance that assumes one similarity is too small, above 1.
        scales: scale of each part over that of the whole.
        sigmas: standard deviation of each.
    """

    factor: float
    scales: tuple[float, ...]
    sigmas: tuple[float, ...]

    def warning(self) -> str:
        """The disagreement in one sentence."""
        parts = ", ".join(f"{s:.5g} +- {e:.2g}" for s, e in zip(self.scales, self.sigmas, strict=True))
        return (
            f"the parts of the path have different scales ({parts} times that of the whole): the evidence "
            "drifts, which no single similarity describes; intervals and the position error grew by a factor "
            f"of {self.factor**0.5:.2g}, but a place may be off by more"
        )


def disagreement(mapped: FloatArray, target: FloatArray, sigma: float) -> Disagreement | None:
    """Compare the scales of consecutive parts of a path, each with its correlated errors.

    Q = sum (log s_b - mean)^2 / v_b over B parts, with the mean weighted by 1 / v_b, follows (B - 1) F for
    one similarity, and the square of the trend along the path over its variance follows F with one degree of
    freedom. Where one exceeds its 99 % quantile, the parts disagree; covariances then grow by the larger of
    Q / (B - 1) and the trend's square.
    Source: Birge 1932 (consistency of measurements).

    Args:
        mapped: the source points in the target frame, in the order of their rows, shape (m, 3).
        target: the same points as measured, shape (m, 3).
        sigma: standard deviation of one coordinate of the target's errors.

    Returns:
        None where the parts agree, or are too few.
    """
    count = min(_MOST_PARTS, len(mapped) // _MIN_PART)
    if count < 2 or not sigma > 0:
        return None
    logs, variances, freedoms = [], [], []
    for rows in np.array_split(np.arange(len(mapped)), count):
        x, y = mapped[rows], target[rows]
        if is_collinear(x):
            return None
        own = umeyama(x, y)
        moved = transform_points(own, x)
        freedom = 3.0 * len(x) - 7.0
        base = uncertainty_of_points(moved, sigma, freedom)
        found, _ = with_correlation(base, moved, moved - y, sigma)
        logs.append(np.log(own.scale))
        variances.append(found.covariance[3, 3])
        freedoms.append(found.freedom)
    log, variance = np.array(logs), np.array(variances)
    weight = 1 / variance
    off = log - float(weight @ log) / weight.sum()
    along = np.arange(count) - float(weight @ np.arange(count)) / weight.sum()
    q = float(weight @ off**2) / (count - 1)
    trend = float(weight @ (along * off)) ** 2 / float(weight @ along**2)
    freedom = float(np.mean(freedoms))
    if q <= fisher_quantile((count - 1, freedom), _DISAGREE) and trend <= fisher_quantile(
        (1, freedom), _DISAGREE
    ):
        return None
    return Disagreement(max(q, trend, 1.0), tuple(np.exp(log).tolist()), tuple(np.sqrt(variance).tolist()))


def _jacobian(d: FloatArray) -> FloatArray:
    """Derivatives of positions by the centre, the scale's logarithm and the rotation, shape (m, 3, 7)."""
    found = np.zeros((len(d), 3, 7))
    found[:, :, :3] = np.eye(3)
    found[:, :, 3] = d
    for axis in range(3):
        found[:, :, 4 + axis] = np.cross(np.eye(3)[axis], d)
    return found


def _likelihood(
    vectors: FloatArray, values: FloatArray, jacobian: FloatArray, error: FloatArray
) -> tuple[float, float] | None:
    """Logarithm of the restricted likelihood, and the variance of a coordinate that maximises it."""
    scale = 1 / np.sqrt(np.maximum(values, 1e-12))
    count = len(error)
    J = (scale[:, None] * (vectors.T @ jacobian.reshape(count, -1))).reshape(3 * count, 7)
    e = (scale[:, None] * (vectors.T @ error)).reshape(-1)
    # The columns differ in size by the unit of lengths; scaled ones keep the factorisation exact.
    size = np.linalg.norm(J, axis=0)
    if not (size > 0).all():
        return None
    q, r = np.linalg.qr(J / size)
    diagonal = np.abs(np.diag(r))
    if diagonal.min() < 1e-9:
        return None
    left = e - q @ (q.T @ e)
    freedom = len(e) - 7
    variance = float(left @ left) / freedom
    if not variance > 0:
        return None
    logs = float(np.log(diagonal).sum() + np.log(size).sum())
    value = -0.5 * freedom * np.log(variance) + 3 * float(np.log(scale).sum()) - logs
    return float(value), variance


def _positive(matrix: FloatArray, base: FloatArray) -> FloatArray:
    """The part of a symmetric matrix that increases variances, relative to the units of another one."""
    unit = np.sqrt(np.maximum(np.diag(base), 1e-300))
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2 / np.outer(unit, unit))
    found: FloatArray = (vectors * np.maximum(values, 0)) @ vectors.T * np.outer(unit, unit)
    return found
