"""MAVLink link to the simulated autopilot, end to end through sockets, on one clock."""

from __future__ import annotations

import socket

import numpy as np
import pytest

from alula.schemas.errors import LinkError
from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.flight.links.protocol import Order
from alula.stages.sim_vehicle.ardupilot.copter import ArduCopter
from alula.stages.sim_vehicle.common.faults import Fault
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, VelocitySetpoint
from support.vehicles.autopilot_client import EXACT, QUICK
from support.vehicles.mocap_samples import sample
from support.vehicles.served_autopilot import FRAME, G, Served, flight, stream, take_off

KEY = bytes(range(32))
CHANGED = ("GUID_OPTIONS", "ATC_ANGLE_BOOST", "GUID_TIMEOUT", "FS_GCS_ENABLE")


def test_it_is_found_prepared_flown_landed_and_left_as_it_was():
    served = Served()
    before = {name: served.copter.parameters[name] for name in CHANGED}
    with flight(served=served, prepare=False) as (served, time, link):
        lines = link.prepare()
        assert [line.split(":")[0] for line in lines if not line.startswith("SYSID")] == list(CHANGED)
        take_off(time, link)
        position, velocity = served.true_state()
        assert link.state.position == pytest.approx(position, abs=0.05)
        assert link.state.velocity == pytest.approx(velocity, abs=0.05)

        desired = np.array([0.8, -0.4, 0.3])
        stream(time, link, 3.0, lambda s: VelocitySetpoint(desired, 0.3))
        assert served.true_state()[1] == pytest.approx(desired, abs=0.15)
        link.order(Order.HOLD, time())
        time.run(link, 2.0)
        assert np.linalg.norm(served.true_state()[1]) < 0.1
        assert link.status.obeys

        desired = np.array([0.5, 0.3, -0.1])
        stream(time, link, 0.5, lambda s: AccelerationSetpoint(desired, s.velocity, s.position, 0.3))
        start = served.true_state()[1]
        stream(time, link, 1.0, lambda s: AccelerationSetpoint(desired, s.velocity, s.position, 0.3))
        assert served.true_state()[1] - start == pytest.approx(desired, abs=0.12)
        link.order(Order.HOLD, time())
        time.run(link, 2.0)

        link.order(Order.LAND, time())
        time.run(link, 20.0, step_s=0.02)
        assert link.status.landed
        assert link.status.armed is False
    assert {name: served.copter.parameters[name] for name in CHANGED} == before


def test_rates_and_thrust_mean_what_they_say():
    with flight() as (served, time, link):
        take_off(time, link)
        stream(time, link, 0.5, lambda s: RatesSetpoint(G, np.zeros(3)))
        before = served.true_state()[1]
        stream(time, link, 0.5, lambda s: RatesSetpoint(1.1 * G, np.zeros(3)))
        climbed = (served.true_state()[1] - before)[2]
        assert climbed == pytest.approx(0.1 * G * 0.5, rel=0.15)
        stream(time, link, 2.0, lambda s: RatesSetpoint(G, np.array([0.0, 0.0, 1.0])))  # yaw overshoots
        assert link.state.omega == pytest.approx([0, 0, 1.0], abs=0.1)
        stream(time, link, 2.0, lambda s: RatesSetpoint(G, np.zeros(3)))
        stream(time, link, 0.2, lambda s: RatesSetpoint(G, np.array([0.0, 0.5, 0.0])))
        assert link.state.omega == pytest.approx([0, 0.5, 0], abs=0.1)
        assert served.copter.flying.guided.rejected == 0


def test_a_wrong_throttle_at_hover_is_found_in_flight():
    right = ArduCopter(FASTBRIDGE).hover_throttle
    served = Served(parameters={"MOT_THST_HOVER": 1.25 * right})
    with flight(served=served, flies_rates=True) as (served, time, link):
        assert link.hover.value == pytest.approx(1.25 * right)
        take_off(time, link)
        stream(time, link, 8.0, lambda s: RatesSetpoint(G - 4.0 * s.velocity[2], np.zeros(3)))
        assert link.hover.value < 1.16 * right
        assert abs(served.true_state()[1][2]) < 0.35


def test_without_set_points_it_stops_by_itself():
    with flight() as (served, time, link):
        take_off(time, link)
        stream(time, link, 2.0, lambda s: VelocitySetpoint(np.array([1.5, 0, 0]), 0.0))
        time.run(link, 2.0)
        assert np.linalg.norm(served.true_state()[1]) < 0.15


def test_arming_before_the_estimator_has_settled_is_refused_with_its_words():
    slow = Served(options=type(EXACT)(boot_time_s=20.0))
    with flight(served=slow) as (_, time, link):
        link.order(Order.ARM, time())
        time.run(link, 6.0)
        refusals = link.status.refusals
        assert refusals
        assert refusals[0][0] is Order.ARM
        assert "failed" in refusals[0][1]
        assert link.status.is_estimator_ready is False


@pytest.mark.parametrize(
    ("source", "words"),
    [
        (6, "EK3_SRC1_POSXY is 6, external navigation, which this command sends only with --mocap"),
        (0, "EK3_SRC1_POSXY is 0: it has no source of positions"),
    ],
)
def test_a_vehicle_without_a_position_is_told_what_it_lacks_and_asked_once_for_what_it_does_not_have(
    source, words
):
    names = ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")
    parameters = {f"EK3_SRC1_{name}": float(source) for name in names} | {"GPS1_TYPE": 0.0}
    with flight(served=Served(parameters=parameters)) as (_, time, link):
        time.run(link, 12.0)
        assert link.state is None
        assert link.status.without_position.startswith(words)
        assert "it has no origin of its frame (GPS_GLOBAL_ORIGIN)" in link.status.without_position
        said = [text for text in link.status.texts if text.startswith("No ap_message")]
        assert said == ["No ap_message for mavlink id (124)"]


def test_when_we_are_gone_it_lands_and_a_pilots_mode_is_seen():
    with flight() as (served, time, link):
        take_off(time, link)
        for _ in range(700):  # without polls the link sends no heartbeats
            time.sleep(0.01)
        assert served.copter.mode.name == "LAND"
        time.run(link, 1.5)
        assert link.status.mode == "LAND"
        served.copter.set_mode(5)
        time.run(link, 1.2)
        assert not link.status.obeys
        assert link.status.mode == "LOITER"


def test_state_ages_under_faults_of_the_line():
    with flight() as (served, time, link):
        for kind in ("drop", "freeze", "nan", "wrong-system", "bad-crc"):
            time.run(link, 0.5)
            assert time() - link.state.received_s < 0.05, kind
            served.vehicle.inject(Fault(kind=kind, duration=0.5))
            time.run(link, 0.45)
            assert time() - link.state.received_s > 0.4, kind
        assert link.status.bad_packets > 50


def test_a_simulation_that_lost_time_is_not_stale_for_ever_but_one_behind_a_long_line_is():
    with flight() as (served, time, link):
        time.run(link, 1.0)
        served.begin += 0.4  # its machine was busy
        time.run(link, 0.41)
        time.run(link, 1.0)
        assert time() - link.state.received_s < 0.05
        served.vehicle.inject(Fault(kind="delay", duration=10.0, amount=0.3))
        time.run(link, 5.0)
        assert time() - link.state.received_s > 0.2


def test_flights_survive_other_faults_of_the_line():
    with flight() as (served, time, link):
        take_off(time, link)
        received = []
        desired = np.array([0.5, 0.0, 0.0])
        for kind in ("duplicate", "reorder", "delay"):
            served.vehicle.inject(Fault(kind=kind, duration=1.2))
            for _ in range(150):
                link.send(VelocitySetpoint(desired, 0.0), time())
                time.run(link, 0.01)
                received.append(link.state.received_s)
            assert served.true_state()[1] == pytest.approx(desired, abs=0.2), kind
        assert (np.diff(received) >= 0).all()
        assert link.status.clock_jumps == 0


def test_a_signed_flight_and_a_wrong_key(tmp_path):
    wall = 1.8e9
    options = {"key": KEY, "signing_file": tmp_path / "stamp", "wall_clock": lambda: wall}
    served = Served(key=KEY, channel=1, epoch_s=wall)
    with flight(served=served, **options) as (_, time, link):
        link.order(Order.ARM, time())
        time.run(link, 3.0)
        assert link.status.armed
    served = Served(key=bytes(32), channel=1, epoch_s=wall)
    with pytest.raises(LinkError, match="no vehicle heartbeat"), flight(served=served, **options):
        pass


@pytest.mark.slow
def test_with_motion_capture_alone_it_arms_and_its_loss_is_seen_at_once():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    parameters = {f"EK3_SRC1_{each}": 6.0 for each in ("POSXY", "VELXY", "POSZ", "VELZ", "YAW")}
    parameters |= {"VISO_TYPE": 1.0, "GPS1_TYPE": 0.0}
    served = Served(options=QUICK, parameters=parameters)
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera,
        flight(served=served, mocap=f"udp:127.0.0.1:{port}") as (served, time, link),
    ):
        from alula.stages.vehicles.frames import flipped_body  # noqa: F401

        def watch():
            position, velocity = served.true_state()
            quat = FRAME.attitude_from_ned(np.array(served.copter.airframe.truth.attitude))
            camera.sendto(
                sample(time(), position, quat.tolist(), velocity_m_s=velocity.tolist()), ("127.0.0.1", port)
            )

        time.run(link, 20.0, step_s=0.02, each=watch)
        assert link.status.is_estimator_ready
        position, _ = served.true_state()
        assert link.state.position == pytest.approx(position, abs=0.05)
        link.order(Order.ARM, time())
        time.run(link, 2.5, each=watch)
        assert link.status.armed, (link.status.refusals, link.status.texts)
        link.order(Order.TAKE_OFF, time(), 1.0)
        time.run(link, 8.0, each=watch)
        assert link.state.position[2] > 0.7
        time.run(link, 0.35)
        assert time() - link.state.received_s > 0.15
        assert link.status.is_estimator_ready  # it has not noticed yet
