"""Attitude in 32 bits, as a Crazyflie packs it into packets."""

from __future__ import annotations

import math
from collections.abc import Sequence

_QUAT_BITS = 9
_QUAT_MAX = (1 << _QUAT_BITS) - 1


def compress_quat_wxyz(quat_wxyz: Sequence[float]) -> int:
    """Compress a unit quaternion to 32 bits.

    The two highest bits hold the index of the component of x, y, z, w with the largest magnitude. That
    component is made positive and omitted. The sign and nine bits of |q| sqrt(2) of each of the three others
    follow in this order.

    Args:
        quat_wxyz: unit quaternion w, x, y, z.
    """
    w, x, y, z = map(float, quat_wxyz)
    parts = (x, y, z, w)
    largest = max(range(4), key=lambda i: abs(parts[i]))
    packed = largest
    for i, part in enumerate(parts):
        if i != largest:
            is_negative = (part < 0) != (parts[largest] < 0)
            scaled = min(abs(part) * math.sqrt(2.0), 1.0)
            packed = packed << (_QUAT_BITS + 1) | is_negative << _QUAT_BITS | int(scaled * _QUAT_MAX + 0.5)
    return packed


def expand_quat_wxyz(packed: int) -> tuple[float, float, float, float]:
    """Expand 32 bits to a quaternion; inverse of `compress_quat_wxyz`.

    The error of each component that was sent is at most 1.4e-3.
    """
    largest = packed >> 30 & 3
    parts = [0.0] * 4
    for i in (3, 2, 1, 0):
        if i != largest:
            magnitude = (packed & _QUAT_MAX) / _QUAT_MAX / math.sqrt(2.0)
            parts[i] = -magnitude if packed >> _QUAT_BITS & 1 else magnitude
            packed >>= _QUAT_BITS + 1
    parts[largest] = math.sqrt(max(0.0, 1.0 - sum(part * part for part in parts)))
    x, y, z, w = parts
    return w, x, y, z
