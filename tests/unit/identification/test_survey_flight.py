"""Flights of steps on the simulated autopilot in lock-step, and a flight of a plan with what they found."""

import math

import numpy as np
import pytest

from alula.schemas.errors import UsageError
from alula.schemas.parameters.configs.identify import IdentifyConfig
from alula.schemas.scenarios.vehicle import FASTBRIDGE, VelocitiesTable, read_vehicle, vehicle_text
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.identification.fit import fit
from alula.stages.identification.result import disagreements, identified_vehicle
from alula.stages.identification.steps import LEAN_RAD
from alula.stages.identification.survey import make_survey
from alula.stages.sim_vehicle.ardupilot import attitude
from alula.stages.vehicles.velocity_lag import stop_time_s
from support.flights.flights import mission
from support.flights.survey_flights import BOX, Px4Survey, SurveyFlight
from support.scenes.small_scenes import box_cover, line_plan
from support.vehicles.autopilot_client import QUICK
from support.vehicles.lockstep import Flight, fault
from support.vehicles.responses import MEASURED


def written(flight):
    """Fit and file of a flight."""
    found = fit(flight.steps.tape.recording(), FASTBRIDGE.body.gravity_m_s2)
    return found, identified_vehicle(
        flight.survey.vehicle,
        found,
        flight.config.speeds_m_s,
        name="mine",
        autopilot=flight.said,
        date="today",
    )


@pytest.mark.slow
def test_steps_that_fit_are_flown_and_found():
    flight = SurveyFlight(speeds_m_s=(0.5, 1.0), box=(-2.7, -2.7, 0, 2.7, 2.7, 2.4)).fly()
    assert flight.loop.supervision.cause is Event.PLAN_FINISHED, flight.recorder.lines[-5:]
    assert [words.split(":")[0] for words in flight.survey.steps.skipped] == ["+z at 1 m/s", "-z at 1 m/s"]
    assert not flight.copter.is_armed
    found, vehicle = written(flight)
    assert found.vertical_lag is None
    assert vehicle.velocities.vertical_lag == VelocitiesTable().vertical_lag
    level = stop_time_s(vehicle.velocities.horizontal_lag, 1.0)
    assert level == pytest.approx(MEASURED["stop_1_s"], rel=0.1)
    assert disagreements(found, flight.survey.vehicle, flight.parameters) == []


@pytest.fixture(scope="module")
def flown():
    return SurveyFlight().fly()


@pytest.fixture(scope="module")
def identified(flown):
    return written(flown)


@pytest.mark.slow
def test_all_steps_are_flown_within_the_box_and_it_lands(flown):
    assert flown.loop.supervision.cause is Event.PLAN_FINISHED, flown.recorder.lines[-5:]
    assert flown.steps.is_over
    assert not flown.survey.steps.skipped
    assert not flown.copter.is_armed
    north, east, down = np.array(flown.truth)[:, 1:].T
    assert np.abs([north, east]).max() < BOX[3] - FASTBRIDGE.body.radius_m - flown.config.reserve_m + 0.3
    assert (-down).max() < BOX[5] - FASTBRIDGE.body.radius_m - flown.config.reserve_m + 0.3
    assert flown.copter.parameters["GUID_TIMEOUT"] == 3.0  # restored


@pytest.mark.slow
def test_the_law_has_the_times_that_were_measured_apart_from_it(identified):
    _, vehicle = identified
    for speed in (1.0, 2.0, 3.0):
        level = stop_time_s(vehicle.velocities.horizontal_lag, speed)
        assert level == pytest.approx(MEASURED[f"stop_{speed:g}_s"], rel=0.1)
    for speed in (1.0, 2.0):
        climb = stop_time_s(vehicle.velocities.vertical_lag, speed)
        assert climb == pytest.approx(MEASURED[f"stop_up_{speed:g}_s"], rel=0.1)


@pytest.mark.slow
def test_drag_and_hover_are_those_of_the_simulated_vehicle(flown, identified):
    found, vehicle = identified
    hover = flown.copter.parameters["MOT_THST_HOVER"]  # it learns
    assert found.hover_throttle.value == pytest.approx(hover, rel=0.05)
    for drag in found.drag_per_s:  # 0.242 and 0.034 or 0.051 times the speed
        assert 0.242 < drag.value < 0.242 + 0.051 * 2.0 + 0.05
    assert 0 < found.residual_m_s2 < 0.5
    assert vehicle.velocities.max_up_m_s == 2.5  # by WPNAV_SPEED_UP
    assert vehicle.disturbance.linear_drag_n_s_m == pytest.approx(
        [vehicle.body.mass_kg * each for each in vehicle.identified.drag_per_s], rel=1e-3
    )
    assert 1.5 < vehicle.velocities.deceleration_m_s2 < 2.5


@pytest.mark.slow
def test_a_wrong_first_guess_is_named(flown, identified):
    found, _ = identified
    assert [line.split(":")[0] for line in disagreements(found, flown.survey.vehicle, flown.parameters)] == [
        "fastest descent, by WPNAV_SPEED_DN"
    ]
    wrong = flown.parameters | {"MOT_THST_HOVER": 0.5, "WPNAV_ACCEL": 100.0}
    lines = disagreements(found, flown.survey.vehicle, wrong)
    assert any("hover throttle, by MOT_THST_HOVER" in line and "expected 0.5" in line for line in lines)
    assert any("WPNAV_ACCEL" in line for line in lines)


@pytest.mark.slow
def test_the_file_reads_as_it_was_written(identified, tmp_path):
    _, vehicle = identified
    path = tmp_path / "mine.toml"
    path.write_text(vehicle_text(vehicle, ["a comment"]))
    assert read_vehicle(path) == vehicle
    assert vehicle.identified.date == "today"
    low, high = vehicle.identified.horizontal_lag_interval[0]
    assert low < vehicle.velocities.horizontal_lag[0] < high


@pytest.mark.slow
def test_a_plan_flown_with_the_file_keeps_its_margin(identified):
    _, vehicle = identified
    made = mission(vehicle=vehicle, speed_m_s=1.5)
    level, _, climb = made.config.velocity_lag_s
    assert level == pytest.approx(1.25 * stop_time_s(vehicle.velocities.horizontal_lag, 1.5))
    assert climb == pytest.approx(1.25 * stop_time_s(vehicle.velocities.vertical_lag, 1.5))
    flight = Flight(made).fly()
    flight.judge()
    assert flight.cause is Event.PLAN_FINISHED, flight.recorder.lines[-5:]
    assert flight.clearance(State.FLY) > 0.8 * made.config.margin_m


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1.5, 3.0])
def test_a_plan_through_a_wall_ends_in_front_of_it_with_the_margin(identified, speed):
    _, vehicle = identified
    wall = box_cover([((80, -20, 0), (84, 40, 40))])
    through = line_plan((0.3, 1.0, 1.0), (12.0, 1.0, 1.0), 11.7 * 2.1875 / speed)  # top speed of a septic
    made = mission(cover=wall, plan=through, is_clear=True, vehicle=vehicle, speed_m_s=speed, max_time_s=14.0)
    flight = Flight(made).fly()
    assert flight.clearance(State.FLY, State.HOLD) > made.config.margin_m
    assert flight.path(State.FLY)[:, 1].max() > 7.5
    path = flight.path(State.FLY)
    speeds = np.linalg.norm(np.diff(path[:, 1:], axis=0), axis=1) / np.diff(path[:, 0])
    assert speeds.max() > 0.75 * speed


@pytest.mark.slow
def test_rates_are_found_in_spite_of_noise():
    flight = SurveyFlight(noise=QUICK, rates=True, speeds_m_s=(0.5, 1.0)).fly()
    assert flight.loop.supervision.cause is Event.PLAN_FINISHED, flight.recorder.lines[-5:]
    _, vehicle = written(flight)
    for name, time_s in zip(("roll", "pitch", "yaw"), vehicle.rates.axis_time_constant_s, strict=True):
        assert time_s == pytest.approx(MEASURED[f"{name}_s"], rel=0.1, abs=0.008)
    assert vehicle.identified.thrust_time_constant_s < 0.1
    turn = vehicle.identified.yaw_acceleration_rad_s2
    assert turn == pytest.approx(math.radians(flight.parameters["ATC_ACCEL_Y_MAX"] / 100), rel=0.05)
    for reached, step in zip(vehicle.identified.reached_rad_s, fast_steps(flight), strict=True):
        assert reached == pytest.approx(abs(step.size), rel=0.1)
    assert vehicle.rates.max_rad_s == FASTBRIDGE.rates.max_rad_s
    assert flight.largest_lean < LEAN_RAD + 0.1


def fast_steps(flight):
    """One fast step about each axis."""
    steps = [step for step in flight.survey.steps.flown if step.is_fast]
    return [next(step for step in steps if step.axis == axis) for axis in range(3)]


@pytest.mark.slow
def test_a_vehicle_that_turns_less_fast_than_its_file_says(monkeypatch):
    monkeypatch.setattr(attitude, "_DAMPING_PER_S", 7.0)  # 14.1 rad/s^2 of its rotors turn it by 2 rad/s
    flight = SurveyFlight(rates=True, speeds_m_s=(0.5, 1.0), parameters={"ATC_RATE_Y_MAX": 200.0}).fly()
    assert flight.loop.supervision.cause is Event.PLAN_FINISHED, flight.recorder.lines[-5:]
    found, vehicle = written(flight)
    assert vehicle.rates.max_rad_s[2] == pytest.approx(2.0, rel=0.1)
    assert vehicle.rates.max_rad_s[:2] == (10.0, 10.0)
    lines = disagreements(found, flight.survey.vehicle, flight.parameters)
    assert any(line.startswith("fastest yaw rate, by ATC_RATE_Y_MAX: measured 2") for line in lines)


@pytest.mark.slow
def test_px4_is_identified_too():
    flight = Px4Survey(speeds_m_s=(0.5, 1.0), box=(-3, -3, 0, 3, 3, 5)).fly()
    assert flight.loop.supervision.cause is Event.PLAN_FINISHED, flight.recorder.lines[-5:]
    found, vehicle = written(flight)
    assert flight.parameters == {}
    assert 0.2 < stop_time_s(vehicle.velocities.horizontal_lag, 1.0) < 0.6
    assert any("by the first guess" in line for line in disagreements(found, flight.survey.vehicle, {}))


@pytest.mark.slow
def test_a_gap_in_flight_repeats_the_step():
    """A hold of the supervisor ends the step; it begins again, and the fit takes both."""
    flight = SurveyFlight(speeds_m_s=(0.5, 1.0), box=(-4, -4, 0, 4, 4, 8))

    def each(flight):
        begun, freeze = [], fault("freeze", duration=0.4)
        decide = flight.steps.decide

        def watched(*seen):
            if len(flight.steps.tape.steps) == 3 and not begun:
                begun.append(True)
                freeze(flight)
            return decide(*seen)

        flight.steps.decide = watched

    flight.fly(each)
    assert flight.loop.supervision.cause is Event.PLAN_FINISHED, flight.recorder.lines[-5:]
    assert "hold" in flight.recorder.states
    flown = [step.name for step in flight.steps.tape.steps]
    assert len(flown) == len(flight.survey.steps.flown) + 1
    found, _ = written(flight)
    assert math.isfinite(found.horizontal_lag.a.value)
    assert not found.left_out


def test_a_box_that_is_too_small_is_refused():
    config = IdentifyConfig(box=(-1, -1, 0, 1, 1, 4), speeds_m_s=(1.0, 2.0))
    with pytest.raises(UsageError, match=r"too small.*it needs .* m, and the box has 0.7 m"):
        make_survey(config, FASTBRIDGE)
