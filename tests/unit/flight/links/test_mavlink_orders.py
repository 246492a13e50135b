"""Commands and parameters over the MAVLink link: repeated, refused, verified, restored."""

from __future__ import annotations

import numpy as np
import pytest

from alula.schemas.errors import LinkError, UsageError
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order
from alula.stages.vehicles.setpoints import RatesSetpoint, VelocitySetpoint
from support.vehicles.mavlink_peer import ARDUPILOT, FRAME, PX4, Peer, m, vehicle


def test_px4_has_its_own_parameters_bit_by_bit_and_its_own_modes():
    peer = Peer(autopilot=m.MAV_AUTOPILOT_PX4)
    with vehicle(peer=peer) as (peer, time, link):
        assert {name: round(value, 3) for name, (value, _) in peer.parameters.items()} == {
            "COM_OF_LOSS_T": 0.3,
            "COM_OBL_RC_ACT": 4,
            "COM_RCL_EXCEPT": 4,
            "COM_RC_OVERRIDE": 3,
            "MPC_THR_HOVER": 0.5,
        }
        link.order(Order.TAKE_CONTROL, time())  # at once: it must wait until enough has been streamed
        time.run(link, 1.05)
        assert not peer.commands(m.MAV_CMD_DO_SET_MODE)
        stream = peer.of("SET_POSITION_TARGET_LOCAL_NED")
        assert len(stream) >= 15
        assert {e.type_mask for e in stream} == {0b1101_1100_0111}
        time.run(link, 0.3)
        (mode,) = peer.commands(m.MAV_CMD_DO_SET_MODE)
        assert (mode.param1, mode.param2) == (1, 6)
        assert link.status.obeys
        assert link.status.mode == "OFFBOARD"
        peer.send_state((3, 4, -1))
        time.run(link, 0.02)
        link.order(Order.TAKE_OFF, time(), 1.5)
        time.run(link, 0.1)
        climb = peer.of("SET_POSITION_TARGET_LOCAL_NED")[-1]
        assert (climb.x, climb.y, climb.z) == pytest.approx((3, 4, -2.5), abs=1e-5)
        link.send(RatesSetpoint(9.81, np.zeros(3)), time())
        time.sleep(0.01)
        assert peer.of("SET_ATTITUDE_TARGET")[-1].thrust == pytest.approx(0.5)
        link.order(Order.LAND, time())
        time.run(link, 0.2)
        assert link.status.mode == "AUTO.LAND"
        assert not link.status.obeys
    assert peer.parameters == PX4


def test_px4_that_has_heard_set_points_for_long_enough_is_asked_at_once():
    with vehicle(peer=Peer(autopilot=m.MAV_AUTOPILOT_PX4)) as (peer, time, link):
        time.run(link, 2.0)
        assert len(peer.of("SET_POSITION_TARGET_LOCAL_NED")) > 30
        link.order(Order.ARM, time())
        time.run(link, 0.1)
        assert link.status.obeys
        assert link.status.armed


def test_arming_takes_control_first_and_orders_end_when_done():
    with vehicle() as (peer, time, link):
        link.order(Order.ARM, time())
        time.run(link, 0.2)
        assert link.status.armed
        assert link.status.mode == "GUIDED"
        (arm,) = peer.commands(m.MAV_CMD_COMPONENT_ARM_DISARM)
        assert (arm.param1, arm.param2) == (1, 0)
        link.order(Order.TAKE_OFF, time(), 2.5)
        time.run(link, 3.0)
        (climb,) = peer.commands(m.MAV_CMD_NAV_TAKEOFF)
        assert climb.param7 == 2.5
        link.order(Order.LAND, time())
        time.run(link, 3.0)
        assert link.status.mode == "LAND"
        assert len(peer.commands(m.MAV_CMD_DO_SET_MODE)) == 2
        assert not link.status.refusals


def test_a_refused_order_has_the_vehicles_own_reason():
    with vehicle() as (peer, time, link):
        peer.results[m.MAV_CMD_COMPONENT_ARM_DISARM] = m.MAV_RESULT_FAILED
        peer.send(m.MAVLink_statustext_message(2, b"Arm: Need Position Estimate"))
        time.run(link, 0.05)
        link.order(Order.ARM, time())
        time.run(link, 0.3)
        assert link.status.refusals == [(Order.ARM, "failed; Arm: Need Position Estimate")]
        assert "Arm: Need Position Estimate" in link.status.texts


def test_an_order_without_an_answer_is_repeated_then_reported_and_land_goes_on():
    with vehicle() as (peer, time, link):
        peer.silent = True
        link.order(Order.TAKE_CONTROL, time())
        time.run(link, 7.0)
        assert 8 <= len(peer.commands(m.MAV_CMD_DO_SET_MODE)) <= 11
        assert [order for order, _ in link.status.refusals] == [Order.TAKE_CONTROL]
        peer.heard.clear()
        link.order(Order.LAND, time())
        time.run(link, 20.0)
        assert len(peer.commands(m.MAV_CMD_DO_SET_MODE)) >= 38
        assert [order for order, _ in link.status.refusals] == [Order.TAKE_CONTROL, Order.LAND]


def test_a_pilot_who_takes_over_keeps_control():
    with vehicle() as (peer, time, link):
        link.order(Order.ARM, time())
        time.run(link, 0.2)
        link.order(Order.HOLD, time())
        peer.custom_mode = 5
        peer.beat()
        before = len(peer.commands(m.MAV_CMD_DO_SET_MODE))
        time.run(link, 5.0)
        assert not link.status.obeys
        assert link.status.mode == "LOITER"
        assert len(peer.commands(m.MAV_CMD_DO_SET_MODE)) == before


@pytest.mark.parametrize("order", [Order.LAND, Order.TAKE_CONTROL, Order.ARM])
def test_a_repeat_that_is_due_when_the_pilot_switches_does_not_go_out(order):
    with vehicle() as (peer, time, link):
        peer.takes_modes = False
        link.order(order, time())
        time.run(link, 0.2)
        before = len(peer.commands(m.MAV_CMD_DO_SET_MODE))
        assert before == 1
        peer.custom_mode = 5
        peer.beat()
        time.sleep(2.0)  # one poll receives the new mode and is due to repeat the command
        link.poll(time())
        time.run(link, 3.0)
        assert link.status.mode == "LOITER"
        assert len(peer.commands(m.MAV_CMD_DO_SET_MODE)) == before


def test_holding_streams_zero_velocity_until_something_else_is_told():
    with vehicle() as (peer, time, link):
        link.order(Order.HOLD, time())
        time.run(link, 1.0)
        stream = peer.of("SET_POSITION_TARGET_LOCAL_NED")
        assert 15 <= len(stream) <= 21
        assert {(e.type_mask, e.vx, e.vy, e.vz) for e in stream} == {(0b1101_1100_0111, 0, 0, 0)}
        link.order(Order.NOTHING, time())
        peer.heard.clear()
        time.run(link, 1.0)
        assert not peer.of("SET_POSITION_TARGET_LOCAL_NED")


def test_motors_stop_on_the_ground_only():
    with vehicle() as (peer, time, link):
        peer.armed, peer.landed = True, m.MAV_LANDED_STATE_IN_AIR
        time.run(link, 1.1)
        link.order(Order.DISARM, time())
        time.run(link, 0.5)
        assert link.status.refusals.pop()[0] is Order.DISARM
        assert not peer.commands(m.MAV_CMD_COMPONENT_ARM_DISARM)
        peer.landed = m.MAV_LANDED_STATE_ON_GROUND
        time.run(link, 1.1)
        link.order(Order.DISARM, time())
        time.run(link, 0.5)
        (command,) = peer.commands(m.MAV_CMD_COMPONENT_ARM_DISARM)
        assert (command.param1, command.param2) == (0, 0)


@pytest.mark.parametrize(("before", "meant"), [(0.0, 10.0), (30.0, 10.0), (5.0, 5.0)])
def test_a_landing_vehicle_leans_less_until_the_end(before, meant):
    peer = Peer()
    peer.parameters["PSC_ANGLE_MAX"] = (before, m.MAV_PARAM_TYPE_REAL32)
    with vehicle(peer=peer) as (peer, time, link):
        peer.deaf_to.add("PSC_ANGLE_MAX")
        link.order(Order.LAND, time())
        link.order(Order.SETTLE, time())
        time.run(link, 2.0)
        assert link.status.mode == "LAND"  # the order before is not cancelled
        peer.deaf_to.clear()
        time.run(link, 1.0)
        assert peer.parameters["PSC_ANGLE_MAX"][0] == meant
        sent = [e for e in peer.of("PARAM_SET") if e.param_id == "PSC_ANGLE_MAX"]
        assert len(sent) <= 6
        time.run(link, 2.0)  # once confirmed it is not sent any more
        assert len([e for e in peer.of("PARAM_SET") if e.param_id == "PSC_ANGLE_MAX"]) == len(sent)
        assert not link.status.changed
    assert peer.parameters["PSC_ANGLE_MAX"][0] == before


def test_a_vehicle_without_such_a_limit_is_left_alone():
    with vehicle() as (peer, time, link):
        before = len(peer.of("PARAM_SET"))
        link.order(Order.SETTLE, time())
        time.run(link, 2.0)
        assert len(peer.of("PARAM_SET")) == before


def test_guided_without_position_takes_rates_alone():
    with vehicle(address="?mode=guided_nogps") as (_, time, link):
        assert link.accepts == {RatesSetpoint}
        with pytest.raises(LinkError, match="takes no VelocitySetpoint"):
            link.send(VelocitySetpoint(np.zeros(3), 0.0), time())
        link.order(Order.TAKE_CONTROL, time())
        time.run(link, 0.2)
        assert link.status.mode == "GUIDED_NOGPS"
        assert link.status.obeys
    with pytest.raises(UsageError, match="must be guided"):
        open_link("udpout:127.0.0.1:1?mode=rtl")


def test_parameters_are_set_verified_and_put_back():
    with vehicle() as (peer, _, _):
        assert {name: peer.parameters[name][0] for name in ARDUPILOT} == {
            "GUID_OPTIONS": 9,
            "ATC_ANGLE_BOOST": 0,
            "GUID_TIMEOUT": pytest.approx(0.3),
            "FS_GCS_ENABLE": 5,
            "MOT_THST_HOVER": 0.35,
            "SYSID_MYGCS": 255,
        }
    assert peer.parameters == ARDUPILOT
    assert "ARMING_CHECK" not in {e.param_id for e in peer.of("PARAM_SET")}


@pytest.mark.parametrize("name", ["ATC_ACCEL_{}_MAX", "ATC_ACC_{}_MAX"])  # before 4.7, and since
def test_a_parameter_is_set_and_put_back_under_the_name_that_the_vehicle_has(name):
    peer = Peer()
    peer.parameters["FS_GCS_TIMEOUT"] = (5.0, m.MAV_PARAM_TYPE_REAL32)
    accelerations = {name.format(axis): (1100.0, m.MAV_PARAM_TYPE_REAL32) for axis in "RP"}
    peer.parameters |= accelerations
    before = dict(peer.parameters)
    with vehicle(peer=peer, ready=False, flies_rates=True) as (peer, _, link):
        lines = link.prepare()
        assert [line.split(":")[0] for line in lines[-2:]] == list(accelerations)
        assert [peer.parameters[each][0] for each in accelerations] == [0.0, 0.0]
    assert peer.parameters == before


def test_parameters_of_a_vehicle_that_somebody_flies_are_not_touched():
    peer = Peer()
    peer.armed, peer.landed = True, m.MAV_LANDED_STATE_IN_AIR
    with vehicle(peer=peer, ready=False) as (peer, _, link):
        with pytest.raises(LinkError, match="armed"):
            link.prepare()
        assert not peer.of("PARAM_SET")
        assert not peer.of("SET_POSITION_TARGET_LOCAL_NED")


def test_lines_tell_of_what_changed_only():
    peer = Peer()
    peer.parameters["GUID_OPTIONS"] = (8.0, 6)
    peer.parameters["SYSID_MYGCS"] = (252.0, 4)
    with vehicle(peer=peer, ready=False) as (peer, _, link):
        lines = link.prepare()
        assert [line.split(":")[0] for line in lines] == [
            "ATC_ANGLE_BOOST",
            "GUID_TIMEOUT",
            "FS_GCS_ENABLE",
            "SYSID_MYGCS is 252",
        ]


@pytest.mark.parametrize("name", ["GUID_OPTIONS", "ATC_ANGLE_BOOST", "GUID_TIMEOUT", "FS_GCS_ENABLE"])
@pytest.mark.parametrize("failure", ["absent", "refused"])
def test_a_failure_on_the_way_puts_back_what_was_changed_before(name, failure):
    peer = Peer()
    if failure == "absent":
        del peer.parameters[name]
    else:
        peer.deaf_to.add(name)
    before = dict(peer.parameters)
    with pytest.raises(LinkError, match=name), vehicle(peer=peer):
        pass
    assert peer.parameters == before


def test_an_interrupt_while_preparing_puts_back_too():
    with vehicle(ready=False) as (peer, time, link):
        sleep, count = time.sleep, 0

        def interrupted(seconds):
            nonlocal count
            count += 1
            if count == 5:
                raise KeyboardInterrupt
            sleep(seconds)

        link._session.options = LinkOptions(frame=FRAME, clock=time, sleep=interrupted)
        with pytest.raises(KeyboardInterrupt):
            link.prepare()
        assert peer.of("PARAM_SET")
        assert peer.parameters == ARDUPILOT


def test_what_others_changed_meanwhile_stays():
    with vehicle() as (peer, time, link):
        peer.parameters["GUID_TIMEOUT"] = (1.0, 9)
        peer.say_parameter("GUID_TIMEOUT")
        time.run(link, 0.1)
        link.close()
        assert peer.parameters["GUID_TIMEOUT"][0] == 1.0
        assert peer.parameters["GUID_OPTIONS"] == ARDUPILOT["GUID_OPTIONS"]
        assert any("GUID_TIMEOUT was changed by others" in text for text in link.status.texts)


def test_a_vehicle_that_does_not_answer_any_more_is_left_in_time_and_named():
    with vehicle() as (peer, time, link):
        peer.silent = True
        before = time()
        link.close()
        assert time() - before < 6
        assert sum("could not be put back" in text for text in link.status.texts) == 4


@pytest.mark.parametrize(("landed", "is_kept"), [(m.MAV_LANDED_STATE_IN_AIR, True), (1, False)])
def test_what_lands_a_vehicle_that_nobody_flies_stays_with_it(landed, is_kept):
    with vehicle() as (peer, time, link):
        link.order(Order.ARM, time())
        peer.landed = landed
        time.run(link, 1.5)
        assert link.status.obeys
        assert link.status.armed
        link.close()
        assert (peer.parameters["FS_GCS_ENABLE"][0] == 5) == is_kept
        assert ("FS_GCS_ENABLE stays 5; it was 0" in link.status.texts) == is_kept


def test_of_a_line_that_is_gone_each_parameter_is_named(monkeypatch):
    with vehicle() as (_, _, link):

        def gone(message):
            raise LinkError("the vehicle's line is gone: unplugged")

        monkeypatch.setattr(link._session, "send", gone)
        link.close()
        names = [text.split()[0] for text in link.status.texts if "could not be put back: set it to" in text]
        assert sorted(names) == ["ATC_ANGLE_BOOST", "FS_GCS_ENABLE", "GUID_OPTIONS", "GUID_TIMEOUT"]
