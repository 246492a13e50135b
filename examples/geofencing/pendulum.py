"""Measure the times of the pendulum's two filters, and of general solvers on the same programs.

Usage: python pendulum.py [--quick] FILE

Both native filters run on the states of one flight against the boundary, in turns. A solver gets every row of
the program at these states, called from Python with its set-up. Its time is in addition to building the rows,
which the time of the native program includes. FILE is JSON.
"""

import argparse
import importlib.util
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.atomic import write_text
from alula.stages.filtering.qp import clarabel_backend
from papers.geofencing.pendulum import PROGRAM, PUSH, REGULATION, Pendulum, program_rows, swing

parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--quick", action="store_true")
parser.add_argument("file", type=Path)
options = parser.parse_args()
ROUNDS, SOLVED = (3, 20) if options.quick else (15, 150)
ONE = np.ones((1, 1))


def micro(action: Callable[[], Any]) -> float:
    """Time an action [us]."""
    began = time.perf_counter()
    action()
    return 1e6 * (time.perf_counter() - began)


def quadprog_backend(hessian: Any, gradient: Any, rows: Any, bounds: Any) -> Any:
    """Solve with quadprog, the method of Goldfarb and Idnani."""
    import quadprog

    return quadprog.solve_qp(hessian, -gradient, rows.T, bounds)


def answers(solver: Callable[..., Any], gradient: Any, a: Any, b: Any) -> float | None:
    """Time a solver on one program [us]; None without a solution."""
    try:
        return micro(lambda: solver(ONE, gradient, np.ascontiguousarray(a[:, None]), b))
    except ValueError:
        return None


flown = swing(PROGRAM, Pendulum().alpha, 0.01)
states = np.stack([flown.angle, flown.rate], axis=1)
filters = {name: _core.PendulumFilter(name) for name in (REGULATION, PROGRAM)}
times: dict[str, list[float]] = {name: [] for name in filters}
for _ in range(ROUNDS):
    for name, made in filters.items():
        times[name].append(micro(lambda made=made: made.filter(states, PUSH)) / len(states))
found = {f"{name} [us]": statistics.median(each) for name, each in times.items()}

picked = states[:: max(1, len(states) // SOLVED)]
a, b = program_rows(picked)
gradient = np.array([-PUSH])
solvers: dict[str, Callable[..., Any]] = {
    "active-set": lambda *program: _core.QpSolver(None).solve(*program, np.empty(0, np.uint32)),
    "clarabel": clarabel_backend,
}
if importlib.util.find_spec("quadprog") is not None:
    solvers["quadprog"] = quadprog_backend
for name, solver in solvers.items():
    took = [answers(solver, gradient, a[i], b[i]) for i in range(len(picked))]
    solved = [value for value in took if value is not None]
    if solved:
        found[f"solver {name} [us]"] = statistics.median(solved)
write_text(
    options.file,
    json.dumps({"times": found, "rows": a.shape[1], "states": len(states), "solved": len(picked)}, indent=2)
    + "\n",
)
