"""Motion capture: received datagrams, messages to the vehicle, and its loss."""

from __future__ import annotations

import math
import socket

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.schemas.errors import LinkError, UsageError
from alula.stages.flight.links.mocap import Mocap
from alula.stages.vehicles.frames import LocalFrame
from support.vehicles.mavlink_peer import FRAME, Peer, m, vehicle
from support.vehicles.mocap_samples import sample


@pytest.fixture
def sender():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        yield made


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def ready_peer():
    peer = Peer()
    for name in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW"):
        peer.parameters[f"EK3_SRC1_{name}"] = (6.0, 2)
    peer.parameters["VISO_TYPE"] = (1.0, 2)
    return peer


def test_samples_are_forwarded_at_50_hz_in_the_vehicles_frame(sender):
    port = free_port()
    turn = Rotation.from_euler("ZYX", [0.5, 0.2, -0.1])
    x, y, z, w = turn.as_quat()
    velocity = np.array([0.3, -0.2, 0.1])
    with vehicle(peer=ready_peer(), mocap=f"udp:127.0.0.1:{port}") as (peer, time, link):
        begin = time()

        def each():
            p = np.array([1, 2, 3]) + velocity * (time() - begin)
            sender.sendto(sample(time() - 900, p, (w, x, y, z)), ("127.0.0.1", port))
            peer.send_state((1, 2, 3))

        peer.heard.clear()
        time.run(link, 2.0, each=each)
        places = peer.of("VISION_POSITION_ESTIMATE")
        speeds = peer.of("VISION_SPEED_ESTIMATE")
        assert 95 <= len(places) <= 102
        assert len(speeds) == len(places)
        stamps = np.array([e.usec for e in places]) * 1e-6
        assert np.diff(stamps) == pytest.approx(0.02, abs=0.011)
        moved = np.array([1, 2, 3]) + velocity * (places[-1].usec * 1e-6 + link._session.start_s - begin)
        last = places[-1]
        assert (last.x, last.y, last.z) == pytest.approx(FRAME.position_to_ned(moved), abs=2e-3)
        enu = Rotation.from_euler("z", FRAME.yaw_rad) * turn
        ned = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]]) * enu
        expected = ned * Rotation.from_matrix(np.diag([1.0, -1, -1]))
        sent = Rotation.from_euler("ZYX", [last.yaw, last.pitch, last.roll])
        assert (sent * expected.inv()).magnitude() < 1e-5
        v = speeds[-1]
        assert (v.x, v.y, v.z) == pytest.approx(FRAME.vector_to_ned(velocity), abs=1e-3)
        (origin, *_) = peer.of("SET_GPS_GLOBAL_ORIGIN") or [None]
        count = len(peer.of("SET_GPS_GLOBAL_ORIGIN"))
        assert origin is None or 1 <= count <= 3
        peer.send(m.MAVLink_gps_global_origin_message(473977000, 85456000, 488000))
        time.run(link, 0.05)
        peer.heard.clear()
        time.run(link, 2.0)
        assert not peer.of("SET_GPS_GLOBAL_ORIGIN")
        assert not peer.of("VISION_POSITION_ESTIMATE")


def test_px4_gets_odometry_and_no_origin(sender):
    """It takes no VISION_SPEED_ESTIMATE, and an origin moves its estimate by the way from latitude 0."""
    port = free_port()
    peer = Peer(autopilot=m.MAV_AUTOPILOT_PX4)
    peer.parameters["EKF2_EV_CTRL"] = (15.0, m.MAV_PARAM_TYPE_INT32)
    with vehicle(peer=peer, mocap=f"udp:127.0.0.1:{port}") as (peer, time, link):

        def each():
            sender.sendto(sample(time() - 900, (1, 2, 3), (1, 0, 0, 0)), ("127.0.0.1", port))
            peer.send_state((1, 2, 3))

        time.run(link, 2.0, each=each)
        last = peer.of("ODOMETRY")[-1]
        assert (last.x, last.y, last.z) == pytest.approx(FRAME.position_to_ned(np.array([1, 2, 3])), abs=1e-5)
        assert (last.vx, last.vy, last.vz) == pytest.approx((0, 0, 0), abs=1e-5)
        assert last.frame_id == last.child_frame_id == m.MAV_FRAME_LOCAL_NED
        assert last.estimator_type == m.MAV_ESTIMATOR_TYPE_VISION
        assert not peer.of("VISION_POSITION_ESTIMATE")
        assert not peer.of("VISION_SPEED_ESTIMATE")
        assert not peer.of("SET_GPS_GLOBAL_ORIGIN")


def test_another_sender_is_refused_until_the_first_was_silent_for_two_seconds():
    mocap = Mocap("udp:127.0.0.1:9", FRAME)
    first, other = ("127.0.0.1", 40000), ("127.0.0.1", 40001)
    mocap.take(sample(1.0), 10.0, first)
    mocap.take(sample(1.1), 10.1, other)
    assert mocap.bad == 1
    mocap.take(sample(1.2), 10.2, first)
    assert mocap.bad == 1
    assert mocap.is_fresh(10.2)
    mocap.take(b"{}", 12.3, other)  # it becomes the sender only with a good sample
    mocap.take(sample(3.3), 12.3, other)
    assert mocap.bad == 2
    mocap.take(sample(3.4), 12.4, first)
    assert mocap.bad == 3


def test_when_it_stops_the_state_ages_though_the_vehicle_still_sends_one(sender):
    port = free_port()
    with vehicle(peer=ready_peer(), mocap=f"udp:127.0.0.1:{port}") as (peer, time, link):

        def state():
            peer.send_state((1, 2, 3))

        def both():
            sender.sendto(sample(time()), ("127.0.0.1", port))
            state()

        time.run(link, 0.5, each=both)
        assert time() - link.state.received_s < 0.012
        time.run(link, 0.14, each=state)
        assert time() - link.state.received_s < 0.012
        time.run(link, 0.16, each=state)
        assert 0.13 < time() - link.state.received_s < 0.18
        time.run(link, 0.05, each=both)
        assert time() - link.state.received_s < 0.012


def test_a_vehicle_that_is_not_set_up_for_it_is_refused_by_name():
    peer = ready_peer()
    peer.parameters["EK3_SRC1_YAW"] = (1.0, 2)
    del peer.parameters["VISO_TYPE"]
    before = dict(peer.parameters)
    with (
        pytest.raises(LinkError, match=r"EK3_SRC1_YAW is 1, not 6; VISO_TYPE is missing, not 1"),
        vehicle(peer=peer, mocap=f"udp:127.0.0.1:{free_port()}"),
    ):
        pass
    assert peer.parameters == before


BAD = [
    b"",
    b"{}",
    b"[1, 2]",
    b"\xff\xfe",
    b"[" * 1000,
    sample(math.nan),
    sample(1.0, (1, math.inf, 3)),
    sample(1.0, (1, 2)),
    sample(1.0, (1, 2, 1e5)),
    sample(1.0, quat=(0, 0, 0, 0)),
    sample(1.0, quat=(2, 0, 0, 0)),
    sample(1.0, velocity_m_s=[0, 0, 1e3]),
    sample(1.0, colour="red"),
    sample(1.0) + b" " * 1024,
]


@pytest.mark.parametrize("data", BAD)
def test_what_is_no_sample_is_a_missing_one(data):
    mocap = Mocap("udp:127.0.0.1:9763", LocalFrame())
    mocap.take(data, 1.0)
    assert mocap.bad == 1
    assert not mocap.is_fresh(1.0)


@settings(deadline=None)
@given(st.binary(max_size=1100))
def test_no_bytes_break_it(data):
    mocap = Mocap("udp:127.0.0.1:9763", LocalFrame())
    mocap.take(data, 1.0)
    assert mocap.bad == 1


def test_old_and_repeated_samples_are_none_and_a_new_start_is_told():
    mocap = Mocap("udp:127.0.0.1:9763", LocalFrame())
    for k in range(20):
        mocap.take(sample(5 + k * 0.01), 100 + k * 0.01)
    assert mocap.is_fresh(100.19)
    mocap.take(sample(5.19), 100.5)
    mocap.take(sample(5.1), 100.5)
    assert not mocap.is_fresh(100.5)
    for k in range(5):
        mocap.take(sample(0.5 + k * 0.01), 101 + k * 0.01)
    assert mocap.is_fresh(101.04)
    position, _ = mocap._messages(0)
    assert position.reset_counter == 1


def test_the_address_is_taken_once():
    port = free_port()
    first, second = (Mocap(f"udp:127.0.0.1:{port}", LocalFrame()) for _ in range(2))
    first.open()
    with pytest.raises(LinkError, match=f"127.0.0.1:{port}"):
        second.open()
    first.close()
    with pytest.raises(UsageError, match="udp:HOST:PORT"):
        Mocap("tcp:127.0.0.1:1", LocalFrame())
