"""Uncertainty of a similarity: confidence intervals of its parameters and of the positions that it maps."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.stages.alignment.similarity import transform_points
from alula.stages.quantiles import fisher_quantile, student_quantile

CONFIDENCE = 0.95
_WIDEST = 2 / 3  # of the threshold: residuals below the threshold cannot distinguish larger sigmas
_CORRELATED = 0.3  # correlation of neighbours' residuals that causes a warning, if above 4 standard errors
_FLAT = 0.05  # smallest over largest singular value below this: nearly a plane, or a line


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """First-order error model of a similarity around one point.

    A mapped point at the offset d from `centre` has the error tau + d lambda + omega x d, where tau is the
    error of the centre, lambda that of the scale's logarithm and omega that of the rotation, as a vector.

    Attributes:
        centre: shape (3,), target frame.
        covariance: covariance of (tau, lambda, omega), shape (7, 7); units of the target, 1 and rad.
        freedom: degrees of freedom of the estimate of that covariance.
    """

    centre: FloatArray
    covariance: FloatArray
    freedom: float

    def student(self) -> float:
        """Half width of a two-sided 95 % interval, in standard deviations."""
        return student_quantile(self.freedom, (1 + CONFIDENCE) / 2)

    def at(self, points: FloatArray) -> FloatArray:
        """Covariances of the positions of mapped points.

        Args:
            points: mapped points, shape (n, 3), target frame.

        Returns:
            Shape (n, 3, 3) [target units squared].
        """
        d = points - self.centre
        zero = np.zeros(len(d))
        rows = [
            np.stack([d[:, 0], zero, d[:, 2], -d[:, 1]], axis=1),
            np.stack([d[:, 1], -d[:, 2], zero, d[:, 0]], axis=1),
            np.stack([d[:, 2], d[:, 1], -d[:, 0], zero], axis=1),
        ]
        identity = np.broadcast_to(np.eye(3), (len(d), 3, 3))
        jacobian = np.concatenate([identity, np.stack(rows, axis=1)], axis=2)
        covariance: FloatArray = jacobian @ self.covariance @ jacobian.swapaxes(1, 2)
        return covariance

    def position_error(self, corners: FloatArray) -> float:
        """Bound of the position error of every point of a box, with 95 % confidence for all of them at once.

        The largest eigenvalue of a point's covariance is convex in the point, so a corner of the box has
        the maximum. The square root of that maximum times 7 F (7 and `freedom` degrees of freedom) bounds
        the error. Source: Scheffe 1959, simultaneous intervals for a linear model.

        Args:
            corners: mapped corners of the box, shape (8, 3), target frame.

        Returns:
            The bound [target units].
        """
        largest = float(np.linalg.eigvalsh(self.at(corners))[:, -1].max())
        factor = 7.0 * fisher_quantile((7, self.freedom), CONFIDENCE)
        return float(np.sqrt(max(factor * largest, 0.0)))

    def record(self, similarity: Similarity) -> dict[str, Any]:
        """Standard deviations and 95 % half widths for the alignment's record, one per component.

        The rotation's components are about the axes of the target frame; the translation is the mapped
        position of the source's origin.
        """
        student = self.student()
        scale_sigma = similarity.scale * float(np.sqrt(self.covariance[3, 3]))
        omega = np.sqrt(np.diag(self.covariance)[4:]) * 180 / pi
        origin = np.sqrt(np.diag(self.at(np.array([similarity.translation_m]))[0]))
        return {
            "scale_sigma": scale_sigma,
            "scale_interval": [
                similarity.scale - student * scale_sigma,
                similarity.scale + student * scale_sigma,
            ],
            "rotation_sigma_deg": omega.tolist(),
            "rotation_interval_deg": (student * omega).tolist(),
            "translation_sigma_m": origin.tolist(),
            "translation_interval_m": (student * origin).tolist(),
            "freedom": self.freedom,
        }


def uncertainty_of_points(
    mapped: FloatArray,
    sigma: float,
    freedom: float,
    rotation_information: float = 0.0,
    *,
    positions_turn: bool = True,
) -> Uncertainty:
    """Uncertainty of the least-squares similarity onto points with independent errors.

    With mapped, centred points y_i the covariance is sigma^2 I / m for the centre, sigma^2 / sum |y_i|^2 for
    the logarithm of the scale, and inv(sum (|y_i|^2 I - y_i y_i') / sigma^2 + i I) for the rotation, where i
    is `rotation_information`.

    Args:
        mapped: the source points in the target frame, shape (m, 3).
        sigma: standard deviation of one coordinate [target units].
        freedom: degrees of freedom of `sigma`.
        rotation_information: information on each angle of the rotation from other evidence [1/rad^2].
        positions_turn: whether the points contribute to the rotation.
    """
    centre = mapped.mean(axis=0)
    y = mapped - centre
    spread = float((y * y).sum())
    covariance = np.zeros((7, 7))
    covariance[:3, :3] = sigma**2 / len(y) * np.eye(3)
    covariance[3, 3] = sigma**2 / spread
    if positions_turn:  # multiplied by sigma^2: exact data have none
        turning = spread * np.eye(3) - y.T @ y + sigma**2 * rotation_information * np.eye(3)
        covariance[4:, 4:] = sigma**2 * np.linalg.inv(turning)
    else:
        covariance[4:, 4:] = np.eye(3) / rotation_information
    return Uncertainty(centre, covariance, freedom)


@dataclass(frozen=True, slots=True)
class Spread:
    """Standard deviations of one coordinate of errors that were truncated at a threshold.

    Attributes:
        error: standard deviation before the truncation, at most 2/3 of the threshold.
        fit: standard deviation of independent errors that would make least squares as uncertain as this fit.
        freedom: degrees of freedom of `fit`.
    """

    error: float
    fit: float
    freedom: float


def untruncated(sigma: float, freedom: float, threshold: float) -> Spread:
    """Correct the standard deviation of residuals for their truncation at a threshold.

    Let F_k be the distribution function of chi^2_k at (threshold / sigma)^2. Normal errors in space that
    are shorter than the threshold have the variance sigma^2 F_5 / F_3 per coordinate. A fit to its own
    inliers is an M-estimate: its variance is that of least squares on as many errors of variance
    sigma^2 F_3 / F_5, because errors near the threshold become outliers instead of pulling the fit back.
    The degrees of freedom decrease according to the fourth moment, 15 F_7 / F_3, by the delta method.
    Source: Huber 1981, section 6.3 (asymptotic variance E psi^2 / (E psi')^2), with psi(r) = r inside.

    Args:
        sigma: standard deviation of one coordinate of the residuals below the threshold.
        freedom: degrees of freedom of `sigma`.
        threshold: maximum length of a residual, in the unit of `sigma`.

    Returns:
        The corrected standard deviations, in the unit of `sigma`.
    """
    if sigma < threshold / 20:
        return Spread(sigma, sigma, freedom)
    from scipy.optimize import brentq
    from scipy.special import gammainc

    def F(k: int, true: float) -> float:
        return float(gammainc(k / 2, 0.5 * (threshold / true) ** 2))

    def variance_ratio(true: float) -> float:
        return F(5, true) / F(3, true)

    def truncated(true: float) -> float:
        return true * float(np.sqrt(variance_ratio(true)))

    true = widest = _WIDEST * threshold
    if sigma < truncated(widest):
        true = float(brentq(lambda x: truncated(x) - sigma, sigma / 2, widest, xtol=1e-12 * threshold))
    slope = np.log(variance_ratio(1.001 * true) / variance_ratio(0.999 * true)) / np.log(1.001 / 0.999)
    gain = (1 - slope / 2) / (1 + slope / 2)  # d log fit / d log truncated
    moment = 15 * F(7, true) * F(3, true) / (9 * F(5, true) ** 2) - 1  # of r^2; 2/3 without truncation
    return Spread(
        true,
        true / float(np.sqrt(variance_ratio(true))),
        float(max(1.0, freedom * (2 / 3) / (moment * gain**2))),
    )


def shape_warnings(singular_values: FloatArray) -> list[str]:
    """Warnings about an arrangement of points that is nearly a line or a plane.

    Args:
        singular_values: of the centred points, decreasing, shape (3,).
    """
    first, second, third = singular_values
    ratio = "singular values " + ", ".join(f"{value:.3g}" for value in singular_values)
    if second < _FLAT * first:
        return [f"the correspondences are nearly collinear ({ratio}): rotation about the line is weak"]
    if third < _FLAT * first:
        return [f"the correspondences are nearly planar ({ratio}): a mirrored set would not be noticed"]
    return []


def correlation_warnings(where: FloatArray, error: FloatArray) -> list[str]:
    """Warning that the errors of neighbouring points are correlated, as those of a drift are.

    The statistic is the mean of e_i . e_j over the nearest neighbours j of i, relative to the mean of
    e_i . e_i. For independent errors e its standard deviation is at most about sqrt(2 / (3 n)), which is
    reached when all pairs count twice.

    Args:
        where: positions, shape (n, 3).
        error: residuals as vectors, shape (n, 3).
    """
    from scipy.spatial import cKDTree

    square = float((error * error).sum())
    if square <= 0 or len(where) < 3:
        return []
    near = cKDTree(where).query(where, k=2)[1][:, 1]
    correlation = float((error * error[near]).sum()) / square
    if correlation <= max(_CORRELATED, 4 * np.sqrt(2 / (3 * len(where)))):
        return []
    return [
        f"residuals of neighbours are alike (correlation {correlation:.2f}), as when one side drifts: errors "
        "are not independent; intervals and the position error were widened for it"
    ]


def mapped_corners(similarity: Similarity, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Mapped corners of an axis-aligned box.

    Args:
        similarity: target from source.
        lower: smallest coordinates of the box, shape (3,), source frame and units.
        upper: largest coordinates of the box, shape (3,), source frame and units.

    Returns:
        Shape (8, 3), target frame.
    """
    from itertools import product

    return transform_points(similarity, np.array(list(product(*zip(lower, upper, strict=True)))))
