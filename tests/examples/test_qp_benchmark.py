"""The benchmark of the QP solver runs, finds no errors, and would find them; times are not tested."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest

from alula import _core
from support.models.qp_families import INFEASIBLE, OPTIMAL, generic, infeasible
from support.paths import ROOT


@pytest.fixture(scope="module")
def benchmark_module():
    if not (ROOT / "benchmarks").is_dir():
        pytest.skip("not a checkout")
    sys.path.append(str(ROOT / "benchmarks"))
    try:
        import qp_problems
    finally:
        sys.path.remove(str(ROOT / "benchmarks"))
    return qp_problems


def test_a_short_run_counts_and_times(benchmark_module, tmp_path):
    figures = tmp_path / "figures.json"
    command = [sys.executable, "-P", benchmark_module.__file__, "--problems", "300", "--json", str(figures)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    found = json.loads(figures.read_text())
    assert found["qp_problems"] == 300
    assert found["qp_wrong"] == found["qp_infeasible_missed"] == found["qp_failed"] == 0
    assert found["qp_infeasible"] > 10
    for name in ("qp_p50_us", "qp_p99_us", "qp_call_p50_us", "clarabel_p50_us"):
        assert 0 < found[name] < math.inf


def test_it_stops_in_time(benchmark_module):
    assert benchmark_module.verdicts(10**6, 0, 0.2, cvxpy=0)["qp_problems"] < 10**5


def test_false_verdicts_contradict_clarabel(benchmark_module):
    feasible, impossible = (family(np.random.default_rng(1), 20, 4, 30) for family in (generic, infeasible))
    feasible.gradient *= 10
    for stack, truth in ((feasible, OPTIMAL), (impossible[impossible.truth == -1], INFEASIBLE)):
        honest = _core.QpSolver().solve_many(*stack.problem)
        if truth == OPTIMAL:  # a point that is worse, a certificate of a row that is not active
            loose = np.full_like(honest["active"], -1)
            slack = np.einsum("kmn,kn->km", stack.rows, honest["x"]) - stack.bounds
            loose[:, 0] = slack.argmax(axis=1)
            lies = [
                {**honest, "x": honest["x"] + 100},
                {
                    **honest,
                    "status": np.full(len(stack), INFEASIBLE),
                    "active": loose,
                    "multipliers": np.ones((20, 5)),
                },
            ]
        else:
            lies = [{**honest, "status": np.full(len(stack), OPTIMAL), "x": np.zeros((len(stack), 4))}]
        decided = 0
        for i in range(len(stack)):
            other = benchmark_module.through_clarabel(stack, i)
            assert not benchmark_module.contradicts(stack, honest, i, other)
            if other[0] != truth:
                continue
            decided += 1
            assert all(benchmark_module.contradicts(stack, lie, i, other) for lie in lies), i
        assert decided >= 10
