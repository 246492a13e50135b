"""Injected faults: of packets, of the vehicle, and their syntax."""

import itertools
import math

import pytest

from alula.schemas.errors import UsageError
from alula.stages.sim_vehicle.ardupilot.copter import ArduCopter
from alula.stages.sim_vehicle.ardupilot.modes import Mode
from alula.stages.sim_vehicle.common.faults import KINDS, Fault, parse_fault
from alula.stages.sim_vehicle.common.packets import mavlink
from alula.stages.sim_vehicle.common.quaternions import to_euler
from alula.stages.sim_vehicle.px4.vehicle import Px4Copter
from support.vehicles.autopilot_client import EXACT, Client, of


def streaming(*faults, seed=1):
    """Positions at 50 Hz, and faults that begin now."""
    client = Client(seed=seed)
    client.wait(1)
    client.interval("LOCAL_POSITION_NED", 50)
    for text in faults:
        client.vehicle.inject(parse_fault(text))
    client.heard.clear()
    client.packets.clear()
    return client


def test_packets_are_dropped_for_a_while():
    client = streaming("drop:start=1,duration=1")
    times = [m.time_boot_ms for m in of("LOCAL_POSITION_NED", client.wait(3))]
    gaps = [b - a for a, b in itertools.pairwise(times)]
    assert max(gaps) == pytest.approx(1000, abs=25)


def test_packets_are_dropped_with_a_probability_that_the_seed_decides():
    counts = [len(streaming("drop:probability=0.3", seed=s).wait(4)) for s in (1, 1, 2)]
    assert counts[0] == counts[1]
    assert 100 < counts[0] < 180
    assert counts[0] != counts[2] or counts[0] != 0


def test_packets_are_delayed_doubled_and_swapped():
    client = streaming("delay:amount=0.3")
    (first, *_) = of("LOCAL_POSITION_NED", client.wait(1))
    client.wait(1)
    age_ms = client.vehicle.time_s * 1000 - client.last("LOCAL_POSITION_NED").time_boot_ms
    assert age_ms == pytest.approx(300, abs=25)
    assert first.time_boot_ms < 1200
    doubled = [m.time_boot_ms for m in of("LOCAL_POSITION_NED", streaming("duplicate").wait(1))]
    assert doubled[::2] == doubled[1::2]
    swapped = [m.time_boot_ms for m in of("LOCAL_POSITION_NED", streaming("reorder").wait(1))]
    assert any(b < a for a, b in itertools.pairwise(swapped))
    assert len(set(swapped)) == len(swapped)


def test_motion_freezes_and_loses_its_numbers():
    client = streaming("freeze:start=1,duration=1", "nan:start=3,duration=0.5")
    client.wait(1)
    frozen = of("LOCAL_POSITION_NED", client.wait(0.5))
    assert len(frozen) == 25
    assert len({m.time_boot_ms for m in frozen[2:]}) == 1
    client.wait(1.6)
    (lost, *_) = of("LOCAL_POSITION_NED", client.wait(0.2))
    assert math.isnan(lost.x)
    assert math.isnan(lost.vz)
    client.wait(0.5)
    assert math.isfinite(client.last("LOCAL_POSITION_NED").x)


def test_packets_come_from_another_system_or_are_damaged():
    client = streaming("wrong-system:amount=77", "bad-crc:start=1,duration=1")
    assert {m.get_srcSystem() for m in client.wait(0.5)} == {77}
    client.wait(1)
    assert client.bad > 10


def test_what_comes_in_can_be_lost_too():
    client = Client(faults=(parse_fault("drop:way=in,start=1"),))
    client.wait(1.5)
    client.send(mavlink.MAVLink_param_request_read_message(1, 1, b"GUID_TIMEOUT", -1))
    assert not of("PARAM_VALUE", client.wait(0.1))
    late = Client(faults=(parse_fault("delay:way=in,amount=0.5"),))
    late.send(mavlink.MAVLink_param_request_read_message(1, 1, b"GUID_TIMEOUT", -1))
    assert not of("PARAM_VALUE", late.wait(0.45))
    assert of("PARAM_VALUE", late.wait(0.1))


def test_faults_wait_for_arming_and_flight_and_position_jumps():
    text = "jump:since=airborne,start=8,duration=2,amount=1.5"
    client = Client(
        options=EXACT,
        faults=(parse_fault(text), parse_fault("mode:since=arm,start=22,amount=land", Mode.__members__)),
    )
    client.fly(3)
    begin = client.vehicle.time_s
    assert client.copter.estimator.offset == (0.0, 0.0, 0.0)
    seen = []
    while client.vehicle.time_s < begin + 8:
        client.wait(0.1)
        seen.append(client.truth.position[0])
    assert min(seen) < -0.5  # the vehicle flew to where its estimate was back at the set-point
    assert client.copter.mode is Mode.GUIDED
    client.wait(10)
    assert client.copter.mode is Mode.LAND


def test_mocap_is_lost_by_a_fault_and_faults_can_be_injected():
    client = Client()
    client.vehicle.inject(Fault(kind="mocap-loss", duration=1))
    client.wait(0.5)
    assert client.copter.estimator.is_mocap_lost
    client.wait(1)
    assert not client.copter.estimator.is_mocap_lost


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_fault_is_parsed(kind):
    default, _, most = KINDS[kind]
    fault = parse_fault(f"{kind}:start=1,duration=2,probability=0.5,amount={most},since=arm")
    assert fault == Fault(
        kind=kind, start=1.0, duration=2.0, probability=0.5, amount=most, way="out", since="arm"
    )
    assert parse_fault(kind).size == default
    with pytest.raises(UsageError, match="amount"):
        parse_fault(f"{kind}:amount={most + 1}")


@pytest.mark.parametrize(
    "text",
    [
        *("", "flood", "drop:start", "drop:start=x", "drop:when=1", "drop:probability=0", "drop:start=-1"),
        *("drop:duration=0", "nan:way=in", "drop:way=up", "drop:since=dawn", "delay:amount=nan"),
    ],
)
def test_what_is_no_fault_is_refused(text):
    with pytest.raises(UsageError, match="fault"):
        parse_fault(text)


@pytest.mark.parametrize(
    ("kind", "followed"),
    [  # of 3.3 m, measured on the real programs: after the jump [s], and by how much [m]
        (ArduCopter, {0.8: 1.0, 1.2: 1.63, 1.6: 2.14, 2.4: 2.82, 3.2: 3.17}),
        (Px4Copter, {0.8: 0.6, 1.3: 1.2, 1.9: 1.8, 2.5: 2.2, 3.1: 2.5, 4.3: 2.88}),
    ],
)
def test_an_estimate_follows_fixes_that_jump_as_the_real_one(kind, followed):
    flown = type("Flown", (Client,), {"kind": kind})()
    flown.wait(1.0)
    flown.interval("GPS_RAW_INT", 5)
    flown.interval("LOCAL_POSITION_NED", 20)
    flown.wait(0.5)
    before, north = flown.last("GPS_RAW_INT").lat, flown.last("LOCAL_POSITION_NED").x
    flown.vehicle.inject(parse_fault("fixes"))
    at = 0.0
    for when, moved in followed.items():
        flown.wait(when - at)
        at = when
        assert flown.last("LOCAL_POSITION_NED").x - north == pytest.approx(moved, abs=0.35)
    assert flown.last("GPS_RAW_INT").lat - before == pytest.approx(
        3.3 / 6378100.0 * 180 / math.pi * 1e7, abs=3
    )


def test_a_compass_that_is_off_shows_as_in_the_real_program():
    """400 mG on the real ArduPilot: a variance of 0.77 after 0.4 s, 0.2 rad after 4.7 s."""
    client = Client(options=EXACT)
    client.fly(3)
    for name in ("EKF_STATUS_REPORT", "ATTITUDE"):
        client.interval(name, 20)
    client.wait(0.5)
    heading = client.last("ATTITUDE").yaw
    assert client.last("EKF_STATUS_REPORT").compass_variance < 0.1
    client.vehicle.inject(parse_fault("compass"))
    client.wait(0.4)
    assert client.last("EKF_STATUS_REPORT").compass_variance == pytest.approx(0.77, abs=0.05)
    client.wait(4.3)
    error = client.last("ATTITUDE").yaw - to_euler(client.truth.attitude)[2] - heading
    assert math.remainder(error, 2 * math.pi) == pytest.approx(0.2, abs=0.03)
