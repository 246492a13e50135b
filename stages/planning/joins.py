"""How the pieces of a plan meet, exactly, within bounds that do not depend on the plan."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from math import perm

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.schemas.errors import ArtifactError

LEAST_DURATION_S = 1e-3
"""Minimum duration of a piece [s]."""
APART = (1e-9, 1e-7, 1e-5, 1e-3, 1.0)
"""Maximum difference of derivatives 0 to 4 of two pieces where they meet, of position and heading [SI].

Stored coefficients of a flight within 100 km of the origin are ten times closer. As pieces last a
millisecond at least, differences of one derivative add at most 1e-4 m/s^2, 1e-2 m/s^3 or 1 m/s^4 to the mean
of the next one.
"""
ORDERS = ("position", "velocity", "acceleration", "jerk", "snap")
_YAW_ORDERS = ("heading", "rate of the heading", "acceleration of the heading")


def faults_of_joins(time: FloatArray, coefficient: FloatArray) -> list[tuple[int, str]]:
    """Where a curve is not one motion: pieces that are too short, or do not meet.

    The stored numbers are taken as exact, and so is the arithmetic.

    Args:
        time: knots, shape (K + 1,) [s].
        coefficient: shape (K, D, 8) with D >= 3; a fourth row is the heading.

    Returns:
        Piece and fault, of each piece the first.
    """
    knots = [Fraction(t) for t in time.tolist()]
    duration = [b - a for a, b in pairwise(knots)]
    found = [
        (i, f"piece {i} lasts {float(each):.3g} s, less than {LEAST_DURATION_S:g} s")
        for i, each in enumerate(duration)
        if each < Fraction(LEAST_DURATION_S)
    ]
    rows = coefficient.tolist()
    for i, each in enumerate(duration[:-1]):
        powers = [each**j for j in range(coefficient.shape[2])]
        for names, axes in ((ORDERS, slice(0, 3)), (_YAW_ORDERS, slice(3, 4))):
            jump = _first_jump(rows[i][axes], rows[i + 1][axes], powers, names)
            if jump is not None:
                found.append((i, f"the {jump[0]} jumps by {jump[1]:.3g} after piece {i}"))
    return sorted(found)


def _first_jump(
    before: list[list[float]], after: list[list[float]], powers: list[Fraction], names: tuple[str, ...]
) -> tuple[str, float] | None:
    for order, name in enumerate(names):
        most = Fraction(APART[order])
        for row, next_row in zip(before, after, strict=True):
            end = sum(perm(j, order) * Fraction(row[j]) * powers[j - order] for j in range(order, len(row)))
            jump = abs(end - perm(order, order) * Fraction(next_row[order]))
            if jump > most:
                return name, float(jump)
    return None


def require_motion(plan: Artifact) -> None:
    """Refuse a plan that no vehicle can fly: it jumps, or has pieces that are too short.

    Raises:
        ArtifactError: names the first fault, with the time.
    """
    time, coefficient = (np.asarray(plan[name], np.float64) for name in ("time", "coefficient"))
    for piece, fault in faults_of_joins(time, coefficient):
        raise ArtifactError(f"the plan is no motion: at {time[piece + 1]:.6g} s {fault}; plan it again")
