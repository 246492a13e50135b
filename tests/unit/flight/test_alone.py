"""When this program ends or stands still in flight, the vehicle stops by itself, and as near as was said."""

import math

import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import FASTBRIDGE, read_vehicle
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.flight.mission import make_needs
from alula.stages.vehicles.setpoints import RatesSetpoint, VelocitySetpoint
from support.flights.flights import BALL, mission
from support.paths import VEHICLES
from support.scenes.small_scenes import line_plan
from support.vehicles.lockstep import Flight, Upset, stall
from support.vehicles.served_autopilot import G, flight, stream, take_off

SPEED = 1.0


def levelled(state):
    """Body rates that hold the vehicle level."""
    w, x, y, _ = state.attitude_wxyz
    return RatesSetpoint(G, np.array([-6.0 * w * x, -6.0 * w * y, 0.0]))


def left_alone(*, prepared, by_rates):
    """Distance that the vehicle still flies, time until it lands [s], and what was said of it before."""
    with flight(flies_rates=prepared) as (served, time, link):
        take_off(time, link)
        stream(time, link, 4.0, lambda s: VelocitySetpoint(np.array([SPEED, 0, 0]), 0.0))
        if by_rates:
            stream(time, link, 0.4, levelled)
        begin, begin_s, landing_s = served.true_state()[0], time(), math.inf
        for _ in range(1200):  # nobody polls the link any more
            time.sleep(0.01)
            if served.copter.mode.name == "LAND":
                landing_s = min(landing_s, time() - begin_s)
        coasted = np.linalg.norm((served.true_state()[0] - begin)[:2])
        return coasted, landing_s, link.status.own_safety.alone_s


def test_a_vehicle_by_rates_lands_within_the_time_and_stops_within_the_distance_that_were_said():
    made = mission("cone-backup", scene=BALL, is_clear=True, speed_m_s=SPEED)
    coasted, landing_s, alone_s = left_alone(prepared=True, by_rates=True)
    assert landing_s < alone_s < 0.9
    assert coasted < SPEED * alone_s + make_needs(made, (RatesSetpoint,)).stop_m
    assert coasted < 1.5


def test_without_that_it_coasts_for_metres():
    coasted, landing_s, _ = left_alone(prepared=False, by_rates=True)
    assert landing_s > 4.0
    assert coasted > 2.5


def test_a_vehicle_by_velocities_stops_without_set_points():
    coasted, _, alone_s = left_alone(prepared=False, by_rates=False)
    made = mission(speed_m_s=SPEED)
    assert alone_s == pytest.approx(0.3)
    assert coasted < SPEED * alone_s + make_needs(made, (VelocitySetpoint,)).stop_m


def test_the_parameters_are_set_for_rates_only_and_put_back():
    own = {"FS_GCS_TIMEOUT": 5.0, "ATC_ACCEL_R_MAX": 110000.0, "ATC_ACCEL_P_MAX": 110000.0}
    for_rates = {"FS_GCS_TIMEOUT": 0.5, "ATC_ACCEL_R_MAX": 0.0, "ATC_ACCEL_P_MAX": 0.0}
    for flies_rates, expected in ((False, own), (True, for_rates)):
        with flight(flies_rates=flies_rates) as (served, time, link):
            assert {name: served.copter.parameters[name] for name in own} == expected
            time.run(link, 6.0)
            assert not served.copter.failsafe
        assert {name: served.copter.parameters[name] for name in own} == own


def test_a_flight_after_a_killed_one_by_rates_keeps_its_vehicle_out_of_the_failsafe():
    left = {"FS_GCS_TIMEOUT": 0.5, "FS_GCS_ENABLE": 5.0, "GUID_TIMEOUT": 0.3}
    flown = Flight(mission(plan=line_plan((0.3, 2.0, 0.5), (1.2, 2.0, 0.5), 2.0)), parameters=left).fly()
    assert flown.cause is Event.PLAN_FINISHED, flown.loop.ending
    assert not any("GCS" in words for _, words in flown.recorder.lines)


def test_a_loop_that_stands_still_finds_its_vehicle_landing_and_says_why():
    made = mission("cone-backup", scene=BALL, is_clear=True, plan=line_plan((0.3, 3.2, 1.0), (3.7, 3.2, 1.0)))
    flown = Flight(made, [Upset(State.FLY, 2.0, stall(3.0))], {"failsafe_s": 3.0}).fly()
    assert flown.cause is Event.FAILSAFE
    assert "GCS Failsafe" in flown.loop.ending
    assert flown.copter.mode.name == "LAND"


def test_what_it_coasts_is_said_before_take_off():
    made = mission("cone-backup", scene=BALL, is_clear=True, speed_m_s=SPEED)
    flown = Flight(made, loop_words={"dry_run": True}).fly()
    words = next(each.words for each in flown.loop.checks.verdicts if each.name == "failsafes")
    assert words.endswith("; from 1 m/s it coasts at most 1.8 m when this program dies")


def test_a_file_with_a_faster_yaw_than_the_vehicles_own_filter_is_pointed_out():
    for vehicle, expected in ((FASTBRIDGE, True), (read_vehicle(VEHICLES / "arducopter.toml"), False)):
        with flight(prepare=False, flies_rates=True, vehicle=vehicle) as (_, _, link):
            words = [line for line in link.prepare() if line.startswith("ATC_RAT_YAW_FLTE is 2.5 Hz: ")]
            assert bool(words) is expected
