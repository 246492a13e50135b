"""Voxels in parts, by columns along z: those near a tile, and boxes around all beyond each of its sides."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.parts import Parts

_HELD = 2**22  # voxels of parts that are kept in memory, beside those of the parts in use
_FAR = 2**31  # no voxel is farther along z

Ints = NDArray[np.int64]
_Voxels = NDArray[np.int32]


class Columns:
    """Voxels, of whose parts few are in memory at a time.

    Args:
        source: voxels, or a cover whose members they are.

    Attributes:
        count: number of voxels, of a cover of members.
    """

    def __init__(self, source: Parts, voxel_size_m: float) -> None:
        self._source, self._size = source, voxel_size_m
        self._held: OrderedDict[int, NDArray[np.int32]] = OrderedDict()
        self.count = 0
        found: tuple[list[_Extents], list[_Extents]] = ([], [])
        for number in range(len(source)):
            index = self._part(number)
            self.count += len(index)
            for axis in (0, 1):
                found[axis].append(_Extents.of(index, axis))
        self._beyond = [_Beyond(_Extents.joined(each)) for each in found]

    def __iter__(self) -> Iterator[NDArray[np.int32]]:
        """All voxels, part by part, each of shape (M, 3)."""
        return (self._part(number) for number in range(len(self._source)))

    def near(self, low: Ints, high: Ints) -> NDArray[np.int32]:
        """Voxels that touch a column, shape (M, 3).

        Args:
            low: lower ends of the column along x and y [voxels].
        """
        ends = [np.append(each, z) * self._size for each, z in ((low, -_FAR), (high, _FAR))]
        found = [np.empty((0, 3), np.int32)]
        for number in self._source.touching(ends[0].tolist(), ends[1].tolist()):
            index = self._part(number)
            ends_x = np.array([low[0] - 1, high[0] + 1], np.int32)  # of the type of the voxels: no copy
            begin, end = np.searchsorted(index[:, 0], ends_x)
            some = index[begin:end]
            found.append(some[(some[:, 1] <= high[1]) & (some[:, 1] + 1 >= low[1])])
        return np.concatenate(found)

    def beyond(self, low: Ints, high: Ints) -> Iterator[Ints]:
        """Boxes around all voxels beyond each side of a column; each voxel that `near` lacks is in one.

        Yields:
            Lower and upper corner of the box, shape (2, 3), of each side with voxels.
        """
        for axis in (0, 1):
            yield from self._beyond[axis].sides(int(low[axis]) - 1, int(high[axis]))

    def _part(self, number: int) -> NDArray[np.int32]:
        """Voxels of a part, in the order of x, and column by column in memory."""
        if number in self._held:
            self._held.move_to_end(number)
            return self._held[number]
        index = _by_x(self._source[number])
        while self._held and sum(map(len, self._held.values())) + len(index) > _HELD:
            self._held.popitem(last=False)
        self._held[number] = index
        return index


def voxels_of(part: Artifact) -> NDArray[np.int32]:
    """Voxels or members of hulls, shape (M, 3).

    Args:
        part: voxels or a cover.
    """
    return np.ascontiguousarray(part["index" if "index" in part.arrays else "member_index"], np.int32)


def _by_x(part: Artifact) -> NDArray[np.int32]:
    index = voxels_of(part)
    if "index" not in part.arrays:
        index = index[np.argsort(index[:, 0], kind="stable")]
    return np.asfortranarray(index, np.int32)


class _Extents:
    """Boxes around the voxels with each value of a coordinate, by this value."""

    def __init__(self, value: _Voxels, lower: _Voxels, upper: _Voxels) -> None:
        order = np.argsort(value, kind="stable")
        value = value[order]
        start = np.flatnonzero(np.r_[True, value[1:] != value[:-1]]) if len(value) else order
        self.value = value[start]
        self.lower = np.minimum.reduceat(lower[order], start, axis=0) if len(value) else lower
        self.upper = np.maximum.reduceat(upper[order], start, axis=0) if len(value) else upper

    @classmethod
    def of(cls, index: NDArray[np.int32], axis: int) -> _Extents:
        """Of voxels, shape (M, 3)."""
        return cls(index[:, axis], index, index)

    @classmethod
    def joined(cls, some: list[_Extents]) -> _Extents:
        """Of the voxels of all."""
        none = np.empty((0, 3), np.int32)
        value = np.concatenate([np.empty(0, np.int32), *(each.value for each in some)])
        lower = np.concatenate([none, *(each.lower for each in some)])
        return cls(value, lower, np.concatenate([none, *(each.upper for each in some)]))


class _Beyond:
    """Boxes around all voxels below, and above, a value of a coordinate."""

    def __init__(self, extents: _Extents) -> None:
        self._value = extents.value
        lower, upper = extents.lower.astype(np.int64), extents.upper.astype(np.int64) + 1
        self._below = np.minimum.accumulate(lower, axis=0), np.maximum.accumulate(upper, axis=0)
        lower, upper = np.minimum.accumulate(lower[::-1], 0), np.maximum.accumulate(upper[::-1], 0)
        self._above = lower[::-1], upper[::-1]

    def sides(self, below: int, above: int) -> Iterator[Ints]:
        """Boxes of the voxels with a coordinate below the one value, and above the other."""
        end = int(np.searchsorted(self._value, below))
        if end > 0:
            yield np.stack([each[end - 1] for each in self._below])
        begin = int(np.searchsorted(self._value, above, side="right"))
        if begin < len(self._value):
            yield np.stack([each[begin] for each in self._above])
