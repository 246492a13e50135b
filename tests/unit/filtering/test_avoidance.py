"""The manoeuvre of the DR-ACBF filter: its states, braking in the end, and walls while it dodges."""

import numpy as np
import pytest

from alula import _core
from support.scenes.moving_scenes import NO_TRACKS, NO_WALLS, track, tracks

RECOVERING, REFUSED = 3, 4
NOMINAL, AVOID, HOVER = 0, 1, 2
ZERO = [0.0, 0.0, 0.0]


def make(**options):
    return _core.moving_filter("dr_acbf", options)


def tick(filter_, position, velocity, rows=NO_TRACKS, nominal=ZERO, walls=NO_WALLS):
    return filter_.filter(list(position), list(velocity), rows, walls, list(nominal))[0]


def enter(filter_, speed=6.0):
    """A warning: an obstacle ahead that comes straight at the vehicle."""
    report = tick(filter_, ZERO, ZERO, tracks(track(1, [3.0, 0.1, 0], [-speed, 0, 0])))
    assert report.mode == AVOID
    return report


GONE = tracks(track(1, [-5.0, 0, 0], [-6.0, 0, 0]))


def test_a_warning_enters_avoid_and_the_command_goes_across():
    report = enter(make())
    assert report.urgent == 0
    assert abs(report.acceleration[1]) + abs(report.acceleration[2]) > 3


def test_avoid_holds_for_the_time_set_and_then_hovers_when_the_obstacle_recedes():
    filter_ = make()
    enter(filter_)
    modes = [tick(filter_, ZERO, [1.0, 0, 0], GONE).mode for _ in range(25)]
    assert modes[:19] == [AVOID] * 19
    assert modes[20:] == [HOVER] * 5


def test_avoid_ends_at_the_longest_time_even_when_the_obstacle_stays():
    filter_ = make(longest_avoid_s=0.3, latency_s=0.0)
    enter(filter_)
    # far enough to warn no more, still coming straight at the vehicle
    rows = tracks(track(1, [15.0, 0, 0], [-6.0, 0, 0]))
    modes = [tick(filter_, ZERO, [1.0, 0, 0], rows).mode for _ in range(35)]
    assert modes[28] == AVOID
    assert modes[-1] == HOVER


def test_hover_ends_when_the_vehicle_stands_or_the_time_is_over():
    for velocity, ticks in (([0.1, 0, 0], 1), ([2.0, 0, 0], 50)):
        filter_ = make()
        enter(filter_)
        while tick(filter_, ZERO, [1.0, 0, 0], GONE).mode == AVOID:
            pass
        modes = [tick(filter_, ZERO, velocity, GONE).mode for _ in range(55)]
        assert modes.index(NOMINAL) == pytest.approx(ticks - 1, abs=1)


def test_hover_brakes_and_a_new_warning_starts_over():
    filter_ = make()
    enter(filter_)
    while (report := tick(filter_, ZERO, [1.0, 0, -0.5], GONE)).mode == AVOID:
        pass
    assert report.acceleration == pytest.approx([-4.0, 0, 2.0], abs=1e-5)
    assert enter(filter_).mode == AVOID


def test_the_direction_is_kept_against_small_improvements():
    filter_ = make()
    first = enter(filter_)
    for wobble in (0.02, -0.02, 0.03, -0.03):
        rows = tracks(track(1, [2.9, 0.1 + wobble, wobble], [-6, 0, 0]))
        again = tick(filter_, ZERO, ZERO, rows)
        assert np.dot(again.acceleration, first.acceleration) > 0


def test_ticks_without_a_horizon_brake_and_descend_in_the_end():
    filter_ = make(distributional=0, simple_quantile=0)  # which does not warn: a manoeuvre would go on
    # six obstacles all around, closing: no acceleration obeys all
    rows = tracks(*[track(i, 1.2 * d, -8.0 * d) for i, d in enumerate(np.vstack([np.eye(3), -np.eye(3)]))])
    reports = [tick(filter_, ZERO, [3.0, 0, 0], rows) for _ in range(8)]
    assert all(r.status == RECOVERING and not r.feasible for r in reports)
    assert reports[-1].acceleration == pytest.approx([-6, 0, -1.0], abs=1e-4)
    assert reports[0].acceleration != reports[-1].acceleration


# Walls


def fly(filter_, walls, nominal, seconds=6.0, delay=0, jerk=np.inf, rows=lambda t, p: NO_TRACKS, start=None):
    """A double integrator with a delay [ticks] and a jerk limit; walls are planes (m, 4) n . x >= c."""
    dt, steps = 0.01, 10
    p, v, a = np.zeros(3), np.array(start if start is not None else ZERO, float), np.zeros(3)
    pending = [np.zeros(3)] * delay
    closest, statuses = np.inf, set()
    for k in range(int(seconds / dt)):
        distance = walls[:, :3] @ p - walls[:, 3]
        report = tick(filter_, p, v, rows(k * dt, p), nominal(k * dt, p, v), np.c_[walls[:, :3], distance])
        assert report.status != REFUSED
        statuses.add(report.status)
        pending.append(np.array(report.acceleration))
        command = pending.pop(0)
        for _ in range(steps):
            h = dt / steps
            a = command if np.isinf(jerk) else a + np.clip(command - a, -jerk * h, jerk * h)
            p, v = p + h * v + h**2 / 2 * a, v + h * a
            closest = min(closest, float((walls[:, :3] @ p - walls[:, 3]).min()))
    return closest, statuses


CORRIDOR = np.array(
    [[0.0, 1, 0, -1.5], [0, -1, 0, -1.5], [0, 0, 1, -1.5], [0, 0, -1, -1.5], [-1.0, 0, 0, -8.0]]
)


@pytest.mark.every(5)
@pytest.mark.parametrize(("delay", "jerk"), [(0, np.inf), (2, np.inf), (0, 60.0), (2, 60.0)])
@pytest.mark.parametrize("direction", [(1, 0, 0), (0, 1, 0), (0.7, 0.7, 0), (0.6, -0.6, 0.5)])
def test_walls_are_never_entered_at_full_thrust(direction, delay, jerk):
    filter_ = make(j_max=0.0 if np.isinf(jerk) else jerk, latency_s=0.01 * delay)
    push = (6 * np.array(direction) / np.abs(direction).max()).tolist()
    closest, statuses = fly(filter_, CORRIDOR, lambda t, p, v: push, delay=delay, jerk=jerk)
    assert closest >= 0.15
    if delay == 0 and np.isinf(jerk):
        assert RECOVERING not in statuses


@pytest.mark.parametrize("turn", [0.0, 0.5, 1.2])
def test_a_corner_of_right_angles_is_safe_however_turned(turn):
    third = turn + 2 * np.pi / 3 * np.arange(3)  # the axis of the corner is x: one face of the box has to do
    normals = np.c_[-np.ones(3), np.sqrt(2) * np.cos(third), np.sqrt(2) * np.sin(third)] / np.sqrt(3)
    np.testing.assert_allclose(normals @ normals.T, np.eye(3), atol=1e-12)
    walls = np.c_[normals, np.full(3, -10 / np.sqrt(3))]
    closest, _ = fly(make(), walls, lambda t, p, v: [6.0, 0, 0], 5.0, delay=2, jerk=60.0)
    assert closest >= 0.15


@pytest.mark.parametrize("seed", range(6))
def test_walls_are_never_entered_while_dodging(seed):
    rng = np.random.default_rng(seed)
    lateral = rng.normal(scale=0.3, size=2)
    filter_ = make()

    def rows(t, p):
        return tracks(track(1, [12 - 7 * t, *lateral], [-7.0, 0, 0], sigma_p=0.05, sigma_v=0.1))

    def nominal(t, p, v):
        return np.clip(2 * (np.array([3.0, 0, 0]) - v), -6, 6).tolist()

    walls = CORRIDOR[:4]
    closest, _ = fly(filter_, walls, nominal, 3.0, delay=2, jerk=60.0, rows=rows, start=[3.0, 0, 0])
    assert closest >= 0.15


@pytest.mark.parametrize("seed", [0, 1, 7])
def test_where_walls_contradict_each_other_obstacles_still_come_last(seed):
    """A blind alley so narrow that after a change of the command both sides ask for the other."""
    rng = np.random.default_rng(seed)
    speed, lateral = rng.uniform(4, 12), rng.normal(scale=0.2, size=2)
    walls = np.vstack([CORRIDOR[:4], [1.0, 0, 0, -0.6]])
    walls[:4, 3] = -0.5

    def rows(t, p):
        position = [8 - speed * t, *lateral]
        return tracks(track(1, position, [-speed, 0, 0], sigma_p=0.05, sigma_v=0.1))

    def nominal(t, p, v):
        return np.clip(-4 * p - 3 * v, -6, 6).tolist()

    closest, _ = fly(make(), walls, nominal, 3.0, delay=2, jerk=60.0, rows=rows)
    assert closest >= 0.15 + 0.09  # nearly all of the room kept from walls
