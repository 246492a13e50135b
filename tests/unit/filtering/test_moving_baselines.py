"""The filters that DR-ACBF is compared with, each against its program written down again for Clarabel."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from alula.stages.filtering.qp import clarabel_backend
from support.effort import examples
from support.scenes.moving_scenes import NO_TRACKS, NO_WALLS, crowd, track, tracks

ZERO = [0.0, 0.0, 0.0]
AVOID, RECOVERING = 1, 3
LIMIT = 6.0


def clearance(horizon, envelope=1.0):
    return 0.3 + 12 * 0.02 + 3 * 0.02**2 + 10 * horizon**3 + 0.5 * envelope * horizon**2


def solve(objective, constraints):
    import cvxpy as cp

    problem = cp.Problem(cp.Minimize(objective), constraints)
    problem.solve(solver=cp.CLARABEL)
    return problem.status == cp.OPTIMAL


def bypass(rows, velocity):
    """The bypass point from the origin: twelve directions, the least acceleration past all that close in.

    To hover there keeps the clearance, so obstacles pass it with their own velocity.
    """
    p, v = rows[:, 1:4], rows[:, 4:7] - velocity
    distance = np.linalg.norm(p, axis=1)
    los = p / distance[:, None]
    closing = -(los * v).sum(axis=1)
    n = los[np.argmax(closing / distance)]
    e1 = np.cross([0, 0, 1], n)
    e1 /= np.linalg.norm(e1)
    e2 = np.cross(n, e1)
    lateral = [np.cos(x) * e1 + np.sin(x) * e2 for x in np.arange(8) * np.pi / 4]
    best = (np.inf, None)
    for c in lateral + [(x - n) / np.sqrt(2) for x in lateral[::2]]:
        score, shift = 0.0, 0.0
        for i in np.flatnonzero(closing > 0):
            own = rows[i, 4:7]
            t = np.clip(-(p[i] @ own) / (own @ own), 0.05, 3)
            m, room = p[i] + own * t, rows[i, 28] + 0.15 + 1.0
            if np.linalg.norm(m) >= room:
                continue
            s = c @ m + np.sqrt((c @ m) ** 2 - m @ m + room**2)
            score, shift = max(score, 2 * s / max(t, 0.4) ** 2), max(shift, s)
        if score < best[0] - 1e-5:
            best = (score, shift * c)
    return best[1]


def scene(rng):
    """Obstacles of which the first warns at once."""
    first = track(0, [2.6, *rng.uniform(-0.2, 0.2, 2)], [-6, *rng.uniform(-0.2, 0.2, 2)])
    others = [
        track(
            i,
            rng.uniform(3, 9) * np.array([0.8, 0.6, 0.1]) * rng.choice([-1, 1], 3),
            rng.normal(scale=3, size=3),
        )
        for i in (1, 2)
    ]
    return tracks(first, *others).astype(np.float32).astype(float)


def active(rows, velocity):
    los = rows[:, 1:4] / np.linalg.norm(rows[:, 1:4], axis=1, keepdims=True)
    keep = -(los * (rows[:, 4:7] - velocity)).sum(axis=1) > 0
    return rows[keep], los[keep]


def avoid_desired(rows, velocity):
    return np.clip(60 * bypass(rows, velocity) - 14 * velocity, -LIMIT, LIMIT)


def test_the_manoeuvre_goes_to_the_best_bypass_point():
    rng = np.random.default_rng(0)
    for _ in range(60):
        rows, velocity = scene(rng), rng.uniform(-0.5, 0.5, 3).astype(np.float32).astype(float)
        # no row acts on a velocity so free
        options = {"cbf_qp_horizon_s": 1e-3, "v_max": 1.0, "j_max": 0, "latency_s": 0}
        filter_ = _core.moving_filter("cbf_qp", options)
        report, _ = filter_.filter(ZERO, velocity.tolist(), rows, NO_WALLS, ZERO)
        assert report.mode == AVOID
        assert np.allclose(report.acceleration, avoid_desired(rows, velocity), atol=2e-2)


def flown(moves, velocity):
    """Positions and velocities (20, 3) after each step from the origin."""
    p, v, places, speeds = np.zeros(3), velocity, [], []
    for k in range(20):
        a = moves[min(k, 2)]
        p, v = p + 0.02 * v + 0.0002 * a, v + 0.02 * a
        places.append(p)
        speeds.append(v)
    return np.array(places), np.array(speeds)


def test_mpc_is_the_program_of_20_steps_and_3_moves():
    import cvxpy as cp

    rng = np.random.default_rng(1)
    for _ in range(12):
        rows, velocity = scene(rng), rng.uniform(-0.5, 0.5, 3).astype(np.float32).astype(float)
        report, _ = _core.moving_filter("mpc").filter(ZERO, velocity.tolist(), rows, NO_WALLS, ZERO)
        u, slack = cp.Variable(9), cp.Variable()
        near, los = active(rows, velocity)
        start = np.array([flown(np.zeros((3, 3)), velocity)[part] for part in (0, 1)])
        unit_moves = [flown(move.reshape(3, 3), np.zeros(3)) for move in np.eye(9)]
        place, speed = (np.stack([move[part] for move in unit_moves], axis=-1) for part in (0, 1))
        weight = np.sqrt(np.repeat([1.0, 1.0, 18.0], 3) * 0.001)
        cost = (
            cp.sum_squares(place.reshape(60, 9) @ u + (start[0] - bypass(rows, velocity)).ravel())
            + 0.01 * cp.sum_squares(speed.reshape(60, 9) @ u + start[1].ravel())
            + cp.sum_squares(cp.multiply(weight, u))
            + 1e5 * cp.square(slack)
        )
        constraints = [slack >= 0, cp.abs(u) <= LIMIT]
        for row, n in zip(near, los, strict=True):
            room = np.linalg.norm(row[1:4]) + n @ row[4:7] * 0.02 * np.arange(1, 21) - clearance(0.4)
            constraints.append((n @ place) @ u + start[0] @ n <= room + slack)
        assert solve(cost, constraints)
        assert report.mode == AVOID
        assert report.rows == 20 * len(near) + 19
        assert np.allclose(report.acceleration, u.value[:3], atol=2e-2)
        missed = float(slack.value)  # as the acceleration that makes up for it over the horizon
        assert report.violation == pytest.approx(2 * missed / 0.4**2 if missed > 1e-3 else 0, abs=1e-2)
        assert report.feasible == (missed <= 1e-3) == (report.status != RECOVERING)


def test_cbf_qp_is_the_program_of_the_velocity():
    import cvxpy as cp

    rng = np.random.default_rng(2)
    changed = cut = 0
    for _ in range(30):
        rows, velocity = scene(rng), rng.uniform(-0.5, 0.5, 3).astype(np.float32).astype(float)
        report, _ = _core.moving_filter("cbf_qp").filter(ZERO, velocity.tolist(), rows, NO_WALLS, ZERO)
        near, _ = active(rows, velocity)
        command = cp.Variable(3)
        desired = velocity + 0.1 * avoid_desired(rows, velocity)
        if not solve(
            cp.sum_squares(command - desired),
            [
                2 * r[1:4] @ (r[4:7] - command) + 2.5 * (r[1:4] @ r[1:4] - clearance(0.4) ** 2) >= 0
                for r in near
            ],
        ):
            assert not report.feasible
            continue
        expected = np.clip((command.value - velocity) / 0.1, -LIMIT, LIMIT)
        changed += np.abs(expected - avoid_desired(rows, velocity)).max() > 0.1
        assert report.feasible
        assert np.allclose(report.acceleration, expected, atol=2e-2)
        reached = velocity + 0.1 * np.array(report.acceleration)  # the box may cut it off
        missed = max(
            (
                los @ (reached - r[4:7])
                - (r[1:4] @ r[1:4] - clearance(0.4) ** 2) / (0.8 * np.linalg.norm(r[1:4]))
            )
            / 0.1
            for r, los in zip(*active(rows, velocity), strict=True)
        )
        assert report.violation == pytest.approx(missed, abs=1e-2)
        cut += missed > 0.1
        assert (report.status == RECOVERING) == (report.violation > 1e-3)
    assert changed > 5
    assert cut > 0


def rolled_out(p, v, target, rows, kp=60.0, kd=14.0, steps=30):
    """V along the policy when obstacles fly straight on; and the argmax."""
    value, where = -np.inf, None
    for k in range(steps + 1):
        for i, row in enumerate(rows):
            depth = clearance(0.4, 0.0) - np.linalg.norm(row[1:4] + row[4:7] * 0.1 * k - p)
            if depth > value:
                value, where = depth, (i, k)
        for _ in range(10):
            a = np.clip(kp * (target - p) - kd * v, -LIMIT, LIMIT)
            p, v = p + 0.01 * v + 0.5e-4 * a, v + 0.01 * a
    return value, where


def test_rp_cbf_is_the_row_of_the_rollouts_gradient():
    import cvxpy as cp

    rng = np.random.default_rng(3)
    bound = infeasible = 0
    for number in range(40):
        velocity = rng.uniform(-0.5, 0.5, 3).astype(np.float32).astype(float)
        avoids = number % 2 == 0
        rows, nominal, gains = scene(rng), np.zeros(3), (60.0, 14.0)
        if not avoids:  # not yet: the policy is to stop
            way = rng.normal(size=3)
            way /= np.linalg.norm(way)
            rows = tracks(track(0, rng.uniform(3.5, 6) * way, -1.0 * way)).astype(np.float32).astype(float)
            nominal, gains = 3 * way.astype(np.float32).astype(float), (0.0, 4.0)
        filter_ = _core.moving_filter("rp_cbf", {"envelope_start": 0, "envelope_cap": 0})
        report, _ = filter_.filter(ZERO, velocity.tolist(), rows, NO_WALLS, nominal.tolist())
        assert report.mode == avoids
        near, _ = active(rows, velocity)
        target = bypass(rows, velocity) if avoids else np.zeros(3)
        desired = avoid_desired(rows, velocity) if avoids else nominal
        value, (i, _k) = rolled_out(np.zeros(3), velocity, target, near, *gains)

        def at(p, v, shift, near=near, target=target, gains=gains):
            return rolled_out(p, v, target, near + shift, *gains)[0]

        h = 1e-5
        gradient = [(at(h * e, velocity, 0) - at(-h * e, velocity, 0)) / (2 * h) for e in np.eye(3)]
        by_v = [
            (at(0 * e, velocity + h * e, 0) - at(0 * e, velocity - h * e, 0)) / (2 * h) for e in np.eye(3)
        ]
        shift = np.zeros_like(near)
        shift[i, 1:4] = h * near[i, 4:7]
        moves = (at(np.zeros(3), velocity, shift) - at(np.zeros(3), velocity, -shift)) / (2 * h)
        u = cp.Variable(3)
        ok = solve(
            cp.sum_squares(u - desired),
            [
                np.array(gradient) @ velocity + moves + np.array(by_v) @ u <= -value,
                cp.abs(u) <= LIMIT,
            ],
        )
        if not ok:
            infeasible += 1
            assert not report.feasible
            row = np.array(by_v)
            missed = np.array(gradient) @ velocity + moves + row @ np.array(report.acceleration) + value
            assert report.violation == pytest.approx(missed / np.linalg.norm(row), abs=0.05, rel=0.01)
            continue
        bound += np.abs(u.value - desired).max() > 0.05
        assert np.allclose(report.acceleration, u.value, atol=5e-2)
    assert bound > 2
    assert infeasible > 0


def test_the_same_rows_through_the_general_solver_give_the_same_command():
    rng = np.random.default_rng(4)
    compared = 0
    for _ in range(40):
        rows, velocity = crowd(rng, 5, near=6.0), rng.uniform(-2, 2, 3).tolist()
        nominal = rng.uniform(-6, 6, 3).tolist()
        reports = [
            _core.moving_filter(method, {}, backend).filter(ZERO, velocity, rows, NO_WALLS, nominal)[0]
            for method, backend in (("dr_acbf", None), ("dr_acbf_qp", None), ("dr_acbf_qp", clarabel_backend))
        ]
        assert len({(r.mode, r.horizon_s, r.status == 3) for r in reports}) == 1
        if reports[0].feasible:
            compared += 1
            for other in reports[1:]:
                assert np.allclose(reports[0].acceleration, other.acceleration, atol=2e-2)
    assert compared > 10


METHODS = ["none", "dr_acbf", "dr_acbf_qp", "mpc", "cbf_qp", "rp_cbf"]


@settings(deadline=None, max_examples=examples(25))
@given(st.integers(0, 10**6), st.sampled_from(METHODS), st.booleans())
def test_every_command_is_in_the_box_and_copies_do_the_same(seed, method, walled):
    rng = np.random.default_rng(seed)
    filter_ = _core.moving_filter(method)
    twin = filter_.clone()
    walls = np.array([[0.0, 0, 1.0, 0.3], [1.0, 0, 0, 2.0]]) if walled else NO_WALLS
    rows = crowd(rng, 4, near=0.5)
    for _ in range(6):
        velocity, nominal = rng.uniform(-4, 4, 3).tolist(), rng.uniform(-8, 8, 3).tolist()
        report, other = (f.filter(ZERO, velocity, rows, walls, nominal)[0] for f in (filter_, twin))
        assert np.isfinite(report.acceleration).all()
        assert np.abs(report.acceleration).max() <= LIMIT
        assert report.acceleration == other.acceleration
        assert report.status in (0, 1, 3)


@pytest.mark.parametrize("method", METHODS)
def test_without_obstacles_every_method_flies_the_nominal(method):
    filter_ = _core.moving_filter(method)
    report, _ = filter_.filter(ZERO, [1.0, 0, 0], NO_TRACKS, NO_WALLS, [0.1, 0.2, -0.3])
    assert (report.status, report.acceleration) == (0, [0.1, 0.2, -0.3])


@pytest.mark.parametrize("method", ["dr_acbf", "dr_acbf_qp", "mpc", "cbf_qp", "rp_cbf"])
def test_every_method_with_a_barrier_keeps_clear_of_a_floor(method):
    filter_ = _core.moving_filter(method)
    z, v, lowest = 3.0, 0.0, np.inf
    for _ in range(300):
        walls = np.array([[0.0, 0, 1.0, z]])
        report, _ = filter_.filter([0, 0, z], [0, 0, v], NO_TRACKS, walls, [0, 0, -6.0])
        a = report.acceleration[2]
        z, v = z + 0.01 * v + 0.5e-4 * a, v + 0.01 * a
        lowest = min(lowest, z)
    assert 0.245 <= lowest < 0.6  # radius and room, less what a lag that is not there makes wrong


@pytest.mark.parametrize(
    ("method", "option", "value"),
    [
        ("mpc", "mpc_step_s", 0.0),
        ("mpc", "mpc_slack_weight", -1.0),
        ("cbf_qp", "cbf_qp_horizon_s", 0.0),
        ("rp_cbf", "rp_cbf_samples", 0.0),
        ("rp_cbf", "rp_cbf_step_s", 0.01),
        ("rp_cbf", "rp_cbf_samples", 1.5),
    ],
)
def test_options_of_a_method_that_mean_nothing_raise(method, option, value):
    with pytest.raises(ValueError):
        _core.moving_filter(method, {option: value})
    with pytest.raises(ValueError, match="no moving filter"):
        _core.moving_filter("nothing")
