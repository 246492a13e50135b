"""Exact geometry of the built-in room, from the calls that construct it: solids, and what hides what."""

from __future__ import annotations

import numpy as np

from alula.stages.reconstruction import room as construction


class Room:
    """Primitives of the room in the world frame [m]; independent of Gaussians and voxels."""

    def __init__(self):
        self.rectangles, self.boxes, self.tubes, self.discs, self.spheres, self.toruses = (
            [] for _ in range(6)
        )
        recorders = {
            "rectangle": lambda corner, u, v, paint, **looks: self.rectangles.append((corner, u, v)),
            "box": lambda lower, upper, paint, **looks: self.boxes.append((lower, upper)) or [],
            "tube": lambda centre, radius, height, paint, top=None, **looks: self.tubes.append(
                (centre, radius, height, radius if top is None else top)
            ),
            "disc": lambda centre, radius, paint, **looks: self.discs.append((centre, radius)),
            "sphere": lambda centre, radius, paint, **looks: self.spheres.append((centre, radius)),
            "torus": lambda centre, axis, radius, tube, paint, **looks: self.toruses.append(
                (centre, axis, radius, tube)
            ),
        }
        kept = {name: getattr(construction, name) for name in recorders}
        try:
            for name, recorder in recorders.items():
                setattr(construction, name, recorder)
            construction.room()
        finally:
            for name, function in kept.items():
                setattr(construction, name, function)

    def is_hidden(self, start, end):
        """Whether a surface lies between the ends of segments, shapes (n, 3): shape (n,)."""
        start, way = np.broadcast_arrays(start, end)[0], np.asarray(end) - start
        hidden = np.zeros(len(way), bool)
        shapes = [
            *((_rectangle, shape) for shape in self.rectangles),
            *((_box, shape) for shape in self.boxes),
            *((_tube, shape) for shape in self.tubes),
            *((_disc, shape) for shape in self.discs),
            *((_sphere, shape) for shape in self.spheres),
            *((_torus, shape) for shape in self.toruses),
        ]
        with np.errstate(divide="ignore", invalid="ignore"):
            for hit, shape in shapes:
                left = np.flatnonzero(~hidden)
                hidden[left] = hit(start[left], way[left], *shape)
        return hidden

    def depth_in_solids(self, lower, upper):
        """How deep cubes reach into walls and furniture [m], shape (n,): 0 or less where they do not.

        Shades and pots, which are open, count as shells without a thickness and are left out.
        """
        size = np.array(construction.SIZE)
        deepest = np.maximum((-lower).max(axis=1), (upper - size).max(axis=1))
        for low, high in self.boxes:
            deepest = np.maximum(deepest, np.minimum(upper - low, np.array(high) - lower).min(axis=1))
        for centre, radius in self.spheres:
            deepest = np.maximum(
                deepest, radius - np.linalg.norm(np.clip(centre, lower, upper) - centre, axis=1)
            )
        for (x, y, z), radius, height, top in self.tubes:
            if top == radius and radius in (0.01, 0.015, 0.02, 0.2, 0.28):  # rods, the column and its foot
                away = radius - np.linalg.norm(
                    np.clip((x, y), lower[:, :2], upper[:, :2]) - np.array((x, y)), axis=1
                )
                along = np.minimum(upper[:, 2] - z, z + height - lower[:, 2])
                deepest = np.maximum(deepest, np.minimum(away, along))
        for shape in self.toruses:
            corner = np.stack(np.meshgrid(*[np.linspace(0, 1, 5)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
            centre = np.array(shape[0])
            near = np.flatnonzero(np.linalg.norm((lower + upper) / 2 - centre, axis=1) < shape[2] + 0.2)
            points = lower[near, None] + corner * (upper - lower)[near, None]
            inside = -_torus_distance(points.reshape(-1, 3), *shape).reshape(len(near), -1)
            deepest[near] = np.maximum(deepest[near], inside.max(axis=1))
        return deepest


def _between(t):
    return (t > 1e-9) & (t < 1 - 1e-9)


def _rectangle(start, way, corner, u, v):
    corner, u, v = (np.array(each, float) for each in (corner, u, v))
    normal = np.cross(u, v)
    t = ((corner - start) @ normal) / (way @ normal)
    at = start + t[:, None] * way - corner
    a, b = at @ u / (u @ u), at @ v / (v @ v)
    return _between(t) & (a >= 0) & (a <= 1) & (b >= 0) & (b <= 1)


def _box(start, way, lower, upper):
    first, second = (np.array(lower) - start) / way, (np.array(upper) - start) / way
    enter, leave = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
    return (enter < leave) & (leave > 0) & (enter < 1)


def _quadratic(a, b, c):
    root = np.sqrt(b * b - 4 * a * c)
    return (-b - root) / (2 * a), (-b + root) / (2 * a)


def _tube(start, way, centre, radius, height, top):
    slope = (top - radius) / height
    p = start - np.array(centre)
    r, dr = radius + slope * p[:, 2], slope * way[:, 2]
    a = (way[:, :2] ** 2).sum(axis=1) - dr**2
    b = 2 * ((p[:, :2] * way[:, :2]).sum(axis=1) - r * dr)
    c = (p[:, :2] ** 2).sum(axis=1) - r**2
    hit = np.zeros(len(way), bool)
    for t in _quadratic(a, b, c):
        z = p[:, 2] + t * way[:, 2]
        hit |= _between(t) & (z >= 0) & (z <= height)
    return hit


def _disc(start, way, centre, radius):
    t = (centre[2] - start[:, 2]) / way[:, 2]
    at = start + t[:, None] * way - np.array(centre)
    return _between(t) & ((at[:, :2] ** 2).sum(axis=1) <= radius**2)


def _sphere(start, way, centre, radius):
    p = start - np.array(centre)
    roots = _quadratic((way**2).sum(axis=1), 2 * (p * way).sum(axis=1), (p**2).sum(axis=1) - radius**2)
    return _between(roots[0]) | _between(roots[1])


def _torus_distance(points, centre, axis, radius, tube):
    p = points - np.array(centre)
    along = p @ np.array(axis)
    across = np.linalg.norm(p - along[:, None] * np.array(axis), axis=1)
    return np.hypot(across - radius, along) - tube


def _torus(start, way, *shape):
    """March along the segments by the distance to the torus."""
    length = np.linalg.norm(way, axis=1)
    t, hit = np.zeros(len(way)), np.zeros(len(way), bool)
    going = np.flatnonzero(length > 0)
    for _ in range(200):
        if len(going) == 0:
            break
        distance = _torus_distance(start[going] + t[going, None] * way[going], *shape)
        hit[going] = distance < 1e-6
        t[going] += np.maximum(distance, 1e-6) / length[going]
        going = going[(distance >= 1e-6) & (t[going] < 1)]
    return hit
