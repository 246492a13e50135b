"""The backup-set barrier with gradients, on the pendulum and the drone, beside the geofence's rule."""

import numpy as np
import pytest

from alula import _core
from support.flights.fence_flights import fly_in
from support.models import racer_model as model


def pendulum_backup(x, k=3.0, largest=1.0, d=0.1, cap=0.1):
    inward = -np.clip(abs(x[0]) - (largest - d), 0, cap) * np.sign(x[0])
    return -np.sin(x[0]) + k * (inward - x[1])


def pendulum_flow(x, horizon=3.0, steps=100):
    """The explicit midpoint rule of theta'' = sin theta + u_B."""
    dt, states = horizon / steps, [np.array(x, float)]

    def f(y):
        return np.array([y[1], np.sin(y[0]) + pendulum_backup(y)])

    for _ in range(steps):
        y = states[-1]
        states.append(y + dt * f(y + dt / 2 * f(y)))
    return np.array(states)


def pendulum_states(count, seed):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-0.95, 0.95, count), rng.uniform(-0.8, 0.8, count)])


def test_the_pendulums_regulation_is_that_of_the_paper():
    states = pendulum_states(40, 0)
    got = _core.PendulumFilter("regulation", beta=1.5).filter(states, 2.0)
    for x, (u, h_i, weight, *_) in zip(states, got, strict=True):
        flow = pendulum_flow(x)
        expected = min((1 - np.abs(flow[:, 0])).min(), 0.1 - abs(flow[-1, 1]))
        assert h_i == pytest.approx(expected, abs=1e-12)
        assert weight == pytest.approx(1 - np.exp(-1.5 * max(expected, 0)))
        assert u == pytest.approx(weight * 2 + (1 - weight) * pendulum_backup(x))


def test_the_pendulums_program_has_the_rows_of_the_flow():
    """All rows by finite differences along drift and input; the nearest input by its interval."""
    states, alpha = pendulum_states(40, 1), 5.0
    got = _core.PendulumFilter("backup-qp", alpha=alpha).filter(states, 2.0)

    def barriers(x):
        flow = pendulum_flow(x)
        return np.concatenate([1 - flow[:, 0], 1 + flow[:, 0], [0.1 - flow[-1, 1], 0.1 + flow[-1, 1]]])

    feasible = 0
    for x, (u, *_, infeasible) in zip(states, got, strict=True):
        h, eps = barriers(x), 1e-6
        drift = np.array([x[1], np.sin(x[0])])
        along = [
            (barriers(x + eps * d) - barriers(x - eps * d)) / (2 * eps) for d in (drift, np.array([0, 1.0]))
        ]
        low, high = -20.0, 20.0
        for a, b in zip(along[1], -(along[0] + alpha * h), strict=True):
            if a > 1e-9:
                low = max(low, b / a)
            elif a < -1e-9:
                high = min(high, b / a)
        if low > high + 1e-6:
            assert infeasible
            assert u == pytest.approx(pendulum_backup(x))
        elif low < high - 1e-6:
            feasible += 1
            assert u == pytest.approx(np.clip(2.0, low, high), abs=1e-5)
    assert feasible > 20


@pytest.mark.parametrize("rule", ["regulation", "backup-qp"])
def test_a_pushed_pendulum_stays_within_its_angle(rule):
    flight = _core.PendulumFilter(rule).fly(0.0, 0.0, 2.0, 0.01, 1500)
    assert 0.95 < flight[:, 0].max() <= 1 + 1e-3
    assert flight[-1, 0] > 0.95


def test_at_high_gain_the_program_oscillates_and_the_regulation_does_not():
    """Fig. 4: total variation of the input per second, at the boundary."""
    variation = {}
    for rule in ("regulation", "backup-qp"):
        flight = _core.PendulumFilter(rule, beta=60.0, alpha=50.0).fly(0.0, 0.0, 2.0, 0.01, 1500)
        variation[rule] = np.abs(np.diff(flight[-500:, 2])).sum() / 5
    assert variation["regulation"] < 0.01
    assert variation["backup-qp"] > 5


@pytest.mark.parametrize("wrong", [{"k": 0.0}, {"beta": -1.0}, {"steps": 0}, {"push_rate": np.nan}])
def test_pendulums_without_meaning_are_refused(wrong):
    with pytest.raises(ValueError):
        _core.PendulumFilter("regulation", **wrong)
    with pytest.raises(ValueError):
        _core.PendulumFilter("none")


@pytest.fixture(scope="module")
def geofence():
    return _core.Geofence(_core.Fence(box=model.BOX))


def test_far_away_the_program_passes_the_pilot(geofence):
    x = model.random_states(1, 0, speed=2, tilt=0.3, low=(-1, -1, 30), high=(1, 1, 31))
    pilot = np.array([[0.31, 0.5, -0.25, 0.125]])
    u, _, rows, infeasible = _core.BackupQp(geofence, 5.0).filter(x, pilot)
    assert u.tobytes() == pilot.tobytes()
    assert rows[0] >= 8
    assert not infeasible[0]


def test_its_flow_is_that_of_the_geofence_without_the_margin(geofence):
    states = model.random_states(60, 1)
    values, first = geofence.evaluate(states)
    _, h_i, _, _ = _core.BackupQp(geofence, 2.0).filter(states, np.tile([0.3, 0, 0, 0], (60, 1)))
    decided = values[:, 0] < values[:, 4]
    assert decided.sum() > 40
    assert (values[decided, 0] <= h_i[decided]).all()
    assert (
        h_i[decided] - values[decided, 0] <= values[decided, 2] + 0.02
    ).all()  # cos and sin are exact there
    assert first.shape == (60, 4)


def test_the_program_on_the_drone_is_the_least_change_that_keeps_the_rows(geofence):
    """By its effect: it lets h_I fall no faster than alpha h_I, and the pilot's input does."""
    x = np.r_[15.0, 0, 30, 18.0, 0, 0, np.cos(0.3), 0, np.sin(0.3), 0, 0, 0, 0]
    pilot = np.array([0.6, 0.0, 3.0, 0.0])
    program, alpha = _core.BackupQp(geofence, 2.0), 2.0
    u, h_i, rows, infeasible = program.filter(x[None], pilot[None])
    assert not infeasible[0]
    assert rows[0] > 8
    assert np.abs(u[0] - pilot).max() > 0.1

    def rate(command, dt=1e-3):
        racer = _core.Racer(_core.RacerModel())
        racer.reset(x)
        racer.step(dt, command)
        return (program.filter(racer.state[None], pilot[None])[1][0] - h_i[0]) / dt

    assert rate(u[0]) + alpha * h_i[0] > -0.5  # the row of the nearest node; dt is not 0
    assert rate(u[0]) > rate(pilot) + 0.5


def test_the_programs_flights_stay_inside_and_are_more_cautious(geofence):
    start = np.r_[0, 0, 30.0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]
    logs = [fly_in(geofence, start=start, duration_s=4, rule=rule)[0] for rule in ("geofence", "backup-qp")]
    assert min(log["min_distance_m"] for log in logs) > -0.01
    assert logs[1]["max_speed_m_s"] < logs[0]["max_speed_m_s"]


def test_programs_without_meaning_are_refused(geofence):
    with pytest.raises(ValueError):
        _core.BackupQp(geofence, 0.0)
    with pytest.raises(ValueError):
        _core.BackupQp(geofence, 1.0).filter(np.full((1, 13), np.nan), np.zeros((1, 4)))
    with pytest.raises(ValueError):
        _core.BackupQp(geofence, 1.0).filter(np.zeros((2, 13)), np.zeros((1, 4)))
