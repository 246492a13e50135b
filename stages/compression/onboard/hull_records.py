"""Records of the hulls of a cover in parts, of which few parts are in memory at a time."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.artifacts.parts import Parts
from alula.schemas.errors import ArtifactError
from alula.stages.compression.hulls import some_hulls
from alula.stages.compression.onboard.image import HULL_BYTES, KDOP_PLANE_BYTES, PLANE_BYTES
from alula.stages.compression.onboard.layout import MapFrame, encode_records

_HELD = 2**21  # vertices of parts that are kept in memory, beside those of the parts in use
_STARTS = ("vertex_start", "plane_start")
_ARRAYS = ("vertex", "vertex_start", "plane_normal", "plane_start")

_Arrays = dict[str, NDArray[Any]]


class HullRecords:
    """Records of all hulls as the whole map has them: its origin, its kind of planes and its order.

    Attributes:
        frame: of the whole map.
        empty: image of the whole map without its records.

    Raises:
        InfeasibleError, InputError, ArtifactError: see `encode_map`; or the cover has no hulls.
    """

    def __init__(self, cover: Parts, largest_normal: int, cover_sha256: str, jobs: int) -> None:
        self._cover, self._normal, self._jobs = cover, largest_normal, jobs
        self._held: OrderedDict[int, Artifact] = OrderedDict()
        self._row: tuple[int, int, NDArray[np.int64]] = (0, -1, np.empty(0, np.int64))
        self._witness: _Arrays | None = None  # a hull that has other planes than those of the 26-DOP family
        self._hint = b""
        lowers, uppers, hulls = [], [], [0]
        for number in range(len(cover)):
            part = self._part(number)
            start, vertex = np.asarray(part["vertex_start"]), np.asarray(part["vertex"])
            if (np.diff(start) == 0).any():
                raise ArtifactError("the cover cannot be encoded: a hull has no volume")
            hulls.append(len(start) - 1)
            if len(start) > 1:
                lowers.append(np.minimum.reduceat(vertex, start[:-1], axis=0))
                uppers.append(np.maximum.reduceat(vertex, start[:-1], axis=0))
        if not lowers:
            raise ArtifactError("the cover has no hulls to cut into tiles")
        self._first = np.cumsum(hulls)
        low, high = (
            np.min([each.min(axis=0) for each in lowers], axis=0),
            np.max([each.max(axis=0) for each in uppers], axis=0),
        )
        self.frame = MapFrame.of(cover.manifest, low.astype(np.int64), high.astype(np.int64))
        self._lower = np.concatenate([each[:, :2] for each in lowers])
        self._upper = np.concatenate([each[:, :2] for each in uppers])
        del lowers, uppers
        is_kdop, largest = self._kind()
        self.empty = self.frame.image(b"", 0, is_kdop, largest, cover_sha256, indexed=False)
        self._is_kdop = is_kdop

    def within(self, low: NDArray[np.int64], high: NDArray[np.int64]) -> list[bytes]:
        """Records of the hulls with a box that meets a column, in the order of the whole map.

        Args:
            low: lower ends of the column along x and y [voxels].
        """
        ends = int(low[1]), int(high[1])
        if self._row[:2] != ends:  # those of a row of tiles, of which each tile takes some
            is_near = (self._lower[:, 1] <= ends[1]) & (self._upper[:, 1] >= ends[0])
            self._row = (*ends, np.flatnonzero(is_near))
        rows = self._row[2]
        rows = rows[(self._lower[rows, 0] <= high[0]) & (self._upper[rows, 0] >= low[0])]
        if len(rows) == 0:
            return []
        records, is_kdop, _ = self._encoded(self._hulls(rows))
        if is_kdop and not self._is_kdop:
            assert self._witness is not None
            records, _, _ = self._encoded(_joined([self._hulls(rows), self._witness]))
            found = _split(records, is_kdop=False)
            found.remove(self._hint)
            return found
        return _split(records, is_kdop=is_kdop)

    def _kind(self) -> tuple[bool, int]:
        """Whether all planes are of the 26-DOP family, and the largest component of a normal."""
        kinds, largest = [], 1
        for number in range(len(self._cover)):
            numbers = np.arange(self._first[number], self._first[number + 1])
            arrays = self._hulls(numbers) if len(numbers) else None
            found = (b"", True, 1) if arrays is None else self._encoded(arrays)
            kinds.append(found[1])
            largest = max(largest, found[2])
            if arrays is not None and not found[1] and self._witness is None:
                self._find_witness(number)
        if self._witness is not None:  # parts of the family alone are written like the others
            for number in np.flatnonzero(kinds).tolist():
                numbers = np.arange(self._first[number], self._first[number + 1])
                if len(numbers):
                    joined = _joined([self._hulls(numbers), self._witness])
                    largest = max(largest, self._encoded(joined)[2])
        return self._witness is None, largest

    def _find_witness(self, number: int) -> None:
        """Find the hull by halving: a set is of the family exactly if all its hulls are."""
        low, high = int(self._first[number]), int(self._first[number + 1])
        while high - low > 1:
            middle = (low + high) // 2
            if self._encoded(self._hulls(np.arange(low, middle)))[1]:
                low = middle
            else:
                high = middle
        self._witness = self._hulls(np.arange(low, high))
        self._hint = self._encoded(self._witness)[0]

    def _encoded(self, arrays: _Arrays) -> tuple[bytes, bool, int]:
        return encode_records(arrays, self.frame, self._normal, self._jobs)

    def _hulls(self, numbers: NDArray[np.int64]) -> _Arrays:
        """Arrays of hulls by their numbers in the whole, in ascending order."""
        found = []
        ends = np.searchsorted(numbers, self._first)
        for number in np.flatnonzero(np.diff(ends)).tolist():
            mine = numbers[ends[number] : ends[number + 1]] - self._first[number]
            found.append(some_hulls(self._part(number), mine, _STARTS)[0])
        return _joined(found)

    def _part(self, number: int) -> Artifact:
        if number in self._held:
            self._held.move_to_end(number)
            return self._held[number]
        part = self._cover[number]
        arrays = {name: part[name] for name in (*_ARRAYS, "plane_offset")}
        others = sum(len(one["vertex"]) for one in self._held.values())
        while self._held and others + len(part["vertex"]) > _HELD:
            others -= len(self._held.popitem(last=False)[1]["vertex"])
        self._held[number] = Artifact(part.manifest, arrays)
        return self._held[number]


def _joined(some: list[_Arrays]) -> _Arrays:
    joined: _Arrays = {
        name: np.concatenate([each[name] for each in some]) for name in ("vertex", "plane_normal")
    }
    for start in _STARTS:
        sizes = np.concatenate([np.diff(each[start]) for each in some])
        joined[start] = np.concatenate([[0], np.cumsum(sizes)])
    return joined


def _split(records: bytes, *, is_kdop: bool) -> list[bytes]:
    """Record of each hull."""
    per_plane, at, found = KDOP_PLANE_BYTES if is_kdop else PLANE_BYTES, 0, []
    while at < len(records):
        end = at + HULL_BYTES + per_plane * records[at + 12]
        found.append(records[at:end])
        at = end
    return found
