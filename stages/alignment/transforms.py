"""Similarities given as numbers in JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import Similarity
from alula.schemas.decode import MalformedError, decode_plain_json
from alula.schemas.errors import InputError
from alula.stages.alignment.tables import LARGEST

_ORTHONORMAL = 1e-4


def parse_transform(text: str, name: str) -> Similarity:
    """Parse a similarity from JSON: a 4x4 matrix, alone or as `matrix`, or scale, rotation, translation_m.

    Raises:
        InputError: not JSON, of another shape, not finite, or not a proper similarity.
    """
    try:
        found: Any = decode_plain_json(text.encode())
    except MalformedError as error:
        raise InputError(f"{name}: is not JSON ({error})") from error
    try:
        if isinstance(found, dict) and "matrix" not in found:
            with np.errstate(over="ignore", invalid="ignore"):  # values that are not finite are refused below
                linear = float(found["scale"]) * np.array(found["rotation"], np.float64)
            if not float(found["scale"]) > 0:
                raise InputError(f"{name}: the scale must be positive, not {found['scale']}")
            translation = np.array(found["translation_m"], np.float64)
        else:
            matrix = np.array(found["matrix"] if isinstance(found, dict) else found, np.float64)
            if matrix.shape != (4, 4) or matrix[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
                raise InputError(f"{name}: needs a 4x4 matrix with the last row 0 0 0 1")
            linear, translation = matrix[:3, :3], matrix[:3, 3]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{name}: needs a 4x4 matrix, or scale, rotation (3x3) and translation_m (3)"
        ) from error
    return checked_similarity(linear, translation, name)


def checked_similarity(linear: FloatArray, translation: FloatArray, name: str) -> Similarity:
    """Check and build a similarity from its linear part and its translation.

    Args:
        linear: a rotation times a scale, up to rounding, shape (3, 3).
        translation: shape (3,) [target units].

    Raises:
        InputError: they are not a proper similarity, or the scale is not between 1e-9 and 1e9.
    """
    if linear.shape != (3, 3) or translation.shape != (3,):
        raise InputError(f"{name}: rotation must be 3x3 and translation_m of length 3")
    if not (np.isfinite(linear).all() and np.isfinite(translation).all()):
        raise InputError(f"{name}: a value is not finite")
    if max(np.abs(linear).max(), np.abs(translation).max()) > LARGEST:
        raise InputError(f"{name}: a value is beyond {LARGEST:g}")
    determinant = float(np.linalg.det(linear))
    if determinant < 0:
        raise InputError(f"{name}: is a reflection (determinant {determinant:.3g}), not a similarity")
    scale = determinant ** (1 / 3)
    if not (1e-9 <= scale <= 1e9):
        raise InputError(f"{name}: the scale is {scale:.3g}, not between 1e-9 and 1e9")
    u, singular, vt = np.linalg.svd(linear / scale)
    if np.abs(singular - 1).max() > _ORTHONORMAL:
        raise InputError(f"{name}: is not a rotation times a scale (singular values {scale * singular})")
    return Similarity(scale=scale, rotation=(u @ vt).tolist(), translation_m=translation.tolist())
