"""The QP solver: every verdict is proved by its own numbers, and held against Clarabel."""

from __future__ import annotations

import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.schemas.errors import UsageError
from alula.stages.filtering.qp import QpStatus, clarabel_backend
from support.effort import examples
from support.models.qp import solve_qp
from support.models.qp_families import (
    FAMILIES,
    INFEASIBLE,
    LOOSE,
    OPTIMAL,
    Stack,
    generic,
    proved,
    proved_exactly,
    scaled,
)

SIZES = [(n, m) for n in range(1, 9) for m in (0, 1, 2, 5, 12, 40)]
NOTHING = np.iinfo(np.uint32).max


def solved(stack, **options):
    return _core.QpSolver().solve_many(*stack.problem, **options)


def family(name, mode, seed, k, n, m):
    rng = np.random.default_rng([seed, n, m])
    stack = FAMILIES[name](rng, k, n, m)
    return stack if mode == "plain" else scaled(rng, stack, exactly=mode == "exact")


def one(hessian, gradient, rows, bounds):
    parts = (np.asarray(part, float)[None] for part in (hessian, gradient, rows, bounds))
    return Stack(*parts, truth=np.zeros(1, int))


@pytest.mark.every(2)
@pytest.mark.parametrize("mode", ["plain", "exact", "decimal"])
@pytest.mark.parametrize("name", FAMILIES)
def test_every_verdict_is_proved_and_none_contradicts_what_is_known(name, mode):
    for n, m in SIZES:
        stack = family(name, mode, 7, 12, n, m)
        answer = solved(stack)
        good = proved(stack, answer, LOOSE)
        assert good.all(), (n, m, np.flatnonzero(~good), answer["status"][~good])
        assert proved(stack, answer).mean() > 0.9
        assert not ((stack.truth == 1) & (answer["status"] == INFEASIBLE)).any(), (n, m)
        assert not ((stack.truth == -1) & (answer["status"] == OPTIMAL)).any(), (n, m)


@pytest.mark.parametrize("name", FAMILIES)
def test_verdicts_are_proved_in_rational_numbers(name):
    for n, m in ((1, 3), (3, 9), (5, 12), (8, 20)):
        stack = family(name, "decimal", 3, 3, n, m)
        answer = solved(stack)
        assert all(proved_exactly(stack, answer, i) for i in range(len(stack))), (n, m, answer["status"])


def test_the_proofs_notice_errors():
    stack = family("generic", "plain", 1, 40, 4, 30)
    answer = solved(stack)
    assert proved(stack, answer).all()
    for change in (1e-12, -1e-12):
        nudged = {**answer, "x": answer["x"] * (1 + change)}
        assert not proved(stack, nudged)[np.abs(answer["x"]).min(axis=1) > 0.1].any()
    forgotten = {**answer, "multipliers": np.zeros_like(answer["multipliers"])}
    assert not proved(stack, forgotten, LOOSE)[(answer["active"] >= 0).any(axis=1)].any()
    stack = family("infeasible", "plain", 1, 40, 4, 30)
    answer = solved(stack)
    assert proved(stack, answer).all()
    assert not proved(stack, {**answer, "multipliers": answer["multipliers"] * [1, 1, 1, 1, 1 - 1e-9]}).any()
    assert not proved(stack, {**answer, "status": np.zeros_like(answer["status"])}).any()


@pytest.mark.parametrize("name", FAMILIES)
def test_objective_and_verdict_are_those_of_clarabel_where_it_has_them(name):
    compared = 0
    for n, m in ((1, 2), (2, 9), (4, 30), (8, 40)):
        stack = family(name, "plain", 11, 10, n, m)
        answer = solved(stack)
        for i in range(len(stack)):
            hessian, gradient, rows, bounds = (part[i] for part in stack.problem)
            status, x, active, dual = clarabel_backend(hessian, gradient, rows, bounds)
            x = np.array(x)
            if status == QpStatus.OPTIMAL and answer["status"][i] == OPTIMAL:
                ours = answer["x"][i]
                value = [v @ hessian @ v / 2 + gradient @ v for v in (ours, x)]
                # What Clarabel's small violations can gain at our multipliers.
                used = answer["active"][i] >= 0
                gaps = np.maximum(bounds - rows @ x, 0)[answer["active"][i][used]]
                gain = gaps @ answer["multipliers"][i][used]
                size = abs(ours @ hessian @ ours) + np.abs(gradient) @ np.abs(ours)
                assert value[0] <= value[1] + gain + 1e-11 * (size + gain)
                compared += 1
            elif status == QpStatus.INFEASIBLE:
                weight = np.array(dual)
                gap = weight @ (bounds[active] - rows[active] @ answer["x"][i])
                terms = weight @ (np.abs(bounds[active]) + np.abs(rows[active]) @ np.abs(answer["x"][i]))
                assert answer["status"][i] == INFEASIBLE or gap <= 1e-9 * terms
                compared += 1
            elif status == QpStatus.OPTIMAL:  # ours is infeasible: x has to violate rows by as much
                size = np.linalg.norm(rows, axis=1)
                gap = np.max((bounds - rows @ x)[size > 0] / size[size > 0])
                assert gap >= answer["violation"][i] * (1 - 1e-6) - 1e-12 * np.linalg.norm(x)
                compared += 1
    assert compared >= 15


def test_the_same_through_cvxpy():
    import cvxpy as cp

    stack = generic(np.random.default_rng(5), 25, 4, 30)
    answer = solved(stack)
    for i in range(len(stack)):
        hessian, gradient, rows, bounds = (part[i] for part in stack.problem)
        x = cp.Variable(4)
        objective = cp.quad_form(x, cp.psd_wrap(hessian)) / 2 + gradient @ x
        cp.Problem(cp.Minimize(objective), [rows @ x >= bounds]).solve(solver=cp.CLARABEL)
        assert answer["x"][i] == pytest.approx(x.value, abs=1e-5)


@settings(deadline=None, max_examples=examples(300))
@given(st.data(), st.integers(1, 8), st.integers(0, 12))
def test_small_whole_numbers_of_any_kind(data, n, m):
    whole = st.integers(-3, 3).map(float)
    basis = data.draw(arrays.arrays(float, (n, n), elements=whole))
    gradient = data.draw(arrays.arrays(float, n, elements=whole))
    rows = data.draw(arrays.arrays(float, (m, n), elements=whole))
    bounds = data.draw(arrays.arrays(float, m, elements=whole))
    stack = one(basis @ basis.T + np.eye(n), gradient, rows, bounds)
    answer = solved(stack)
    assert proved_exactly(stack, answer, 0), answer["status"]


@pytest.mark.parametrize("mode", ["plain", "exact", "decimal"])
def test_a_warm_start_changes_nothing_but_time(mode):
    for name in FAMILIES:
        for n, m in ((2, 9), (4, 40), (8, 40)):
            stack = family(name, mode, 5, 12, n, m)
            cold = solved(stack)
            right = cold["active"].astype(np.uint32)
            wrong = np.random.default_rng(0).integers(0, m + 3, right.shape).astype(np.uint32)
            for warm in (right, wrong, np.full_like(right, NOTHING)):
                answer = solved(stack, warm=warm)
                assert np.array_equal(answer["status"], cold["status"]), name
                assert proved(stack, answer, LOOSE).all(), name
                change = answer["x"] - cold["x"]
                norm = [np.sqrt(np.einsum("ki,kij,kj->k", v, stack.hessian, v)) for v in (change, cold["x"])]
                assert (norm[0] <= 1e-7 * norm[1]).all(), name
    stack = generic(np.random.default_rng(2), 50, 4, 70)
    cold = solved(stack)
    again = solved(stack, warm=cold["active"].astype(np.uint32))
    assert np.array_equal(again["x"], cold["x"])
    assert again["iterations"].sum() < cold["iterations"].sum()


def test_equal_problems_give_equal_bits_whatever_came_before():
    stack = generic(np.random.default_rng(2), 30, 5, 60)
    solver = _core.QpSolver()
    first = solver.solve_many(*stack.problem)
    order = np.random.default_rng(3).permutation(30)
    solver.solve_many(*family("nearly_parallel", "decimal", 1, 20, 5, 90).problem)
    second = solver.solve_many(*stack[order].problem)
    for name in ("status", "x", "active", "multipliers", "violation", "iterations"):
        assert np.array_equal(second[name], first[name][order]), name


def test_thousands_of_rows():
    for name in ("generic", "vertex", "nearly_parallel", "infeasible", "flight"):
        stack = family(name, "plain", 2, 2, 6, 3000)
        assert proved(stack, solved(stack), LOOSE).all(), name


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("solver", ["active-set", "clarabel"])
def test_a_number_that_is_not_finite_has_no_answer(bad, solver):
    good = [np.eye(3), np.ones(3), np.ones((6, 3)), np.ones(6)]
    for part in range(4):
        for at in range(good[part].size):
            problem = [values.copy() for values in good]
            problem[part].flat[at] = bad
            answer = solve_qp(*problem, solver=solver)
            assert answer.status == QpStatus.FAILED
            assert answer.violation == np.inf
            assert not answer.x.any()


def test_a_hessian_that_is_not_positive_definite_has_no_answer():
    for hessian in (
        np.zeros((2, 2)),
        -np.eye(2),
        np.ones((2, 2)),
        [[1, 2], [2, 1]],
        [[1e308, 0], [0, -1e-308]],
    ):
        hessian = np.array(hessian, float)
        assert solve_qp(hessian, np.ones(2), np.eye(2), np.zeros(2)).status == QpStatus.FAILED


def test_numbers_beyond_the_square_root_of_the_range():
    for size in (1e-300, 1e-200, 1e200, 1e300):
        answer = solve_qp(np.eye(2), np.array([1.0, 0]), np.array([[size, 0], [0, 1]]), np.array([size, -1]))
        assert answer.status == QpStatus.OPTIMAL
        assert answer.x.tolist() == [1, 0]
        assert answer.multipliers == pytest.approx([2 / size, 0])
    tiny = solve_qp(1e8 * np.eye(2), np.array([1e-305, -1e-310]), np.eye(2), -np.ones(2))
    assert tiny.status == QpStatus.OPTIMAL


def test_rows_of_zeros_are_vacuous_or_impossible():
    zero = np.zeros((1, 2))
    assert solve_qp(np.eye(2), np.ones(2), zero, np.zeros(1)).x.tolist() == [-1, -1]
    answer = solve_qp(np.eye(2), np.ones(2), np.vstack([np.eye(2), zero, zero]), np.array([0, 0, -1, 1e-300]))
    assert answer.status == QpStatus.INFEASIBLE
    assert answer.multipliers.tolist() == [0, 0, 0, 1]


def test_one_answer_by_hand():
    answer = solve_qp(
        np.diag([1.0, 4]), np.zeros(2), np.array([[2.0, 0], [0, 1], [1, 0]]), np.array([6.0, -1, 3])
    )
    assert answer.x.tolist() == [3, 0]
    assert answer.active.tolist() == [0]
    assert answer.multipliers.tolist() == [1.5, 0, 0]
    assert answer.violation == 0
    answer = solve_qp(np.eye(1), np.zeros(1), np.array([[2.0], [-1]]), np.array([2.0, 0]))
    assert answer.status == QpStatus.INFEASIBLE  # x >= 1 and x <= 0: any x violates one of them by 1/2
    assert answer.multipliers @ [2, -1] == 0
    assert answer.violation == 0.5


def test_both_solvers_answer_alike():
    rng = np.random.default_rng(4)
    for margin, status in ((-0.5, QpStatus.OPTIMAL), (0.5, QpStatus.INFEASIBLE)):
        rows = rng.normal(size=(40, 4))
        rows[20:] = -rows[:20]
        bounds = rows @ rng.normal(size=4) + margin
        ours, theirs = (
            solve_qp(np.eye(4), np.ones(4), rows, bounds, solver=s) for s in ("active-set", "clarabel")
        )
        assert ours.status == theirs.status == status
        assert ours.x == pytest.approx(theirs.x, abs=1e-6)
        for answer in (ours, theirs):
            if status == QpStatus.INFEASIBLE:
                assert len(answer.active) <= 5
                assert np.abs(rows.T @ answer.multipliers).max() < 1e-6
                assert answer.multipliers @ bounds == pytest.approx(answer.violation)
                assert answer.violation > 0.05
            else:
                assert answer.active.tolist() == ours.active.tolist()
                assert answer.multipliers == pytest.approx(ours.multipliers, abs=1e-5)
                assert 0 <= answer.violation < 1e-6


def test_a_backend_answers_behind_the_native_solver():
    asked = []

    def backend(hessian, gradient, rows, bounds):
        asked.append((hessian.shape, gradient.shape, rows.shape, bounds.shape))
        return 0, [1.0, 2.0], [1], [0.5]

    solver = _core.QpSolver(backend)
    problem = np.eye(2), np.zeros(2), np.array([[1.0, 0], [0, 2], [3, 4]]), np.array([0.0, 4, 16])
    answer = solver.solve(*problem)
    assert asked == [((2, 2), (2,), (3, 2), (3,))]
    assert (answer.status, answer.x.tolist(), answer.active.tolist()) == (0, [1, 2], [1])
    assert answer.violation == 1  # recomputed: (16 - 11) / 5
    for wrong in (
        None,
        (0, [1.0], [], []),
        (3, [1.0, 2], [], []),
        (0, [1.0, 2], [3], [1.0]),
        (0, [1.0, 2], [1], []),
    ):
        with pytest.raises((TypeError, ValueError, RuntimeError)):
            _core.QpSolver(lambda *_, answer=wrong: answer).solve(*problem)
    assert _core.QpSolver(lambda *_: (0, [np.nan, 1], [], [])).solve(*problem).status == 2
    with pytest.raises(KeyboardInterrupt):
        _core.QpSolver(_interrupted).solve(*problem)
    with pytest.raises(TypeError):
        _core.QpSolver(3)


def test_the_native_solver_refuses_shapes_of_its_own():
    solver = _core.QpSolver()
    for shapes in (
        ((2, 2), (3,), (4, 3), (4,)),
        ((11, 11), (11,), (4, 11), (4,)),
        ((3, 3), (3,), (4, 3), (5,)),
    ):
        with pytest.raises(ValueError, match="quadratic program"):
            solver.solve(*(np.ones(shape) for shape in shapes))
        with pytest.raises(ValueError, match="quadratic program"):
            solver.solve_many(*(np.ones((2, *shape)) for shape in shapes))


def _interrupted(*_):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    "shapes",
    [
        ((2, 2), (3,), (4, 3), (4,)),
        ((3, 3), (3,), (4, 2), (4,)),
        ((3, 3), (3,), (4, 3), (5,)),
        ((11, 11), (11,), (4, 11), (4,)),
        ((0, 0), (0,), (4, 0), (4,)),
        ((9,), (3,), (4, 3), (4,)),
    ],
)
def test_shapes_that_do_not_fit_are_refused(shapes):
    for solver in ("active-set", "clarabel"):
        with pytest.raises(UsageError, match="not a quadratic program"):
            solve_qp(*(np.ones(shape) for shape in shapes), solver=solver)
    with pytest.raises(UsageError, match="no QP solver"):
        solve_qp(np.eye(1), np.ones(1), np.eye(1), np.ones(1), solver="simplex")
