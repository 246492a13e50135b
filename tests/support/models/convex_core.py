"""The convex problem within planning, stated in cvxpy and solved by Clarabel: a reference, not for speed.

For fixed durations of the pieces, all constraints of a curve in a corridor are linear or second-order cones
in its control points. `native/core/include/alula/planning/minimum_time.hpp` solves it, with the durations as
further variables; tests compare the two.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from math import comb
from typing import Any

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.stages.planning.limits import Limits
from alula.stages.planning.opening import Opening
from alula.stages.planning.trajectory import DEGREE

_ORDERS = 5  # position to snap
_LARGEST_SCALE = 64.0
_SNAP_UNIT = 100.0  # of the cost, without a limit [m/s^4]
_SOLVER_ERROR = 1e-4  # of Clarabel on these programs, relative to the limits


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """Pieces in cells {x : normal . x <= offset}.

    Attributes:
        normal, offset: rows of each cell, shapes (R_c, 3), (R_c,) [m].
        cell: of each piece, shape (K,).
        limits: of the motion.
        state: position, velocity, acceleration and jerk at the start, shape (4, 3); a position alone, shape
            (1, 3), stands for rest, with zero snap.
        goal: at rest, shape (3,) [m].
        via: points at the ends of pieces, by the number of the piece.
        opening: room at the ends of pieces, by the number of the piece: the piece ends in it, and the pieces
            beside a disc lie on its two sides.
        speed: limit of each piece, shape (K,); None for that of all [m/s].
    """

    normal: list[FloatArray]
    offset: list[FloatArray]
    cell: NDArray[np.int64]
    limits: Limits
    state: FloatArray
    goal: FloatArray
    via: dict[int, FloatArray]
    opening: dict[int, Opening] = field(default_factory=dict)
    speed: FloatArray | None = None


def minimum_snap(problem: Problem, duration: FloatArray) -> tuple[float, FloatArray] | None:
    """Minimise the integral of |snap|^2 for given durations.

    Args:
        problem: cells, limits and ends.
        duration: shape (K,) [s].

    Returns:
        The integral and the control points, shape (K, 8, 3); None where no curve meets the constraints.
    """
    point = [cp.Variable((DEGREE + 1, 3)) for _ in problem.cell]
    constraints, snap = _constraints(problem, point, duration, 1.0)
    gram = np.array([[comb(3, i) * comb(3, j) / comb(6, i + j) / 7 for j in range(4)] for i in range(4)])
    root = np.linalg.cholesky(gram).T
    unit = _SNAP_UNIT if np.isinf(problem.limits.snap_m_s4) else problem.limits.snap_m_s4
    parts = zip(duration.tolist(), snap, strict=True)
    program = cp.Problem(cp.Minimize(sum(t * cp.sum_squares(root @ s / unit) for t, s in parts)), constraints)
    if not _solved(program):
        return None
    return float(program.value) * unit**2, np.stack([np.asarray(p.value) for p in point])


def minimum_scale(problem: Problem, duration: FloatArray, tolerance: float = 1e-3) -> float:
    """The smallest common factor of the durations for which a curve exists, by bisection.

    For a start at rest every larger factor has one, too.

    Args:
        problem: cells, limits and ends.
        duration: shape (K,) [s].
        tolerance: relative, of the factor.

    Returns:
        A factor with a curve, infinite above 64.
    """
    low, high = 0.0, 1.0
    while not _exists(problem, high * duration):
        low, high = high, 2 * high
        if high > _LARGEST_SCALE:
            return float("inf")
    while high - low > tolerance * high:
        middle = 0.5 * (low + high) if low > 0 else 0.9 * high
        low, high = (low, middle) if _exists(problem, middle * duration) else (middle, high)
    return high


def _exists(problem: Problem, duration: FloatArray) -> bool:
    """Whether there is a curve: the smallest common factor on the limits is 1, to the solver's error."""
    point = [cp.Variable((DEGREE + 1, 3)) for _ in problem.cell]
    factor = cp.Variable()
    constraints, _ = _constraints(problem, point, duration, factor)
    program = cp.Problem(cp.Minimize(factor), constraints)
    return _solved(program) and float(program.value) <= 1 + _SOLVER_ERROR


def _solved(program: cp.Problem) -> bool:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of an inaccurate solution, which the status tells
        try:
            program.solve(solver=cp.CLARABEL)
        except cp.SolverError:
            return False
    return program.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)


def _constraints(
    problem: Problem, point: list[Any], duration: FloatArray, factor: Any
) -> tuple[list[Any], list[Any]]:
    """All constraints, with a common factor on the limits of the motion, and the control points of snap."""
    limits = problem.limits
    constraints: list[Any] = []
    ends: list[list[tuple[Any, Any]]] = []  # per piece and order: first and last control point
    snap = []
    g = limits.gravity_m_s2
    for k, (p, c, t) in enumerate(zip(point, problem.cell.tolist(), duration.tolist(), strict=True)):
        constraints.append(p @ problem.normal[c].T <= np.tile(problem.offset[c], (DEGREE + 1, 1)))
        y, ends_here = p, [(p[0], p[DEGREE])]
        for order in range(1, _ORDERS):
            degree = DEGREE - order
            y = (degree + 1) / t * (y[1:] - y[:-1])
            ends_here.append((y[0], y[degree]))
            bound = (limits.speed_m_s, limits.acceleration_m_s2, limits.jerk_m_s3, limits.snap_m_s4)[
                order - 1
            ]
            if order == 1 and problem.speed is not None:
                bound = min(bound, float(problem.speed[k]))
            if np.isfinite(bound):
                constraints.append(cp.norm(y / bound, axis=1) <= factor)
            if order == 2:  # y / factor is in the set
                lift = g * factor
                up = cp.hstack([y[i, 2] + lift for i in range(degree + 1)])
                if np.isfinite(limits.most_thrust_m_s2):
                    thrust = cp.vstack([y[:, 0], y[:, 1], up])
                    constraints.append(cp.norm(thrust / g, axis=0) <= limits.most_thrust_m_s2 / g * factor)
                if np.isfinite(limits.least_thrust_m_s2):
                    constraints.append(up / g >= limits.least_thrust_m_s2 / g * factor)
                if np.isfinite(limits.tangent):
                    constraints.append(cp.norm(y[:, :2] / g, axis=1) <= limits.tangent * up / g)
        snap.append(y)
        ends.append(ends_here)
    for i in range(len(point) - 1):
        unit = min(duration[i], duration[i + 1])
        for order in range(_ORDERS):
            constraints.append(unit**order * (ends[i][order][1] - ends[i + 1][order][0]) == 0)
    moving = len(problem.state) > 1
    for order in range(4 if moving else _ORDERS):
        given = problem.state[order] if order < len(problem.state) else np.zeros(3)
        constraints.append(duration[0] ** order * (ends[0][order][0] - given) == 0)
    for order in range(_ORDERS):
        wanted = problem.goal if order == 0 else np.zeros(3)
        constraints.append(duration[-1] ** order * (ends[-1][order][1] - wanted) == 0)
    constraints += [ends[i][0][1] == via for i, via in problem.via.items()]
    for i, each in problem.opening.items():
        constraints.append(cp.norm(ends[i][0][1] - each.centre) <= each.radius_m)
        if each.is_disc:
            constraints.append(each.normal @ (ends[i][0][1] - each.centre) == 0)
            constraints.append((point[i] - each.centre) @ each.normal <= 0)
            constraints.append((point[i + 1] - each.centre) @ each.normal >= 0)
    return constraints, snap
