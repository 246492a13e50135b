"""The simulated Crazyflie: bytes in and out, on the clock of the test."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.stages.sim_vehicle.crazyflie.planner import Goal, Plan, Planner
from alula.stages.sim_vehicle.crazyflie.supervisor import Stage
from alula.stages.vehicles.packed_attitude import compress_quat_wxyz, expand_quat_wxyz
from support.effort import examples
from support.vehicles.crazyflie_rehearsal import ARM, DISARM, Rehearsal, packet, take_off, velocity

IDENTITY = compress_quat_wxyz((1.0, 0.0, 0.0, 0.0))


def full_state(position, velocity=(0, 0, 0), push=(0, 0, 0), rates=(0, 0, 0)) -> bytes:
    numbers = [round(1000 * each) for each in (*position, *velocity, *push)]
    return packet(
        7, 0, struct.pack("<B9hI3h", 6, *numbers, IDENTITY, *(round(1000 * each) for each in rates))
    )


def land(duration: float) -> bytes:
    return packet(8, 0, struct.pack("<BBff?f", 8, 0, 0.0, 0.0, True, duration))


RELAX = packet(7, 1, struct.pack("<BI", 0, 0))


@given(st.tuples(*4 * [st.floats(-1, 1)]).filter(lambda q: sum(each * each for each in q) > 1e-3))
@settings(deadline=None)
def test_attitudes_survive_32_bits(parts) -> None:
    quat = np.array(parts) / np.linalg.norm(parts)
    packed = compress_quat_wxyz(quat.tolist())
    again = np.array(expand_quat_wxyz(packed))
    assert 0 <= packed < 1 << 32
    assert min(np.abs(again - quat).max(), np.abs(again + quat).max()) < 3e-3


def test_attitudes_are_packed_as_cflib_packs_them() -> None:
    encoding = pytest.importorskip("cflib.utils.encoding", reason="cflib is not there")
    for quat in np.random.default_rng(1).normal(size=(300, 4)):
        w, x, y, z = (quat / np.linalg.norm(quat)).tolist()
        packed = compress_quat_wxyz((w, x, y, z))
        assert packed == encoding.compress_quaternion([x, y, z, w])
        assert np.allclose(encoding.decompress_quaternion(packed)[[3, 0, 1, 2]], expand_quat_wxyz(packed))


def test_a_full_state_is_in_thousandths_and_its_rates_in_milliradian() -> None:
    rehearsal = Rehearsal()
    rehearsal.ask(full_state((1, -2, 3), (0.5, 0, -1), (0, 2, 9), (0.5, -1.5, 30)))
    seen = rehearsal.vehicle.setpoint
    assert np.allclose(seen.position, (1, -2, 3))
    assert np.allclose(seen.acceleration, (0, 2, 9))
    assert np.allclose(seen.omega, (0.5, -1.5, 30))


def circle_error(controller: int) -> float:
    rehearsal = Rehearsal(controller)
    rehearsal.fly()
    begin = rehearsal.vehicle.time_s
    radius, rate, errors = 0.5, 2.0, []

    def send() -> bytes:
        angle = rate * (rehearsal.vehicle.time_s - begin)
        cos, sin = math.cos(angle), math.sin(angle)
        place = np.array([radius * (cos - 1), radius * sin, 0.5])
        errors.append(float(np.linalg.norm(place - rehearsal.vehicle.body.position)))
        speed = radius * rate
        return full_state(
            place, (-speed * sin, speed * cos, 0), (-speed * rate * cos, -speed * rate * sin, 0)
        )

    rehearsal.live(6.0, send)
    return max(errors[300:])


def test_pid_leaves_out_the_acceleration_of_a_full_state() -> None:
    assert circle_error(2) < 0.06
    assert circle_error(1) > 0.2


def test_mellinger_goes_down_when_told_a_velocity_and_lee_falls() -> None:
    for controller, rises in ((1, True), (2, False), (5, False)):
        rehearsal = Rehearsal(controller)
        rehearsal.fly()
        rehearsal.live(0.6, velocity(0, 0, 0.3))
        assert (rehearsal.height > 0.6) is rises
        assert (rehearsal.height < 0.4) is not rises


def test_silence_levels_out_and_then_stops_the_motors_for_good() -> None:
    rehearsal = Rehearsal(1)
    rehearsal.fly(1.0)
    rehearsal.live(0.5, velocity(0.5, 0, 0))
    rehearsal.live(0.4)
    assert rehearsal.stage is Stage.FLYING
    rehearsal.live(0.2)
    assert rehearsal.stage is Stage.LEVEL_OUT
    rehearsal.live(0.1, velocity(0, 0, 0))
    assert rehearsal.stage is Stage.FLYING
    rehearsal.live(2.2)
    assert rehearsal.stage is Stage.LOCKED
    rehearsal.live(2.0)
    assert rehearsal.height == 0.0
    rehearsal.vehicle.receive(ARM)
    rehearsal.live(0.1)
    assert not rehearsal.vehicle.supervisor.is_armed
    assert any(b"Locked" in each for each in rehearsal.heard)


def test_a_plan_waits_for_its_turn_and_without_one_the_motors_stop() -> None:
    rehearsal = Rehearsal()
    rehearsal.fly()
    rehearsal.live(0.3, full_state((0, 0, 0.5)))
    rehearsal.vehicle.receive(land(1.5))
    rehearsal.live(0.3)
    assert rehearsal.vehicle.setpoint.kind == "full-state"  # still the one with the higher priority
    rehearsal.vehicle.receive(RELAX)
    rehearsal.live(4.0)
    assert rehearsal.height == 0.0
    assert rehearsal.stage is Stage.CHECKED  # still for two seconds: disarmed

    rehearsal = Rehearsal()
    rehearsal.fly(1.0)
    rehearsal.live(0.3, full_state((0, 0, 1.0)))
    rehearsal.vehicle.receive(RELAX)
    rehearsal.live(1.5)
    assert rehearsal.height == 0.0


def test_zero_thrust_stops_the_motors() -> None:
    rehearsal = Rehearsal()
    rehearsal.fly()
    rehearsal.live(0.3, packet(3, 0, struct.pack("<fffH", 0, 0, 0, 0)))
    assert rehearsal.height < 0.4


def test_arming_is_by_request_and_ends_by_itself() -> None:
    rehearsal = Rehearsal()
    assert rehearsal.ask(ARM)[-1][1:] == b"\x81\0\0"  # before its checks
    rehearsal.live(0.1)
    rehearsal.vehicle.receive(take_off(0.5, 1.0))
    rehearsal.live(0.5)
    assert rehearsal.height == 0.0
    rehearsal.vehicle.receive(packet(8, 0, b"\3\0"))
    assert rehearsal.ask(ARM)[-1][1:] == b"\x81\1\1"
    rehearsal.live(29.0)
    assert rehearsal.stage is Stage.READY
    rehearsal.live(2.0)
    assert rehearsal.stage is Stage.CHECKED
    by_itself = Rehearsal(arms_itself=True)
    by_itself.live(0.1)
    assert by_itself.stage is Stage.READY


def test_the_emergency_watchdog_wants_notices_once_it_had_one() -> None:
    rehearsal = Rehearsal()
    rehearsal.fly()
    rehearsal.live(1.5, packet(9, 1, b"\4"))
    assert rehearsal.stage is Stage.FLYING
    rehearsal.live(1.1)
    assert rehearsal.stage is Stage.LOCKED


def test_disarming_in_the_air_locks() -> None:
    rehearsal = Rehearsal()
    rehearsal.fly()
    rehearsal.vehicle.receive(DISARM)
    rehearsal.live(0.1)
    assert rehearsal.stage is Stage.LOCKED


def test_poses_lead_the_estimate_and_without_them_it_drifts() -> None:
    rehearsal = Rehearsal(needs_poses=True)

    def pose() -> bytes:
        x, y, z = rehearsal.vehicle.body.position + np.array([1.0, 2.0, 0.0])
        return packet(6, 1, struct.pack("<B7f", 8, x, y, z, 0, 0, 0, 1))

    rehearsal.live(1.0, pose)
    estimator = rehearsal.vehicle.estimator
    assert np.allclose(estimator.position, (1, 2, 0), atol=1e-3)
    assert estimator.variance < 1e-3
    rehearsal.vehicle.receive(ARM)
    rehearsal.live(0.1, pose)
    rehearsal.vehicle.receive(take_off(0.5, 1.5))
    rehearsal.live(2.5, pose)
    rehearsal.live(1.0)
    assert estimator.variance > 0.1
    assert np.linalg.norm(rehearsal.vehicle.body.position[:2]) > 0.05


def test_tables_answer_and_refuse() -> None:
    rehearsal = Rehearsal(has_app=True)
    names = []
    (info,) = rehearsal.ask(packet(2, 0, b"\3"))
    (count,) = struct.unpack_from("<H", info, 2)
    for number in range(count):
        item = rehearsal.ask(packet(2, 0, b"\2" + struct.pack("<H", number)))[-1]
        names.append(item[5:-1].replace(b"\0", b".").decode())
    assert {"stabilizer.controller", "alula.radius"} <= set(names)
    assert rehearsal.ask(packet(2, 0, b"\2" + struct.pack("<H", count)))[-1][1:] == b"\2"
    where = struct.pack("<H", names.index("alula.radius"))
    wrote = rehearsal.ask(packet(2, 2, where + struct.pack("<f", 0.25)))[-1]
    assert wrote[1:] == where + struct.pack("<f", 0.25)
    assert rehearsal.ask(packet(2, 1, where))[-1][1:] == where + b"\0" + struct.pack("<f", 0.25)
    named = b"alula\0vmax\0"
    assert rehearsal.ask(packet(2, 3, b"\0" + named + b"\6" + struct.pack("<f", 2)))[-1][-1] == 0
    assert rehearsal.vehicle.parameters.values["alula.vmax"] == 2
    assert rehearsal.ask(packet(2, 3, b"\0alula\0none\0\6" + struct.pack("<f", 2)))[-1][-1] == 2
    # Logs: seven floats are too many, an unknown block cannot start, one exists once.
    block = b"".join(struct.pack("<BH", 0x77, 0) for _ in range(7))
    assert rehearsal.ask(packet(5, 1, b"\6\1" + block))[-1][1:] == b"\6\1\7"
    assert rehearsal.ask(packet(5, 1, b"\6\1"))[-1][1:] == b"\6\1\x11"
    assert rehearsal.ask(packet(5, 1, b"\3\2\1"))[-1][1:] == b"\3\2\2"
    assert rehearsal.ask(packet(15, 3, b""))[-1] == b"\xff"


@given(st.lists(st.binary(min_size=1, max_size=33), max_size=12))
@settings(deadline=None, max_examples=examples(150))
def test_no_packet_brings_it_down(packets: list[bytes]) -> None:
    rehearsal = Rehearsal(has_app=True)
    rehearsal.live(0.05)
    for data in packets:
        rehearsal.vehicle.receive(data)
        rehearsal.live(0.02)
    assert np.isfinite(rehearsal.vehicle.body.position).all()
    assert all(1 <= len(each) <= 31 for each in rehearsal.heard)


@given(st.integers(0, 15), st.integers(0, 3), st.integers(0, 14), st.binary(max_size=29))
@settings(deadline=None, max_examples=examples(200))
def test_no_command_brings_it_down(port: int, channel: int, command: int, rest: bytes) -> None:
    rehearsal = Rehearsal(has_app=True)
    rehearsal.live(0.05)
    rehearsal.vehicle.receive(packet(port, channel, bytes([command]) + rest))
    rehearsal.live(0.05)
    assert np.isfinite(rehearsal.vehicle.body.position).all()


def test_a_way_begins_where_the_vehicle_is_and_ends_at_rest() -> None:
    planner = Planner()
    here = Goal(np.array([1.0, 2.0, 3.0]), np.array([0.5, 0.0, -0.2]), np.zeros(3), 3.0)
    assert planner.receive(struct.pack("<BBBBfffff", 12, 0, 0, 0, 2, 2, 2, -3.0, 2.0), here, 10.0) == 0
    begin, end = planner.goal(10.0), planner.goal(12.0)
    assert np.allclose(begin.position, here.position)
    assert np.allclose(begin.velocity, here.velocity)
    assert np.allclose(end.position, (2, 2, 2))
    assert np.allclose(end.velocity, 0)
    assert end.yaw_rad == pytest.approx(-3.0 + 2 * math.pi)  # the short way round
    near = planner.goal(10.001)
    assert np.allclose((near.position - begin.position) / 0.001, begin.velocity, atol=1e-3)
    assert planner.receive(b"\7", here, 10.0) != 0
    assert planner.plan is Plan.FLYING
