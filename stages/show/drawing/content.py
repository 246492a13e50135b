"""What a view shows: named parts, a first camera, and flights to play, as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray, IntArray

Color = tuple[int, int, int]

CUT = "Ceiling and near walls"


@dataclass(frozen=True, slots=True, kw_only=True)
class Gaussians:
    """Gaussians of a splat.

    Attributes:
        name: place in the scene tree, parts separated by /.
        mean: centres, shape (n, 3), world frame [m].
        covariance: shape (n, 3, 3), world frame [m^2].
        color: red, green and blue, 0 to 255, shape (n, 3).
        opacity: 0 to 1, shape (n,).
    """

    name: str
    mean: NDArray[np.float32]
    covariance: NDArray[np.float32]
    color: NDArray[np.uint8]
    opacity: NDArray[np.float32]
    visible: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Faces:
    """A triangle mesh of one colour: corners, shape (V, 3) [m], and triangles, shape (T, 3).

    With `far_only` only sides that are turned away are drawn: near ones would hide Gaussians inside of it,
    which viser draws after all meshes.
    """

    name: str
    corners: FloatArray
    triangles: IntArray
    color: Color
    opacity: float = 1.0
    far_only: bool = False
    visible: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Lines:
    """Line segments, shape (n, 2, 3) [m], of one colour or of one per end, shape (n, 2, 3)."""

    name: str
    segments: FloatArray
    color: Color | NDArray[np.uint8]
    width_px: float = 1.5
    visible: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Copies:
    """A small mesh at many places.

    Attributes:
        corners, triangles: of the mesh, shapes (V, 3) and (T, 3).
        position: of each copy, shape (n, 3) [m].
        scale: of each copy along its own axes, shape (n, 3) [m].
        quat_wxyz: copy to world, shape (n, 4).
        color: red, green and blue of each, shape (n, 3), or of all.
    """

    name: str
    corners: FloatArray
    triangles: IntArray
    position: FloatArray
    scale: FloatArray
    quat_wxyz: FloatArray
    color: Color | NDArray[np.uint8]
    opacity: float = 1.0
    visible: bool = True


Part = Gaussians | Faces | Lines | Copies


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """A curve over the time of a flight, for the plots beside it.

    Attributes:
        plot: name of the plot that it belongs to, with the unit.
        time_s: shape (n,) [s].
        value: NaN where unknown, shape (n,).
        limit: drawn as a line across the plot; None without one.
    """

    label: str
    plot: str
    time_s: FloatArray
    value: FloatArray
    limit: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Body:
    """Size of a vehicle: radius of its sphere [m], and places of its rotors in the body, shape (k, 3) [m]."""

    radius_m: float
    rotors_m: FloatArray = field(default_factory=lambda: np.empty((0, 3)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Decides:
    """An obstacle that decides what is sent in some samples of a flight.

    Attributes:
        name: such as "hull 12".
        corners: shape (V, 3) [m].
        triangles: shape (T, 3).
        rows: samples in which it decides, shape (n,).
    """

    name: str
    corners: FloatArray
    triangles: IntArray
    rows: NDArray[np.bool_]


@dataclass(frozen=True, slots=True, kw_only=True)
class Play:
    """A flight to play at its own speed.

    Attributes:
        run, trial: where it is logged.
        begin_s: time in the log at which it begins [s].
        time_s: from 0, shape (n,) [s].
        position_world: shape (n, 3) [m].
        quat_world_body_wxyz: shape (n, 4).
        obstacles_world: true positions of moving obstacles, shape (n, k, 3) [m].
        tracks_world: their tracks, NaN without one, shape (n, k, 3) [m].
        obstacle_radius_m: shape (k,) [m].
        nearest_world: nearest point of the world, NaN where there is none, shape (n, 3) [m].
        acts: the filter changes the command, shape (n,).
        status: word of the filter, n words.
        marked_s: time of the worst moment [s].
        plans: time from which the flight follows a new plan, and its points, shape (k, 3) [s], [m].
    """

    label: str
    outcome: str
    words: str
    time_s: FloatArray
    position_world: FloatArray
    quat_world_body_wxyz: FloatArray
    body: Body
    obstacles_world: FloatArray
    tracks_world: FloatArray
    obstacle_radius_m: FloatArray
    nearest_world: FloatArray
    acts: NDArray[np.bool_]
    status: tuple[str, ...]
    series: tuple[Series, ...] = ()
    marked_s: float = 0.0
    run: str = ""
    trial: int = 0
    begin_s: float = 0.0
    decides: tuple[Decides, ...] = ()
    plans: tuple[tuple[float, FloatArray], ...] = ()


@dataclass(frozen=True, slots=True)
class Camera:
    """First camera: where it is and what it looks at, world frame [m], and its far plane [m]."""

    position: FloatArray
    look_at: FloatArray
    far_m: float = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Content:
    """All that one view shows.

    Attributes:
        parts: in the order of the scene tree.
        plays: flights to play, the worst first.
        legend: colour (#rrggbb) by meaning.
        notes: what is left out, in words.
        up: axis that points up, as +z.
    """

    title: str
    parts: tuple[Part, ...]
    camera: Camera
    plays: tuple[Play, ...] = ()
    legend: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    up: str = "+z"

    @property
    def gaussians(self) -> int:
        """Number of Gaussians of all parts."""
        return sum(len(part.mean) for part in self.parts if isinstance(part, Gaussians))


def rgb(color: str) -> Color:
    """Red, green and blue of #rrggbb."""
    return int(color[1:3], 16), int(color[3:5], 16), int(color[5:7], 16)


def hex_of(color: Color) -> str:
    """A color as #rrggbb."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def segments_of(points: FloatArray) -> FloatArray:
    """The N - 1 segments of a path of N points, shape (N - 1, 2, 3)."""
    return np.stack([points[:-1], points[1:]], axis=1)


def tree_name(words: str) -> str:
    """Turn words into one name of the scene tree: a slash would open a level."""
    return " ".join(words.replace("/", "∕").split()) or "unnamed"
