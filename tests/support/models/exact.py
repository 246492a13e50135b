"""Polytopes by rational arithmetic alone: hulls and volumes, straight from their definitions."""

from fractions import Fraction
from itertools import combinations
from math import gcd

HalfSpaces = list[tuple[tuple[int, ...], int]]


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def facets_of(points) -> set[tuple[tuple[int, ...], int]]:
    """The facets' primitive planes: those through three points that leave all others on one side.

    Empty when the points span no volume.
    """
    points, found = sorted(set(points)), set()
    for a, b, c in combinations(points, 3):
        normal = cross([y - x for x, y in zip(a, b, strict=True)], [y - x for x, y in zip(a, c, strict=True)])
        divisor = gcd(*normal)
        if divisor == 0:
            continue
        normal = tuple(n // divisor for n in normal)
        heights = [dot(normal, p) - dot(normal, a) for p in points]
        if min(heights) == 0 == max(heights):
            return set()
        if max(heights) == 0:
            found.add((normal, dot(normal, a)))
        elif min(heights) == 0:
            found.add((tuple(-n for n in normal), -dot(normal, a)))
    return found


def solve(rows):
    """The point on three planes by Cramer's rule; None when they do not meet in one."""
    (a, p), (b, q), (c, r) = rows
    bc, ca, ab = cross(b, c), cross(c, a), cross(a, b)
    det = dot(a, bc)
    if det == 0:
        return None
    return tuple(Fraction(p * x + q * y + r * z, det) for x, y, z in zip(bc, ca, ab, strict=True))


def polygon_area(points):
    """Area of the convex hull of rational points in the plane: sorted around their least, exactly."""
    points = sorted(set(points))
    chains = []
    for ordered in (points, points[::-1]):
        chain = []
        for p in ordered:
            while len(chain) > 1 and (chain[-1][0] - chain[-2][0]) * (p[1] - chain[-2][1]) <= (
                chain[-1][1] - chain[-2][1]
            ) * (p[0] - chain[-2][0]):
                chain.pop()
            chain.append(p)
        chains += chain[:-1]
    turned = zip(chains, chains[1:] + chains[:1], strict=True)
    return sum((a[0] * b[1] - a[1] * b[0] for a, b in turned), Fraction(0)) / 2


def exact_volume(half_spaces: HalfSpaces) -> Fraction:
    """Volume of {x : n . x <= o} for integer planes: cones from one vertex over the facets."""
    half_spaces = list(dict.fromkeys(half_spaces))
    corners = {solve(rows) for rows in combinations(half_spaces, 3)} - {None}
    corners = [p for p in corners if all(dot(n, p) <= o for n, o in half_spaces)]
    total = Fraction(0)
    for n, o in half_spaces if corners else ():
        axis = max(range(3), key=lambda i: abs(n[i]))
        face = [p for p in corners if dot(n, p) == o]
        area = polygon_area([tuple(p[i] for i in range(3) if i != axis) for p in face])
        total += area * (o - dot(n, corners[0])) / abs(n[axis]) / 3
    return total


def exact_union(hulls: list[HalfSpaces]) -> Fraction:
    """By inclusion and exclusion."""
    return sum(
        (-1) ** (k + 1) * exact_volume([p for hull in chosen for p in hull])
        for k in range(1, len(hulls) + 1)
        for chosen in combinations(hulls, k)
    )


def voxel_planes(voxel) -> HalfSpaces:
    """The six faces of the cube [v, v + 1]."""
    faces = []
    for axis, v in enumerate(voxel):
        unit = tuple(int(axis == i) for i in range(3))
        faces += [(unit, v + 1), (tuple(-n for n in unit), -v)]
    return faces


def reach(normal, voxel) -> int:
    """Of the corner of a voxel that is farthest along a normal."""
    return sum(n * (v + (n > 0)) for n, v in zip(normal, voxel, strict=True))


def cutting(half_spaces: HalfSpaces, voxel) -> HalfSpaces | None:
    """The half-spaces that leave only a part of a voxel; None when there is none left inside all."""
    if any(-reach([-n for n in normal], voxel) >= offset for normal, offset in half_spaces):
        return None
    return [(normal, offset) for normal, offset in half_spaces if reach(normal, voxel) > offset]


def exact_excess(half_spaces: HalfSpaces, voxels) -> Fraction:
    """Volume of a polytope outside voxels."""
    filled = Fraction(0)
    for voxel in voxels:
        part = cutting(half_spaces, voxel)
        if part is not None:
            filled += exact_volume(part + voxel_planes(voxel)) if part else 1
    return exact_volume(half_spaces) - filled
