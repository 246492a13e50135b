"""Obstacles that decide what a filter sends, while it changes the command."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.log.flights import Flight
from alula.schemas.scenarios.check import TRACKING
from alula.stages.rotation import matrix_from_quat_wxyz
from alula.stages.show.drawing.content import Decides
from alula.stages.show.drawing.solids import Solids
from alula.stages.show.viewing.shapes import ball_mesh

ROUTINE = ("", "ok", "passed")  # statuses of a filter that leaves the command as it is
_WITHOUT_MAP = TRACKING | {"geofence", "backup-qp", "none"}  # `active` is no hull or ellipsoid
_OF_HULLS = ("polytope-cbf",)
DECIDES_COLOR = (230, 120, 0)
_MOST = 60  # obstacles of a flight; those that decide longest
_GROWN = 1.02  # drawn a little larger than the obstacle, which would hide it


@dataclass(frozen=True, slots=True)
class Numbered:
    """Obstacles by the numbers that filters give them: ellipsoids first, then hulls.

    Attributes:
        solids: the hulls; None where they are not known.
        centers: of the ellipsoids, shape (n, 3) [m].
        semi_axes: at level 1, shape (n, 3) [m].
        quat_wxyz: of the semi-axes, shape (n, 4).
        ellipsoids: their number in the map; None where it is not known.
    """

    solids: Solids | None
    centers: NDArray[np.floating[Any]]
    semi_axes: NDArray[np.floating[Any]]
    quat_wxyz: NDArray[np.floating[Any]]
    ellipsoids: int | None
    level: float = 1.0

    def mesh(self, number: int, *, is_hull: bool) -> tuple[str, FloatArray, NDArray[np.int64]] | None:
        """Name, corners and triangles of an obstacle; None where it is not known.

        Args:
            number: as in the log.
            is_hull: the numbers count hulls alone.
        """
        first = 0 if is_hull else self.ellipsoids
        if first is None:
            return None
        if number < first:
            if number >= len(self.centers):
                return None
            corners, triangles = ball_mesh()
            turn = matrix_from_quat_wxyz(np.asarray(self.quat_wxyz[number : number + 1], np.float64))[0]
            places = (corners * (self.level * self.semi_axes[number])) @ turn.T + self.centers[number]
            return f"ellipsoid {number}", places, triangles
        hull = number - first
        if self.solids is None or hull >= len(self.solids):
            return None
        a, b = self.solids.corner_start[hull : hull + 2]
        c, d = self.solids.triangle_start[hull : hull + 2]
        return f"hull {hull}", self.solids.corners[a:b], self.solids.triangles[c:d] - a


def deciding(
    flight: Flight, filters: str, answer: NDArray[np.int64] | None, among: Numbered
) -> tuple[Decides, ...]:
    """Obstacles that decide, each with the samples in which a filter changes the command because of it.

    Args:
        filters: name of the run's filter, where it is a single one.
        answer: row of the filter's answers at each sample, shape (n,); None without any.
    """
    if answer is None:
        return ()
    found: dict[tuple[int, bool], NDArray[np.bool_]] = {}
    for name, active in flight.active.items():
        filter_ = name or filters
        if filter_ in _WITHOUT_MAP:
            continue
        words = flight.each_status[name] if name else flight.status
        acts = np.array([words[i].lower() not in ROUTINE for i in answer], np.bool_)
        number = np.where(acts, active[answer], -1)
        for each in np.unique(number[number >= 0]).tolist():
            key = (each, filter_ in _OF_HULLS)
            found[key] = found.get(key, np.zeros(len(answer), np.bool_)) | (number == each)
    longest = sorted(found, key=lambda key: (-int(found[key].sum()), key))
    return tuple(_drawn(among, ((key, found[key]) for key in longest[:_MOST])))


def _drawn(among: Numbered, each: Iterable[tuple[tuple[int, bool], NDArray[np.bool_]]]) -> Iterable[Decides]:
    for (number, is_hull), rows in each:
        if (mesh := among.mesh(number, is_hull=is_hull)) is not None:
            name, corners, triangles = mesh
            middle = corners.mean(axis=0)
            yield Decides(
                name=name, corners=middle + _GROWN * (corners - middle), triangles=triangles, rows=rows
            )
