"""Similarities between two point sets: closed-form fit, composition, inverse."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity

COLLINEAR = 1e-3  # second over first singular value below this: no rotation


def umeyama(source: FloatArray, target: FloatArray) -> Similarity:
    """Least-squares similarity: minimises sum |target_i - (s R source_i + t)|^2 with det R = +1.

    With the singular values U D V' of the cross-covariance sum y_i x_i' of centred points,
    R = U S V', s = trace(D S) / sum |x_i|^2, S = diag(1, 1, det U det V).
    Source: Umeyama 1991, eq. 40 to 42.

    Args:
        source: at least three points that are not collinear, shape (n, 3), source units.
        target: the same points in the target frame, shape (n, 3), target units.
    """
    x, y = source - source.mean(axis=0), target - target.mean(axis=0)
    scale, rotation = from_moments(y.T @ x, (x * x).sum())
    translation = target.mean(axis=0) - scale * rotation @ source.mean(axis=0)
    return Similarity(scale=float(scale), rotation=rotation.tolist(), translation_m=translation.tolist())


def from_moments(cross: FloatArray, spread: Any) -> tuple[FloatArray, FloatArray]:
    """Scale and rotation of least-squares similarities from the moments of the points (see `umeyama`).

    Args:
        cross: cross-covariances sum y_i x_i' of the centred points, shape (..., 3, 3).
        spread: sums of squares sum |x_i|^2 of the centred source points, shape (...).

    Returns:
        Scales, shape (...), and rotations, shape (..., 3, 3).
    """
    u, d, vt = np.linalg.svd(cross)
    sign = np.where(np.linalg.det(u) * np.linalg.det(vt) < 0, -1.0, 1.0)
    d[..., 2] *= sign
    u[..., :, 2] *= sign[..., None]
    scale: FloatArray = d.sum(axis=-1) / spread
    return scale, u @ vt


def transform_points(similarity: Similarity, points: NDArray[Any]) -> FloatArray:
    """Mapped points s R p + t, in double precision.

    Args:
        similarity: target from source.
        points: shape (n, 3), source frame and units, any type.

    Returns:
        Shape (n, 3), target frame and units.
    """
    moved: FloatArray = np.asarray(points, np.float64) @ np.array(similarity.rotation).T
    moved *= similarity.scale
    moved += np.array(similarity.translation_m)
    return moved


def compose(second: Similarity, first: Similarity) -> Similarity:
    """Composition of two similarities.

    Args:
        second: applied last, c from b.
        first: applied first, b from a.

    Returns:
        c from a.
    """
    return Similarity(
        scale=second.scale * first.scale,
        rotation=(np.array(second.rotation) @ np.array(first.rotation)).tolist(),
        translation_m=transform_points(second, np.array([first.translation_m]))[0].tolist(),
    )


def inverse(similarity: Similarity) -> Similarity:
    """Inverse of a similarity.

    Args:
        similarity: b from a.

    Returns:
        a from b.
    """
    rotation = np.array(similarity.rotation).T
    translation = -(rotation @ np.array(similarity.translation_m)) / similarity.scale
    return Similarity(
        scale=1 / similarity.scale, rotation=rotation.tolist(), translation_m=translation.tolist()
    )


def is_collinear(points: FloatArray) -> bool:
    """Test whether points lie on a line, or nearly so.

    Args:
        points: shape (n, 3), any units.
    """
    singular = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(singular[1] <= COLLINEAR * singular[0])
