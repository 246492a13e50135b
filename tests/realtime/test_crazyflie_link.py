"""Link to the simulated Crazyflie in real time, through the published cflib."""

from __future__ import annotations

import json
import math
import socket
import threading

import numpy as np
import pytest

from alula.schemas.errors import LinkError
from alula.stages.flight.links.crazyflie.link import CrazyflieLink
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order
from alula.stages.sim_vehicle.crazyflie.supervisor import Stage
from alula.stages.vehicles.frames import LocalFrame
from alula.stages.vehicles.setpoints import AccelerationSetpoint, VelocitySetpoint
from support.vehicles.crazyflie_peer import clock, crazyflie_vehicle, fly_until, pause, served

pytest.importorskip("cflib", reason="cflib, of the extra crazyflie, is not there")

FRAME = LocalFrame(0.5, (1.0, 2.0, 0.0))


def opened(address: str, **options) -> CrazyflieLink:
    link = open_link(address, LinkOptions(vehicle=crazyflie_vehicle(), clock=clock, sleep=pause, **options))
    assert isinstance(link, CrazyflieLink)
    link.open(10.0)
    return link


def take_off(link: CrazyflieLink, height: float = 0.3) -> None:
    link.order(Order.ARM, clock())
    assert fly_until(link, lambda: link.status.armed is True)
    ground = link.state.position[2]
    link.order(Order.TAKE_OFF, clock(), height)
    assert fly_until(link, lambda: link.state.position[2] - ground > 0.95 * height)
    link.order(Order.TAKE_CONTROL, clock())


def land(link: CrazyflieLink) -> None:
    link.order(Order.LAND, clock())
    assert fly_until(link, lambda: link.status.landed is True, 15.0)
    assert fly_until(link, lambda: link.status.armed is False, 5.0)


def test_a_flight_on_accelerations_in_a_frame_of_its_own() -> None:
    with served() as vehicle:
        link = opened(vehicle.address, frame=FRAME)
        assert link.status.mode == "standby"
        assert not link.status.obeys
        assert "stabilizer.controller: 1 -> 2" in link.prepare()
        take_off(link)
        centre, begin, errors = link.state.position.copy(), clock(), []

        def make() -> AccelerationSetpoint:
            state, angle = link.state, 1.5 * (clock() - begin)
            cos, sin = math.cos(angle), math.sin(angle)
            place = centre + 0.5 * np.array([cos - 1, sin, 0])
            speed = 0.75 * np.array([-sin, cos, 0])
            errors.append(float(np.linalg.norm(place - state.position)))
            push = (
                6 * (place - state.position) + 4 * (speed - state.velocity) - 1.125 * np.array([cos, sin, 0])
            )
            return AccelerationSetpoint(push, state.velocity, state.position, 0.3)

        fly_until(link, lambda: clock() - begin > 3, make=make)
        assert max(errors[len(errors) // 2 :]) < 0.2
        assert vehicle.vehicle.setpoint.kind == "full-state"
        # The world's axes are turned by 0.5 rad in the vehicle's frame, and yaw with them.
        assert vehicle.vehicle.setpoint.yaw_rad == pytest.approx(0.8, abs=0.05)
        true = FRAME.position_from_local(vehicle.vehicle.body.position)
        assert np.allclose(true, link.state.position, atol=0.15)
        w, x, y, z = link.state.attitude_wxyz
        assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(0.3, abs=0.15)
        land(link)
        link.close()
        assert vehicle.vehicle.parameters.values["stabilizer.controller"] == 1
        assert vehicle.vehicle.parameters.values["stabilizer.estimator"] == 1
        assert not link.status.refusals
        assert any("Ready to fly" in text for text in link.status.texts)


def test_rates_arrive_in_radian_and_the_logged_pitch_rate_has_its_sign() -> None:
    with served() as vehicle:
        link = opened(vehicle.address)
        link.prepare()
        link.order(Order.TAKE_CONTROL, clock())
        begin = clock()

        def make() -> AccelerationSetpoint:
            push = np.array([5.0, 3.0, 0.0]) * (clock() - begin)
            return AccelerationSetpoint(push, np.zeros(3), np.zeros(3), 0.0)

        fly_until(link, lambda: clock() - begin > 0.6, make=make)
        pause(0.1)
        seen = vehicle.vehicle.setpoint.omega
        # A jerk forward pitches the nose down, positive about y; one to the left rolls, negative about x.
        assert seen[1] == pytest.approx(5 / 10.3, rel=0.3)
        assert seen[0] == pytest.approx(-3 / 10.3, rel=0.3)
        x = np.zeros(12)
        vehicle.vehicle.body.measured = lambda: (
            x[:3],
            x[3:6],
            np.array([1.0, 0, 0, 0]),
            np.array([0.1, 0.2, 0.3]),
        )
        assert fly_until(link, lambda: link.state.omega[2] > 0.29, make=make)
        assert np.allclose(link.state.omega, (0.1, 0.2, 0.3), atol=2e-3)
        link.close()


def test_velocities_fly_by_pid_and_turn_to_the_heading() -> None:
    with served(arms_itself=True) as vehicle:
        link = opened(f"{vehicle.address}?controller=pid")
        assert link.status.armed is False  # it armed itself, without a command
        link.prepare()
        take_off(link)
        begin = clock()
        request = VelocitySetpoint(np.array([0.4, -0.2, 0.0]), 0.6)
        fly_until(link, lambda: clock() - begin > 2.0, make=lambda: request)
        assert np.allclose(link.state.velocity, request.velocity, atol=0.1)
        w, x, y, z = link.state.attitude_wxyz
        assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(0.6, abs=0.15)
        with pytest.raises(LinkError, match="AccelerationSetpoint"):
            link.send(AccelerationSetpoint(np.zeros(3), np.zeros(3), np.zeros(3), 0.0), clock())
        land(link)
        with pytest.raises(LinkError, match="landing"):
            link.send(request, clock())
        link.close()


def test_when_set_points_end_it_holds_its_place_by_itself() -> None:
    with served() as vehicle:
        link = opened(f"{vehicle.address}?controller=pid")
        link.prepare()
        take_off(link)
        begin = clock()
        request = VelocitySetpoint(np.array([0.6, 0.0, 0.0]), 0.0)
        fly_until(link, lambda: clock() - begin > 1.0, make=lambda: request)
        fly_until(link, lambda: False, 2.5)
        assert any("holds its position" in text for text in link.status.texts)
        assert vehicle.vehicle.supervisor.stage is Stage.FLYING
        assert np.linalg.norm(link.state.velocity) < 0.05
        assert link.state.position[2] == pytest.approx(0.3, abs=0.1)
        link.order(Order.DISARM, clock())
        assert link.status.refusals.pop()[0] is Order.DISARM
        link.close()  # in the air: cflib does not stop the motors, and the controller is not changed
        pause(0.5)
        assert vehicle.vehicle.body.position[2] == pytest.approx(0.3, abs=0.1)
        assert any("in the air" in text for text in link.status.texts)


def test_nothing_leaves_it_hovering_and_refusals_are_told() -> None:
    with served() as vehicle:
        link = opened(vehicle.address)
        link.prepare()
        link.order(Order.TAKE_OFF, clock(), 0.3)
        assert link.status.refusals.pop() == (Order.TAKE_OFF, "it is not armed")
        take_off(link)
        state = link.state
        still = AccelerationSetpoint(np.zeros(3), np.zeros(3), state.position, 0.0)
        begin = clock()
        fly_until(link, lambda: clock() - begin > 0.5, make=lambda: still)
        link.order(Order.NOTHING, clock())
        fly_until(link, lambda: False, 2.5)
        assert vehicle.vehicle.body.position[2] == pytest.approx(0.3, abs=0.1)
        vehicle.vehicle.supervisor.stop()
        assert fly_until(link, lambda: link.status.is_failsafe)
        assert not link.status.obeys
        assert any("reboot" in text for text in link.status.texts)
        fly_until(link, lambda: link.status.armed is False, 5.0)
        link.order(Order.ARM, clock())
        assert "locked" in link.status.refusals[0][1]
        link.close()


def test_parameters_of_the_app_are_set_checked_and_put_back() -> None:
    with served(has_app=True) as vehicle:
        values = vehicle.vehicle.parameters.values
        link = opened(f"{vehicle.address}?controller=oot&alula.radius=0.125&alula.enable=1")
        lines = link.prepare()
        assert "alula.radius: 0.15 -> 0.125" in lines
        assert not any("alula.enable" in line for line in lines)
        assert values["stabilizer.controller"] == 6
        assert link.configure({"alula.vmax": 0.5}) == ["alula.vmax: 1 -> 0.5"]
        with pytest.raises(LinkError, match=r"no parameter alula\.height; alula has .*radius"):
            link.configure({"alula.height": 1.0})
        with pytest.raises(LinkError, match="the app refuses"):
            link.configure({"alula.radius": -1.0})
        with pytest.raises(LinkError, match=r"did not take alula\.divider"):
            link.configure({"alula.divider": 300})
        link.close()
        assert values["alula.radius"] == pytest.approx(0.15)
        assert values["alula.vmax"] == 1.0
        assert values["stabilizer.controller"] == 1
    with served() as vehicle:
        link = opened(f"{vehicle.address}?controller=oot")
        with pytest.raises(LinkError, match=r"did not take stabilizer\.controller = 6"):
            link.prepare()
        link.close()


def test_motion_capture_leads_it_and_its_end_ends_the_state() -> None:
    with served(needs_poses=True, start=(0.2, 0.1, 0.0)) as vehicle:
        port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        port.bind(("127.0.0.1", 0))
        place = port.getsockname()
        port.close()
        ends = threading.Event()

        def capture() -> None:
            sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            while not ends.wait(0.01):
                position, _, quat, _ = vehicle.vehicle.body.measured()
                sample = {
                    "time_s": clock(),
                    "position_m": FRAME.position_from_local(position).tolist(),
                    "attitude_wxyz": FRAME.attitude_from_local(quat).tolist(),
                }
                sender.sendto(json.dumps(sample).encode(), place)
            sender.close()

        thread = threading.Thread(target=capture, daemon=True)
        thread.start()
        link = opened(vehicle.address, frame=FRAME, mocap=f"udp:{place[0]}:{place[1]}")
        lines = link.prepare()
        assert any(line.startswith("kalman.initialX: 0 -> 0.2") for line in lines)
        assert fly_until(link, lambda: link.status.is_estimator_ready is True)
        assert np.allclose(vehicle.vehicle.estimator.position, (0.2, 0.1, 0), atol=5e-3)
        take_off(link)
        assert np.allclose(
            link.state.position, FRAME.position_from_local(vehicle.vehicle.body.position), atol=0.1
        )
        ends.set()
        thread.join()
        fly_until(link, lambda: False, 0.5)
        assert clock() - link.state.received_s > 0.2
        link.close()


def test_a_cut_line_is_silence_and_nobody_there_is_said_at_once() -> None:
    with served() as vehicle:
        link = opened(vehicle.address)
        link.prepare()
        link.poll(clock())
        vehicle.is_cut = True
        fly_until(link, lambda: False, 1.5)
        assert clock() - link.status.heard_s > 1.0
        assert clock() - link.state.received_s > 1.0
        assert link.status.armed is None
        begin = clock()
        link.close()
        assert clock() - begin < 20
        assert "it may be in the air: its parameters stay as they are" in link.status.texts
        assert any("stays 2; it was 1" in text for text in link.status.texts), link.status.texts
    begin = clock()
    link = open_link(vehicle.address)
    with pytest.raises(LinkError, match="no Crazyflie"):
        link.open(5.0)
    assert clock() - begin < 16


def test_the_emergency_watchdog_is_kept_fed_and_locks_at_the_end() -> None:
    with served() as vehicle:
        link = opened(f"{vehicle.address}?watchdog=1")
        link.prepare()
        take_off(link)
        fly_until(link, lambda: False, 1.5)
        assert vehicle.vehicle.supervisor.stage is Stage.FLYING
        link.order(Order.LAND, clock())
        assert fly_until(link, lambda: link.status.landed is True)
        link.close()
        assert any("restart it" in text for text in link.status.texts)
        pause(1.3)
        assert vehicle.vehicle.supervisor.stage is Stage.LOCKED


def test_older_firmware_is_armed_by_its_platform_port_and_the_oldest_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("alula.stages.sim_vehicle.crazyflie.vehicle.PROTOCOL", 10)
    with served() as vehicle:
        link = opened(f"{vehicle.address}?watchdog=1")
        link.prepare()
        link.order(Order.ARM, clock())
        assert fly_until(link, lambda: link.status.armed is True)
        fly_until(link, lambda: False, 0.5)
        vehicle.is_cut = True  # no more notices
        pause(1.5)
        assert vehicle.vehicle.supervisor.stage is Stage.LOCKED
        link.close()
    monkeypatch.setattr("alula.stages.sim_vehicle.crazyflie.vehicle.PROTOCOL", 8)
    with served() as vehicle, pytest.raises(LinkError, match="too old: CRTP 8"):
        opened(vehicle.address)


@pytest.mark.parametrize(("volts", "share"), [(3.55, 0.5), (math.nan, None)])
def test_a_battery_that_is_not_a_number_is_not_told(volts, share):
    link = open_link("udp://127.0.0.1:19850", LinkOptions())
    link.status.battery_share = 0.9  # an earlier value
    values = {
        "kalman.varX": 0.0,
        "kalman.varY": 0.0,
        "kalman.varZ": 0.0,
        "pm.vbat": volts,
        "supervisor.info": 0,
    }
    link._status_block = (10.0, values)
    link._read_status(10.1)
    assert link.status.battery_share == (share if share is None else pytest.approx(share))
