"""How a Crazyflie writes numbers: millimetres and milliradians in 16 bits, attitudes in 32."""

from __future__ import annotations

import math
from collections.abc import Sequence

LARGEST = 32.767  # of m, m/s, m/s^2 and rad/s in 16 bits of thousandths

_BITS = 9
_MOST = (1 << _BITS) - 1


def compress_quat_wxyz(quat_wxyz: Sequence[float]) -> int:
    """A unit quaternion in 32 bits.

    The two highest say which of x, y, z, w has the largest magnitude; it is made positive and left out. Of
    the three others, in this order, follow the sign and nine bits of |q| sqrt(2).
    """
    w, x, y, z = map(float, quat_wxyz)
    parts = (x, y, z, w)
    largest = max(range(4), key=lambda i: abs(parts[i]))
    packed = largest
    for i, part in enumerate(parts):
        if i != largest:
            is_negative = (part < 0) != (parts[largest] < 0)
            share = min(abs(part) * math.sqrt(2.0), 1.0)
            packed = packed << (_BITS + 1) | is_negative << _BITS | int(share * _MOST + 0.5)
    return packed


def expand_quat_wxyz(packed: int) -> tuple[float, float, float, float]:
    """The inverse of `compress_quat_wxyz`, exact to 1.4e-3 in each component that was sent."""
    largest = packed >> 30 & 3
    parts = [0.0] * 4
    for i in (3, 2, 1, 0):
        if i != largest:
            share = (packed & _MOST) / _MOST / math.sqrt(2.0)
            parts[i] = -share if packed >> _BITS & 1 else share
            packed >>= _BITS + 1
    parts[largest] = math.sqrt(max(0.0, 1.0 - sum(part * part for part in parts)))
    x, y, z, w = parts
    return w, x, y, z
