"""The distance filter with the rows of all ellipsoids: few are measured, and the answer is that of all."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from support.effort import examples
from support.models.splat_filter_model import scene

OK, FILTERED, RECOVERING = 0, 1, 3
RADIUS = 0.1


def index_of(rows, sigma=1.0, loss=None):
    return _core.EllipsoidIndex(*rows, sigma=sigma, radius=RADIUS, loss=loss)


def tick(filt, p, v, a):
    return filt.filter((*p, 0, 0, 0, *v, 0, 0, 0), tuple(a))


def barriers(filt, count, p, v):
    """h, rows and bounds of all ellipsoids."""
    found = [filt.barrier(i, tuple(p), tuple(v)) for i in range(count)]
    return tuple(np.array([b[part] for b in found]) for part in range(3))


def case(seed):
    """A scene and a state: in the open, in the crowd or inside, slow or fast."""
    rng = np.random.default_rng(seed)
    count, high = int(rng.choice([200, 1500])), rng.choice([-1.2, -0.6])
    mean, scale, quat = scene(rng, count, size=3.0, high=high)
    if rng.random() < 0.6:  # a void around the middle
        mean *= (1 + 1.5 / np.maximum(1e-3, np.linalg.norm(mean, axis=1)))[:, None]
    p = rng.normal(size=3) * 0.2
    if rng.random() < 0.2:
        p = mean[0] + rng.normal(size=3) * 0.3 * scale[0].min()
    v = rng.normal(size=3) * rng.choice([0.0, 0.1, 0.5, 3.0])
    nominal = rng.normal(size=3) * rng.choice([0.1, 3.0, 30.0])
    loss = (rng.uniform(0, 0.02, (count, 3)) * [1, 0, 0]).astype(np.float32) if rng.random() < 0.3 else None
    return (mean, scale, quat), loss, p.astype(float), v, nominal


def test_the_answer_is_that_of_the_program_with_all_rows():
    outcomes, measured, total = [], 0, 0
    for seed in range(120):
        rows, loss, p, v, nominal = case(seed)
        hessian = "published" if seed % 4 == 3 else "correct"
        limit = 8.0 if seed % 3 == 2 else np.inf
        index = index_of(rows, loss=loss)
        by_tree, by_scan = (
            _core.SaferSplat(
                index, _core.SaferSplatOptions(hessian=hessian, brute=brute, max_acceleration=limit)
            )
            for brute in (False, True)
        )
        report, scan = tick(by_tree, p, v, nominal), tick(by_scan, p, v, nominal)
        h, row, bound = barriers(by_tree, len(index), p, v)
        length = np.linalg.norm(row, axis=1)
        row, bound = row / length[:, None], bound / length
        if np.isfinite(limit):
            box = np.vstack([np.eye(3), -np.eye(3)])
            row, bound = np.vstack([row, box]), np.concatenate([bound, np.full(6, -limit)])
        expected = _core.QpSolver().solve(np.eye(3), -nominal, row, bound)
        assert expected.status in (0, 1)
        assert report["infeasible"] == scan["infeasible"] == (expected.status == 1)
        assert report["gate_m"] == np.inf
        a = np.array(report["acceleration"])
        scale = 1 + np.linalg.norm(a)
        if expected.status == 0:
            np.testing.assert_allclose(a, expected.x, rtol=0, atol=1e-9 * scale)
            np.testing.assert_allclose(scan["acceleration"], expected.x, rtol=0, atol=1e-9 * scale)
            assert (row @ a - bound).min() >= -1e-12 * (scale + np.abs(bound).max())
            assert (report["status"] == OK) == (not (row @ nominal < bound).any() and h.min() >= 0)
        else:
            assert (report["status"] == FILTERED) == bool((row @ a - bound).min() >= -1e-9 * scale)
        assert (report["margin"] < 0) == (h.min() < 0)
        assert report["margin"] == scan["margin"] == pytest.approx(h.min(), rel=1e-9, abs=1e-12)
        assert scan["candidates"] == len(index) >= report["candidates"] >= report["rows"]
        measured, total = measured + report["candidates"], total + len(index)
        outcomes.append((expected.status, report["status"]))
    assert measured < 0.5 * total
    for outcome in ((0, OK), (0, FILTERED), (0, RECOVERING), (1, RECOVERING)):
        assert outcomes.count(outcome) >= 5, outcome


@settings(max_examples=examples(150), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    hessian=st.sampled_from(["correct", "published"]),
    gains=st.sampled_from([(5.0, 1.0), (2.0, 2.0), (0.3, 9.0)]),
)
def test_no_violated_row_is_passed_over(seed, hessian, gains):
    rows, loss, p, v, nominal = case(seed)
    filt = _core.SaferSplat(
        index_of(rows, loss=loss), _core.SaferSplatOptions(hessian=hessian, alpha=gains[0], beta=gains[1])
    )
    h, row, bound = barriers(filt, len(rows[0]), p, v)
    unsure = set(filt.unsure(tuple(p), tuple(v), tuple(nominal)).tolist())
    assert set(np.flatnonzero(row @ nominal < bound).tolist()) <= unsure
    is_inside = np.array([filt.barrier(i, tuple(p), (0, 0, 0))[0] for i in range(len(h))]) < -(RADIUS**2)
    assert set(np.flatnonzero(is_inside & (loss is None)).tolist()) <= unsure


@settings(max_examples=examples(60), deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    hessian=st.sampled_from(["correct", "published"]),
    speed=st.sampled_from([0.0, 0.5, 4.0]),
)
def test_a_row_that_is_just_violated_is_not_passed_over(seed, hessian, speed):
    rng = np.random.default_rng(seed)
    mean, scale, quat = scene(rng, 40, low=-3.5, high=-0.7)
    loss = np.outer(rng.uniform(0, 0.1, 40), [1, 0, 0]).astype(np.float32)
    filt = _core.SaferSplat(
        index_of((mean, scale, quat), loss=loss), _core.SaferSplatOptions(hessian=hessian)
    )
    for i in range(40):
        p = rng.normal(size=3)
        v = mean[i] - p + rng.normal(size=3) * rng.choice([0.01, 1.0])
        v *= speed / np.linalg.norm(v)
        _, row, bound = filt.barrier(i, tuple(p), tuple(v))
        unit, length = row / np.linalg.norm(row), np.linalg.norm(row)
        u = rng.normal(size=3) * rng.choice([0.0, 3.0])
        u += unit * (bound / length - unit @ u - 1e-6 * (1 + abs(bound / length)))
        assert i in filt.unsure(tuple(p), tuple(v), tuple(u))


def test_a_tick_remembers_nothing():
    rows = scene(np.random.default_rng(5), 2000, size=3.0, high=-1.2)
    rows[0][:] += 1.0 * rows[0] / np.linalg.norm(rows[0], axis=1)[:, None]
    filt, rng = _core.SaferSplat(index_of(rows)), np.random.default_rng(6)
    states = [(rng.normal(size=3) * 0.3, rng.normal(size=3), rng.normal(size=3) * 4) for _ in range(30)]
    first = [tick(filt, *state) for state in states]
    assert any(report["rows"] > 1 for report in first)
    assert [tick(filt, *state) for state in reversed(states)] == first[::-1]
    fresh = _core.SaferSplat(index_of(rows))
    assert [tick(fresh, *state) for state in states] == first


def test_what_overflows_is_measured_not_passed_over():
    rows = scene(np.random.default_rng(1), 50)
    filt = _core.SaferSplat(index_of(rows))
    for size in (1e20, 1e160, 1e308):
        report = tick(filt, (0, 0, 0), (0.1, 0, 0), (size, 0, 0))
        assert np.isfinite(report["acceleration"]).all()
        assert report["status"] != OK


def room(rng):
    """Walls of flat Gaussians around clutter, clear in places."""
    half, mean, scale = np.array([3.0, 2.5, 1.5]), [], []
    for axis in range(3):
        for side in (-1, 1):
            wall = rng.uniform(-half, half, (350, 3))
            wall[:, axis] = side * half[axis]
            flat = rng.uniform(0.02, 0.12, (350, 3))
            flat[:, axis] = 0.005
            mean.append(wall), scale.append(flat)
    for centre in rng.uniform(-0.7, 0.7, (8, 3)) * half:
        mean.append(centre + rng.normal(size=(60, 3)) * 0.12)
        scale.append(10 ** rng.uniform(-2.3, -1.1, (60, 3)))
    mean, scale = np.vstack(mean), np.vstack(scale)
    quat = np.tile([1.0, 0, 0, 0], (len(mean), 1))
    quat[2100:] = rng.normal(size=(len(mean) - 2100, 4))
    return tuple(a.astype(np.float32) for a in (mean, scale, quat)), half


def fly(filt, start, goal, speed, seconds=6.0, dt=0.01):
    """Least h and top speed of an ideal double integrator that is sent straight to a goal."""
    p, v, least, top = start.copy(), np.zeros(3), np.inf, 0.0
    for _ in range(round(seconds / dt)):
        to = goal - p
        wanted = to * min(2.0, speed / max(1e-9, np.linalg.norm(to)))
        report = tick(filt, p, v, 4 * (wanted - v))
        assert not report["infeasible"]
        a = np.array(report["acceleration"])
        least, top = min(least, report["margin"]), max(top, np.linalg.norm(v))
        p, v = p + dt * v + dt**2 / 2 * a, v + dt * a
    return least, top


def test_a_double_integrator_from_rest_keeps_its_distance_at_any_speed_asked_for():
    rng = np.random.default_rng(11)
    least, tops, starts = [], [], 0
    while starts < 6:
        rows, half = room(rng)
        index = index_of(rows)
        start, goal = rng.uniform(-0.8, 0.8, 3) * half, rng.uniform(-1.3, 1.3, 3) * half  # some beyond a wall
        if index.clearance(start[None])[0] < RADIUS + 0.02 or np.linalg.norm(goal - start) < 2:
            continue
        starts += 1
        h, top = fly(_core.SaferSplat(index), start, goal, speed=2.0 + starts % 3)
        least.append(h), tops.append(top)
    assert min(least) >= -1e-6
    assert min(least) < 0.05  # they did come close
    assert max(tops) > 0.5
