"""The onboard projections on half-spaces in a box against the proved solver, linear programs, Clarabel."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.stages.filtering.qp import QpStatus
from support.effort import examples
from support.models.half_space_families import KINDS, LIMIT, MARGIN, half_spaces, roomiest, unit, violation
from support.models.qp import solve_qp

BOX = np.vstack([np.eye(3), -np.eye(3)])


def nearest(rows, a0, solver="active-set"):
    stacked = -np.vstack([rows[:, :3], BOX])
    bounds = -np.r_[rows[:, 3], np.full(6, LIMIT)]
    return solve_qp(np.eye(3), -a0, stacked, bounds, solver=solver)


def project(rows, a0, solver="exact", **options):
    a, feasible, missed, iterations, basis, _ = _core.half_space_projection(
        rows, a0.tolist(), solver, **options
    )
    return np.array(a), feasible, missed, iterations, basis


def singles(rng, scale=6.0):
    return rng.uniform(-scale, scale, 3).astype(np.float32).astype(float)


@pytest.mark.parametrize("kind", KINDS)
def test_the_exact_projection_is_the_nearest_point_and_never_says_feasible_wrongly(kind):
    rng = np.random.default_rng(KINDS.index(kind))
    verdicts = set()
    for _ in range(examples(500)):
        rows, a0 = half_spaces(rng, kind, int(rng.integers(1, 13))), singles(rng)
        a, feasible, missed, *_ = project(rows, a0)
        truth = nearest(rows, a0)
        assert np.abs(a).max() <= LIMIT
        assert missed == pytest.approx(violation(rows, a), abs=3e-6)
        if feasible:
            assert violation(rows, a) <= 3e-6
            assert truth.status == QpStatus.OPTIMAL
            ball, longer = roomiest(rows), np.linalg.norm(a - a0) - np.linalg.norm(truth.x - a0)
            assert longer <= 2 * LIMIT * np.sqrt(3) * min(1, 1.2 * MARGIN / max(ball, 1e-12)) + 1e-5
        elif truth.status == QpStatus.OPTIMAL:
            assert roomiest(rows) <= 1.05 * MARGIN
        verdicts.add(feasible)
    assert verdicts == {True, False}


def test_the_exact_projection_agrees_with_clarabel():
    rng = np.random.default_rng(9)
    compared = 0
    for _ in range(100):
        rows, a0 = half_spaces(rng, "random", 6), singles(rng)
        a, feasible, *_ = project(rows, a0)
        reference = nearest(rows, a0, "clarabel")
        if not feasible or roomiest(rows) < 0.1:
            continue
        assert np.linalg.norm(a - a0) == pytest.approx(np.linalg.norm(reference.x - a0), abs=1e-2)
        compared += 1
    assert compared > 30


def test_what_obeys_all_rows_comes_back_bit_by_bit_and_nothing_else_does():
    rows = np.array([[1.0, 0, 0, 2.0], [0, 0.6, 0.8, -1.0]])
    inside = np.array([2.0, 6.0, -6.0], np.float32)
    a, feasible, missed, iterations, basis = project(rows, inside.astype(float))
    assert (feasible, iterations, basis) == (True, 0, [])
    assert missed <= 0
    assert np.array_equal(a.astype(np.float32), inside)
    a, feasible, *_, basis = project(rows, np.array([3.0, 0, 0]))
    assert feasible
    assert sorted(basis) == [0, 1]
    assert np.allclose(a, [2, -0.6, -0.8], atol=3e-4)


def test_no_rows_leave_the_box():
    none = np.empty((0, 4))
    for solver in ("exact", "gs", "least-violation"):
        a, feasible, missed, *_ = project(none, np.array([9.0, -7.0, 1.0]), solver)
        assert a.tolist() == [6, -6, 1]
        assert feasible
        assert missed == -np.inf


@pytest.mark.parametrize("kind", KINDS)
def test_the_least_violation_is_that_of_the_linear_program(kind):
    rng = np.random.default_rng(100 + KINDS.index(kind))
    missed_some = 0
    for _ in range(100):
        rows, a0 = half_spaces(rng, kind, int(rng.integers(2, 13))), singles(rng)
        a, feasible, *_ = project(rows, a0, "least-violation")
        assert np.abs(a).max() <= LIMIT
        if feasible:
            assert violation(rows, a) <= 3e-6
        else:
            missed_some += 1
            assert violation(rows, a) <= max(0, -roomiest(rows)) + 2 * MARGIN
    assert missed_some > 0


def test_rows_that_are_not_soft_hold_while_others_are_missed():
    rng = np.random.default_rng(5)
    for _ in range(200):
        wall = np.r_[unit(rng.normal(size=3)), rng.uniform(-5, 5)]
        against = np.c_[-wall[:3] + 0.1 * rng.normal(size=(3, 3)), np.zeros(3)]
        against[:, :3] = unit(against[:, :3])
        against[:, 3] = -wall[3] - rng.uniform(0.5, 3, 3)
        rows = np.vstack([against, wall])
        a, feasible, *_ = project(rows, singles(rng), "least-violation", soft=3)
        assert violation(rows[3:], a) <= 1e-5
        assert feasible == (violation(rows, a) <= 0)


def test_rows_that_contradict_each_other_are_missed_alike():
    rows = np.array([[1.0, 0, 0, -1.0], [-1.0, 0, 0, -1.0]])
    for soft, expected in ((2, 0.0), (1, 1.0)):
        a, feasible, missed, *_ = project(rows, np.array([3.0, 1.0, -2.0]), "least-violation", soft=soft)
        assert not feasible
        assert np.allclose(a, [expected, 1, -2], atol=4e-4)
        assert missed == pytest.approx(1 + expected, abs=4e-4)


def test_gauss_southwell_is_the_printed_iteration():
    rng = np.random.default_rng(6)
    reached = 0
    for _ in range(300):
        rows, a0 = half_spaces(rng, "random", 5), singles(rng)
        a, feasible, missed, iterations, _ = project(rows, a0, "gs", iterations=15)
        x = a0.astype(np.float32)
        normal, bound = rows[:, :3].astype(np.float32), rows[:, 3].astype(np.float32)
        for _ in range(15):
            excess = normal @ x - bound
            worst = int(excess.argmax())
            if excess[worst] <= 0:
                break
            x = np.clip(x - excess[worst] * normal[worst], -LIMIT, LIMIT)
        assert np.allclose(a, x, atol=2e-3)
        assert iterations <= 15
        assert np.abs(a).max() <= LIMIT
        assert feasible == (missed <= np.float32(MARGIN))
        reached += feasible
    assert reached > 100


@settings(deadline=None, max_examples=examples(150))
@given(
    st.lists(st.tuples(*[st.floats(-1, 1)] * 3, st.floats(-1e3, 1e3)), min_size=1, max_size=20),
    st.tuples(*[st.floats(-1e6, 1e6)] * 3),
    st.floats(1e-2, 1e3),
)
def test_every_projection_stays_in_the_box_and_tells_the_truth(rows, a0, limit):
    raw = np.array(rows)
    length = np.linalg.norm(raw[:, :3], axis=1)
    raw[length < 1e-3, :3] = [1, 0, 0]
    table = np.c_[unit(raw[:, :3]), raw[:, 3]].astype(np.float32).astype(float)
    for solver in ("exact", "gs", "least-violation"):
        a, feasible, missed, *_ = project(table, np.array(a0), solver, limit=limit)
        assert np.isfinite(a).all()
        assert np.abs(a).max() <= np.float32(limit)
        assert missed == pytest.approx(violation(table, a), abs=1e-6 * (limit + 1e3))
        if feasible and solver != "gs":
            assert missed <= 0
