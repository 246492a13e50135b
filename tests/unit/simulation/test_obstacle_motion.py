"""Moving obstacles: each motion follows its equation with any step."""

import re

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from alula._core import TrackingGains
from support.effort import examples
from support.flights.moving_worlds import DT, SCENARIO_1, angles, closing, paths, vehicle_path
from support.models.quadrotor_model import fastbridge

GRAVITY = np.array([0, 0, -9.81])
STILL = {"is_relative": False, "position": (30.0, 5.0, 12.0)}


@pytest.mark.parametrize("dt", [0.001, 0.01, 0.37])
def test_an_accelerating_one_follows_the_closed_form_at_any_step(dt):
    table = STILL | {
        "kind": "accelerating",
        "velocity_m_s": (-3.0, 0.0, 4.0),
        "acceleration_m_s2": (0.5, 0.5),
    }
    vehicle = vehicle_path(int(20 / dt))
    path = paths(table | {"max_speed_m_s": 8}, vehicle, dt)[0]
    t = dt * np.arange(len(path))
    speed = np.minimum(5 + 0.5 * t, 8)
    way = np.where(t < 6, 5 * t + 0.25 * t**2, 39 + 8 * (t - 6))
    heading = np.array([-0.6, 0, 0.8])
    assert path[:, :3] == pytest.approx(np.add((30, 5, 12), way[:, None] * heading), abs=1e-9)
    assert path[:, 3:6] == pytest.approx(speed[:, None] * heading)
    late = t > 6 + 1e-9
    assert (path[late, 6:] == 0).all()
    assert path[t < 6 - 1e-9, 6:] == pytest.approx(np.broadcast_to(0.5 * heading, (np.sum(t < 6 - 1e-9), 3)))


def test_a_throw_without_drag_is_the_parabola():
    table = STILL | {"kind": "ballistic", "velocity_m_s": (-2.0, 1.0, 5.0)}
    path = paths(table, vehicle_path(300))[0]
    t = DT * np.arange(300)[:, None]
    assert path[:, :3] == pytest.approx(np.array([30, 5, 12]) + t * [-2, 1, 5] + t * t / 2 * GRAVITY)
    assert path[:, 3:6] == pytest.approx([-2, 1, 5] + t * GRAVITY)
    assert (path[:, 6:] == GRAVITY).all()


def test_drag_is_quadratic():
    table = STILL | {"kind": "ballistic", "velocity_m_s": (-8.0, 1.0, 5.0), "drag_per_m": 0.1}
    path = paths(table, vehicle_path(200))[0]

    def rate(_, x):
        return np.concatenate([x[3:], GRAVITY - 0.1 * np.linalg.norm(x[3:]) * x[3:]])

    t = DT * np.arange(200)
    exact = solve_ivp(rate, (0, 2), [30, 5, 12, -8, 1, 5], t_eval=t, rtol=1e-11, atol=1e-11).y.T
    assert path[:, :6] == pytest.approx(exact, abs=1e-8)
    assert path[50, 6:] == pytest.approx(rate(0, path[50, :6])[3:])


@pytest.mark.parametrize("drag", [0.0, 0.05, 0.3])
def test_a_throw_hits_what_it_is_aimed_at_with_its_mean_horizontal_speed(drag):
    vehicle = vehicle_path(2500, v=(1, -0.5, 0.2), dt=0.001)
    table = {"kind": "ballistic", "distance_m": 4, "azimuth_rad": (-1, 1), "elevation_rad": (-0.3, 0.3)}
    path = paths(table | {"speed_m_s": (2, 4), "drag_per_m": drag, "start_s": 0.2}, vehicle, 0.001, trials=30)
    distance, _ = closing(vehicle, path)
    hit = distance.argmin(1)
    assert distance.min(1).max() < 0.01
    way = np.linalg.norm(path[np.arange(30), hit, :2] - path[:, 0, :2], axis=1)
    speed = way / (0.001 * hit - 0.2)
    assert (speed > 1.97).all()
    assert (speed < 4.03).all()


def test_a_curving_one_turns_within_its_rate_and_then_no_more():
    vehicle = vehicle_path(900)
    path = paths(SCENARIO_1[0], vehicle, trials=50)
    turn = angles(path[:, 1:, 3:6], path[:, :-1, 3:6])
    assert turn.max() <= 0.25 * DT + 1e-7  # arccos near 1 costs half the digits
    distance, _ = closing(vehicle, path)
    for k in range(50):
        near = np.flatnonzero(distance[k] <= 12)[0]
        assert turn[k, near + 1 :].max() < 1e-7
    assert (np.linalg.norm(path[..., 3:6], axis=-1) <= 12 + 1e-12).all()


def _curving_reference(x, speed, acceleration, vehicle, rate=0.25, release=12.0, most=12.0):
    """Positions, with the meeting point by a root search and the turn by a rotation about the normal."""
    p, h, t, positions, turns = x[:3].copy(), x[3:6] / np.linalg.norm(x[3:6]), 0.0, [x[:3].copy()], True

    def way(a, b):
        up = (most - speed) / acceleration
        return sum(
            (min(b, up) - min(a, up)) * (speed + acceleration * (min(a, up) + min(b, up)) / 2) if part == 0
            else most * (max(b, up) - max(a, up))
            for part in (0, 1)
        )  # fmt: skip

    for q in vehicle[:-1]:
        turns = turns and np.linalg.norm(q[:3] - p) > release
        before = h
        if turns:
            root = brentq(
                lambda s, r=q[:3] - p, v=q[3:6], t=t: np.linalg.norm(r + s * v) - way(t, t + s),
                0,
                100,
                xtol=1e-13,
            )
            desired = q[:3] + root * q[3:6] - p
            desired /= np.linalg.norm(desired)
            normal = np.cross(h, desired)
            angle = np.arctan2(np.linalg.norm(normal), h @ desired)
            if angle <= rate * DT:
                h = desired
            else:
                n = normal / np.linalg.norm(normal)
                h = np.cos(rate * DT) * h + np.sin(rate * DT) * np.cross(n, h)
        p = p + way(t, t + DT) / 2 * (before + h)
        t += DT
        positions.append(p)
    return np.array(positions)


def test_a_curving_one_heads_for_the_intercept_reckoned_anew():
    vehicle = vehicle_path(500)
    vehicle[250:, 4] = 2.0  # the vehicle turns away
    vehicle[250:, 1] = 2.0 * DT * np.arange(250)
    path = paths(SCENARIO_1[0] | {"speed_m_s": (6, 6), "acceleration_m_s2": (0.5, 0.5)}, vehicle, trials=3)
    for one in path:
        assert one[:, :3] == pytest.approx(_curving_reference(one[0], 6.0, 0.5, vehicle), abs=1e-6)


@pytest.mark.parametrize("heavy", [False, True])
def test_a_quadrotor_reaches_its_way_points_within_its_limits(heavy):
    points = [(1.0, 0.5, 1.2), (1.0, -1.0, 1.5), (-1.0, -1.0, 0.8)]
    table = {"kind": "quadrotor", "is_relative": False, "position": (0.0, 0.0, 1.0), "way_points": points}
    flown = (
        {"body": fastbridge(), "gains": TrackingGains(max_tilt_rad=1.0, max_thrust_share=0.9)}
        if heavy
        else {}
    )
    dt, speed = 0.005, 1.5
    vehicle = vehicle_path(2000, dt=dt)
    path = paths(table | flown | {"speed_m_s": (speed, speed)}, vehicle, dt)[0]
    for point in points:
        assert np.linalg.norm(path[:, :3] - point, axis=1).min() < 0.02
    assert path[-1, :3] == pytest.approx(points[-1], abs=0.01)
    assert np.linalg.norm(path[-1, 3:6]) < 0.02
    fastest = np.linalg.norm(path[:, 3:6], axis=1).max()
    assert 0.9 * speed < fastest < 1.1 * speed
    thrust = np.linalg.norm(path[1:, 6:] - GRAVITY, axis=1)
    assert thrust.max() <= (17 / 0.461 if heavy else 0.45 / 0.029) + 1e-9
    middle = (path[2:, :3] - path[:-2, :3]) / (2 * dt)
    assert middle == pytest.approx(path[1:-1, 3:6], abs=0.01)


def test_a_quadrotor_that_is_asked_for_too_much_stays_within_its_rotors():
    table = {"kind": "quadrotor", "is_relative": False, "way_points": [(20.0, 0.0, 3.0), (0.0, 0.0, 0.0)]}
    path = paths(table | {"speed_m_s": (30, 30), "acceleration_m_s2": (60, 60)}, vehicle_path(600))[0]
    assert np.isfinite(path).all()
    assert np.linalg.norm(path[1:, 6:] - GRAVITY, axis=1).max() <= 0.45 / 0.029 + 1e-9


def _pairs(low, high):
    return st.tuples(st.floats(low, high), st.floats(low, high)).map(lambda ends: tuple(sorted(ends)))


_TABLES = st.fixed_dictionaries(
    {
        "kind": st.sampled_from(["constant-velocity", "accelerating", "curving", "ballistic", "quadrotor"]),
        "distance_m": st.floats(0.5, 100),
        "azimuth_rad": _pairs(-4, 4),
        "elevation_rad": _pairs(-1.5, 1.5),
        "speed_m_s": _pairs(0.1, 12),
        "heading_rad": _pairs(-4, 4),
        "acceleration_m_s2": _pairs(0, 3),
        "crosses": st.booleans(),
        "start_s": st.floats(0, 2),
        "turn_rate_rad_s": st.floats(0, 5),
        "drag_per_m": st.sampled_from([0.0, 0.01]),
    }
)
# So slow that the vehicle meets it where it starts.
_MET_AT_ITS_START = {
    "kind": "quadrotor",
    "distance_m": 1.0,
    "speed_m_s": (0.1, 0.1),
    "acceleration_m_s2": (1e-9, 1e-9),
}


@settings(deadline=None, max_examples=examples(150))
@given(table=_TABLES, v=st.tuples(*[st.floats(-6, 6)] * 3))
@example(table=_MET_AT_ITS_START, v=(1.0, 0.0, 0.0))
@example(table=_MET_AT_ITS_START | {"crosses": True, "heading_rad": (1.0, 1.0)}, v=(6.0, 0.0, 0.0))
@example(table=_MET_AT_ITS_START | {"acceleration_m_s2": (5e-324, 5e-324)}, v=(1.0, 0.0, 0.0))
@example(table=_MET_AT_ITS_START | {"acceleration_m_s2": (1e-200, 1e-200)}, v=(0.0, 0.0, 0.0))
def test_whatever_is_not_refused_moves_finitely_and_without_jumps(table, v):
    try:
        path = paths(table, vehicle_path(300, v=v))[0]
    except ValueError as error:
        expected = re.search("too near|nowhere|above or below|no throw|a minute", str(error))
        if expected is None:
            raise
        return
    assert np.isfinite(path).all()
    fastest = np.linalg.norm(path[:, 3:6], axis=1).max()
    assert np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1).max() <= 1.1 * DT * fastest + 1e-9
    if table["kind"] != "ballistic":
        assert fastest <= 12 * 1.25
