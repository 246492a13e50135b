"""The map in a log, as `foxglove.SceneUpdate`: hulls, ellipsoids and fence."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.decode import json_decoder
from alula.schemas.flights import MAP_TOPIC
from alula.schemas.mcap_log import messages
from alula.schemas.run import open_log
from alula.stages.show.drawing.content import CUT, Part
from alula.stages.show.drawing.solids import Solids, solids_of
from alula.stages.show.viewing.cut import Cut
from alula.stages.show.viewing.shapes import balls

_OPACITY = 0.6
_LARGEST_M = 1e12


@dataclass(frozen=True, slots=True)
class LoggedMap:
    """Hulls and ellipsoids of a log.

    Attributes:
        solids: the hulls.
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
        """The ellipsoids as a part, and those that are cut as another.

        Args:
            name: in the scene tree.
            cut: of ceiling and near walls.
        """
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


class _Point(msgspec.Struct, gc=False):
    x: float
    y: float
    z: float


class _Turn(msgspec.Struct, gc=False):
    x: float
    y: float
    z: float
    w: float


class _Pose(msgspec.Struct, gc=False):
    position: _Point
    orientation: _Turn


class _Color(msgspec.Struct, gc=False):
    r: float
    g: float
    b: float


class _Sphere(msgspec.Struct):
    pose: _Pose
    size: _Point
    color: _Color


class _Triangles(msgspec.Struct):
    points: list[_Point]
    indices: list[int]


class _Pair(msgspec.Struct):
    key: str
    value: str


class _Entity(msgspec.Struct):
    id: str = ""
    metadata: list[_Pair] = []
    triangles: list[_Triangles] = []
    spheres: list[_Sphere] = []


class _Update(msgspec.Struct):
    entities: list[_Entity] = []


def map_of(message: Mapping[str, Any]) -> LoggedMap:
    """Map of a `foxglove.SceneUpdate`.

    Its fence is left out, because the parameters of the run have it too.

    Args:
        message: decoded.

    Raises:
        ValueError: it has other fields.
    """
    return _map_of(msgspec.convert(message, _Update))


def read_map(log: Path) -> LoggedMap | None:
    """Read the map in a log; None when it has none.

    Args:
        log: file of a run.

    Raises:
        InputError: the log cannot be read.
        DamagedError: truncated or corrupt before the map.
    """
    with open_log(log) as file:
        for _, data in messages(file, (MAP_TOPIC,)):
            return _map_of(json_decoder(_Update).decode(data))
    return None


def _map_of(message: _Update) -> LoggedMap:
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
        sum(_count(entity) for entity in entities),
    )


def _count(entity: _Entity) -> int:
    """Number of ellipsoids that an entity stands for."""
    values = [pair.value for pair in entity.metadata if pair.key == "ellipsoids"]
    return int(values[0]) if values and values[0].isascii() and values[0].isdecimal() else 0


def _points(each: list[_Point]) -> FloatArray:
    found = np.array([(p.x, p.y, p.z) for p in each], np.float64).reshape(-1, 3)
    if np.abs(found).max(initial=0.0) > _LARGEST_M:
        raise ValueError("a place of the map is too large to be measured")
    return found


def _mesh(one: _Triangles) -> tuple[FloatArray, NDArray[np.int64]]:
    indices = np.array(one.indices, np.int64)
    if len(indices) % 3 or (len(indices) and not 0 <= indices.min() <= indices.max() < len(one.points)):
        raise ValueError("triangles of the map name corners that it does not have")
    return _points(one.points), indices.reshape(-1, 3)
