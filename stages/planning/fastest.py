"""Curves of minimum time: through a corridor, and straight from rest to rest."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.stages.planning.corridor import Corridor
from alula.stages.planning.joins import LEAST_DURATION_S
from alula.stages.planning.limits import WITHIN, Limits
from alula.stages.planning.trajectory import DEGREE

PIECES_PER_CELL = (3, 5)  # tried in turn; the first is less, but 2 at least, in a corridor of many cells
_FEW_PIECES = 20
_LEAST_DURATION_S = 0.02  # of a piece
_HOLD_PIECE_S = 0.5  # of the first and last pieces of a rest
_GAP = 1e-2  # of the barrier method, in units of the total time; less costs more than it saves in flight
_MOST_STEPS = 300  # of Newton's method
# A straight piece from rest to rest, class C4, in two halves: control points along the way.
_STRAIGHT = np.array([[0, 0, 0, 0, 0, 0.125, 0.3125, 0.5], [0.5, 0.6875, 0.875, 1, 1, 1, 1, 1]])


@dataclass(frozen=True, slots=True)
class MovingState:
    """Motion of a vehicle at the start of a plan: velocity, acceleration, jerk, shape (3,) each."""

    velocity_m_s: FloatArray
    acceleration_m_s2: FloatArray
    jerk_m_s3: FloatArray


@dataclass(frozen=True, slots=True)
class Curve:
    """Pieces in Bernstein form.

    Attributes:
        point: control points, shape (K, 8, 3), world frame [m].
        duration: shape (K,) [s].
        cell: cell of each piece, -1 where it has none, shape (K,).
        stop: pieces that come to rest at their end, shape (K,); the last one does.
        segment: segment of the corridor that each piece belongs to, shape (K,).
    """

    point: FloatArray
    duration: FloatArray
    cell: NDArray[np.int64]
    stop: NDArray[np.bool_]
    segment: NDArray[np.int64]

    @property
    def time(self) -> FloatArray:
        """Knots, shape (K + 1,) [s]."""
        return np.concatenate([[0.0], np.cumsum(self.duration)])

    def coefficient(self) -> FloatArray:
        """Power coefficients c_j = C(7, j) D^j b_0 / T^j of each piece, shape (K, 3, 8); c_0 is exact."""
        difference = self.point
        columns = []
        for j in range(DEGREE + 1):
            columns.append(comb(DEGREE, j) * difference[:, 0] / self.duration[:, None] ** j)
            difference = np.diff(difference, axis=1)
        return np.stack(columns, axis=2)


def joined(curves: list[Curve]) -> Curve:
    """One curve after the other."""
    return Curve(*(np.concatenate([getattr(each, name) for each in curves]) for name in Curve.__slots__))


def fastest_curve(
    corridor: Corridor,
    cells: range,
    limits: Limits,
    pieces: int,
    *,
    start: MovingState | None = None,
    smooth: float = 1.0,
) -> Curve | None:
    """The curve of minimum time through some consecutive cells, from rest to rest.

    Args:
        corridor: its joints between these cells are open.
        cells: cells to pass, from the first point of the first to the last point of the last.
        pieces: in each cell, at least 2; two more in a cell alone.
        start: state of motion at the start; at rest if none.
        smooth: factor on the minimum time, in which snap is minimised.

    Returns:
        None if there is none, or none was found.
    """
    normal = [corridor.rows(i)[0] for i in cells]
    offset = [corridor.rows(i)[1] for i in cells]
    row_start = np.concatenate([[0], np.cumsum([len(rows) for rows in offset])]).astype(np.int64)
    count = max(2, min(pieces, _FEW_PIECES // len(cells) if pieces == PIECES_PER_CELL[0] else pieces))
    if len(cells) == 1:
        count += 2  # from rest to a constant speed and back take two pieces each
    cell = np.repeat(np.arange(len(cells)), count)
    joint = np.zeros((len(cell) - 1, 3))
    is_via = np.zeros(len(cell) - 1, np.uint8)
    at = np.arange(1, len(cells)) * count - 1
    between = slice(cells.start, cells.stop - 1)
    joint[at], is_via[at] = corridor.joint[between], corridor.is_via[between]
    centre, across, room = np.zeros((len(joint), 3)), np.zeros((len(joint), 3)), np.zeros(len(joint))
    for j, each in enumerate(at.tolist()):
        if (opening := corridor.opening.get(cells.start + j)) is not None:
            centre[each], across[each], room[each] = opening.centre, opening.normal, opening.radius_m
    begin = corridor.point[cells.start][None]
    if start is not None:
        begin = np.vstack([begin, start.velocity_m_s, start.acceleration_m_s2, start.jerk_m_s3])
    status, point, duration, _ = _core.minimum_time(
        np.concatenate(normal),
        np.concatenate(offset),
        row_start,
        cell.astype(np.uint32),
        limits.native(),
        np.ascontiguousarray(begin),
        corridor.point[cells.stop].tolist(),
        joint,
        is_via,
        _LEAST_DURATION_S,
        _GAP,
        _MOST_STEPS,
        smooth,
        centre,
        across,
        room,
        None if corridor.speed is None else np.minimum(corridor.speed[cell + cells.start] * WITHIN, 1e9),
    )
    if status == _core.TimeStatus.infeasible:
        return None
    point = np.array(point)
    point[0, 0], point[-1, -1] = corridor.point[cells.start], corridor.point[cells.stop]
    for i in np.flatnonzero(is_via).tolist():
        point[i, -1] = point[i + 1, 0] = point[i + 1, 0] if room[i] > 0 else joint[i]
    stop = np.zeros(len(cell), np.bool_)
    stop[-1] = True
    segment = cell.astype(np.int64) + cells.start
    return Curve(point, np.asarray(duration), segment, stop, segment)


def straight_curve(
    start: FloatArray, goal: FloatArray, limits: Limits, smooth: float = 1.0, segment: int = 0
) -> Curve:
    """Straight from rest to rest in two pieces, as fast as the limits allow for this shape.

    Args:
        start: shape (3,) [m].
        goal: shape (3,), another point [m].
        segment: of the corridor that it belongs to.
    """
    point = (1 - _STRAIGHT[..., None]) * start + _STRAIGHT[..., None] * goal
    low, high = 1e-3, 1e-3
    while not keeps(point, np.full(2, high), limits).all():
        low, high = high, 2 * high
    while high > low * (1 + 1e-6):
        middle = 0.5 * (low + high)
        fits = keeps(point, np.full(2, middle), limits).all()
        low, high = (low, middle) if fits else (middle, high)
    duration, cell = np.full(2, smooth * high), np.full(2, -1)
    return Curve(point, duration, cell, np.array([False, True]), np.full(2, segment))


def hold_curve(point: FloatArray, duration_s: float, segment: int) -> Curve:
    """Rest at a point, in pieces that let the heading turn at the beginning and at the end.

    Args:
        point: shape (3,) [m].
        duration_s: of the rest; 2 ms at least [s].
        segment: of the corridor that begins there.
    """
    duration_s = max(duration_s, 2 * LEAST_DURATION_S)  # the rounding of knots takes a little
    begin = np.full(2, _HOLD_PIECE_S)
    duration = np.array([*begin, duration_s - 2 * begin.sum(), *begin])
    if duration[2] < _HOLD_PIECE_S:
        count = max(1, round(duration_s / _HOLD_PIECE_S))
        duration = np.full(count, duration_s / count)
    count = len(duration)
    of = np.full(count, segment)
    return Curve(np.tile(point, (count, DEGREE + 1, 1)), duration, of, np.zeros(count, np.bool_), of)


def keeps(
    point: FloatArray, duration: FloatArray, limits: Limits, speed: FloatArray | None = None
) -> NDArray[np.bool_]:
    """Whether the control points of each piece's derivatives keep the limits, beyond rounding; shape (K,).

    A derivative lies in the hull of its control points, and the limits are convex: they hold at every
    instant.

    Args:
        point: control points of positions, shape (K, 8, 3) [m].
        duration: shape (K,) [s].
        speed: lower limits of the pieces, shape (K,) [m/s].
    """
    room = 1 - 1e-9
    bound = (limits.speed_m_s, limits.acceleration_m_s2, limits.jerk_m_s3, limits.snap_m_s4)
    good = np.ones(len(point), np.bool_)
    for order in range(1, 5):
        point = (DEGREE + 1 - order) / duration[:, None, None] * np.diff(point, axis=1)
        size = np.linalg.norm(point, axis=2).max(axis=1)
        good &= size <= room * bound[order - 1]
        if order == 1 and speed is not None:
            good &= size <= room * speed
        if order == 2:
            thrust = point + np.array([0, 0, limits.gravity_m_s2])
            sideways, upward = np.linalg.norm(thrust[..., :2], axis=2), thrust[..., 2]
            good &= np.linalg.norm(thrust, axis=2).max(axis=1) <= room * limits.most_thrust_m_s2
            good &= upward.min(axis=1) >= limits.least_thrust_m_s2 + 1e-9
            if np.isfinite(limits.tangent):
                good &= (sideways <= room * limits.tangent * upward).all(axis=1)
    return good
