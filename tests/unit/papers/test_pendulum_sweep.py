"""The pendulum of the geofencing paper: rows against differences of an independent flow, and its flights."""

import numpy as np
import pytest

from alula import _core
from papers.geofencing import figures as geofencing_figures
from papers.geofencing.pendulum import PROGRAM, REGULATION, Pendulum, program_rows, sweep, swing

STATES = np.random.default_rng(3).uniform([-0.97, -1.2], [0.97, 1.2], (60, 2))


def flow(x, o):
    """Angles at all nodes and the last rate, written from the paper: u_B cancels gravity and damps."""
    angle, rate, dt, angles = *x, o.horizon_s / o.steps, [x[0]]

    def bend(angle, rate):
        beyond = abs(angle) - (o.largest_angle - o.push_distance)
        push = -np.copysign(min(max(o.push_gain * beyond, 0.0), o.push_rate), angle)
        return o.k * (push - rate)

    for _ in range(o.steps):
        middle = angle + dt / 2 * rate, rate + dt / 2 * bend(angle, rate)
        angle, rate = angle + dt * middle[1], rate + dt * bend(*middle)
        angles.append(angle)
    return np.array(angles), rate


def test_the_rows_are_the_change_of_the_flow_along_drift_and_input():
    o, step = Pendulum(alpha=3.0), 1e-6
    a, b = program_rows(STATES, o)
    assert a.shape == b.shape == (60, 2 * 101 + 4)
    smooth = 0
    for x, along, bound in zip(STATES, a, b, strict=True):
        start, _ = flow(x, o)
        slopes = []
        for direction in (np.array([x[1], np.sin(x[0])]), np.array([0.0, 1.0])):
            (ahead, last), (behind, first) = flow(x + step * direction, o), flow(x - step * direction, o)
            slopes.append(np.append(ahead - behind, last - first) / (2 * step))
        drift, push = slopes
        for sign, rows in ((1, slice(0, 202, 2)), (-1, slice(1, 202, 2))):
            limit = 1.0 - sign * start
            if np.allclose(along[rows], -sign * push[:101], atol=1e-6):
                smooth += 1
                np.testing.assert_allclose(bound[rows], sign * drift[:101] - 3.0 * limit, atol=1e-5)
        np.testing.assert_array_equal(along[-2:], [1, -1])
        np.testing.assert_array_equal(bound[-2:], [-o.largest_input] * 2)
    assert smooth > 110  # of 120: a difference across a corner of the push is none of its slopes


def test_the_native_program_solves_the_same_rows():
    a, b = program_rows(STATES)
    found = _core.PendulumFilter("backup-qp").filter(STATES, 2.0)
    solved = 0
    for along, bound, (u, _, _, _, unsolved) in zip(a, b, found, strict=True):
        low = max(bound[along > 1e-12] / along[along > 1e-12])
        high = min(bound[along < -1e-12] / along[along < -1e-12])
        empty = low > high or bool((bound[np.abs(along) <= 1e-12] > 0).any())
        assert bool(unsolved) == empty
        if not empty:
            solved += 1
            assert u == pytest.approx(np.clip(2.0, low, high), abs=1e-9)
    assert solved > 30


def test_at_a_high_gain_the_program_chatters_and_the_regulation_does_not():
    calm, rough = swing(REGULATION, 60.0, 0.01), swing(PROGRAM, 50.0, 0.01)
    assert calm.chatter < 0.01 < 10 < rough.chatter
    assert calm.arrival_s == pytest.approx(rough.arrival_s, abs=0.05)
    assert rough.unsolved > 100 > calm.unsolved == 0
    tail = slice(1000, None)
    assert calm.settled_rad == pytest.approx(calm.angle[tail].mean())
    assert rough.chatter == pytest.approx(np.abs(np.diff(rough.input[tail])).sum() / 4.99)


def test_a_gentle_gain_may_not_arrive():
    assert swing(REGULATION, 0.5, 0.01).arrival_s is None


def test_a_sweep_flies_each_gain_at_each_tick_and_is_drawn():
    swings = sweep({REGULATION: (5.0, 60.0), PROGRAM: (1.0, 50.0)}, (0.01, 0.005))
    assert len(swings) == 8
    shown = geofencing_figures.pendulum_figure(
        swings, {REGULATION: 5.0, PROGRAM: 1.0}, {REGULATION: 60.0, PROGRAM: 50.0}
    )
    assert shown.alt.count("chatter") == 4
    chatter = geofencing_figures.chatter_figure(swings)
    assert chatter.alt.count(" ms from ") == 4
