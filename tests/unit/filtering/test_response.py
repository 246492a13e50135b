"""What the response to velocities and accelerations says about disturbances, and what filters make of it."""

import math

import numpy as np
import pytest

from alula import _core
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.filtering.bridge import native_filter
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.filtering.registry import make_filter
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
from support.scenes.small_scenes import box_cover

DT, LAG, ROOM = 0.01, 0.9, 0.3
BODY = quadrotor(FASTBRIDGE)
WALL = Hulls.from_cover(box_cover([((-40, 20, -40), (40, 24, 40))]))  # at y = 2
RADIUS, SPEED, BETA = 0.15, 2.0, 2.0


def flight_by(interface, filters=(), *, time_s=0.2, delay_s=0.0):
    spec = _core.VehicleSpec(
        BODY,
        interface=interface,
        gains=tracking_gains(FASTBRIDGE, 0.5),
        velocity_lag_s=LAG,
        max_speed_m_s=SPEED,
        assumed=_core.ActuatorModel(delay_s=delay_s),
    )
    options = _core.FlightOptions(dt_s=DT, response_time_s=time_s, response_room_m_s2=ROOM)
    return _core.Flight(spec, options, _core.Mission.given(gain_per_s=2.0), list(filters))


def by_hulls(hulls=WALL):
    world = FilterWorld(hulls=hulls, radius_m=RADIUS, speed_m_s=SPEED, dt_s=DT, extent_m=20.0)
    safety = make_filter("polytope-cbf", world, {"beta": BETA, "kappa_per_m": 100.0, "smoothing": "sound"})
    return [_core.ChordFilter(native_filter(safety), lag_s=LAG, max_speed_m_s=SPEED)]


def respond(
    flight, command_of, follows, seconds, *, disturbance=lambda t: np.zeros(3), start=(0.0, 0.0, 1.0)
):
    """Fly a point that follows what is sent; its states (T, 6), what was found, and what was sent.

    `command_of` gives the reference by time, or None for what the flight decides about a reference at rest.
    """
    x, rows, reports, sent = np.zeros(12), [], [], []
    x[:3] = start
    row = np.zeros(18)
    row[:3] = start
    for k in range(round(seconds / DT)):
        t = k * DT
        flight.observe(t, x, target=row, age_s=0.0)
        found = flight.decide()
        if command_of is None:
            command = found["command"][:3]
            flight.sent()
        else:
            command = np.asarray(command_of(t), float)
            flight.sent(("velocity", "acceleration")[follows == "acceleration"], (*command, 0.0))
        rows.append([*x[:3], *x[6:9]]), reports.append(found), sent.append(command)
        for _ in range(5):
            a = command if follows == "acceleration" else (command - x[6:9]) / follows
            x[:3] += DT / 5 * x[6:9]
            x[6:9] += DT / 5 * (a + disturbance(t))
    return np.array(rows), reports, np.array(sent)


def steps(t):
    """Velocities or accelerations that change in steps, half a second each."""
    return np.array([[1.5, 0, 0], [0, 1, 0.5], [-1, -1, 0], [0, 0, 0]][int(2 * t) % 4])


@pytest.mark.parametrize("lag", [0.12, 0.3, 0.6, 0.9])
def test_a_vehicle_no_slower_than_assumed_leaves_nothing_out(lag):
    _, reports, _ = respond(flight_by("velocity"), steps, lag, 6.0)
    assert not any(any(found["disturbance"]) or found["disturbance_bound"] for found in reports)
    assert all(found["added_margin_m"] == 0 for found in reports)


@pytest.mark.parametrize("interface", ["velocity", "acceleration"])
def test_a_constant_disturbance_is_estimated_up_to_the_room_of_the_interval(interface):
    true = np.array([0.0, 1.8, -0.9])
    flight = flight_by(interface)
    # The longest lag that the interval allows leaves nothing of the disturbance to it.
    follows = LAG if interface == "velocity" else "acceleration"
    _, reports, _ = respond(
        flight, lambda t: (0, 0, 0), follows, 3.0, disturbance=lambda t: true if t >= 1.0 else np.zeros(3)
    )
    found = np.array([r["disturbance"] for r in reports])
    bound = np.array([r["disturbance_bound"] for r in reports])
    assert not found[:100].any()
    if interface == "acceleration":
        np.testing.assert_allclose(found[-1], true - ROOM * np.sign(true), atol=0.02)
    else:  # of velocities, once the vehicle has come to its new speed, faster responses explain part of it
        np.testing.assert_allclose(found[150], true - ROOM * np.sign(true), atol=0.55)
    left = np.linalg.norm(true - ROOM * np.sign(true) - found, axis=1)
    late = slice(
        121, 160
    )  # from one time constant after it began: the peak of what is not known yet has passed
    assert (left[late] <= bound[late] + 0.25).all()
    assert bound.max() > 0.8 * np.linalg.norm(true - ROOM * np.sign(true))
    assert bound[-1] < 0.5 * bound.max()  # released again,
    assert bound[200] > 0.3 * bound.max()  # slowly


def test_a_slower_vehicle_is_noticed_though_no_wind_blows():
    _, reports, _ = respond(flight_by("velocity"), lambda t: (2.0 if t < 2 else 0.0, 0, 0), 2.5, 4.0)
    assert max(found["disturbance"][0] for found in reports) > 0.1  # it goes on when it should brake
    assert min(found["disturbance"][0] for found in reports) < -0.3


def test_an_unknown_command_begins_the_estimate_anew():
    flight = flight_by("velocity")
    respond(flight, lambda t: (0, 0, 0), LAG, 1.0, disturbance=lambda t: np.array([2.0, 0, 0]))
    x = np.zeros(12)
    flight.observe(1.0, x, target=np.zeros(18), age_s=0.0)
    assert flight.decide()["disturbance"][0] > 0.5
    flight.sent("body-rates", (BODY.mass * 9.81, 0.0, 0.0, 0.0))
    for k in range(20):
        flight.observe(1.01 + k * DT, x, target=np.zeros(18), age_s=0.0)
        assert not any(flight.decide()["disturbance"])
        flight.sent()


def test_a_commanded_acceleration_is_sent_less_the_estimate():
    flight = flight_by("acceleration")
    rows, reports, sent = respond(
        flight, None, "acceleration", 6.0, disturbance=lambda t: np.array([0, 1.5 if t > 1 else 0, 0])
    )
    last = reports[-1]
    np.testing.assert_allclose(
        sent[-1], np.array(last["nominal"]["acceleration"]) - last["disturbance"], atol=1e-12
    )
    off, *_ = respond(
        flight_by("acceleration", time_s=0.0),
        None,
        "acceleration",
        6.0,
        disturbance=lambda t: np.array([0, 1.5 if t > 1 else 0, 0]),
    )
    assert abs(rows[-1, 1]) < 0.4 * abs(off[-1, 1])  # only the room of the interval moves it aside


@pytest.mark.parametrize("gust", [1.0, 2.5])
def test_a_gust_towards_a_wall_uses_less_of_the_margin_than_without_the_estimate(gust):
    def blow(t):
        return np.array([0, gust if 1 < t < 1.6 else 0.0, 0])

    start = (0.0, 1.55, 1.0)  # 0.3 m clear
    near, reports, _ = respond(
        flight_by("velocity", by_hulls()), None, 0.6, 4.0, disturbance=blow, start=start
    )
    off, *_ = respond(
        flight_by("velocity", by_hulls(), time_s=0.0), None, 0.6, 4.0, disturbance=blow, start=start
    )
    assert near[:, 1].max() < off[:, 1].max() - 0.1 * gust * 0.3
    grown = max(found["added_margin_m"] for found in reports)
    assert grown == pytest.approx(0.5 * LAG * max(found["disturbance_bound"] for found in reports))


def test_a_grown_margin_stops_the_approach_and_drives_nothing_away():
    """With a bound but no estimate any more: it may not come nearer, and need not leave."""
    flight = flight_by("velocity", by_hulls())
    _, reports, _ = respond(
        flight,
        None,
        LAG,
        2.2,
        disturbance=lambda t: np.array([1.5 if 1 < t < 1.4 else 0.0, 0, 0]),  # along the wall
        start=(0.0, 1.6, 1.0),
    )
    last = reports[-1]
    assert last["added_margin_m"] > 0.05
    at = last["estimate"][:3]
    # The reference in the wall: without a grown margin the filter would approach at beta times the room.
    row = np.zeros(18)
    row[:3] = at + np.array([0, 1.0, 0])
    x = np.array(last["estimate"])
    x[6:9] = 0
    flight.observe(2.21, x, target=row, age_s=0.0)
    velocity = flight.decide()["filters"][-1]["velocity"]
    assert 0 <= 2 - RADIUS - at[1] - 0.2 < last["added_margin_m"]
    assert velocity[1] == pytest.approx(0.0, abs=0.02)
    calm = flight_by("velocity", by_hulls())
    calm.observe(0.0, x, target=row, age_s=0.0)
    assert calm.decide()["filters"][-1]["velocity"][1] > 0.2


def test_a_slip_of_the_position_adds_itself_to_the_margin():
    row, x = np.zeros(18), np.zeros(12)
    x[:3] = row[:3] = (0.0, 1.6, 1.0)
    row[1] += 1.0  # in the wall, which is 0.25 m beyond the radius
    towards = []
    for slip_m in (0.0, 0.1, 0.3):
        flight = flight_by("velocity", by_hulls())
        flight.observe(0.0, x, target=row, age_s=0.0, slip_m=slip_m)
        found = flight.decide()
        assert found["added_margin_m"] == slip_m
        towards.append(found["filters"][-1]["velocity"][1])
    assert towards[0] - towards[1] == pytest.approx(BETA * 0.1, abs=0.02)
    assert towards[2] == pytest.approx(0.0, abs=0.02)
    for wrong in (math.nan, math.inf, -0.1):
        with pytest.raises(ValueError, match="finite and not negative"):
            flight_by("velocity", by_hulls()).observe(0.0, x, target=row, age_s=0.0, slip_m=wrong)


def test_filters_of_accelerations_keep_more_where_the_response_contradicts():
    hulls = hull_obstacles(WALL)
    index = _core.EllipsoidIndex(
        np.array([[1e3, 0, 0]], np.float32),
        np.array([[0.1] * 3], np.float32),
        np.array([[1, 0, 0, 0]], np.float32),
        sigma=1.0,
        radius=RADIUS,
    )
    options = _core.SaferSplatOptions()

    def answer(disturbed):
        flight = flight_by(
            "acceleration",
            [_core.SaferSplat(index, options, near_map=_core.HullMap(hulls), near_radius_m=RADIUS)],
        )
        gust = (lambda t: np.array([2.5 if t > 0.8 else 0.0, 0, 0])) if disturbed else (lambda t: np.zeros(3))
        _, reports, _ = respond(flight, None, "acceleration", 1.0, disturbance=gust, start=(0.0, 1.4, 1.0))
        x, row = np.array(reports[-1]["estimate"]), np.zeros(18)
        x[:3], x[6:9], row[:3] = (0, 1.4, 1), (0, 0.1, 0), (0, 3.0, 1)
        flight.observe(1.01, x, target=row, age_s=0.0)
        return flight.decide()["filters"][-1]["acceleration"][1]

    assert answer(True) < answer(False) - 0.1
