"""Quaternions in the order w, x, y, z and rotation matrices, single or in arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray


def matrix_from_quat_wxyz(quat_wxyz: NDArray[Any]) -> FloatArray:
    """Rotation matrices of unit quaternions; column i is the image of axis i.

    Args:
        quat_wxyz: unit quaternions, shape (..., 4).

    Returns:
        Shape (..., 3, 3), in double precision.
    """
    quat = np.asarray(quat_wxyz, np.float64)
    w, x, y, z = quat.tolist() if quat.ndim == 1 else np.moveaxis(quat, -1, 0)  # numbers are much faster
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    if quat.ndim == 1:
        return np.array(rows)
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quat_wxyz_from_matrix(matrix: NDArray[Any]) -> FloatArray:
    """Unit quaternions of rotation matrices, with w >= 0; accurate for every angle.

    The largest of the four squared components is found from the diagonal and divides the others.
    Source: Shepperd 1978.

    Args:
        matrix: rotation matrices, shape (..., 3, 3).

    Returns:
        Shape (..., 4).
    """
    m = np.asarray(matrix, np.float64)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 1, 0] + m[..., 0, 1], m[..., 2, 0] + m[..., 0, 2], m[..., 2, 1] + m[..., 1, 2]
    candidates = np.stack(  # row i is 4 q_i q, for each i
        [
            np.stack([1 + xx + yy + zz, wx, wy, wz], axis=-1),
            np.stack([wx, 1 + xx - yy - zz, xy, xz], axis=-1),
            np.stack([wy, xy, 1 - xx + yy - zz, yz], axis=-1),
            np.stack([wz, xz, yz, 1 - xx - yy + zz], axis=-1),
        ],
        axis=-2,
    )
    best = np.argmax(np.diagonal(candidates, axis1=-2, axis2=-1), axis=-1)
    quat = np.take_along_axis(candidates, best[..., None, None], axis=-2)[..., 0, :]
    quat = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
    signed: FloatArray = np.where(quat[..., :1] < 0, -quat, quat)
    return signed


def multiply_quat_wxyz(left: NDArray[Any], right: NDArray[Any]) -> FloatArray:
    """Hamilton products: the rotation `right` first, then `left`.

    Args:
        left: shape (..., 4).
        right: shape (..., 4).

    Returns:
        Shape (..., 4), not renormalised.
    """
    p, q = np.asarray(left, np.float64), np.asarray(right, np.float64)
    a, b, c, d = p[..., 0], p[..., 1], p[..., 2], p[..., 3]
    e, f, g, h = q[..., 0], q[..., 1], q[..., 2], q[..., 3]
    made = np.empty((*np.broadcast_shapes(a.shape, e.shape), 4))  # faster than a stack for single ones
    made[..., 0] = a * e - b * f - c * g - d * h
    made[..., 1] = a * f + b * e + c * h - d * g
    made[..., 2] = a * g - b * h + c * e + d * f
    made[..., 3] = a * h + b * g - c * f + d * e
    return made
