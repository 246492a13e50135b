"""Clarabel as the solver of native filters, to compare them with their own."""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np

from alula.schemas.arrays import FloatArray


class QpStatus(IntEnum):
    """Verdict on a program; the numbers are those of `QpStatus` in native/core."""

    OPTIMAL = 0
    """`x` is the minimiser."""
    INFEASIBLE = 1
    """No x obeys all rows; the multipliers y >= 0 prove it: rows^T y = 0 and bounds . y > 0."""
    FAILED = 2
    """A number is not finite, the Hessian is not positive definite, or there is no proved verdict."""


def clarabel_backend(
    hessian: FloatArray, gradient: FloatArray, rows: FloatArray, bounds: FloatArray
) -> tuple[int, list[float], list[int], list[float]]:
    """Let Clarabel minimise 1/2 x^T hessian x + gradient^T x subject to rows x >= bounds.

    A native filter reaches Clarabel through `QpSolver::with_backend` (alula/qp/qp.hpp): its binding hands
    this callable to `qp_solver` (bindings/python_qp.hpp), which then answers behind `QpSolver::solve`. It
    takes the GIL, copies the problem and costs about 0.1 ms, so it is there to compare filters, not to fly.
    Tolerances are those of Clarabel, about 1e-8; an "almost" of Clarabel is FAILED.

    Args:
        hessian: symmetric positive definite, shape (n, n).
        gradient: shape (n,).
        rows: shape (m, n).
        bounds: shape (m,).

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
