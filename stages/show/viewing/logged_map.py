"""The map in a log, as `foxglove.SceneUpdate`: hulls, ellipsoids and fence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.decode import json_decoder
from alula.schemas.log.channels import MAP_TOPIC
from alula.schemas.log.foxglove import SceneUpdate, TriangleListPrimitive, Vector3
from alula.schemas.log.mcap import messages, open_log
from alula.schemas.log.samples import measured
from alula.stages.show.drawing.content import CUT, Part
from alula.stages.show.drawing.solids import Solids, solids_of
from alula.stages.show.viewing.cut import Cut
from alula.stages.show.viewing.shapes import balls

_OPACITY = 0.6


@dataclass(frozen=True, slots=True)
class LoggedMap:
    """Hulls and ellipsoids of a log.

    Attributes:
        centers: of the ellipsoids, shape (n, 3) [m].
        semi_axes: shape (n, 3) [m].
        quat_wxyz: shape (n, 4).
        color: shape (n, 3).
        ellipsoid_count: number of ellipsoids of the map; a log has those near the paths.
    """

    solids: Solids
    centers: FloatArray
    semi_axes: FloatArray
    quat_wxyz: FloatArray
    color: NDArray[np.uint8]
    ellipsoid_count: int = 0

    @property
    def has_ellipsoids(self) -> bool:
        """The run flew among ellipsoids."""
        return len(self.centers) > 0

    def ellipsoids(self, name: str, cut: Cut | None = None) -> list[Part]:
        """The ellipsoids as a part, and those that are cut as another."""
        gone = np.zeros(len(self.centers), np.bool_)
        if cut is not None and len(gone):
            gone = cut.removes(self.centers, self.centers)
        return [
            balls(
                full,
                self.centers[some],
                self.semi_axes[some],
                self.color[some],
                opacity=_OPACITY,
                quat_wxyz=self.quat_wxyz[some],
            )
            for full, some in ((name, ~gone), (f"{CUT}/{name}", gone))
            if some.any()
        ]


def read_map(log: Path) -> LoggedMap | None:
    """Read the map in a log; None when it has none.

    Raises:
        InputError: the log cannot be read.
        DamagedError: truncated or corrupt before the map.
    """
    with open_log(log) as file:
        for _, data in messages(file, (MAP_TOPIC,)):
            return map_of(json_decoder(SceneUpdate).decode(data))
    return None


def map_of(message: SceneUpdate) -> LoggedMap:
    """Hulls and ellipsoids of a map.

    Its fence is left out, because the parameters of the run have it too.

    Raises:
        ValueError: a place is missing or too large.
    """
    entities = [one for one in message.entities if one.id != "fence"]
    each = [_mesh(one) for entity in entities for one in entity.triangles]
    spheres = [sphere for entity in entities for sphere in entity.spheres]
    turns = [s.pose.orientation for s in spheres]
    color = np.array([(s.color.r, s.color.g, s.color.b) for s in spheres], np.float64).reshape(-1, 3)
    return LoggedMap(
        solids_of([one for one in each if len(one[1])]),
        _points([s.pose.position for s in spheres]),
        0.5 * _points([s.size for s in spheres]),
        np.array([(q.w, q.x, q.y, q.z) for q in turns], np.float64).reshape(-1, 4),
        np.clip(255 * color, 0, 255).round().astype(np.uint8),
        sum(entity.count("ellipsoids") or 0 for entity in entities),
    )


def _points(each: Sequence[Vector3]) -> FloatArray:
    return measured("place of the map", [point.tuple for point in each], is_known=True).reshape(-1, 3)


def _mesh(one: TriangleListPrimitive) -> tuple[FloatArray, NDArray[np.int64]]:
    indices = np.array(one.indices, np.int64)
    if len(indices) % 3 or (len(indices) and not 0 <= indices.min() <= indices.max() < len(one.points)):
        raise ValueError("triangles of the map name corners that it does not have")
    return _points(one.points), indices.reshape(-1, 3)
