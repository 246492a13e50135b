"""Small dense quadratic programs: the native active-set solver, or Clarabel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import UsageError

QpSolverName = Literal["active-set", "clarabel"]


class QpStatus(IntEnum):
    """Verdict on a program; the numbers are those of `QpStatus` in native/core."""

    OPTIMAL = 0
    """`x` is the minimiser."""
    INFEASIBLE = 1
    """No x obeys all rows; the multipliers y >= 0 prove it: rows^T y = 0 and bounds . y > 0."""
    FAILED = 2
    """A number is not finite, the Hessian is not positive definite, or there is no proved verdict."""


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

    A native filter reaches Clarabel through `QpSolver::with_backend` (alula/qp/qp.hpp): its binding hands a
    callable to `qp_solver` (bindings/python_qp.hpp), here `clarabel_backend`, which then answers behind
    `QpSolver::solve`. It takes the GIL, copies the problem and costs about 0.1 ms, so it is there to
    compare filters, not to fly.

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


def clarabel_backend(
    hessian: FloatArray, gradient: FloatArray, rows: FloatArray, bounds: FloatArray
) -> tuple[int, list[float], list[int], list[float]]:
    """Let Clarabel solve the program; a backend of `_core.QpSolver`.

    Returns:
        The number of a `QpStatus`, x, the rows whose multiplier outweighs their slack, and these
        multipliers; of a certificate all rows above rounding, scaled to sum_i y_i |rows_i| = 1.
    """
    import clarabel
    from scipy.sparse import csc_matrix

    n, m = len(gradient), len(bounds)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    solution: Any = clarabel.DefaultSolver(
        csc_matrix(np.triu((hessian + hessian.T) / 2)),
        gradient,
        csc_matrix(-rows),
        -bounds,
        [clarabel.NonnegativeConeT(m)] if m else [],
        settings,
    ).solve()
    nothing: tuple[int, list[float], list[int], list[float]] = (QpStatus.FAILED, [0.0] * n, [], [])
    if solution.status == clarabel.SolverStatus.Solved:
        dual, slack = np.array(solution.z), np.array(solution.s)
        active = np.flatnonzero(dual > slack)
        return QpStatus.OPTIMAL, list(solution.x), active.tolist(), dual[active].tolist()
    if solution.status == clarabel.SolverStatus.PrimalInfeasible:
        size = np.linalg.norm(rows, axis=1)
        impossible = np.flatnonzero((size == 0) & (bounds > 0))
        if len(impossible):
            return QpStatus.INFEASIBLE, [0.0] * n, [int(impossible[0])], [1.0]
        weight = np.maximum(np.array(solution.z), 0) * size
        active = np.flatnonzero(weight > 1e-9 * weight.max())
        weight = _few(rows[active] / size[active, None], bounds[active] / size[active], weight[active])
        if weight.any():
            kept = weight > 0
            dual = weight[kept] / size[active][kept] / weight.sum()
            return QpStatus.INFEASIBLE, [0.0] * n, active[kept].tolist(), dual.tolist()
    return nothing


def _few(rows: FloatArray, bounds: FloatArray, weight: FloatArray) -> FloatArray:
    """A certificate of the same unit rows that needs at most n + 1 of them; zeros if there is none."""
    if len(bounds) <= rows.shape[1] + 1 or not bounds.any():
        return weight
    from scipy.optimize import nnls

    equations = np.vstack([rows.T, bounds / np.abs(bounds).max()])
    return np.asarray(nnls(equations, np.append(np.zeros(rows.shape[1]), 1.0))[0])
