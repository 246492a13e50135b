"""Pitfalls observed on the real autopilot, each with the measured number."""

import math

import pytest

from alula.stages.sim_vehicle.ardupilot.guided import Sub
from alula.stages.sim_vehicle.common.quaternions import from_euler
from support.vehicles.autopilot_client import EXACT, GUIDED, NOGPS, Client

THRUST = {"GUID_OPTIONS": 8}
LEVEL_THRUST = {"GUID_OPTIONS": 8, "ATC_ANGLE_BOOST": 0}
NAN = float("nan")


def test_take_off_to_ten_metres_takes_about_nine_seconds():
    client = Client()
    client.wait(2.5)
    client.mode(GUIDED)
    client.arm()
    begin = client.vehicle.time_s
    assert client.command(22, 0, 0, 0, 0, 0, 0, 10.0) == 0
    while client.height < 9.5 and client.vehicle.time_s < begin + 20:
        client.wait(0.05)
    assert client.vehicle.time_s - begin == pytest.approx(9.4, abs=0.4)


def test_thrust_is_a_climb_rate_unless_the_option_is_set():
    client = Client(options=EXACT).fly(10)
    client.stream(3, thrust=0.75)  # half of WPNAV_SPEED_UP
    assert client.climb == pytest.approx(1.25, abs=0.05)
    client.stream(3, thrust=0.25)  # half of WPNAV_SPEED_DN
    assert client.climb == pytest.approx(-0.75, abs=0.05)
    client.stream(3, thrust=0.5)
    assert client.climb == pytest.approx(0, abs=0.05)
    falling = Client(options=EXACT, parameters=THRUST).fly(12)
    falling.stream(1, thrust=0.75 * falling.copter.hover_throttle)
    assert falling.climb == pytest.approx(-0.25 * 9.81 * 0.87, rel=0.05)  # the rest is drag


@pytest.mark.every(2)
@pytest.mark.parametrize(
    ("share", "climb"), [(0.8, -1.714), (0.9, -0.845), (1.1, 0.876), (1.25, 2.078), (1.5, 3.980)]
)
def test_a_second_of_thrust_over_hover_thrust_climbs_as_measured(share, climb):
    client = Client(options=EXACT, parameters=LEVEL_THRUST).fly(12)
    client.stream(1, thrust=share * client.copter.hover_throttle)
    assert client.climb == pytest.approx(climb, rel=0.05)


def test_the_hover_thrust_that_is_believed_moves_no_rotor():
    climbs = []
    for parameters in (LEVEL_THRUST, LEVEL_THRUST | {"MOT_THST_HOVER": 0.4}):
        client = Client(options=EXACT, parameters=parameters).fly(10)
        client.stream(1, thrust=1.1 * client.copter.hover_throttle)
        climbs.append(client.climb)
    assert climbs[0] == pytest.approx(climbs[1], abs=0.05)


@pytest.mark.parametrize(("boost", "climb"), [(0, -1.44), (1, 0.0)])
def test_angle_boost_makes_up_for_the_tilt_unless_it_is_off(boost, climb):
    client = Client(options=EXACT, parameters=THRUST | {"ATC_ANGLE_BOOST": boost}).fly(12)
    hover = client.copter.hover_throttle
    client.stream(math.radians(30), omega=(1.0, 0.0, 0.0), thrust=hover)
    client.stream(1, thrust=hover)
    assert math.degrees(client.tilt) == pytest.approx(30, abs=1)
    assert client.climb == pytest.approx(climb, abs=0.2)


def test_rates_are_followed_as_fast_as_measured():
    client = Client(options=EXACT, parameters=THRUST).fly(10)
    hover = client.copter.hover_throttle
    for axis, rate, expected_s in ((0, 0.5, 0.031), (1, 0.5, 0.032), (0, -0.5, 0.031), (2, 0.5, 0.277)):
        omega = tuple(rate if i == axis else 0.0 for i in range(3))
        begin, rise, seen = client.vehicle.time_s, None, []
        for _ in range(160):
            client.rates(omega, hover)
            client.wait(0.0025)
            seen.append(client.truth.omega[axis] / rate)
            if rise is None and seen[-1] >= 0.632:
                rise = client.vehicle.time_s - begin
        assert rise == pytest.approx(expected_s, abs=0.01)  # the client measured up to three ticks more
        if axis != 2:
            assert seen[-1] == pytest.approx(1, abs=0.05)
            assert max(seen) < 1.08
        client.stream(3.0, mask=7, thrust=hover)  # level again


def rise_s(client, rate=0.5):
    """Time until 63 % of a roll rate [s]."""
    begin = client.vehicle.time_s
    while client.truth.omega[0] < 0.632 * rate:
        client.rates((rate, 0.0, 0.0), client.copter.hover_throttle)
        client.wait(0.0025)
    return client.vehicle.time_s - begin


def test_rates_that_are_not_fed_forward_are_followed_by_the_attitude_only():
    client = Client(options=EXACT, parameters=THRUST | {"ATC_RATE_FF_ENAB": 0}).fly(10)
    assert rise_s(client) > 1 / 4.5  # the gain of the attitude


@pytest.mark.parametrize(("limit", "fastest"), [(0, 150), (20, 23)])
def test_a_rate_limit_bounds_turns_to_an_attitude_but_no_rate_command(limit, fastest):
    client = Client(options=EXACT, parameters=THRUST | {"ATC_RATE_R_MAX": limit}).fly(12)
    peak, q = 0.0, (math.cos(0.25), math.sin(0.25), 0.0, 0.0)
    for _ in range(200):
        client.rates(thrust=client.copter.hover_throttle, mask=7, q=q)
        client.wait(0.0025)
        peak = max(peak, math.degrees(client.truth.omega[0]))
    assert 0.6 * fastest < peak < fastest
    client.stream(2.0, mask=7, thrust=client.copter.hover_throttle)
    assert rise_s(client) == pytest.approx(0.031, abs=0.01)  # 0.5 rad/s are 29 degrees/s


def test_rates_are_integrated_into_an_attitude_that_is_held():
    client = Client(options=EXACT, parameters=THRUST).fly(12)
    hover = client.copter.hover_throttle
    client.stream(0.4, omega=(0.5, 0, 0), thrust=hover)
    client.stream(0.6, thrust=hover)
    assert client.tilt == pytest.approx(0.2, abs=0.01)  # a pure rate loop would have lost the lag
    target = client.copter.attitude.target
    assert 2 * math.asin(target[1]) == pytest.approx(client.tilt, abs=0.005)


def test_thrust_without_a_number_gives_minimum_throttle():
    client = Client(options=EXACT, parameters=THRUST).fly(12)
    client.stream(0.6, thrust=NAN)
    assert client.climb == pytest.approx(-5.54, rel=0.1)  # its drag falls with the thrust, this one does not


def test_a_climb_rate_without_a_number_is_none():
    client = Client(options=EXACT).fly(5)
    client.stream(2, thrust=NAN)
    assert client.climb == pytest.approx(0, abs=0.05)


def test_partial_masks_are_rejected_and_the_mode_begins_again():
    client = Client(options=EXACT, parameters=THRUST).fly(10)
    guided = client.copter.flying.guided
    for count, mask in enumerate((129, 130, 132, 131, 133, 134, 192, 64, 1, 128 | 7 | 64), 1):
        client.stream(0.1, omega=(0.6, 0, 0), thrust=client.copter.hover_throttle)
        assert guided.sub is Sub.ANGLE
        client.rates((2.0, 2.0, 2.0), 1.0, mask=mask)
        assert guided.rejected == count
        assert guided.sub is Sub.VELOCITY
    client.wait(10)  # it brakes from a lean of 0.6 rad and returns: measured -0.46 m/s after 4 s
    assert client.tilt < 0.03
    assert math.dist(client.truth.velocity, (0, 0, 0)) < 0.1


def test_an_attitude_that_is_none_is_rejected():
    client = Client(options=EXACT, parameters=THRUST).fly(2)
    for count, q in enumerate(((0.0,) * 4, (2.0, 0.0, 0.0, 0.0), (NAN, 0.0, 0.0, 0.0)), 1):
        client.rates(thrust=0.3, mask=7, q=q)
        assert client.copter.flying.guided.rejected == count


def test_an_attitude_is_taken_up():
    client = Client(options=EXACT).fly(5)
    client.stream(3, thrust=0.5, mask=7, q=from_euler(0.2, 0.0, 0.3))  # yaw overshoots
    assert client.truth.attitude == pytest.approx(from_euler(0.2, 0.0, 0.3), abs=0.01)


def test_silence_means_level_and_no_climb_after_the_timeout_only():
    client = Client(options=EXACT, parameters=THRUST).fly(20)
    hover = client.copter.hover_throttle
    client.stream(0.3, omega=(0.05, 0, 0), thrust=1.02 * hover)
    client.wait(2.8)
    assert client.tilt > 0.14  # the last rates stayed in force
    client.wait(1.5)
    assert client.tilt < 0.01
    client.wait(2)
    assert client.climb == pytest.approx(0, abs=0.05)
    quick = Client(options=EXACT, parameters=THRUST | {"GUID_TIMEOUT": 0.3}).fly(10)
    quick.stream(0.3, omega=(0.5, 0, 0), thrust=hover)
    quick.wait(0.25)
    assert quick.tilt > 0.15
    quick.wait(0.8)
    assert quick.tilt < 0.02


def test_setpoints_are_followed_in_guided_modes_only():
    client = Client(options=EXACT, parameters=THRUST).fly(10)
    client.mode(5)
    client.wait(1)
    client.stream(1, omega=(1.0, 0, 0), thrust=0.0)
    assert client.tilt < 0.02
    assert abs(client.climb) < 0.1
    assert client.mode(NOGPS) == 0
    client.stream(0.5, omega=(0.4, 0, 0), thrust=client.copter.hover_throttle)
    assert client.tilt == pytest.approx(0.2, abs=0.02)


IGNORE_P, IGNORE_V, IGNORE_A, FORCE, IGNORE_YAW, IGNORE_RATE = 7, 56, 448, 512, 1024, 2048
YAW = IGNORE_YAW | IGNORE_RATE


def streamed(client, seconds, *arguments, **named):
    for _ in range(round(seconds / 0.05)):
        client.target(*arguments, **named)
        client.wait(0.05)


def test_a_position_is_flown_to():
    client = Client(options=EXACT).fly(4)
    client.target(IGNORE_V | IGNORE_A | IGNORE_RATE, p=(3, -2, -5), yaw=1.0)
    client.wait(9)
    assert client.truth.position == pytest.approx((3, -2, -5), abs=0.1)
    assert client.truth.attitude == pytest.approx(from_euler(0, 0, 1.0), abs=0.03)
    client.target(IGNORE_V | IGNORE_A | YAW, p=(1, 0, 0), frame=9)  # ahead of the body
    client.wait(6)
    ahead = (3 + math.cos(1.0), -2 + math.sin(1.0), -5)
    assert client.truth.position == pytest.approx(ahead, abs=0.1)


def test_a_velocity_is_flown_until_it_times_out():
    client = Client(options=EXACT).fly(4)
    streamed(client, 3, IGNORE_P | IGNORE_A | YAW, v=(0.8, -0.4, -0.2))
    assert client.truth.velocity == pytest.approx((0.8, -0.4, -0.2), abs=0.05)
    client.wait(2.8)
    assert client.truth.velocity == pytest.approx((0.8, -0.4, -0.2), abs=0.05)
    client.wait(3)
    assert math.dist(client.truth.velocity, (0, 0, 0)) < 0.1


def test_an_acceleration_is_flown():
    client = Client(options=EXACT).fly(4)
    streamed(client, 1, IGNORE_P | IGNORE_V | YAW, a=(1.0, 0.0, 0.0))
    assert client.truth.velocity[0] == pytest.approx(1.0, abs=0.2)
    assert client.truth.velocity[1:] == pytest.approx((0, 0), abs=0.05)


def test_a_moving_point_is_followed():
    client = Client(options=EXACT).fly(4)
    x0, y0, z0 = client.truth.position
    for i in range(200):
        t = i * 0.02
        client.target(YAW, p=(x0 + 0.25 * t * t, y0, z0), v=(0.5 * t, 0, 0), a=(0.5, 0, 0))
        client.wait(0.02)
    assert client.truth.position == pytest.approx((x0 + 4.0, y0, z0), abs=0.15)


def test_positions_that_mean_nothing_are_rejected():
    client = Client(options=EXACT).fly(2)
    nothing, force = IGNORE_P | IGNORE_V | IGNORE_A, IGNORE_P | IGNORE_V | FORCE
    cases = [(nothing, 1, 1), (force, 1, 1), (IGNORE_P | IGNORE_A, 0, 1), (IGNORE_P | IGNORE_A, 1, NAN)]
    for count, (mask, frame, speed) in enumerate(cases, 1):
        client.target(mask, v=(speed, 0, 0), frame=frame)
        assert client.copter.flying.guided.rejected == count


def test_the_force_bit_beside_a_velocity_is_ignored_and_the_velocity_flown():
    client = Client(options=EXACT).fly(4)
    streamed(client, 3, IGNORE_P | IGNORE_A | FORCE | YAW, v=(1.0, 0.0, 0.0))
    assert client.copter.flying.guided.rejected == 0
    assert client.truth.velocity == pytest.approx((1.0, 0.0, 0.0), abs=0.05)


@pytest.mark.every(2)
@pytest.mark.parametrize(
    ("name", "value", "column", "v"),
    [
        ("WPNAV_ACCEL", 50, 0, (1.0, 0.0, 0.0)),
        ("PSC_JERK_XY", 1, 0, (1.0, 0.0, 0.0)),
        ("WPNAV_ACCEL_Z", 40, 2, (0.0, 0.0, -1.0)),
        ("PSC_JERK_Z", 1, 2, (0.0, 0.0, -1.0)),
    ],
)
def test_setpoints_are_shaped_by_parameters(name, value, column, v):
    fallen = []
    for parameters in ({}, {name: value}):
        client = Client(options=EXACT).fly(6)
        for each in parameters.items():
            client.copter.parameters.set(*each)
        streamed(client, 6, IGNORE_P | IGNORE_A | YAW, v=v)
        streamed(client, 0.8, IGNORE_P | IGNORE_A | YAW)
        fallen.append(1 - client.truth.velocity[column] / v[column])
    assert fallen[0] > 0.6
    assert fallen[1] < fallen[0] - 0.15


def test_yaw_overshoots_by_its_rate_gains():
    peaks = []
    for gains in ({}, {"ATC_RAT_YAW_FLTE": 0.0}, {"ATC_RAT_YAW_P": 0.6}):
        client = Client(options=EXACT, parameters=THRUST | gains).fly(10)
        seen = []
        for _ in range(150):
            client.rates((0.0, 0.0, 0.5), client.copter.hover_throttle)
            client.wait(0.01)
            seen.append(client.truth.omega[2] / 0.5)
        peaks.append(max(seen))
    assert peaks[0] == pytest.approx(1.227, rel=0.03)
    assert peaks[1] < peaks[0] - 0.05  # without the low-pass of the error
    assert peaks[2] > peaks[0] + 0.05
