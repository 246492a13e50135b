"""Small dense quadratic programs: the native active-set solver, or Clarabel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import UsageError
from alula.stages.filtering.qp import QpStatus, clarabel_backend

QpSolverName = Literal["active-set", "clarabel"]


@dataclass(frozen=True, slots=True)
class QpSolution:
    """Answer to a quadratic program of n variables and m rows.

    Attributes:
        status: every caller branches on it.
        x: the minimiser, shape (n,); zero unless optimal.
        multipliers: y >= 0 with hessian x + gradient = rows^T y, or the certificate, shape (m,).
        active: rows that hold with equality and have a multiplier, or those of the certificate, ascending.
        violation: largest (bounds_i - rows_i . x) / |rows_i|, at least 0, of the input; when infeasible
            bounds . y / sum_i y_i |rows_i|, which some row of every x exceeds; infinite when failed.
    """

    status: QpStatus
    x: FloatArray
    multipliers: FloatArray
    active: NDArray[np.int64]
    violation: float


def solve_qp(
    hessian: FloatArray,
    gradient: FloatArray,
    rows: FloatArray,
    bounds: FloatArray,
    *,
    solver: QpSolverName = "active-set",
    warm: Sequence[int] = (),
) -> QpSolution:
    """Minimise 1/2 x^T hessian x + gradient^T x subject to rows x >= bounds.

    With "active-set" every verdict is proved from the input: what is optimal solves a program that
    differs from the given one by a few units of rounding, relative to each sum of absolute values, and
    what is infeasible has a certificate. With "clarabel" the answer is that of an interior-point method
    with its default tolerances, about 1e-8; an "almost" of Clarabel is FAILED.

    Args:
        hessian: symmetric positive definite, shape (n, n), n = 1..10; only its symmetric part matters.
        gradient: shape (n,).
        rows: shape (m, n).
        bounds: shape (m,).
        solver: "active-set" or "clarabel".
        warm: rows believed active; only the active-set solver looks at them.

    Raises:
        UsageError: shapes do not fit together, or the solver is not known.

    Source: Goldfarb, Idnani 1983, "A numerically stable dual method for solving strictly convex QPs".
    """
    hessian, gradient, rows, bounds = (
        np.ascontiguousarray(part, dtype=np.float64) for part in (hessian, gradient, rows, bounds)
    )
    names = np.array([row for row in warm if row >= 0], dtype=np.uint32)
    if solver not in ("active-set", "clarabel"):
        raise UsageError(f"no QP solver is called {solver!r}; there are active-set and clarabel")
    n, m = gradient.size, bounds.size
    if not 1 <= n <= 10 or (hessian.shape, gradient.shape, rows.shape, bounds.shape) != (
        (n, n),
        (n,),
        (m, n),
        (m,),
    ):
        shapes = ", ".join(str(part.shape) for part in (hessian, gradient, rows, bounds))
        raise UsageError(f"not a quadratic program of 1 to 10 variables: shapes {shapes}")
    native = _core.QpSolver(clarabel_backend if solver == "clarabel" else None)
    result = native.solve(hessian, gradient, rows, bounds, names)
    multipliers = np.zeros(m)
    multipliers[result.active] = result.multipliers
    return QpSolution(
        QpStatus(result.status), result.x, multipliers, result.active.astype(np.int64), result.violation
    )
