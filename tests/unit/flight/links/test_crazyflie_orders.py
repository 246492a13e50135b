"""Commands to a Crazyflie and the queue of packets, without a vehicle."""

from __future__ import annotations

import numpy as np
import pytest

from alula.stages.flight.links.crazyflie.orders import IS_ARMED, IS_FLYING, Motion, Orders
from alula.stages.flight.links.crazyflie.session import Session
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order, VehicleStatus

MOTION = Motion(np.array([0.0, 0.0, 1.0]), np.zeros(3), 0.0, 0.0)


def flying():
    session, status = Session("udp://127.0.0.1:1", LinkOptions()), VehicleStatus()
    orders = Orders(session, status)
    orders.update(IS_ARMED | IS_FLYING)
    assert status.armed
    return session, status, orders


@pytest.mark.parametrize("order", [Order.HOLD, Order.LAND])
def test_what_may_be_flying_is_held_and_landed_though_it_does_not_say_so(order):
    session, status, orders = flying()
    status.armed = status.landed = None  # no log for a second: without set-points it falls after two
    orders.start(order, 10.0, 0.0, MOTION)
    assert status.refusals == []
    assert not session._queue.empty()


@pytest.mark.parametrize("order", [Order.HOLD, Order.LAND, Order.TAKE_OFF])
def test_what_is_disarmed_goes_nowhere(order):
    session, status, orders = flying()
    status.armed, status.landed = False, True
    orders.start(order, 10.0, 0.5, MOTION)
    assert status.refusals == [(order, "it is not armed")]
    assert session._queue.empty()


def test_a_take_off_needs_to_be_known_to_be_armed():
    _, status, orders = flying()
    status.armed = None
    orders.start(Order.TAKE_OFF, 10.0, 0.5, MOTION)
    assert status.refusals == [(Order.TAKE_OFF, "it is not armed")]


def test_of_set_points_and_poses_that_a_lost_radio_holds_up_the_newest_goes_out():
    session, sent = Session("udp://127.0.0.1:1", LinkOptions()), []
    for number in range(200):
        session.post_newest("pose", lambda _, n=number: sent.append(("pose", n)))
        session.post_newest("set-point", lambda _, n=number: sent.append(("set-point", n)))
    session.post(lambda _: sent.append("order"))
    session._queue.put(None)
    session._send_all()
    assert sent == [("pose", 199), ("set-point", 199), "order"]
    session.post_newest("pose", lambda _: sent.append("next"))
    session._queue.put(None)
    session._send_all()
    assert sent[-1] == "next"


@pytest.mark.parametrize("landed", [False, None, True])
def test_a_controller_is_not_changed_under_what_may_be_flying(landed, monkeypatch):
    link, written = open_link("udp://127.0.0.1:1"), []
    monkeypatch.setattr(link._session, "read", lambda name: 2.0)
    monkeypatch.setattr(link._session, "write", lambda name, value, *_: written.append((name, value)) or True)
    link._parameters._changed["stabilizer.controller"] = (1.0, 2.0)
    link._is_prepared, link._status.landed = True, landed
    link.close()
    assert written == ([("stabilizer.controller", 1.0)] if landed else [])
    assert ("stabilizer.controller stays 2; it was 1" in link.status.texts) != (landed is True)
