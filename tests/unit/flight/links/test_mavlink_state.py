"""State of a MAVLink link from packets that are late, old, apart or from before a restart."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.stages.flight.links.vehicle_clock import VehicleClock
from support.effort import examples
from support.vehicles.mavlink_peer import m, said, vehicle


def test_late_twice_and_old_packets_are_no_new_state():
    with vehicle() as (peer, time, link):
        for _ in range(20):
            time.sleep(0.01)
            peer.send_state((1, 2, 3))
            link.poll(time())
        first = peer.pack(m.MAVLink_local_position_ned_message(peer.boot_ms() + 10, 5, 5, 5, 0, 0, 0))
        time.sleep(0.02)
        peer.send_state((6, 6, 6))
        time.run(link, 0.01)
        before = said(link, "heard_s")
        peer.send_bytes(first)  # overtaken
        peer.send_bytes(first)
        link.poll(time())
        assert said(link, "heard_s") == before
        held = [peer.pack(m.MAVLink_local_position_ned_message(peer.boot_ms() + 5, 7, 7, 7, 0, 0, 0))]
        held += [peer.pack(m.MAVLink_attitude_quaternion_message(peer.boot_ms() + 5, 1, 0, 0, 0, 0, 0, 0))]
        time.sleep(0.4)
        for data in held:
            peer.send_bytes(data)
        link.poll(time())
        assert time() - link.state.received_s == pytest.approx(0.395, abs=0.01)  # old when it arrives


def test_state_ages_as_soon_as_one_of_its_parts_stops():
    with vehicle() as (peer, time, link):

        def both():
            peer.send_state((1, 2, 3))

        def place():
            peer.send(m.MAVLink_local_position_ned_message(peer.boot_ms(), 1, 2, 3, 0, 0, 0))

        def attitude():
            peer.send(m.MAVLink_attitude_quaternion_message(peer.boot_ms(), 1, 0, 0, 0, 0, 0, 0))

        for alone in (place, attitude):
            time.run(link, 0.2, each=both)
            assert time() - link.state.received_s < 0.011
            time.run(link, 0.3, each=alone)
            assert time() - link.state.received_s > 0.24


def test_the_older_part_is_carried_to_the_time_of_the_newer():
    with vehicle() as (peer, time, link):
        frame = link._options.frame
        peer.send(m.MAVLink_local_position_ned_message(peer.boot_ms(), 1, 0, 0, 2.0, 0, 0))
        peer.send(m.MAVLink_attitude_quaternion_message(peer.boot_ms() + 30, 1, 0, 0, 0, 0, 0, 1.0))
        link.poll(time())
        assert frame.position_to_ned(link.state.position) == pytest.approx([1.06, 0, 0], abs=1e-6)
        peer.send(m.MAVLink_local_position_ned_message(peer.boot_ms() + 40, 1, 0, 0, 2.0, 0, 0))
        link.poll(time())
        quat = frame.attitude_to_ned(link.state.attitude_wxyz)
        assert 2 * math.asin(quat[3]) == pytest.approx(0.01, abs=1e-6)
        assert frame.position_to_ned(link.state.position) == pytest.approx([1, 0, 0], abs=1e-6)


def test_odometry_is_one_state_and_taken_before_the_others():
    with vehicle() as (peer, time, link):
        half = math.sqrt(0.5)
        message = m.MAVLink_odometry_message(
            round((peer.now_s + 5) * 1e6),
            m.MAV_FRAME_LOCAL_NED,
            m.MAV_FRAME_BODY_FRD,
            *(1.0, 2.0, -3.0),
            [half, 0, 0, half],  # its heading is east
            *(1.0, 0.0, 0.0),
            *(0.1, 0.2, 0.3),
            [0.0] * 21,
            [0.0] * 21,
        )
        peer.send(message)
        time.run(link, 0.02)
        frame = link._options.frame
        assert frame.position_to_ned(link.state.position) == pytest.approx([1, 2, -3], abs=1e-6)
        assert frame.vector_to_ned(link.state.velocity) == pytest.approx([0, 1, 0], abs=1e-6)
        assert link.state.omega == pytest.approx([0.1, -0.2, -0.3], abs=1e-6)
        before = said(link, "heard_s")
        peer.send_state((9, 9, 9))
        link.poll(time())
        assert said(link, "heard_s") == before


def test_euler_angles_do_where_there_is_nothing_better():
    with vehicle() as (peer, time, link):
        peer.send(m.MAVLink_local_position_ned_message(peer.boot_ms(), 0, 0, 0, 0, 0, 0))
        peer.send(m.MAVLink_attitude_message(peer.boot_ms(), 0.1, 0.2, 0.3, 0, 0, 0))
        time.run(link, 0.02)
        from scipy.spatial.transform import Rotation

        quat = link._options.frame.attitude_to_ned(link.state.attitude_wxyz)
        expected = Rotation.from_euler("ZYX", [0.3, 0.2, 0.1])
        assert (Rotation.from_quat(np.roll(quat, -1)) * expected.inv()).magnitude() < 1e-6


def test_a_vehicle_that_starts_anew_is_noticed_and_its_old_state_dropped():
    with vehicle() as (peer, time, link):
        time.run(link, 0.3, each=lambda: peer.send_state((1, 2, 3)))
        assert link.status.clock_jumps == 0
        peer.boot_s = -time() + 2.0  # two seconds after boot
        peer.heard.clear()
        peer.send_state((0, 0, 0))
        time.run(link, 0.02)
        assert link.status.clock_jumps == 0  # one packet proves nothing
        time.run(link, 0.3, each=lambda: peer.send_state((4, 5, 6)))
        assert link.status.clock_jumps == 1
        assert any("restarted" in text for text in link.status.texts)
        assert time() - link.state.received_s < 0.02
        time.run(link, 4.0)
        assert peer.commands(m.MAV_CMD_SET_MESSAGE_INTERVAL)  # it has lost its settings


def test_a_clock_drifts_but_does_not_jump():
    clock = VehicleClock()
    for k in range(20000):
        now = 100.0 + k * 0.01
        arrival = clock.arrival(k * 0.01 * (1 + 5e-5) + 7.0, now)
        assert arrival is not None
        assert 0 <= now - arrival < 0.02
    assert clock.jumps == 0


def test_a_clock_that_stood_still_is_told_from_packets_that_are_late():
    with vehicle() as (peer, time, link):

        def state():
            peer.send_state((1, 2, 3))

        def age():
            return time() - link.state.received_s

        time.run(link, 1.0, each=state)
        assert age() < 0.012
        assert link.state.latency_s == pytest.approx(0.01, abs=0.011)
        peer.boot_s -= 0.3  # it stood still
        time.run(link, 0.1, each=state)
        assert age() > 0.0
        time.run(link, 1.0, each=state)
        assert age() < 0.03
        waiting = []

        def late():  # packets of both ways wait for 0.3 s
            waiting.append(peer.boot_ms())
            if len(waiting) > 30:
                stamp = waiting[-31]
                peer.send(m.MAVLink_local_position_ned_message(stamp, 1, 2, 3, 0, 0, 0))
                peer.send(m.MAVLink_attitude_quaternion_message(stamp, 1, 0, 0, 0, 0, 0, 0))

        time.run(link, 5.0, each=late)
        assert age() > 0.27
        assert link.status.clock_jumps == 0


@pytest.mark.parametrize(("up_s", "down_s"), [(0.0, 0.7), (0.7, 0.0), (0.05, 0.04), (0.0, 1.5)])
def test_a_delay_that_all_packets_share_is_measured_by_round_trips(up_s, down_s):
    with vehicle() as (peer, time, link):
        peer.up_s, peer.down_s = up_s, down_s
        time.run(link, 6.0, each=lambda: peer.send_state((1, 2, 3)))
        assert up_s + down_s - 0.011 <= link.state.latency_s <= up_s + down_s + 0.03
        assert link.state.age_s(time()) >= up_s + down_s - 0.011
        peer.answers_time = False  # the evidence ends: a line to the vehicle that became slow would not show
        time.run(link, 6.0 + up_s + down_s, each=lambda: peer.send_state((1, 2, 3)))
        assert math.isnan(link.state.age_s(time()))


def test_a_line_to_the_vehicle_that_becomes_slow_shows_within_seconds():
    with vehicle() as (peer, time, link):
        time.run(link, 2.0, each=lambda: peer.send_state((1, 2, 3)))
        assert link.state.latency_s < 0.03
        peer.up_s = 0.4
        time.run(link, 6.0, each=lambda: peer.send_state((1, 2, 3)))
        assert link.state.latency_s == pytest.approx(0.41, abs=0.02)


@pytest.mark.parametrize(("gain", "is_fast"), [(0.0, False), (0.03, False), (0.2, True), (1.0, True)])
def test_a_vehicle_that_is_not_in_real_time_has_no_age(gain, is_fast):
    with vehicle() as (peer, time, link):

        def state():
            peer.boot_s += gain * (time() - was[0])
            was[0] = time()
            peer.send_state((1, 2, 3))

        was = [time()]
        time.run(link, 2.0, each=lambda: peer.send_state((1, 2, 3)))
        assert link.state.latency_s < 0.03
        was = [time()]
        time.run(link, 5.0, each=state)
        assert math.isnan(link.state.age_s(time())) == is_fast
        assert ("clock runs faster" in link.status.clock) == is_fast
        assert link.status.clock_jumps == 0
        time.run(link, 6.0, each=lambda: peer.send_state((1, 2, 3)))
        assert link.state.latency_s < 0.03
        assert not link.status.clock


@given(
    up_s=st.floats(0, 1.5),
    down_s=st.floats(0, 1.5),
    jitter_s=st.floats(0, 0.2),
    drift=st.floats(-1e-4, 1e-4),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=examples(40))
def test_no_state_is_older_than_its_age_says(up_s, down_s, jitter_s, drift, seed):
    random = np.random.default_rng(seed)
    clock, zero = VehicleClock(), random.uniform(-1e4, 1e4)

    def vehicle_s(now_s):
        return zero + now_s * (1 + drift)

    arrivals = []  # of states: when, time stamp, when measured
    for k in range(400):
        measured_s = k * 0.03
        arrivals.append(
            (measured_s + down_s + random.uniform(0, jitter_s), vehicle_s(measured_s), measured_s)
        )
    answers = []  # of time requests: when, vehicle's clock, when requested
    for k in range(24):
        requested_s = k * 0.5
        there_s = requested_s + up_s + random.uniform(0, jitter_s)
        back_s = there_s + down_s + random.uniform(0, jitter_s)
        answers.append((back_s, vehicle_s(there_s), requested_s))
    answers.sort()
    for now_s, stamp_s, measured_s in sorted(arrivals):
        while answers and answers[0][0] <= now_s:
            clock.synchronise(answers[0][1], answers[0][2])
            answers.pop(0)
        arrival_s = clock.arrival(stamp_s, now_s)
        if arrival_s is not None and not math.isnan(clock.latency_s):
            assert now_s - arrival_s + clock.latency_s >= now_s - measured_s - 1e-9
            assert clock.latency_s <= up_s + down_s + 2 * jitter_s + 0.01


def test_patience_ends_where_nobody_can_be_asked():
    clock = VehicleClock(patience_s=2.0)
    for k in range(1000):
        now = 10 + k * 0.01
        stamp = k * 0.01 - (0.2 if k > 200 else 0.0)
        arrival = clock.arrival(stamp, now)
        if k > 402:
            assert now - arrival < 0.01
        elif 221 < k < 400:
            assert now - arrival == pytest.approx(0.2, abs=0.01)


def test_silence_is_seen_and_what_was_said_long_ago_is_unknown():
    with vehicle() as (peer, time, link):
        peer.send(m.MAVLink_sys_status_message(0, 0, 0, 0, 15200, 0, 80, 0, 0, 0, 0, 0, 0))
        peer.send(m.MAVLink_ekf_status_report_message(1 | 2 | 4 | 8 | 16 | 32, 0, 0, 0, 0, 0))
        time.run(link, 1.5)
        status = link.status
        assert (status.battery_v, status.battery_share) == (pytest.approx(15.2), pytest.approx(0.8))
        assert status.is_estimator_ready is True
        assert status.landed is True
        peer.send(m.MAVLink_ekf_status_report_message(1 | 2 | 4 | 8 | 16 | 32 | 128, 0, 0, 0, 0, 0))
        time.run(link, 0.02)
        assert status.is_estimator_ready is False
        heard = status.heard_s
        peer.silent = True
        time.run(link, 11.0, step_s=0.05)
        assert status.heard_s == pytest.approx(heard, abs=1.1)
        assert (status.landed, status.armed, status.battery_share) == (None, None, None)
        assert status.is_estimator_ready is None
        assert not status.obeys


def test_lost_packets_are_counted_by_their_numbers():
    with vehicle() as (peer, time, link):
        before = link.status.lost_packets
        for _ in range(10):
            peer.pack(m.MAVLink_heartbeat_message(2, 3, 0, 0, 3, 3))
        peer.send_state()
        time.run(link, 0.02)
        assert link.status.lost_packets - before == 10


def test_long_texts_are_joined_and_cannot_command_a_terminal():
    with vehicle() as (peer, time, link):
        link.status.texts.clear()
        text = b"PreArm: " + b"x" * 60 + b" end\x1b[2Jof text"
        pieces = [text[i : i + 50] for i in range(0, len(text), 50)]
        for order in (0, 1):
            peer.send(m.MAVLink_statustext_message(3, pieces[order], 7, order))
        time.run(link, 0.02)
        assert link.status.texts == ["PreArm: " + "x" * 60 + " end[2Jof text"]
        link.status.texts.clear()
        peer.send(m.MAVLink_statustext_message(3, b"y" * 50, 8, 1))
        time.run(link, 1.5)
        assert link.status.texts == ["..." + "y" * 50]


def test_a_clock_of_32_bits_that_comes_round_is_no_new_start():
    with vehicle() as (peer, time, link):
        peer.boot_s = (1 << 32) * 1e-3 - time() - 1.0
        of_64_bits = peer.boot_ms
        peer.boot_ms = lambda: of_64_bits() & 0xFFFFFFFF
        stamps, ages = [], []

        def say():
            stamps.append(peer.boot_ms())
            peer.send_state((1, 2, 3))
            ages.append(time() - (link.state.received_s if link.state else time()))

        time.run(link, 2.0, each=say)
        assert min(stamps) < 2000 < 4e9 < max(stamps)
        assert max(ages) < 0.05
        assert link.status.clock_jumps == 0
        peer.boot_s = -time()  # and now it does restart
        time.run(link, 1.0, each=say)
        assert link.status.clock_jumps == 1
