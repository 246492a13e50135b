"""The QP solver on random and adversarial programs: comparison with Clarabel, and times of several solvers.

Every result is proved from its own numbers (`qp_families.proved`) and compared with what is known about the
program and with Clarabel's result. Clarabel is accurate only to about 1e-8, so the comparison uses
inequalities that hold for any point and any multipliers and depends on no tolerance of Clarabel's.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))  # qp_families

import numpy as np

from alula import _core
from support.models.qp_families import (
    CERTAIN,
    FAILED,
    FAMILIES,
    INFEASIBLE,
    LOOSE,
    OPTIMAL,
    Stack,
    generic,
    proved,
    scaled,
)

_BATCH = 20
_SIZES = (0, 1, 2, 3, 5, 9, 20, 40, 70, 120)
_TIMED_VARIABLES, _TIMED_ROWS = 4, 70
_EXACT = 1e-11  # relative tolerance of the inequalities below; extended precision is far more exact


def programs(problems: int, seed: int) -> Any:
    """Generate batches of all families, plain and scaled, 1 to 8 variables; one in 200 has 3000 rows."""
    done = index = 0
    names = list(FAMILIES)
    while done < problems:
        rng = np.random.default_rng([seed, index])
        name, mode = names[index % len(names)], index // len(names) % 3
        k, n, m = min(_BATCH, problems - done), int(rng.integers(1, 9)), int(rng.choice(_SIZES))
        if index % 200 == 199:
            k, m = 1, 3000
        stack = FAMILIES[name](rng, k, n, m)
        yield name, stack if mode == 0 else scaled(rng, stack, exactly=mode == 1)
        done, index = done + k, index + 1


def _columns(matrix: np.ndarray) -> Any:
    from scipy.sparse import csc_array

    rows, columns = matrix.shape
    indices = np.tile(np.arange(rows, dtype=np.int32), columns)
    return csc_array((matrix.T.ravel(), indices, np.arange(columns + 1, dtype=np.int32) * rows), matrix.shape)


def clarabel_call(stack: Stack, i: int) -> Callable[[], Any]:
    """Prepare Clarabel's set-up and solution of one program; conversion to its format is done beforehand."""
    import clarabel

    hessian, gradient, rows, bounds = (part[i] for part in stack.problem)
    upper, negative = _columns(np.triu(hessian)), _columns(-rows)
    cones = [clarabel.NonnegativeConeT(len(bounds))] if len(bounds) else []
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    return lambda: clarabel.DefaultSolver(upper, gradient, negative, -bounds, cones, settings).solve()


def through_clarabel(stack: Stack, i: int) -> tuple[int, np.ndarray, np.ndarray]:
    """Clarabel's status, x and multipliers."""
    answer = clarabel_call(stack, i)()
    status = {"Solved": OPTIMAL, "PrimalInfeasible": INFEASIBLE}.get(str(answer.status), FAILED)
    return status, np.array(answer.x), np.maximum(np.array(answer.z), 0)


def through_cvxpy(stack: Stack, i: int) -> tuple[int, np.ndarray, np.ndarray]:
    """Status, x and multipliers of Clarabel through cvxpy."""
    import cvxpy as cp

    hessian, gradient, rows, bounds = (part[i] for part in stack.problem)
    x = cp.Variable(len(gradient))
    constraints = [rows @ x >= bounds] if len(bounds) else []
    problem = cp.Problem(cp.Minimize(cp.quad_form(x, cp.psd_wrap(hessian)) / 2 + gradient @ x), constraints)
    nothing = FAILED, np.zeros_like(gradient), np.zeros_like(bounds)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warning that a solution may be inaccurate
            problem.solve(solver=cp.CLARABEL)
    except cp.SolverError:
        return nothing
    if problem.status == cp.INFEASIBLE:
        return INFEASIBLE, nothing[1], nothing[2]
    if problem.status != cp.OPTIMAL:
        return nothing
    dual = np.maximum(constraints[0].dual_value, 0) if constraints else nothing[2]
    return OPTIMAL, np.asarray(x.value), dual


def contradicts(
    stack: Stack, ours: dict[str, np.ndarray], i: int, other: tuple[int, np.ndarray, np.ndarray]
) -> bool:
    """Return whether another solver's point or multipliers show that our result is false.

    Ours is infeasible: y^T b - |y^T A| |x| bounds y^T (b - A x) of any x from below. Ours is optimal: a
    certificate z requires z^T (b - A x) > 0 for any x, and by convexity no x' has
    f(x') < f(x) + y^T (A x' - b), with our multipliers y.
    """
    wide = np.longdouble
    hessian, gradient, rows, bounds = (part[i].astype(wide) for part in stack.problem)
    status, point, dual = other[0], other[1].astype(wide), other[2].astype(wide)
    x, y = ours["x"][i].astype(wide), np.zeros(len(bounds), wide)
    used = ours["active"][i] >= 0
    y[ours["active"][i][used]] = ours["multipliers"][i][used]
    if ours["status"][i] == INFEASIBLE and status == OPTIMAL:
        terms = y * np.abs(bounds) + y * (np.abs(rows) @ np.abs(point))
        return bool(y @ (bounds - rows @ point) < -_EXACT * terms.sum())
    if ours["status"][i] == OPTIMAL and status == INFEASIBLE:
        terms = dual * np.abs(bounds) + dual * (np.abs(rows) @ np.abs(x))
        return bool(dual @ (bounds - rows @ x) > LOOSE * 2 * CERTAIN * terms.sum())
    if ours["status"][i] == OPTIMAL and status == OPTIMAL:

        def objective(at: np.ndarray) -> Any:
            return at @ hessian @ at / 2 + gradient @ at

        def size(at: np.ndarray) -> Any:
            return np.abs(at) @ np.abs(hessian) @ np.abs(at) + np.abs(gradient) @ np.abs(at)

        terms = y * (np.abs(rows) @ np.abs(point) + np.abs(bounds))
        worse = objective(x) - objective(point) - y @ np.maximum(bounds - rows @ point, 0)
        return bool(worse > _EXACT * (size(x) + size(point) + terms.sum()))
    return False


def verdicts(problems: int, seed: int, seconds: float | None, cvxpy: int = 300) -> Counter[str]:
    """Count programs, results and mistakes; a subsample of `cvxpy` programs is also solved through cvxpy."""
    solver, count, start = _core.QpSolver(), Counter[str](), time.monotonic()
    every = max(1, problems // max(1, cvxpy))
    for _, stack in programs(problems, seed):
        if seconds is not None and time.monotonic() - start > seconds:
            break
        ours = solver.solve_many(*stack.problem)
        strict, good = proved(stack, ours), proved(stack, ours, LOOSE)
        status, truth = ours["status"], stack.truth
        wrong = ~good | ((truth == 1) & (status == INFEASIBLE)) | ((truth == -1) & (status == OPTIMAL))
        missed = (truth == -1) & (status != INFEASIBLE)
        for i in range(len(stack)):
            others = [through_clarabel(stack, i)]
            if cvxpy and (count["qp_problems"] + i) % every == 0:
                others.append(through_cvxpy(stack, i))
                count["qp_cvxpy"] += 1
            for other in others:
                if other[0] == FAILED:
                    count["qp_clarabel_undecided"] += 1
                else:
                    count["qp_clarabel_differs"] += int(other[0] != status[i])
                if contradicts(stack, ours, i, other):
                    wrong[i] = True
                    missed[i] |= other[0] == INFEASIBLE
        count.update(
            qp_problems=len(stack),
            qp_wrong=int(wrong.sum()),
            qp_infeasible=int((status == INFEASIBLE).sum()),
            qp_infeasible_missed=int(missed.sum()),
            qp_failed=int((status == FAILED).sum()),
            qp_loose=int((good & ~strict).sum()),
        )
    return count


def calls(stack: Stack, i: int, solver: Any) -> dict[str, Callable[[], Any]]:
    """Prepare one Python call per installed solver; arrays are already in its own form."""
    hessian, gradient, rows, bounds = (part[i] for part in stack.problem)
    made: dict[str, Callable[[], Any]] = {
        "qp_call": lambda: solver.solve(hessian, gradient, rows, bounds),
        "clarabel": clarabel_call(stack, i),
    }
    try:
        import daqp
    except ImportError:
        pass
    else:
        above, sense = np.full(len(bounds), 1e30), np.zeros(len(bounds), np.int32)
        made["daqp"] = lambda: daqp.solve(hessian, gradient, rows, above, bounds, sense)
    try:
        import quadprog
    except ImportError:
        pass
    else:
        columns = np.asfortranarray(rows.T)  # it takes the rows as columns
        made["quadprog"] = lambda: quadprog.solve_qp(hessian, -gradient, columns, bounds)
    return made


def times(seed: int, problems: int = 2000) -> dict[str, float]:
    """Time one program of 4 variables and 70 rows [us], cold, all solvers in turns on each program.

    `qp_` is the native call alone, as in a filter; `qp_call_` and the others are Python calls.
    """
    rng = np.random.default_rng([seed, 1])
    stack = generic(rng, problems, _TIMED_VARIABLES, _TIMED_ROWS)
    solver = _core.QpSolver()
    native = solver.solve_many(*stack.problem)["elapsed_ns"]
    elapsed: dict[str, list[int]] = {}
    for i in range(problems):
        made = list(calls(stack, i, solver).items())
        for name, call in made if i % 2 else reversed(made):
            start = time.perf_counter_ns()
            call()
            elapsed.setdefault(name, []).append(time.perf_counter_ns() - start)
    figures = {
        "qp_p50_us": float(np.median(native)) / 1e3,
        "qp_p99_us": float(np.percentile(native, 99)) / 1e3,
    }
    for name, values in elapsed.items():
        figures[f"{name}_p50_us"] = float(np.median(values)) / 1e3
        figures[f"{name}_p99_us"] = float(np.percentile(values, 99)) / 1e3
    return figures


def run(problems: int = 100_000, seed: int = 0, seconds: float | None = None) -> dict[str, float]:
    """Count mistakes on `problems` programs for at most `seconds`, and time 2000 others.

    Keys: qp_problems, qp_wrong, qp_infeasible, qp_infeasible_missed, qp_failed, qp_loose, qp_cvxpy,
    qp_clarabel_undecided, qp_clarabel_differs, and of `times` qp_, qp_call_, clarabel_, and where
    installed daqp_ and quadprog_, each with p50_us and p99_us.
    """
    names = ("wrong", "infeasible", "infeasible_missed", "failed", "loose", "cvxpy")
    count = verdicts(problems, seed, seconds)
    figures = {f"qp_{name}": float(count[f"qp_{name}"]) for name in ("problems", *names)}
    for name in ("qp_clarabel_undecided", "qp_clarabel_differs"):
        figures[name] = float(count[name])
    return figures | times(seed, 2000 if problems >= 2000 else max(10, problems))


def main() -> int:
    """Print the figures; return 1 if any result is wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--problems", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=None, help="maximum time of counting")
    parser.add_argument("--json", type=Path, default=None, help="also write the figures to this file")
    options = parser.parse_args()
    figures = run(options.problems, options.seed, options.seconds)
    for name, value in figures.items():
        print(f"{name:24} {value:,.2f}" if name.endswith("_us") else f"{name:24} {value:,.0f}")
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return int(figures["qp_wrong"] > 0 or figures["qp_infeasible_missed"] > 0)


if __name__ == "__main__":
    raise SystemExit(main())
