"""COMMAND_ACKs: an answer to another ground station does not count."""

import itertools

import pytest

from alula.stages.flight.links.mavlink.orders import Addressee
from alula.stages.flight.links.protocol import Order
from support.vehicles.mavlink_peer import Peer, m, vehicle

OURS, OTHER, NOBODY = (255, 191), (255, 190), (0, 0)
TAKE_OFF = m.MAV_CMD_NAV_TAKEOFF


class Deaf(Peer):
    """Peer that does not answer take-offs by itself, and names the addressee if `names` is set."""

    names = NOBODY

    def command(self, message):
        if message.command == TAKE_OFF:
            return
        super().command(message)

    def send(self, message):
        if message.get_type() == "COMMAND_ACK":
            message.target_system, message.target_component = self.names
        super().send(message)

    def say(self, result, whom):
        super().send(m.MAVLink_command_ack_message(TAKE_OFF, result, 0, 0, *whom))


def answered(names, result, whom):
    """Effect of an answer to `whom` on a take-off: transmissions in 3 s, and refusals."""
    peer = Deaf()
    peer.names = names
    with vehicle(peer=peer) as (peer, time, link):
        link.order(Order.ARM, time())
        time.run(link, 0.2)
        assert link.status.armed
        link.order(Order.TAKE_OFF, time(), 2.0)
        time.run(link, 0.05)
        peer.say(result, whom)
        time.run(link, 3.0)
        return len(peer.commands(TAKE_OFF)), link.status.refusals


@pytest.mark.parametrize("names", [OURS, NOBODY], ids=["names us", "names nobody"])
@pytest.mark.parametrize("whom", [OTHER, (1, 191), (7, 0), (0, 190)])
def test_the_answer_to_another_is_none_to_us(names, whom):
    for result in (m.MAV_RESULT_ACCEPTED, m.MAV_RESULT_FAILED):
        sent, refusals = answered(names, result, whom)
        assert sent >= 6
        assert not refusals


@pytest.mark.parametrize(
    ("names", "whom"), [(OURS, OURS), (NOBODY, OURS), (NOBODY, NOBODY), (NOBODY, (255, 0))]
)
def test_ours_is(names, whom):
    assert answered(names, m.MAV_RESULT_ACCEPTED, whom) == (1, [])
    sent, refusals = answered(names, m.MAV_RESULT_FAILED, whom)
    assert (sent, [order for order, _ in refusals]) == (1, [Order.TAKE_OFF])


def test_who_names_us_once_is_held_to_it():
    sent, refusals = answered(OURS, m.MAV_RESULT_ACCEPTED, NOBODY)
    assert sent >= 6
    assert not refusals


def test_whom_an_answer_may_name():
    for named in itertools.product((0, 1, 255), (0, 1, 190, 191)):
        ack = m.MAVLink_command_ack_message(TAKE_OFF, 0, 0, 0, *named)
        assert Addressee(255, 191).is_ours(ack) == (named[0] in (0, 255) and named[1] in (0, 191))


def test_a_vehicle_that_was_being_armed_is_disarmed_whatever_it_said_before():
    with vehicle() as (peer, time, link):
        peer.landed = m.MAV_LANDED_STATE_ON_GROUND
        time.run(link, 1.1)
        peer.silent = True  # the command to arm and its answer are in transit
        link.order(Order.ARM, time())
        time.run(link, 0.1)
        assert link.status.armed is False
        link.order(Order.DISARM, time())
        time.run(link, 0.6)
        peer.silent, peer.armed = False, True
        peer.beat()
        time.run(link, 1.5)
        assert not peer.armed
        sent = peer.commands(m.MAV_CMD_COMPONENT_ARM_DISARM)
        assert {command.param1 for command in sent[-2:]} == {0.0}
        before = len(sent)
        time.run(link, 3.0)
        assert len(peer.commands(m.MAV_CMD_COMPONENT_ARM_DISARM)) == before
        assert link.status.armed is False


@pytest.mark.parametrize("late_s", [0.0, 0.02, 0.08])
def test_a_reason_that_comes_after_the_refusal_is_told_with_it(late_s):
    with vehicle() as (peer, time, link):
        peer.results[m.MAV_CMD_COMPONENT_ARM_DISARM] = m.MAV_RESULT_TEMPORARILY_REJECTED
        link.order(Order.ARM, time())
        while not peer.commands(m.MAV_CMD_COMPONENT_ARM_DISARM):
            time.run(link, 0.01)
        time.run(link, 0.01 + late_s)
        peer.send(m.MAVLink_statustext_message(2, b"Preflight Fail: ekf2 missing data"))
        time.run(link, 0.2)
        said = "temporarily rejected; Preflight Fail: ekf2 missing data"
        assert link.status.refusals == [(Order.ARM, said)]
        assert len(peer.commands(m.MAV_CMD_COMPONENT_ARM_DISARM)) == 1


def test_an_order_that_is_done_after_all_was_not_refused():
    with vehicle() as (peer, time, link):
        peer.results[m.MAV_CMD_COMPONENT_ARM_DISARM] = m.MAV_RESULT_TEMPORARILY_REJECTED
        link.order(Order.ARM, time())
        time.run(link, 0.05)
        peer.armed = True
        peer.beat()
        time.run(link, 2.0)
        assert link.status.refusals == []


def test_a_landing_that_is_refused_goes_on():
    with vehicle() as (peer, time, link):
        peer.results[m.MAV_CMD_DO_SET_MODE] = m.MAV_RESULT_DENIED
        link.order(Order.LAND, time())
        time.run(link, 5.0)
        assert len(peer.commands(m.MAV_CMD_DO_SET_MODE)) >= 8
        assert link.status.refusals == [(Order.LAND, "denied")]
