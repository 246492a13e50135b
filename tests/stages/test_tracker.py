"""The tracker: assignment, filters against references, life of tracks, the additions of SAFE-IMM, refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from imm_model import Reference
from scipy.optimize import linear_sum_assignment

from alula import _core

DT = 0.05
SIGMA = 0.3  # of a position per axis, where a test does not say otherwise
WIDE = {"gate": 1e12}  # everything is taken
SINGLE = {"velocity": {"prior": (1, 0)}, "acceleration": {"prior": (0, 1)}}
STAY = (1, 0, 0, 1)
THREE = np.array([[0.986, 0.010, 0.004], [0.010, 0.986, 0.004], [0.015, 0.015, 0.970]])


def tracker(most=128, **options):
    return _core.Tracker(_core.TrackerOptions(**options), most)


def scan(target, t, *positions, sigma=SIGMA, **doppler):
    position = np.array(positions, float).reshape(-1, 3)
    target.update(t, position, np.tile(sigma**2 * np.eye(3), (len(position), 1, 1)), **doppler)


def idle(cost, gate):
    """The least cost of rows that may stay without a column at the price of the gate."""
    rows, columns = cost.shape
    wide = np.full((rows, columns + rows), 1e9)
    wide[:, :columns] = np.where(cost <= gate, cost, 1e9)
    wide[:, columns:][np.eye(rows, dtype=bool)] = gate
    return wide[linear_sum_assignment(wide)].sum()


def price(cost, column, gate):
    taken = column >= 0
    return cost[taken, column[taken]].sum() + gate * np.sum(~taken)


@settings(deadline=None, max_examples=300)
@given(
    st.integers(0, 2**32 - 1), st.integers(0, 9), st.integers(0, 9), st.sampled_from([0.3, 1.0, 3.0, 30.0])
)
def test_an_assignment_within_a_gate_costs_least(seed, rows, columns, gate):
    cost = np.random.default_rng(seed).exponential(1.5, (rows, columns))
    column = _core.assign(cost, gate)
    taken = column[column >= 0]
    assert len(set(taken)) == len(taken)
    assert np.all(cost[column >= 0, taken] <= gate)
    assert price(cost, column, gate) == pytest.approx(idle(cost, gate), rel=1e-12)


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 12), st.booleans())
def test_an_assignment_without_a_gate_is_scipys(seed, rows, columns, ties):
    rng = np.random.default_rng(seed)
    cost = (
        rng.integers(-3, 4, (rows, columns)).astype(float) if ties else rng.normal(size=(rows, columns)) * 50
    )
    column = _core.assign(cost)
    i, j = linear_sum_assignment(cost)
    assert np.sum(column >= 0) == min(rows, columns)
    assert cost[column >= 0, column[column >= 0]].sum() == pytest.approx(cost[i, j].sum(), rel=1e-9, abs=1e-9)
    if not ties:
        assert np.array_equal(np.flatnonzero(column >= 0), i)
        assert np.array_equal(column[column >= 0], j)


def test_costs_that_mean_nothing_are_forbidden():
    cost = np.array([[np.nan, 1.0], [np.inf, 2.0], [1e300, -np.inf]])
    assert _core.assign(cost).tolist() == [1, -1, -1]
    assert _core.assign(np.zeros((0, 3))).tolist() == []
    assert _core.assign(np.zeros((2, 0)), 1.0).tolist() == [-1, -1]
    for gate in (-1.0, np.nan):
        with pytest.raises(ValueError, match="gate"):
            _core.assign(cost, gate)


def test_a_large_assignment_is_scipys():
    cost = np.random.default_rng(5).uniform(size=(150, 130))
    i, j = linear_sum_assignment(cost)
    column = _core.assign(cost)
    assert np.array_equal(np.flatnonzero(column >= 0), i)
    assert np.array_equal(column[i], j)


def flight(rng, steps, doppler):
    """Detections of something that flies straight, then turns; the time between them and misses are irregular."""
    p, v, t, rows = np.array([40.0, 5.0, 10.0]), np.array([-7.0, 1.0, 0.3]), 3.0, []
    for k in range(steps):
        dt = rng.uniform(0.02, 0.1)
        a = np.array([0.0, 0.0, 0.0]) if k < steps // 2 else np.cross([0, 0, 0.4], v)
        p, v, t = p + dt * v + dt**2 / 2 * a, v + dt * a, t + dt
        root = rng.normal(size=(3, 3)) * 0.15
        R = root @ root.T + 0.01 * np.eye(3)
        z = None if k > 0 and rng.uniform() < 0.15 else rng.multivariate_normal(p, R)
        los = p / np.linalg.norm(p)
        rate = {"los": los, "rate": los @ v + 0.1 * rng.normal(), "sigma": 0.1} if doppler else {}
        rows.append((t, dt, z, R, rate))
    return rows


def follow(rows, reference, **options):
    """The largest difference to the reference over a flight, also 30 ms after each scan."""
    target, worst = tracker(**WIDE, **options), 0.0
    for k, (t, dt, z, R, rate) in enumerate(rows):
        seen = z is not None
        doppler = {"los": rate["los"][None], "range_rate": np.array([rate["rate"]])} if rate and seen else {}
        target.update(
            t, z[None] if seen else np.zeros((0, 3)), R[None] if seen else np.zeros((0, 3, 3)), **doppler
        )
        if k == 0:
            reference.start(z, R, **rate)
        else:
            reference.predict(dt)
            if seen:
                reference.correct(z, R, **rate)
        for ahead in (0.0, 0.03):
            x, P, a = reference.read(ahead)
            got = target.tracks(t + ahead)
            assert got["id"].tolist() == [1]
            errors = (
                np.concatenate([got["p"][0], got["v"][0]]) - x,
                (got["covariance"][0] - P) / max(1.0, np.abs(P).max()),
                got["a"][0] - a,
                got["turning"][0] - (1 - reference.mu[0] if reference.kinds[0] == "velocity" else 1),
            )
            worst = max(worst, *(np.abs(e).max() for e in errors))
    return worst


@pytest.mark.parametrize("kind", ["velocity", "acceleration"])
@pytest.mark.parametrize("doppler", [False, True])
def test_a_single_model_is_a_kalman_filter(kind, doppler):
    rows = flight(np.random.default_rng(1), 80, doppler)
    reference = Reference([kind], [[1.0]], [1.0], lent={})
    assert follow(rows, reference, transition=STAY, **SINGLE[kind]) < 1e-9


@pytest.mark.parametrize("mixes", [False, True])
@pytest.mark.parametrize("doppler", [False, True])
@pytest.mark.parametrize("turn", [False, True])
def test_the_models_interact_as_in_the_reference(mixes, doppler, turn):
    rows = flight(np.random.default_rng(2), 120, doppler)
    kinds = ["velocity", "acceleration", "turn"][: 3 if turn else 2]
    transition = THREE if turn else [[0.992, 0.008], [0.015, 0.985]]
    prior = [0.9, 0.05, 0.05] if turn else [0.9, 0.1]
    lent = {"velocity": 0.0, "acceleration": 1.0, "turn": 0.1}
    reference = Reference(kinds, transition, prior, lent=lent, mixes=mixes)
    assert follow(rows, reference, with_turn=turn, mixes=mixes) < 1e-9
    assert reference.mu[0] < 0.9  # there was something to tell apart
