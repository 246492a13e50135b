"""Parameters that a flight relies on are watched: a change by another station lands the vehicle, by name."""

import pytest

from alula.stages.flight.links.mavlink.autopilots import ARDUPILOT, PX4
from alula.stages.flight.loop.supervisor import Event, State
from support.flights.flights import BALL, mission
from support.scenes.small_scenes import line_plan
from support.vehicles.lockstep import Flight, Upset, set_by_another


def flown(do, made=None):
    made = made or mission(plan=line_plan((0.3, 2.0, 0.5), (2.7, 2.0, 0.5), 5.0), rate_hz=50.0)
    flight = Flight(made, [Upset(State.FLY, 1.0, do)]).fly()
    flight.judge()
    return flight


def silently(name, value):
    """A script on the vehicle, or the knob of a pilot, changes it; nobody is told."""
    return lambda flight: flight.copter.parameters.set(name, value)


@pytest.mark.every(4)
@pytest.mark.parametrize("how", [set_by_another, silently])
@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("GUID_OPTIONS", 0.0, "GUID_OPTIONS is 0, not 8"),
        ("GUID_TIMEOUT", 3.0, "GUID_TIMEOUT is 3, not 0.3"),
        ("FS_EKF_ACTION", 0.0, "FS_EKF_ACTION is 0, not 1"),
        ("WPNAV_ACCEL", 125.0, "WPNAV_ACCEL is 125, not 250"),  # it stops half as fast
    ],
)
def test_a_changed_parameter_lands_it_and_is_named(how, name, value, words):
    flight = flown(how(name, value))
    assert flight.cause is Event.PARAMETER_CHANGED
    assert flight.loop.ending == f"parameter changed by another station ({words})"
    latest_s = 0.2 if how is set_by_another else 1.3
    assert flight.entered[State.LAND] - flight.entered[State.FLY] < 1.0 + latest_s
    assert not flight.copter.is_armed
    assert flight.copter.parameters[name] == value  # it stays as the other station wants it


def test_a_climb_rate_is_never_flown_for_a_thrust():
    made = mission("cone-backup", scene=BALL, is_clear=True, rate_hz=50.0)
    flight = flown(set_by_another("GUID_OPTIONS", 0.0), made)
    assert flight.cause is Event.PARAMETER_CHANGED


@pytest.mark.slow
def test_other_parameters_are_the_business_of_others():
    flight = flown(set_by_another("RTL_ALT", 900.0))
    assert flight.cause is Event.PLAN_FINISHED


@pytest.mark.parametrize("autopilot", [ARDUPILOT, PX4])
def test_all_that_is_set_is_watched(autopilot):
    names = autopilot.relied_on
    assert {each.name for each in autopilot.parameters} <= set(names)
    assert len(set(names)) == len(names)
