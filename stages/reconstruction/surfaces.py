"""Painted surfaces that can be sampled evenly: the building blocks of the built-in scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from alula.schemas.arrays import FloatArray

Sampler = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
Paint = Callable[[FloatArray, FloatArray], FloatArray]
Vector = tuple[float, float, float]
Color = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Surface:
    """One patch.

    Attributes:
        area: area of the surface [m^2].
        sample: function from u, v in [0, 1), each of shape (n,), to points [m] and outward unit normals in
            the world frame, each of shape (n, 3), evenly over the area.
        paint: function from u, v to red, green, blue in [0, 1], shape (n, 3).
        density: Gaussians per area, relative to a wall.
        detail: size of the Gaussians, relative to those of a wall.
    """

    area: float
    sample: Sampler
    paint: Paint
    density: float = 1.0
    detail: float = 1.0


def plain(color: Color) -> Paint:
    """Paint of one colour.

    Args:
        color: red, green, blue in [0, 1].
    """
    return lambda u, v: np.broadcast_to(np.array(color), (len(u), 3))


def striped(first: Color, second: Color, count: int, *, along_u: bool = True) -> Paint:
    """Paint with stripes in irregular mixtures of two colours, like planks or the spines of books.

    Args:
        first: red, green, blue in [0, 1].
        second: likewise.
        count: number of stripes.
        along_u: stripes run along u, otherwise along v.
    """

    def paint(u: FloatArray, v: FloatArray) -> FloatArray:
        stripe = np.floor((v if along_u else u) * count)
        mix = (np.sin(stripe * 12.9898) * 43758.5453 % 1.0)[:, None]
        return np.array(first) * (1 - mix) + np.array(second) * mix

    return paint


def framed(inner: Paint, outer: Color, border: float) -> Paint:
    """Paint with a border around another paint.

    Args:
        inner: paint inside the border.
        outer: colour of the border, red, green, blue in [0, 1].
        border: width of the border, as a fraction of each edge.
    """

    def paint(u: FloatArray, v: FloatArray) -> FloatArray:
        inside = (np.minimum(u, 1 - u) > border) & (np.minimum(v, 1 - v) > border)
        return np.where(inside[:, None], inner(u, v), np.array(outer))

    return paint


def rectangle(corner: Vector, edge_u: Vector, edge_v: Vector, paint: Paint, **looks: float) -> Surface:
    """Parallelogram with the normal edge_u x edge_v.

    Args:
        corner: where u = v = 0, world frame [m].
        edge_u: edge along u, world frame [m].
        edge_v: edge along v, world frame [m].
    """
    start, a, b = np.array(corner), np.array(edge_u), np.array(edge_v)
    cross = np.cross(a, b)
    area = float(np.linalg.norm(cross))

    def sample(u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        points = start + u[:, None] * a + v[:, None] * b
        return points, np.broadcast_to(cross / area, points.shape)

    return Surface(area, sample, paint, **looks)


def box(lower: Vector, upper: Vector, paint: Paint, **looks: float) -> list[Surface]:
    """Six faces of an axis-aligned box.

    Args:
        lower: smallest coordinates, world frame [m].
        upper: largest coordinates, world frame [m].
    """
    (x0, y0, z0), (x1, y1, z1) = lower, upper
    x, y, z = (x1 - x0, 0.0, 0.0), (0.0, y1 - y0, 0.0), (0.0, 0.0, z1 - z0)
    return [
        rectangle((x0, y0, z0), y, x, paint, **looks),
        rectangle((x0, y0, z1), x, y, paint, **looks),
        rectangle((x0, y0, z0), x, z, paint, **looks),
        rectangle((x0, y1, z0), z, x, paint, **looks),
        rectangle((x0, y0, z0), z, y, paint, **looks),
        rectangle((x1, y0, z0), y, z, paint, **looks),
    ]


def tube(
    centre: Vector, radius: float, height: float, paint: Paint, *, top: float | None = None, **looks: float
) -> Surface:
    """Side of an upright cylinder or, with another radius at the top, of a conical frustum.

    Args:
        centre: centre of the bottom, world frame [m].
        radius: radius of the bottom [m].
        height: height [m].
        top: radius of the top [m]; None: that of the bottom.
    """
    x0, y0, z0 = centre
    end = radius if top is None else top
    slope = (radius - end) / height
    slant = float(np.hypot(height, radius - end))

    def sample(u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        angle = 2 * np.pi * u
        across = np.sqrt(radius**2 + v * (end**2 - radius**2))  # even over the area
        rise = v * height if end == radius else (radius - across) / slope
        points = np.stack([x0 + across * np.cos(angle), y0 + across * np.sin(angle), z0 + rise], axis=1)
        normals = np.stack([np.cos(angle), np.sin(angle), np.full_like(angle, slope)], axis=1)
        return points, normals / np.hypot(1.0, slope)

    return Surface(np.pi * (radius + end) * slant, sample, paint, **looks)


def disc(centre: Vector, radius: float, paint: Paint, **looks: float) -> Surface:
    """Horizontal disc with an upward normal.

    Args:
        centre: centre, world frame [m].
        radius: radius [m].
    """

    def sample(u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        angle, across = 2 * np.pi * u, radius * np.sqrt(v)
        flat = np.stack([across * np.cos(angle), across * np.sin(angle), np.zeros_like(u)], axis=1)
        return np.array(centre) + flat, np.broadcast_to(np.array([0.0, 0.0, 1.0]), flat.shape)

    return Surface(np.pi * radius**2, sample, paint, **looks)


def sphere(centre: Vector, radius: float, paint: Paint, **looks: float) -> Surface:
    """Sphere.

    Args:
        centre: centre, world frame [m].
        radius: radius [m].
    """

    def sample(u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        z, angle = 2 * v - 1, 2 * np.pi * u
        across = np.sqrt(np.maximum(1 - z * z, 0.0))
        normals = np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
        return np.array(centre) + radius * normals, normals

    return Surface(4 * np.pi * radius**2, sample, paint, **looks)


def torus(
    centre: Vector, axis: Vector, radius: float, thickness: float, paint: Paint, **looks: float
) -> Surface:
    """Torus around a horizontal axis.

    Args:
        centre: centre, world frame [m].
        axis: direction of the axis, horizontal, world frame.
        radius: distance from the centre to the middle of the tube [m].
        thickness: radius of the tube [m].
    """
    forward = np.array(axis) / np.linalg.norm(axis)
    up = np.array([0.0, 0.0, 1.0])
    side = np.cross(up, forward)
    ratio = thickness / radius

    def sample(u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        around, wanted = 2 * np.pi * u, 2 * np.pi * v
        angle = wanted.copy()
        for _ in range(6):  # Newton: angle + ratio sin(angle) = wanted makes it even over the area
            angle -= (angle + ratio * np.sin(angle) - wanted) / (1 + ratio * np.cos(angle))
        radial = np.cos(around)[:, None] * side + np.sin(around)[:, None] * up
        normals = np.cos(angle)[:, None] * radial + np.sin(angle)[:, None] * forward
        return np.array(centre) + radius * radial + thickness * normals, normals

    return Surface(4 * np.pi**2 * radius * thickness, sample, paint, **looks)
