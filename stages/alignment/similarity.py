"""Similarities between two point sets: closed form, composition, inverse."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.manifest import Similarity

COLLINEAR = 1e-3  # second over first singular value below this: no rotation


def umeyama(source: FloatArray, target: FloatArray) -> Similarity:
    """The similarity with the least sum of |target_i - (s R source_i + t)|^2; det R = +1.

    With the singular values U D V' of the cross-covariance sum y_i x_i' of centred points,
    R = U S V', s = trace(D S) / sum |x_i|^2, S = diag(1, 1, det U det V).
    Source: Umeyama 1991, eq. 40 to 42.

    Args:
        source: shape (n, 3), at least three points that are not collinear.
        target: shape (n, 3).
    """
    x, y = source - source.mean(axis=0), target - target.mean(axis=0)
    scale, rotation = from_moments(y.T @ x, (x * x).sum())
    translation = target.mean(axis=0) - scale * rotation @ source.mean(axis=0)
    return Similarity(scale=float(scale), rotation=rotation.tolist(), translation_m=translation.tolist())


def from_moments(cross: FloatArray, spread: Any) -> tuple[FloatArray, FloatArray]:
    """Scale and rotation from cross-covariances (..., 3, 3) and sums of squares (...) of the source."""
    u, d, vt = np.linalg.svd(cross)
    sign = np.where(np.linalg.det(u) * np.linalg.det(vt) < 0, -1.0, 1.0)
    d[..., 2] *= sign
    u[..., :, 2] *= sign[..., None]
    scale: FloatArray = d.sum(axis=-1) / spread
    return scale, u @ vt


def transform_points(similarity: Similarity, points: NDArray[Any]) -> FloatArray:
    """Scale R p + t for points of shape (n, 3), in double precision."""
    moved: FloatArray = np.asarray(points, np.float64) @ np.array(similarity.rotation).T
    moved = similarity.scale * moved + np.array(similarity.translation_m)
    return moved


def compose(second: Similarity, first: Similarity) -> Similarity:
    """The similarity that applies `first`, then `second`."""
    return Similarity(
        scale=second.scale * first.scale,
        rotation=(np.array(second.rotation) @ np.array(first.rotation)).tolist(),
        translation_m=transform_points(second, np.array([first.translation_m]))[0].tolist(),
    )


def inverse(similarity: Similarity) -> Similarity:
    """The similarity that undoes another."""
    rotation = np.array(similarity.rotation).T
    translation = -(rotation @ np.array(similarity.translation_m)) / similarity.scale
    return Similarity(
        scale=1 / similarity.scale, rotation=rotation.tolist(), translation_m=translation.tolist()
    )


def is_collinear(points: FloatArray) -> bool:
    """Whether points of shape (n, 3) lie on a line, or nearly so."""
    singular = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(singular[1] <= COLLINEAR * singular[0])
