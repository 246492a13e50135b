"""The vehicle's own failsafes in flight: they end it by their name, and are not taken for the pilot."""

import pytest

from alula.stages.flight.links.mavlink.telemetry import Telemetry
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.sim_vehicle.common.packets import mavlink
from support.flights.flights import mission
from support.scenes.small_scenes import line_plan
from support.vehicles.lockstep import Flight, Upset, fault

START, GOAL = (0.3, 2.0, 0.5), (2.7, 2.0, 0.5)
AT_ONCE = {"BATT_LOW_TIMER": 0.0}


def flat(flight):
    """The battery's voltage falls below the threshold."""
    flight.copter.parameters.set("BATT_LOW_VOLT", 13.0)


def flown(parameters, *dos):
    made = mission(plan=line_plan(START, GOAL, 3.5), rate_hz=50.0)
    upsets = [Upset(State.FLY, 0.3 + 1.4 * i, do) for i, do in enumerate(dos)]
    upsets += [Upset(State.HAND_OVER, 0.5, lambda flight: setattr(flight, "interrupts", 1))]
    flight = Flight(made, upsets, {"failsafe_s": 3.0}, AT_ONCE | parameters).fly()
    flight.judge()
    return flight


@pytest.mark.parametrize(
    ("parameters", "do", "mode", "cause"),
    [
        ({"BATT_FS_LOW_ACT": 1}, flat, "LAND", "Battery Failsafe; Battery 1 is low"),
        ({"BATT_FS_LOW_ACT": 2}, flat, "RTL", "Battery Failsafe; Battery 1 is low"),
        ({"FS_THR_ENABLE": 1}, fault("radio-loss"), "RTL", "Radio Failsafe"),
    ],
)
def test_a_failsafe_of_the_vehicle_is_named_with_its_cause(parameters, do, mode, cause):
    flight = flown(parameters, do)
    assert flight.cause is Event.FAILSAFE
    assert (State.FLY, Event.FAILSAFE) in flight.rows
    assert flight.link.status.mode == mode
    assert flight.loop.ending.startswith(f"vehicle's own failsafe ({cause}")


def test_a_pilot_who_switches_during_a_failsafe_without_action_is_the_pilot():
    flight = flown({"BATT_FS_LOW_ACT": 0}, flat, fault("mode", amount=5))
    assert flight.cause is Event.MODE_CHANGED
    assert flight.loop.ending == "mode changed by the pilot"


def test_a_second_failsafe_acts_after_one_without_action():
    flight = flown({"BATT_FS_LOW_ACT": 0, "FS_THR_ENABLE": 3}, flat, fault("radio-loss"))
    assert flight.cause is Event.FAILSAFE
    assert "Radio Failsafe" in flight.loop.ending


def test_a_failsafe_without_action_is_reported_as_critical():
    made = mission(plan=line_plan(START, GOAL, 3.5), rate_hz=50.0)
    flight = Flight(made, [Upset(State.FLY, 0.3, flat)], {}, AT_ONCE).fly()
    assert flight.cause is Event.FAILSAFE_IDLE
    assert flight.loop.ending.startswith("failsafe without any action (Battery Failsafe; Battery 1 is low")


TEXTS = [  # as ArduPilot and PX4 send them, and the cause after them
    (["Radio Failsafe"], "Radio Failsafe"),
    (["Radio Failsafe", "Radio Failsafe Cleared"], ""),
    (
        ["EKF variance", "EKF Failsafe: changed to LAND Mode"],
        "EKF Failsafe: changed to LAND Mode; EKF variance",
    ),
    (["PreArm: Battery 1 low voltage failsafe"], ""),
    (["Arm: Radio failsafe on"], ""),
    (["Failsafe activated: no offboard signal"], "Failsafe activated: no offboard signal"),
    (["Crash: Disarming: AngErr=90>30, Accel=0.0<3.0"], "Crash: Disarming: AngErr=90>30, Accel=0.0<3.0"),
    (["EKF3 IMU0 is using GPS"], ""),
]


@pytest.mark.parametrize(("texts", "cause"), TEXTS)
def test_texts_name_the_cause(texts, cause):
    telemetry = Telemetry()
    for text in texts:
        telemetry.take(mavlink.MAVLink_statustext_message(4, text.encode().ljust(50, b"\0"), 0, 0), 1.0)
    assert telemetry.status.failsafe == cause
