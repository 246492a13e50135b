"""Crashes: no thrust is commanded on the ground or upside down, and the motors stop where that is right."""

import dataclasses
import math

import msgspec
import numpy as np
import pytest

from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.flight.links.protocol import Order, VehicleState
from alula.stages.flight.loop.crash_watch import CrashWatch
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.sim_vehicle.common.packets import mavlink
from support.flights.flights import mission
from support.scenes.small_scenes import line_plan
from support.vehicles.lockstep import Flight, Upset, blow, fault, topple

START, GOAL = (0.3, 2.0, 0.5), (2.7, 2.0, 0.5)
JUMPS = {"jump_m": 9.0}  # the vehicle is moved by hand


def flown(do, state=State.FLY, after=1.0, height_m=0.5, **parameters):
    ends = [(x, y, height_m) for x, y, _ in (START, GOAL)]
    made = mission(plan=line_plan(*ends, 3.5), rate_hz=50.0)
    flight = Flight(made, [Upset(state, after, do)], JUMPS, parameters).fly()
    flight.fallen_s = flight.entered[state] + after
    return flight


def thrust_until(flight):
    """When the last set-point reached the vehicle, after the crash [s]."""
    return max(at for at, m in flight.packets() if m.get_type().startswith("SET_")) - flight.fallen_s


@pytest.mark.every(6)
@pytest.mark.parametrize("tilt", [math.pi, 1.8, -1.2])
@pytest.mark.parametrize("check", [0.0, 1.0])
def test_a_vehicle_that_lies_on_the_ground_is_stopped_by_force(tilt, check):
    flight = flown(topple(tilt, falls=True), FS_CRASH_CHECK=check)
    assert Event.CRASHED in {event for _, event in flight.rows}
    assert thrust_until(flight) < 2.0
    assert not flight.copter.is_armed
    assert flight.loop.ending.startswith(("crashed (tilted", "upside down (tilted"))
    forced = [m for _, m in flight.packets() if m.get_type() == "COMMAND_LONG" and m.param2 == 21196]
    assert {(m.command, m.param1) for m in forced} == {(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)}


@pytest.mark.slow
def test_a_vehicle_that_is_upside_down_in_the_air_levels_itself_out_and_lands():
    flight = flown(topple(seconds=0.4), height_m=8.0)
    assert flight.cause is Event.TURNED_OVER
    assert thrust_until(flight) < 0.5
    assert not flight.copter.airframe.is_lying
    assert not [m for _, m in flight.packets() if m.get_type() == "COMMAND_LONG" and m.param2 == 21196]


def test_a_vehicle_that_fell_to_the_ground_gets_no_more_thrust():
    flight = flown(fault("rotors"))
    assert flight.cause in (Event.FALLEN, Event.FALLBACK_LONG)
    assert flight.cause is Event.FALLEN
    assert thrust_until(flight) < 2.5
    assert not flight.copter.is_armed
    assert "below its plan" in flight.loop.ending


def test_a_crash_that_the_vehicle_finds_first_is_named():
    def crash(flight):
        flight.copter.say(0, "Crash: Disarming: AngErr=90>30, Accel=0.0<3.0")
        flight.copter.disarm(forced=True)

    flight = flown(crash)
    assert flight.cause is Event.DISARMED
    assert flight.loop.ending == "disarmed (Crash: Disarming: AngErr=90>30, Accel=0.0<3.0)"


@pytest.mark.slow
def test_a_crash_in_the_landing_after_the_plan_is_no_success():
    flight = flown(topple(1.2, falls=True), State.LAND, 0.1, FS_CRASH_CHECK=0.0)
    assert (State.FLY, Event.PLAN_FINISHED) in flight.rows
    assert flight.cause is Event.CRASHED
    assert not flight.copter.is_armed


@pytest.mark.slow
@pytest.mark.parametrize("start_deg", [0.0, 6.0])
def test_a_vehicle_that_leans_into_the_wind_on_the_ground_is_made_to_notice_it(monkeypatch, start_deg):
    disturbance = msgspec.structs.replace(FASTBRIDGE.disturbance, linear_drag_n_s_m=(0.25,) * 3)
    windy = msgspec.structs.replace(FASTBRIDGE, disturbance=disturbance)
    monkeypatch.setattr("support.vehicles.served_autopilot.FASTBRIDGE", windy)
    gale = Upset(State.LAND, 0.1, blow(8.0, 0.0, 0.0))
    made = mission(plan=line_plan(START, GOAL, 3.5), rate_hz=50.0)
    flight = Flight(made, [gale], {"landed_m": 3.0}, {"PSC_ANGLE_MAX": start_deg})
    most_deg = []
    flight.each = lambda flight: most_deg.append(flight.copter.parameters["PSC_ANGLE_MAX"])
    flight.fly()
    assert flight.cause is Event.PLAN_FINISHED
    assert not flight.copter.is_armed
    assert flight.time() - flight.entered[State.LAND] < 10.0
    assert max(most_deg) == (start_deg or 10.0)  # a smaller limit of the user's stays
    assert flight.copter.parameters["PSC_ANGLE_MAX"] == start_deg  # it is put back
    assert not [m for _, m in flight.packets() if m.get_type() == "COMMAND_LONG" and m.param2 == 21196]


def state(at, up=0.0, speed=0.0, height=0.0):
    """A state tilted by an angle about x."""
    quat = np.array([math.cos(up / 2), math.sin(up / 2), 0.0, 0.0])
    return VehicleState(at, np.array([0.0, 0.0, height]), np.array([speed, 0, 0]), quat, np.zeros(3))


@pytest.mark.parametrize(
    ("tilt", "speed", "height", "plan", "seconds", "found"),
    [
        (0.0, 0.0, 1.0, 0.0, 9.0, ()),
        (1.2, 3.0, 1.0, 0.0, 9.0, ()),  # it flies fast
        (1.6, 3.0, 1.0, 0.0, 0.15, ()),
        (1.6, 3.0, 1.0, 0.0, 0.25, ("is_over",)),
        (1.2, 0.1, 1.0, 0.0, 0.9, ()),
        (1.2, 0.1, 1.0, 0.0, 1.1, ("is_lying",)),
        (0.1, 0.1, 0.1, 0.3, 9.0, ()),  # the plan is low
        (0.1, 0.1, 0.1, 0.5, 0.4, ()),
        (0.1, 0.1, 0.1, 0.5, 0.6, ("is_down",)),
        (0.1, 0.1, 0.1, -math.inf, 9.0, ()),  # in a landing
        (0.1, 0.1, math.nan, math.nan, 9.0, ()),
        (math.nan, math.nan, 0.1, 0.5, 9.0, ()),
    ],
)
def test_the_watch_needs_time_and_all_signs(tilt, speed, height, plan, seconds, found):
    watch = CrashWatch()
    for tenth in range(round(20 * seconds) + 1):
        watch.update(state(0.05 * tenth, tilt, speed), height, plan)
    assert tuple(name for name in ("is_over", "is_lying", "is_down") if getattr(watch, name)) == found
    assert bool(watch.words) == bool(found)


def landed(watch, seconds, height=0.0, climb=0.0, speed=0.0, begin=0.0, is_landing=True):
    for i in range(round(20 * seconds) + 1):
        z = height + 0.05 * climb * i
        watch.update(state(begin + 0.05 * i, 0.0, speed, z), z, -math.inf, is_landing=is_landing)
    return watch


@pytest.mark.parametrize(
    ("seconds", "words", "is_still"),
    [
        (2.9, {}, False),
        (3.1, {}, True),
        (3.1, {"height": 2.0}, True),  # on a table: its height above the take-off does not matter
        (60.0, {"climb": -0.3}, False),  # the slowest landing
        (60.0, {"climb": 0.3}, False),
        (60.0, {"speed": 0.6}, False),
        (60.0, {"is_landing": False}, False),
        (60.0, {"height": math.nan}, False),
    ],
)
def test_a_landing_that_does_not_descend_is_still(seconds, words, is_still):
    watch = landed(CrashWatch(), seconds, **words)
    assert watch.is_still is is_still
    assert not watch.is_lying  # nothing crashed: its motors are not stopped by force


@pytest.mark.parametrize(
    ("seconds", "words", "is_lying"),
    [
        (9.9, {}, False),
        (10.1, {}, True),
        (60.0, {"height": 0.6}, False),  # it may hang in something
        (60.0, {"climb": -0.3}, False),
        (60.0, {"speed": 0.6}, False),
        (60.0, {"is_landing": False}, False),
    ],
)
def test_what_lies_still_after_a_crash_is_stopped(seconds, words, is_lying):
    watch = CrashWatch()
    for i in range(6):
        watch.update(state(0.05 * i, 3.0, 2.0), 1.0, 0.0)
    assert watch.is_over
    landed(watch, seconds, begin=1.0, **words)
    assert watch.is_lying is is_lying
    assert ("after a crash" in watch.words) is is_lying


def test_a_time_without_states_is_no_rest():
    watch = CrashWatch()
    for at in (0.0, 4.0, 8.0):
        watch.update(state(at), 0.0, -math.inf, is_landing=True)
        assert not watch.is_still


def test_the_same_state_again_is_no_evidence():
    watch, first = CrashWatch(), state(0.0, 1.6)
    watch.update(first, 1.0, 0.0)
    watch.update(dataclasses.replace(first, received_s=0.1), 1.0, 0.0)
    for _ in range(100):
        watch.update(first, 1.0, 0.0)
    assert not watch.is_over


def test_the_order_to_stop_is_not_that_to_disarm():
    assert Order.STOP is not Order.DISARM
