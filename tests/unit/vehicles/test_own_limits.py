"""Limits that a vehicle's own parameters set, and steps of rates that keep to them and to a lean."""

import math

import msgspec
import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.identification.step_flight import StepFlight
from alula.stages.identification.steps import LEAN_RAD, MAX_LEAN_RAD, plan_steps
from alula.stages.vehicles.own_limits import PARAMETERS, first_guess, own_limits, rate_notes
from alula.stages.vehicles.setpoints import RatesSetpoint

BEFORE = {  # ArduPilot Copter 4.6
    "WPNAV_SPEED_UP": 250.0,
    "WPNAV_SPEED_DN": 150.0,
    "WPNAV_ACCEL": 200.0,
    "PSC_JERK_XY": 5.0,
    "ANGLE_MAX": 3000.0,
    "ATC_ACCEL_R_MAX": 110000.0,
    "ATC_RATE_Y_MAX": 90.0,
}
SINCE = {  # the same from 4.7 on
    "WP_SPD_UP": 2.5,
    "WP_SPD_DN": 1.5,
    "WP_ACC": 2.0,
    "PSC_NE_JERK": 5.0,
    "ATC_ANGLE_MAX": 30.0,
    "ATC_ACC_R_MAX": 1100.0,
    "ATC_RATE_Y_MAX": 90.0,
}
BOX = (-8.0, -8.0, 0.0, 8.0, 8.0, 16.0)


def test_old_and_new_names_set_the_same_limits():
    before, since = own_limits(BEFORE), own_limits(SINCE)
    assert {what: limit.value for what, limit in before.items()} == pytest.approx(
        {what: limit.value for what, limit in since.items()}
    )
    assert since["acceleration"] == (2.0, "WP_ACC")
    assert before["lean"].value == pytest.approx(math.radians(30.0))
    assert BEFORE.keys() | SINCE.keys() <= set(PARAMETERS)
    assert all(len(name) <= 16 for name in PARAMETERS)


def test_zero_is_no_limit_and_the_position_controllers_own_lean_counts_first():
    assert own_limits({"ATC_RATE_R_MAX": 0.0, "PSC_ANGLE_MAX": 0.0}) == {}
    assert own_limits({"PSC_ANGLE_MAX": 20.0, "ANGLE_MAX": 3000.0})["lean"].parameter == "PSC_ANGLE_MAX"


def test_the_first_guess_takes_rates_and_the_acceleration_of_the_largest_lean():
    guess = first_guess(FASTBRIDGE, SINCE)
    assert guess.rates.max_rad_s == pytest.approx((10.0, 10.0, math.pi / 2))
    assert guess.velocities.deceleration_m_s2 == 2.0
    assert guess.velocities.max_down_m_s == 1.5
    flat = first_guess(FASTBRIDGE, SINCE | {"PSC_ANGLE_MAX": 10.0})
    assert flat.velocities.deceleration_m_s2 == pytest.approx(9.81 * math.tan(math.radians(10.0)))
    assert first_guess(FASTBRIDGE, {}).rates == FASTBRIDGE.rates
    assert first_guess(FASTBRIDGE, {"ATC_RATE_Y_MAX": 720.0}).rates == FASTBRIDGE.rates  # links send 4 rad/s


def test_rates_that_are_not_fed_forward_are_named():
    assert rate_notes(BEFORE) == rate_notes({"ATC_RATE_FF_ENAB": 1.0}) == []
    (line,) = rate_notes({"ATC_RATE_FF_ENAB": 0.0})
    assert line.startswith("ATC_RATE_FF_ENAB is 0")


def fast(vehicle=FASTBRIDGE, box=BOX, **limits):
    planned = plan_steps(vehicle, (0.5, 1.0), box, reserve_m=0.5, rates=True, **limits)
    return [step for step in planned.flown if step.is_fast], planned.skipped


@pytest.mark.parametrize("tau", [0.005, 0.04, 0.2])
def test_a_fast_doublet_settles_before_its_lean_is_reached(tau):
    rates = msgspec.structs.replace(FASTBRIDGE.rates, time_constant_s=tau)
    steps, _ = fast(msgspec.structs.replace(FASTBRIDGE, rates=rates), lean_rad=0.5)
    tilting = [step for step in steps if step.axis != 2]
    for step in tilting:
        assert abs(step.size) * step.out_s <= LEAN_RAD + 1e-9
        assert step.out_s > 4 * tau
        assert step.back == -1.0
    assert {step.axis for step in steps} == (
        {0, 1, 2} if tau < 0.1 else {2}
    )  # else no faster than a slow one


def test_a_small_lean_limit_of_the_vehicle_makes_them_slower():
    steps, _ = fast(lean_rad=math.radians(15.0))
    assert all(
        abs(step.size) * step.out_s <= 0.8 * math.radians(15.0) + 1e-9 for step in steps if step.axis != 2
    )


def test_a_turn_lasts_until_it_is_reached_and_does_not_reverse():
    (turn, *_) = [step for step in fast(turns_rad_s2=2.0)[0] if step.axis == 2]
    assert turn.size == 4.0
    assert turn.out_s > 4.0 / 2.0
    assert turn.back == 0.0


def test_a_box_too_small_for_the_stop_after_a_lean_leaves_it_out():
    slow = msgspec.structs.replace(FASTBRIDGE.following, horizontal_lag=(2.0, 0.5))
    vehicle = msgspec.structs.replace(FASTBRIDGE, velocities=slow)
    steps, skipped = fast(vehicle, box=(-2.0, -9, 0, 2.0, 9, 8))
    assert {step.axis for step in steps} == {2}
    assert any(words.startswith("roll rate of") and "it needs" in words for words in skipped)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("wild", [1.0, 2.5])
def test_a_vehicle_that_rotates_faster_than_asked_never_leans_more_than_stated(axis, wild):
    """Kinematics with a lag, `wild` times as fast as the set-points, both ways."""
    steps = [step for step in fast()[0] if step.axis == axis]
    flight = StepFlight(
        steps, np.zeros(3), np.full(3, 5.0), lag_s=0.5, stop_m=lambda speed, along: 1.0, gravity_m_s2=9.81
    )
    flight.pause(0.0)
    lean = rate = largest = 0.0
    for tick in range(1000):
        attitude = np.array([math.cos(lean / 2), *(math.sin(lean / 2) * np.eye(3)[axis])])
        state = VehicleState(0.01 * tick, steps[0].start, np.zeros(3), attitude, np.zeros(3), 0.01)
        setpoint = flight.decide(state, 0.01, flight.target()).setpoint
        if flight.is_over:
            break
        wanted = wild * setpoint.omega[axis] if isinstance(setpoint, RatesSetpoint) else -2.0 * lean
        rate += 0.01 / 0.04 * (wanted - rate)
        lean += 0.01 * rate
        largest = max(largest, abs(lean))
    assert flight.is_over
    assert largest < MAX_LEAN_RAD
    assert largest > 0.25
