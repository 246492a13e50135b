"""Decoding of quantised quaternions, and error bounds of their rotations."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray


def smallest_three(stored: NDArray[np.float64], largest: NDArray[np.integer]) -> NDArray[np.float64]:
    """Unit quaternions from three stored components; the missing one is not negative.

    Args:
        stored: the stored components, in order, shape (N, 3).
        largest: index 0 to 3 of the missing component, shape (N,).

    Returns:
        Shape (N, 4): sqrt(max(0, 1 - |stored|^2)) at `largest`.
    """
    count = len(stored)
    quat = np.empty((count, 4))
    rows = np.arange(count)
    for i in range(3):  # the index of a stored component increases by one behind the missing one
        quat[rows, i + (i >= largest)] = stored[:, i]
    quat[rows, largest] = np.sqrt(np.maximum(0.0, 1.0 - (stored * stored).sum(axis=1)))
    return quat


def chart_rotation_error(stored: NDArray[np.float64], error: ArrayLike) -> NDArray[np.float64]:
    """Error bound of rotations with quaternions that are stored without one, non-negative component.

    The true stored part m' is within `error` of m. The missing component is w = sqrt(1 - |m|^2); w' lies
    between its values at |m'| = |m| - error and |m'| = min(1, |m| + error). So the chord of the unit
    quaternions is at most sqrt(error^2 + max |w' - w|^2), and a chord c is a rotation by 4 asin(c / 2).

    Args:
        stored: m, shape (N, 3).
        error: bound of |m' - m|, one number or shape (N,).

    Returns:
        Angles [rad], shape (N,), at most pi.
    """
    length = np.linalg.norm(stored, axis=1)
    off = np.asarray(error, np.float64) + np.maximum(
        0.0, length - 1.0
    )  # m is normalised where it is too long
    length = np.minimum(length, 1.0)
    w = np.sqrt(1.0 - length * length)
    least = np.sqrt(1.0 - np.minimum(length + off, 1.0) ** 2)
    most = np.sqrt(1.0 - np.maximum(length - off, 0.0) ** 2)
    chord = np.sqrt(off * off + np.maximum(w - least, most - w) ** 2)
    angle: NDArray[np.float64] = 4.0 * np.arcsin(np.minimum(chord / 2.0, math.sqrt(0.5)))
    return angle * (1.0 + 1e-12)


def whole_rotation_error(stored: NDArray[np.floating], error: float) -> NDArray[np.float64]:
    """Error bound of rotations with quaternions that are stored with all four components.

    The true quaternion is within `error` of the stored one and of length 1, or of any length if the writer
    did not normalise it. So the error of its direction is at most asin(error / |stored|), where a length
    above 1 counts as 1, and the error of the rotation is at most twice that.

    Args:
        stored: quaternions, shape (N, 4).
        error: bound of the distance of the true quaternions from the stored ones.

    Returns:
        Angles [rad], shape (N,), at most pi.
    """
    length = np.clip(np.linalg.norm(stored.astype(np.float64), axis=1), 1e-9, 1.0)
    angle: NDArray[np.float64] = 2.0 * np.arcsin(np.minimum(error / length, 1.0))
    return angle * (1.0 + 1e-12)
