"""Bounds on piecewise polynomials in rational arithmetic: without rounding, over the continuous time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import pairwise
from math import comb

from alula.schemas.arrays import FloatArray

Vector = tuple[Fraction, Fraction, Fraction]
Points = list[Vector]  # control points of one piece
_DEGREE = 7
_PARTINGS = 6  # halvings of a piece beside a plane
THROUGH_M = 1e-2
"""Distance before and behind the plane of a gate that a flight through it reaches at least [m]."""
PLANE_M = 1e-9
"""Distance from a plane that counts as none [m]."""
_HALVINGS = 14  # the peak of a straight plan is then proven within 1e-7 of a limit


def control_points(coefficient: FloatArray, duration: Fraction) -> Points:
    """Bernstein points b_i = sum_j C(i, j) / C(7, j) c_j T^j of one piece.

    Args:
        coefficient: of x, y, z, shape (3, 8).
        duration: T [s].
    """
    powers = [duration**j for j in range(_DEGREE + 1)]
    axes = []
    for row in coefficient.tolist():
        scaled = [Fraction(c) * powers[j] / comb(_DEGREE, j) for j, c in enumerate(row)]
        axes.append([sum(comb(i, j) * scaled[j] for j in range(i + 1)) for i in range(_DEGREE + 1)])
    return [(Fraction(x), Fraction(y), Fraction(z)) for x, y, z in zip(*axes, strict=True)]


def derivative(points: Points, duration: Fraction) -> Points:
    """Control points of the derivative.

    Args:
        points: of a polynomial of degree len(points) - 1.
    """
    factor = (len(points) - 1) / duration
    return [
        (factor * (q[0] - p[0]), factor * (q[1] - p[1]), factor * (q[2] - p[2])) for p, q in pairwise(points)
    ]


def holds(points: Points, is_inside: Callable[[Vector], bool], halvings: int = _HALVINGS) -> bool:
    """Whether a polynomial is proven to stay in a convex set.

    It is where all control points are in the set; otherwise both halves are tried, unless an end, which is a
    point of the curve, is outside.

    Args:
        halvings: of the interval, at most.
    """
    if all(is_inside(p) for p in points):
        return True
    if halvings == 0 or not (is_inside(points[0]) and is_inside(points[-1])):
        return False
    left, right = _halves(points)
    return holds(left, is_inside, halvings - 1) and holds(right, is_inside, halvings - 1)


def _halves(points: Points) -> tuple[Points, Points]:
    left, right, row = [points[0]], [points[-1]], list(points)
    while len(row) > 1:
        row = [((p[0] + q[0]) / 2, (p[1] + q[1]) / 2, (p[2] + q[2]) / 2) for p, q in pairwise(row)]
        left.append(row[0])
        right.append(row[-1])
    return left, right[::-1]


def is_slow_in(points: Points, velocity: Points, box: Sequence[float], speed: float, halvings: int) -> bool:
    """Whether a polynomial is proven to leave a box out wherever it is faster than a limit.

    Args:
        velocity: of its derivative.
        box: XMIN YMIN ZMIN XMAX YMAX ZMAX; its faces belong to the outside.
        halvings: of the interval, at most.
    """
    if all(map(ball(speed), velocity)):
        return True
    low, high = [Fraction(x) for x in box[:3]], [Fraction(x) for x in box[3:]]
    for axis in range(3):
        if all(p[axis] <= low[axis] for p in points) or all(p[axis] >= high[axis] for p in points):
            return True
    if halvings == 0:
        return False
    halves = zip(_halves(points), _halves(velocity), strict=True)
    return all(is_slow_in(p, v, box, speed, halvings - 1) for p, v in halves)


def is_crossed(pieces: Sequence[Points], knot: int, centre: Sequence[float], normal: Sequence[float]) -> bool:
    """Whether a curve is proven to cross a plane along its normal between two pieces, not only to touch it.

    Where they meet, it is in the plane. Back from there no control point of a part of the curve lies behind
    the plane, until a point of the curve that is `THROUGH_M` before it at least; and the other way round
    behind the plane. Pieces are halved where they do not decide that.

    Args:
        pieces: control points of all pieces.
        knot: number of the piece that begins in the plane.
        centre: a point of the plane [m].
        normal: of the plane, unit length.
    """
    if not 0 < knot < len(pieces):
        return False
    n, c = [Fraction(x) for x in normal], [Fraction(x) for x in centre]

    def heights(piece: Points, side: int) -> list[Fraction]:
        return [
            side * sum((a * (x - b) for a, x, b in zip(n, p, c, strict=True)), Fraction(0)) for p in piece
        ]

    def leaves(numbers: range, side: int) -> bool:
        for k in numbers:
            row = heights(pieces[k], side)
            found = _leaves(row if side > 0 else row[::-1], _PARTINGS)
            if found is not None:
                return found
        return False

    at = heights(pieces[knot][:1], 1)[0]
    return abs(at) <= PLANE_M and leaves(range(knot - 1, -1, -1), -1) and leaves(range(knot, len(pieces)), 1)


def _leaves(row: list[Fraction], halvings: int) -> bool | None:
    """Whether a polynomial reaches `THROUGH_M` before it may fall below zero; None if it does neither.

    Args:
        row: control points, in the order in which they are flown or in the opposite one.
        halvings: of the interval, at most.
    """
    if min(row) >= -Fraction(PLANE_M):
        if max(row[0], row[-1]) >= THROUGH_M:
            return True
        if max(row) < THROUGH_M or halvings == 0:
            return None
    elif halvings == 0:
        return False
    left, right, level = [row[0]], [row[-1]], row
    while len(level) > 1:
        level = [(p + q) / 2 for p, q in pairwise(level)]
        left.append(level[0])
        right.append(level[-1])
    found = _leaves(left, halvings - 1)
    return _leaves(right[::-1], halvings - 1) if found is None else found


def nothing(_: Vector) -> bool:
    """The empty set."""
    return False


def ball(radius: float, centre: Sequence[float] = (0, 0, 0)) -> Callable[[Vector], bool]:
    """The set |x - centre| <= radius; empty for a negative radius."""
    if not radius >= 0:
        return nothing
    squared = Fraction(radius) ** 2
    x, y, z = (Fraction(c) for c in centre)
    return lambda p: (p[0] - x) ** 2 + (p[1] - y) ** 2 + (p[2] - z) ** 2 <= squared


def half_space(normal: Sequence[float], offset: float) -> Callable[[Vector], bool]:
    """The set normal . x <= offset."""
    x, y, z = (Fraction(c) for c in normal)
    bound = Fraction(offset)
    return lambda p: x * p[0] + y * p[1] + z * p[2] <= bound


def cone(tangent: float, lift: float) -> Callable[[Vector], bool]:
    """The set |(x, y)| <= tangent (z + lift)."""
    squared, rise = Fraction(tangent) ** 2, Fraction(lift)
    return lambda p: p[2] + rise >= 0 and p[0] ** 2 + p[1] ** 2 <= squared * (p[2] + rise) ** 2
