"""MAVLink link to a scripted vehicle, through real sockets, on the clock of the test."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.schemas.errors import LinkError
from alula.stages.flight.links.options import Limits
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, VelocitySetpoint
from support.effort import examples
from support.vehicles.mavlink_peer import FRAME, Peer, m, vehicle

FINITE = st.floats(-20, 20)


VECTOR = st.tuples(FINITE, FINITE, FINITE)


def test_a_vehicle_is_found_and_named_and_asked_for_its_state():
    with vehicle(ready=False) as (peer, time, link):
        assert link.status.mode == "STABILIZE"
        time.sleep(0.01)
        asked = {int(e.param1): e.param2 for e in peer.commands(m.MAV_CMD_SET_MESSAGE_INTERVAL)}
        assert asked[m.MAVLINK_MSG_ID_LOCAL_POSITION_NED] == 10_000
        assert asked[m.MAVLINK_MSG_ID_ATTITUDE_QUATERNION] == 10_000
        beats = peer.of("HEARTBEAT")
        assert (beats[0].type, beats[0].autopilot) == (m.MAV_TYPE_ONBOARD_CONTROLLER, m.MAV_AUTOPILOT_INVALID)
        assert (beats[0].get_srcSystem(), beats[0].get_srcComponent()) == (255, 191)
        before = len(peer.of("HEARTBEAT"))
        time.run(link, 5.0)
        assert 45 <= len(peer.of("HEARTBEAT")) - before <= 50
        peer.heard.clear()
        link.close()
        peer.tick(time())
        seen = {int(e.param1): e.param2 for e in peer.commands(m.MAV_CMD_SET_MESSAGE_INTERVAL)}
        assert seen.pop(m.MAVLINK_MSG_ID_HEARTBEAT) == 1e6
        assert set(seen.values()) == {0.0}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"kind": m.MAV_TYPE_GROUND_ROVER}, "not a multicopter"),
        ({"autopilot": m.MAV_AUTOPILOT_PPZ}, "neither ArduPilot nor PX4"),
        ({"capabilities": 8192}, "takes no set-points"),
        ({"silent": True}, "no vehicle heartbeat"),
        ({"results": {m.MAV_CMD_REQUEST_MESSAGE: 3}}, "AUTOPILOT_VERSION"),
    ],
)
def test_what_cannot_be_flown_is_refused_with_its_reason(change, words):
    peer = Peer()
    for name, value in change.items():
        setattr(peer, name, value)
    with pytest.raises(LinkError, match=words), vehicle(peer=peer):
        pass


def test_of_two_vehicles_one_must_be_chosen():
    for address, outcome in (("", "several vehicles send heartbeats: 1, 2"), ("?system=2", None)):
        first, second = Peer(), Peer(system=2)
        second.own_messages = False

        def also(_now, first=first, second=second, tick=first.tick):
            tick(_now)
            second.link = first.link
            second.now_s = _now
            if first.link is not None:  # a router: both from one address
                first.send_bytes(
                    second.pack(m.MAVLink_heartbeat_message(m.MAV_TYPE_QUADROTOR, 3, 0, 5, 3, 3))
                )

        first.tick = also
        if outcome is not None:
            with pytest.raises(LinkError, match=outcome), vehicle(peer=first):
                pass
        else:
            with pytest.raises(LinkError, match="AUTOPILOT_VERSION"), vehicle(peer=first, address=address):
                pass
            assert {e.target_system for e in first.of("COMMAND_LONG")} == {2}
        second.close()


def test_state_is_that_of_the_wire_in_the_world():
    @settings(deadline=None, max_examples=examples(60))
    @given(p=VECTOR, v=VECTOR, w=st.tuples(*3 * [st.floats(-5, 5)]), r=VECTOR)
    def check(p, v, w, r):
        attitude = Rotation.from_rotvec(np.array(r) / 10)
        q = attitude.as_quat()
        time.sleep(0.01)
        peer.send_state(p, v, (q[3], q[0], q[1], q[2]), w)
        link.poll(time())
        state = link.state
        world_enu = Rotation.from_euler("z", -FRAME.yaw_rad)
        enu_ned = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
        frd_flu = Rotation.from_matrix(np.diag([1.0, -1, -1]))
        whole = world_enu * enu_ned * attitude * frd_flu
        np.testing.assert_allclose(
            state.position, world_enu.apply(enu_ned.apply(p) - FRAME.origin_enu_m), atol=1e-5
        )
        np.testing.assert_allclose(state.velocity, (world_enu * enu_ned).apply(v), atol=1e-5)
        np.testing.assert_allclose(state.omega, frd_flu.apply(w), atol=1e-6)
        got = Rotation.from_quat(np.roll(state.attitude_wxyz, -1))
        assert (got * whole.inv()).magnitude() < 1e-5
        assert state.received_s == pytest.approx(time(), abs=2e-3)

    with vehicle() as (peer, time, link):
        check()


def test_rates_go_out_with_all_of_them_and_thrust_by_hover():
    limits = Limits(rates_slew_rad_s2=1e6, throttle_slew_per_s=1e6)
    with vehicle(limits=limits) as (peer, time, link):
        link.send(RatesSetpoint(9.81 * 1.5, np.array([0.5, 2.5, -1.0])), time())
        time.sleep(0.01)
        (sent,) = peer.of("SET_ATTITUDE_TARGET")
        assert sent.type_mask == 128
        assert (sent.target_system, sent.target_component) == (1, 1)
        assert (sent.body_roll_rate, sent.body_pitch_rate, sent.body_yaw_rate) == pytest.approx(
            (0.5, -2.5, 1.0)
        )
        assert sent.thrust == pytest.approx(1.5 * 0.35)
        assert list(sent.q) == [1, 0, 0, 0]


def test_velocities_and_accelerations_go_out_along_ned_with_their_masks():
    v, a = np.array([1.0, 2.0, 0.5]), np.array([0.3, -0.2, 1.0])
    yaw = 0.4
    turn = Rotation.from_euler("z", FRAME.yaw_rad)
    ned = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    heading = math.pi / 2 - (yaw + FRAME.yaw_rad)
    with vehicle() as (peer, time, link):
        link.send(VelocitySetpoint(v, yaw), time())
        time.sleep(0.01)
        link.send(AccelerationSetpoint(a, v, np.zeros(3), yaw), time())
        time.sleep(0.01)
        first, second = peer.of("SET_POSITION_TARGET_LOCAL_NED")
        assert (first.type_mask, second.type_mask) == (0b1001_1100_0111, 0b1000_0000_0111)
        assert first.coordinate_frame == second.coordinate_frame == m.MAV_FRAME_LOCAL_NED
        for sent in (first, second):
            assert (sent.vx, sent.vy, sent.vz) == pytest.approx(ned @ turn.apply(v), abs=1e-6)
            assert math.remainder(sent.yaw - heading, 2 * math.pi) == pytest.approx(0, abs=1e-6)
        assert (second.afx, second.afy, second.afz) == pytest.approx(ned @ turn.apply(a), abs=1e-6)


BAD = [
    (RatesSetpoint(math.nan, np.zeros(3)), "thrust_m_s2"),
    (RatesSetpoint(math.inf, np.zeros(3)), "thrust_m_s2"),
    (RatesSetpoint(1e4, np.zeros(3)), "thrust_m_s2"),
    (RatesSetpoint(9.81, np.array([0, math.nan, 0])), "omega.y"),
    (RatesSetpoint(9.81, np.array([0, 0, 573.0])), "omega.z"),
    (VelocitySetpoint(np.array([0, 0, -math.inf]), 0.0), "velocity.z"),
    (VelocitySetpoint(np.zeros(3), math.nan), "yaw_rad"),
    (VelocitySetpoint(np.zeros(2), 0.0), "velocity"),
    (AccelerationSetpoint(np.array([math.nan, 0, 0]), np.zeros(3), np.zeros(3), 0.0), "acceleration.x"),
    (AccelerationSetpoint(np.zeros(3), np.array([0, math.nan, 0]), np.zeros(3), 0.0), "velocity.y"),
    (AccelerationSetpoint(np.zeros(3), np.zeros(3), np.array([0, 0, math.nan]), 0.0), "position.z"),
]


def test_no_number_that_is_none_leaves_the_house():
    with vehicle() as (peer, time, link):
        for setpoint, field in BAD:
            with pytest.raises(LinkError, match=f"refused: {field}"):
                link.send(setpoint, time())
        time.sleep(0.01)
        assert not peer.of("SET_ATTITUDE_TARGET")
        assert not peer.of("SET_POSITION_TARGET_LOCAL_NED")


def test_whatever_is_sent_is_finite_within_limits_and_within_reach_of_the_last():
    limits = Limits()
    thrust = st.floats(-5, 50)
    rates = st.tuples(st.floats(-19, 19), st.floats(-19, 19), st.floats(-7, 7))

    @settings(deadline=None, max_examples=examples(30))
    @given(st.lists(st.tuples(thrust, rates), min_size=2, max_size=12))
    def check(requests):
        peer.heard.clear()
        for each, omega in requests:
            time.sleep(0.01)
            link.send(RatesSetpoint(each, np.array(omega)), time())
        time.sleep(0.01)
        sent = [
            (e.thrust, e.body_roll_rate, e.body_pitch_rate, e.body_yaw_rate)
            for e in peer.of("SET_ATTITUDE_TARGET")
        ]
        assert len(sent) == len(requests)
        values = np.array(sent)
        assert np.isfinite(values).all()
        assert (values[:, 0] >= limits.throttle[0] - 1e-6).all()
        assert (values[:, 0] <= limits.throttle[1]).all()
        assert (np.abs(values[:, 1:]) <= np.array(limits.rates_rad_s) + 1e-5).all()
        steps = np.abs(np.diff(values, axis=0))
        assert (steps[:, 0] <= limits.throttle_slew_per_s * 0.01 + 1e-6).all()
        assert (steps[:, 1:] <= limits.rates_slew_rad_s2 * 0.01 + 1e-4).all()

    with vehicle(limits=limits) as (peer, time, link):
        check()
        assert link.clipped > 0
