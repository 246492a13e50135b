"""Plans for flights behind a safety filter: slower where it would act."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.stages.planning.corridor import Corridor, divided
from alula.stages.planning.fastest import Curve
from alula.stages.planning.trajectory import evaluate

_CELL_M = 0.4  # length of the cells that become slower
_SLOWER = 0.6  # times the speed at which the filter acts
_SLOWEST_M_S = 0.1
_ROUNDS = 14


@dataclass(frozen=True, slots=True)
class Behind:
    """The filters behind which a plan will be flown.

    Attributes:
        acting_s: instants at which they change the command, shape (N,) [s], in a flight without anything
            random along a curve, with its knots (K + 1,) [s] and coefficients of (x, y, z, yaw) (K, 4, 8).
    """

    name: str
    acting_s: Callable[[FloatArray, FloatArray], FloatArray]


Solve = Callable[[Corridor], Curve]
Heading = Callable[[Corridor, Curve], FloatArray]


def slowed(
    corridor: Corridor, curve: Curve, behind: Behind, speed_m_s: float, heading: Heading, solve: Solve
) -> tuple[Corridor, Curve, int]:
    """Slow a curve down where filters act in a flight along it, until they do not.

    Cells in which they act are divided along their segments. In each part where they act the speed is limited
    to 0.6 of what it was there, at least 0.1 m/s, and the fastest curve within these limits is
    flown in its turn, at most 14 times.

    Args:
        curve: the fastest.
        heading: coefficients of the yaw along a curve in its corridor, shape (K, 1, 8).
        solve: the fastest curve in a corridor within the speeds of its cells.

    Returns:
        The curve along which they act for the fewest ticks, its corridor, and the number of these ticks.
    """
    limit = np.full(len(corridor.start) - 1, speed_m_s)
    if corridor.speed is not None:
        limit = np.minimum(limit, corridor.speed)
    best = (corridor, curve, -1)
    for _ in range(_ROUNDS):
        at = behind.acting_s(
            curve.time, np.concatenate([curve.coefficient(), heading(corridor, curve)], axis=1)
        )
        if best[2] < 0 or len(at) < best[2]:
            best = (corridor, curve, len(at))
        acting = _cells_at(curve, at)
        if not len(acting):
            break
        position, speed = _motion_at(curve, at)
        corridor, part = divided(corridor, np.unique(acting[acting >= 0]), _CELL_M)
        before = limit[part]
        limit = before.copy()
        for i in range(len(limit)):
            inside = _within(corridor, i, position) & (acting == part[i])
            if inside.any():
                limit[i] = max(_SLOWEST_M_S, min(limit[i], _SLOWER * float(speed[inside].max())))
        if (limit == before).all():
            break
        corridor = dataclasses.replace(corridor, speed=limit)
        curve = solve(corridor)
        if (curve.cell < 0).any():  # straight lines from rest to rest
            break
    return best


def _cells_at(curve: Curve, at: FloatArray) -> NDArray[np.int64]:
    """Cells of instants, shape (N,)."""
    piece = np.searchsorted(curve.time, at, side="right") - 1
    return curve.cell[np.clip(piece, 0, len(curve.cell) - 1)]


def _motion_at(curve: Curve, at: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (N, 3) [m] and speeds (N,) [m/s] of a curve."""
    coefficient = curve.coefficient()
    speed: FloatArray = np.linalg.norm(evaluate(curve.time, coefficient, at, 1), axis=1)
    return evaluate(curve.time, coefficient, at), speed


def _within(corridor: Corridor, cell: int, position: FloatArray) -> NDArray[np.bool_]:
    """Whether points are in a cell, shape (N,)."""
    normal, offset = corridor.rows(cell)
    return np.asarray((position @ normal.T <= offset + 1e-6).all(axis=1))
