"""Draws of moving obstacles: positions, targets, functions of (seed, trial); the experiments."""

from math import radians

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import kstest

from alula._core import ObstacleSpec, TrackingGains, meeting_time
from support.effort import examples
from support.flights.moving_worlds import (
    DT,
    HARDWARE,
    SCENARIO_1,
    SCENARIO_2,
    angles,
    closing,
    paths,
    vehicle_path,
)


def drawn(table, vehicle, trials, **where):
    """The first states."""
    return paths(table, vehicle[:1], trials=trials, **where)[:, 0]


# -- Meeting ---------------------------------------------------------------------------------------

component = st.floats(-50, 50)


@settings(deadline=None, max_examples=examples(300))
@given(
    st.tuples(component, component, component), st.tuples(component, component, component), st.floats(0, 60)
)
@example((2.55e-151, 0.0, 0.0), (2.55e-151, 0.0, 0.0), 1.2e-115)  # squares underflow
def test_the_meeting_time_is_the_first_root_or_the_nearest_approach(r, v, s):
    t = meeting_time(r, v, s)
    assert 0 <= t <= 1e4

    def gap(time):
        return np.linalg.norm(np.add(r, np.multiply(v, time))) - s * time

    scale = 1 + np.linalg.norm(r) + (np.linalg.norm(v) + s) * t
    grid = np.concatenate([np.linspace(0, t, 200), np.geomspace(1e-3, 1e3, 200)])
    values = np.array([gap(time) for time in grid])
    assert (values[:200] >= min(0, gap(t)) - 1e-6 * scale).all()  # none before
    if abs(gap(t)) > 1e-6 * scale and t < 1e4:
        assert (values >= gap(t) - 1e-6 * scale).all()  # and where none is, nothing nearer


@pytest.mark.parametrize(
    ("start", "kind"), [(0, "constant-velocity"), (0, "accelerating"), (2, "accelerating")]
)
def test_who_aims_meets_a_vehicle_that_holds_its_course(start, kind):
    vehicle = vehicle_path(3000, v=(3, 1, -0.5))
    table = {
        "kind": kind,
        "distance_m": 40,
        "azimuth_rad": (-2, 2),
        "elevation_rad": (-0.5, 0.5),
        "start_s": start,
    }
    path = paths(table | {"speed_m_s": (5, 8), "acceleration_m_s2": (0.2, 2)}, vehicle, trials=50)
    distance, speed = closing(vehicle, path)
    assert (distance.min(1) < DT * np.abs(speed).max(1)).all()


@pytest.mark.parametrize("acceleration", [0.5, 3.0])  # the first is too little for the speed
def test_a_quadrotor_meets_a_vehicle_in_the_middle_of_its_leg(acceleration):
    vehicle = vehicle_path(1400, v=(0.8, -0.3, 0.1))
    table = {
        "kind": "quadrotor",
        "distance_m": 4,
        "azimuth_rad": (-1, 1),
        "speed_m_s": (2, 3),
        "start_s": 0.5,
    }
    path = paths(table | {"acceleration_m_s2": (acceleration,) * 2}, vehicle, trials=10)
    distance, _ = closing(vehicle, path)
    assert distance.min(1).max() < 0.06
    fastest = np.linalg.norm(path[..., 3:6], axis=2)
    assert abs(fastest.argmax(1) - distance.argmin(1)).max() < 50
    assert (fastest.max(1) < 3.15).all()
    assert np.linalg.norm(path[..., 6:], axis=2).max() < 1.2 * acceleration


# -- Draws -----------------------------------------------------------------------------------------


def test_places_speeds_and_headings_are_uniform_in_their_ranges():
    vehicle = vehicle_path(1, v=(1, 2, 0.3))
    table = {"distance_m": 20, "azimuth_rad": (0.3, 0.9), "elevation_rad": (-0.2, 0.4), "either_side": True}
    x = drawn(table | {"heading_rad": (0.1, 0.6), "speed_m_s": (4, 7)}, vehicle, 4000)
    to = x[:, :3] - vehicle[0, :3]
    assert np.linalg.norm(to, axis=1) == pytest.approx(20)
    azimuth = np.arctan2(to[:, 1], to[:, 0]) - np.arctan2(2, 1)
    plain = drawn(table | {"speed_m_s": (4, 7)}, vehicle, 4000)
    assert (plain[:, :3] == x[:, :3]).all()  # each is drawn from numbers of its own
    turn = np.arctan2(x[:, 4], x[:, 3]) - np.arctan2(plain[:, 4], plain[:, 3])
    turn = np.angle(np.exp(1j * turn))
    assert (azimuth > 0).mean() == pytest.approx(0.5, abs=0.04)
    assert (np.sign(turn) == -np.sign(azimuth)).all()  # from ahead on the left, outwards is clockwise
    for values, low, high in [
        (abs(azimuth), 0.3, 0.9),
        (np.arcsin(to[:, 2] / 20), -0.2, 0.4),
        (np.linalg.norm(x[:, 3:6], axis=1), 4, 7),
        (abs(turn), 0.1, 0.6),
    ]:
        assert values.min() >= low - 1e-9
        assert values.max() <= high + 1e-9
        assert kstest((values - low) / (high - low), "uniform").pvalue > 1e-3


def test_errors_of_place_and_meeting_point_are_normal_in_the_frame_of_the_course():
    vehicle = vehicle_path(1, v=(0, 4, 0))
    table = {"distance_m": 50, "speed_m_s": (6, 6)}
    offset = drawn(table | {"offset_sigma_m": (0, 0.3, 0.2)}, vehicle, 4000)[:, :3] - (0, 50, 10)
    assert offset[:, 0].std() == pytest.approx(0.3, rel=0.05)
    assert abs(offset[:, 1]).max() < 1e-12
    assert offset[:, 2].std() == pytest.approx(0.2, rel=0.05)
    x = drawn(table | {"meeting_sigma_m": (0, 1, 2)}, vehicle, 4000)
    at = x[:, :3] + 5 * x[:, 3:6] * (
        30 / (5 * -x[:, 4:5])
    )  # where it is at y = 20: there they meet after 5 s
    assert at[:, 1] == pytest.approx(20)
    assert kstest(at[:, 0], "norm").pvalue > 1e-3
    assert kstest((at[:, 2] - 10) / 2, "norm").pvalue > 1e-3


@pytest.mark.parametrize("start", [0.0, 3.0])
@pytest.mark.parametrize("kind", ["constant-velocity", "accelerating"])
def test_who_crosses_does_so_at_its_angle_from_its_distance(kind, start):
    vehicle = vehicle_path(4000)
    table = {
        "kind": kind,
        "distance_m": 150,
        "azimuth_rad": (radians(45),) * 2,
        "crosses": True,
        "either_side": True,
    }
    path = paths(table | {"start_s": start, "acceleration_m_s2": (0.1, 0.5)}, vehicle, trials=40)
    assert np.linalg.norm(path[:, 0, :3] - vehicle[0, :3], axis=1) == pytest.approx(150)
    assert angles(path[:, -1, 3:6], np.array([-1.0, 0, 0])) == pytest.approx(radians(45))
    distance, _ = closing(vehicle, path)
    assert distance.min(1).max() < 0.15


def test_all_is_a_function_of_seed_trial_and_obstacle():
    vehicle = vehicle_path(60)
    whole = paths(SCENARIO_1[0], vehicle, trials=8, seed=5)
    assert (paths(SCENARIO_1[0], vehicle, trials=3, first_trial=4, seed=5) == whole[4:7]).all()
    assert len(np.unique(whole[:, 0, 0])) == 8
    for other in ({"seed": 6}, {"seed": 5, "obstacle": 1}, {"seed": 5 + 2**32}):
        assert (paths(SCENARIO_1[0], vehicle, trials=8, **other)[:, 0, 0] != whole[:, 0, 0]).all()


def test_who_aims_at_the_vehicle_heads_for_its_start_and_a_curving_one_for_where_it_is():
    vehicle = vehicle_path(900)
    table = {
        "distance_m": 30,
        "azimuth_rad": (1, 1),
        "speed_m_s": (6, 6),
        "aims_at_vehicle": True,
        "start_s": 1.0,
    }
    straight = paths(table, vehicle)[0]
    assert np.linalg.norm(straight[:, :3] - vehicle[0, :3], axis=1).min() < 6 * DT
    released = {"turn_rate_rad_s": 10, "release_m": 0.0, "max_speed_m_s": 6}
    pursuing = paths(table | {"kind": "curving"} | released, vehicle)[0]
    to = vehicle[:-1, :3] - pursuing[:-1, :3]
    far = np.arange(110, (np.linalg.norm(to, axis=1) < 1).argmax())  # then it passes and has to come back
    assert len(far) > 200
    assert angles(pursuing[far + 1, 3:6], to[far]).max() < 1e-7


def test_before_its_start_it_rests_where_it_starts():
    vehicle = vehicle_path(101, v=(0, 0, 0))
    for kind in ("constant-velocity", "accelerating", "curving", "ballistic", "quadrotor"):
        path = paths({"kind": kind, "distance_m": 3, "start_s": 0.5, "speed_m_s": (2, 2)}, vehicle)[0]
        assert (path[:51, :3] == path[0, :3]).all()
        assert (path[:51, 3:] == 0).all()
        assert (np.linalg.norm(path[52:, 3:6], axis=1) > 0).all()


# -- The experiments -------------------------------------------------------------------------------


def test_scenario_1_closes_at_the_published_speed_from_the_side():
    vehicle = vehicle_path(800)
    closes, hit = [], []
    for i, table in enumerate(SCENARIO_1):
        distance, speed = closing(vehicle, paths(table, vehicle, trials=1000, seed=1, obstacle=i))
        near = (distance < 10).argmax(1)
        assert (near > 0).all()
        closes.append(speed[np.arange(1000), near].mean())
        hit.append((distance.min(1) <= 0.3).mean())
    # Published: 10.43 and 10.97 at the trigger; the second depends on how the first was avoided.
    assert closes == pytest.approx([10.47, 12.27], abs=0.15)
    # Without avoidance the second always hits, the first in half of the runs, within 1.5 m in most.
    assert hit[1] == 1
    assert 0.35 < hit[0] < 0.55


def test_scenario_2_meets_with_an_error_of_a_metre_and_head_on():
    vehicle = vehicle_path(2600)
    crossing, ahead = (paths(table, vehicle, trials=400, obstacle=i) for i, table in enumerate(SCENARIO_2))
    assert (np.ptp(crossing[..., 3:6], axis=1) == 0).all()
    assert np.linalg.norm(crossing[:, 0, :3] - vehicle[0, :3], axis=1) == pytest.approx(150)
    degrees = np.degrees(angles(crossing[:, 0, 3:6], np.array([-1.0, 0, 0])))
    assert degrees == pytest.approx(45, abs=2)
    assert degrees.std() < 0.6
    distance, _ = closing(vehicle, crossing)
    # An error of 1 m per axis is one across the relative path of 1 m per axis: Rayleigh.
    assert np.median(distance.min(1)) == pytest.approx(np.sqrt(2 * np.log(2)), rel=0.12)
    distance, speed = closing(vehicle, ahead)
    assert distance[:, 0] == pytest.approx(200)
    assert distance.min(1).max() < 0.15
    assert speed[:, 0].mean() == pytest.approx(11, abs=0.2)


def test_the_hardware_runs_hit_who_hovers():
    vehicle = vehicle_path(500, v=(0, 0, 0), p=(0, 0, 1))
    approaching, thrown = (paths(table, vehicle, trials=100, obstacle=i) for i, table in enumerate(HARDWARE))
    distance, speed = closing(vehicle, approaching)
    assert distance.min() < 0.02
    assert speed.max() == pytest.approx(2.35, abs=0.15)
    distance, speed = closing(vehicle, thrown)
    assert (distance.min(1) < 0.2).all()
    assert np.median(distance.min(1)) > 0.02
    assert (distance[:, :150].std(1) == 0).all()
    flying = speed[np.arange(100), (distance < 1).argmax(1)]
    assert flying.min() > 2
    assert flying.max() < 5


# -- Refusals --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"kind": "flying"}, "kind must be constant-velocity, accelerating"),
        ({"radius_m": 0}, "radius"),
        ({"radius_m": np.nan}, "radius"),
        ({"position": (np.nan, 0, 0)}, "finite"),
        ({"distance_m": -1}, "distance"),
        ({"azimuth_rad": (1, 0)}, "range"),
        ({"speed_m_s": (np.nan, 1)}, "range"),
        ({"heading_rad": (0, np.inf)}, "range"),
        ({"elevation_rad": (0, 2)}, "elevation"),
        ({"speed_m_s": (-1, 1)}, "speeds and accelerations"),
        ({"acceleration_m_s2": (-1, 1)}, "speeds and accelerations"),
        ({"offset_sigma_m": (0, -1, 0)}, "standard deviations"),
        ({"meeting_sigma_m": (np.inf, 0, 0)}, "standard deviations"),
        ({"max_speed_m_s": 0}, "highest speed"),
        ({"kind": "curving", "max_speed_m_s": 7}, "no faster than its highest"),
        ({"turn_rate_rad_s": -1}, "turn rate"),
        ({"start_s": -1}, "start"),
        ({"velocity_m_s": (1, 0, 0)}, "needs a place"),
        ({"is_relative": False, "crosses": True}, "a distance, not a place"),
        ({"crosses": True, "aims_at_vehicle": True}, "or aims"),
        ({"kind": "ballistic", "speed_m_s": (0, 1)}, "needs a speed"),
        ({"way_points": [(0, 0, 0)]}, "only a quadrotor"),
        ({"kind": "quadrotor", "speed_m_s": (0, 1)}, "starts at rest"),
        ({"kind": "quadrotor", "way_points": [(0, 0, 0), (0, 0, 0)]}, "differ"),
        ({"kind": "quadrotor", "way_points": [(0, 0, np.nan)]}, "finite"),
    ],
)
def test_a_specification_without_meaning_is_refused(table, message):
    with pytest.raises(ValueError, match=message):
        ObstacleSpec(**table)


def test_a_body_needs_its_gains():
    with pytest.raises(ValueError, match="a body needs its gains"):
        ObstacleSpec(kind="quadrotor", gains=TrackingGains())


@pytest.mark.parametrize(
    ("table", "vehicle", "message"),
    [
        ({}, np.full((1, 9), np.nan), "must be finite"),
        ({}, np.zeros((0, 9)), "one state at least"),
        ({"crosses": True, "azimuth_rad": (np.pi, np.pi), "speed_m_s": (4, 4)}, vehicle_path(1), "nowhere"),
        ({"crosses": True, "start_s": 20}, vehicle_path(1), "too near"),
        (
            {"kind": "ballistic", "elevation_rad": (np.pi / 2,) * 2},
            vehicle_path(1, v=(0, 0, 0)),
            "above or below",
        ),
        ({"kind": "ballistic", "drag_per_m": 5.0}, vehicle_path(1, v=(0, 0, 0)), "no throw reaches"),
        ({"kind": "ballistic", "speed_m_s": (0.5, 0.5)}, vehicle_path(1, v=(0, 0, 0)), "a minute"),
        (
            {"kind": "quadrotor", "is_relative": False, "way_points": [(0, 0, 0)]},
            vehicle_path(1),
            "lead away from its start",
        ),
    ],
)
def test_a_vehicle_that_cannot_be_met_is_refused(table, vehicle, message):
    with pytest.raises(ValueError, match=message):
        paths(table, vehicle)
