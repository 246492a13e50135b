"""The vehicle's own checks before arming are part of the checks before a flight, and of a dry run."""

import pytest

from alula.stages.flight.links.mavlink.autopilots import ARDUPILOT, PX4
from alula.stages.flight.links.mavlink.telemetry import Telemetry
from alula.stages.flight.loop.supervisor import Event, State
from alula.stages.sim_vehicle.common.packets import mavlink
from alula.stages.sim_vehicle.common.pilot import Pilot
from support.flights.flights import mission
from support.scenes.small_scenes import line_plan
from support.vehicles.lockstep import Flight, Upset, fault

PREARM = mavlink.MAV_SYS_STATUS_PREARM_CHECK


def checked(*upsets, **words):
    made = mission(plan=line_plan((0.3, 2.0, 0.5), (2.7, 2.0, 0.5), 3.5), rate_hz=50.0)
    return Flight(made, list(upsets), loop_words={"dry_run": True, **words})


def test_a_dry_run_says_why_the_vehicle_refuses():
    flight = checked(Upset(None, 0.0, fault("radio-loss"))).fly()
    assert flight.cause is Event.CHECK_FAILED
    assert "arming: the vehicle refuses: RC not found" in flight.loop.checks.failure()
    assert flight.loop.checks.is_of_link


def test_a_refusal_that_passes_is_waited_for():
    flight = checked(Upset(None, 0.0, fault("radio-loss", duration=4.0)), Upset(State.CHECKS, 9.0, _never))
    flight.fly()
    assert flight.cause is Event.CHECKS_PASSED_DRY
    assert any("waiting for arming" in words for _, words in flight.recorder.lines)


def _never(flight):
    pytest.fail("the checks took too long")


def test_without_checks_of_its_own_nothing_is_required():
    def unchecked(message):
        message.onboard_control_sensors_enabled &= ~PREARM
        message.onboard_control_sensors_health &= ~PREARM

    flight = checked()
    flight.changes["SYS_STATUS"] = unchecked
    flight.fly()
    assert flight.cause is Event.CHECKS_PASSED_DRY


def status(enabled, healthy):
    return mavlink.MAVLink_sys_status_message(PREARM, enabled, healthy, 0, 12000, 0, 90, 0, 0, 0, 0, 0, 0)


def text(words):
    return mavlink.MAVLink_statustext_message(2, words.encode().ljust(50, b"\0"), 0, 0)


def test_the_bit_and_the_texts_are_read():
    telemetry = Telemetry()
    telemetry.autopilot = ARDUPILOT
    assert telemetry.status.can_arm is None
    telemetry.take(status(PREARM, 0), 1.0)
    assert (telemetry.status.can_arm, telemetry.status.arming) == (False, "")
    telemetry.take(text("PreArm: RC not found"), 1.1)
    telemetry.take(text("PreArm: GPS 1: Bad fix"), 1.1)
    telemetry.take(text("PreArm: RC not found"), 30.0)
    assert telemetry.status.arming == "RC not found; GPS 1: Bad fix"
    telemetry.take(status(PREARM, 0), 40.0)
    assert telemetry.status.arming == "RC not found"
    telemetry.take(status(PREARM, PREARM), 41.0)
    assert (telemetry.status.can_arm, telemetry.status.arming) == (True, "")
    telemetry.take(status(0, 0), 42.0)
    assert telemetry.status.can_arm is None


def test_the_bit_of_px4_depends_on_its_mode_and_is_not_read():
    telemetry = Telemetry()
    telemetry.autopilot = PX4
    telemetry.take(status(PREARM, 0), 1.0)
    assert telemetry.status.can_arm is None


def test_a_radio_that_was_lost_was_found_before():
    pilot = Pilot({})
    pilot.is_lost = True
    pilot.attend(landed=True)
    assert not pilot.was_seen
    pilot.is_lost = False
    pilot.attend(landed=True)
    pilot.is_lost = True
    assert pilot.was_seen
