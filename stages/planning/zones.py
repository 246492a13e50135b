"""Boxes with a lower top speed: which segments touch them, where a path is split, planes beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.scenarios.mission import ZoneTable

_GAP_M = 0.05  # before and behind a zone, where a path is split
_BESIDE_M = 1e-3  # that a cell keeps from a zone that its segment does not touch
_HALVINGS = 60  # of a search along a segment


@dataclass(frozen=True, slots=True)
class Zone:
    """A box and its limit.

    Attributes:
        lower, upper: corners, shape (3,) [m].
        speed_m_s: top speed in it.
    """

    lower: FloatArray
    upper: FloatArray
    speed_m_s: float

    @classmethod
    def of(cls, table: ZoneTable) -> Zone:
        """From a mission."""
        return cls(np.array(table.box_m[:3]), np.array(table.box_m[3:]), table.speed_m_s)

    def part(self, begin: FloatArray, end: FloatArray) -> tuple[float, float] | None:
        """The part of a segment in the box, as fractions of its length; None without any.

        Args:
            begin: shape (3,) [m].
            end: shape (3,) [m].
        """
        way = end - begin
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (self.lower - begin) / way, (self.upper - begin) / way
        still = way == 0
        inside = (begin >= self.lower) & (begin <= self.upper)
        if (still & ~inside).any():
            return None
        low = np.where(still, 0.0, np.minimum(first, second)).max(initial=0.0)
        high = np.where(still, 1.0, np.maximum(first, second)).min(initial=1.0)
        return (float(low), float(high)) if low <= high else None

    def plane_beside(self, begin: FloatArray, end: FloatArray) -> tuple[FloatArray, float] | None:
        """A plane n . x <= d between a segment and the box; None where the segment is too near.

        It is across the shortest line between the two. The distance of a point of the segment from the box is
        a convex function along it.

        Args:
            begin: shape (3,) [m].
            end: shape (3,) [m].
        """
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            third = (high - low) / 3
            near, far = (
                float(np.linalg.norm(self._to(begin + s * (end - begin))))
                for s in (low + third, high - third)
            )
            low, high = (low, high - third) if near <= far else (low + third, high)
        way = self._to(begin + 0.5 * (low + high) * (end - begin))
        length = float(np.linalg.norm(way))
        if length <= 2 * _BESIDE_M:
            return None
        normal = way / length
        offset = float(np.minimum(normal * self.lower, normal * self.upper).sum()) - _BESIDE_M
        is_between = max(float(normal @ begin), float(normal @ end)) <= offset - 0.5 * _BESIDE_M
        return (normal, offset) if is_between else None

    def is_beside(self, normal: FloatArray, offset: FloatArray) -> bool:
        """Whether a half-space of a cell leaves the box out.

        Args:
            normal: shape (R, 3), rows of the cell.
            offset: shape (R,) [m].
        """
        least = np.minimum(normal * self.lower, normal * self.upper).sum(axis=1)
        return bool((least >= offset + 0.5 * _BESIDE_M).any())

    def _to(self, point: FloatArray) -> FloatArray:
        """From a point to the nearest one of the box."""
        return np.asarray(np.clip(point, self.lower, self.upper) - point)


def touched(begin: FloatArray, end: FloatArray, zones: Sequence[Zone]) -> NDArray[np.bool_]:
    """Segments that touch a zone, shape (S,).

    Args:
        begin: shape (S, 3) [m].
        end: shape (S, 3) [m].
    """
    return np.array(
        [any(zone.part(a, b) is not None for zone in zones) for a, b in zip(begin, end, strict=True)],
        np.bool_,
    )


def split_at(point: FloatArray, zones: Sequence[Zone]) -> tuple[FloatArray, NDArray[np.int64], list[int]]:
    """Split the segments of a path a little before they enter a zone and behind it.

    Args:
        point: the path, shape (W, 3) [m].

    Returns:
        The path with further points; where the given ones are in it, shape (W,); indices of the further ones.
    """
    parts, index, further = [point[:1]], [0], []
    count = 1
    for a, b in pairwise(point):
        length = float(np.linalg.norm(b - a))
        cuts = set()
        for zone in zones:
            part = zone.part(a, b)
            if part is not None:
                cuts |= {part[0] * length - _GAP_M, part[1] * length + _GAP_M}
        last = 0.0
        for cut in sorted(cuts):
            if cut - last >= _GAP_M and length - cut >= _GAP_M:
                parts.append((a + cut / length * (b - a))[None])
                further.append(count)
                count += 1
                last = cut
        parts.append(b[None])
        index.append(count)
        count += 1
    return np.concatenate(parts), np.array(index), further
