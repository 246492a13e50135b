"""Link to the simulated PX4 through sockets, on one clock: the behaviour specific to PX4."""

import socket

import numpy as np
import pytest

from alula.schemas.errors import LinkError
from alula.stages.flight.links.protocol import Order
from alula.stages.sim_vehicle.px4.modes import Px4Mode
from alula.stages.sim_vehicle.px4.vehicle import Px4Copter
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, VelocitySetpoint
from support.vehicles.autopilot_client import QUICK
from support.vehicles.mocap_samples import sample
from support.vehicles.served_autopilot import FRAME, G, Served, flight, stream, take_off

FAST = {"MPC_TKO_SPEED": 5.0, "MPC_TKO_RAMP_T": 0.25, "MPC_LAND_SPEED": 2.0}
CHANGED = {"COM_OF_LOSS_T": 0.3, "COM_OBL_RC_ACT": 4, "COM_RCL_EXCEPT": 4, "COM_RC_OVERRIDE": 3}


class ServedPx4(Served):
    kind, fast = Px4Copter, FAST


def test_px4_is_prepared_flown_landed_and_left_as_it_was():
    served = ServedPx4()
    before = {name: served.copter.parameters[name] for name in CHANGED}
    with flight(served=served, prepare=False) as (served, time, link):
        lines = link.prepare()
        assert [line.split(":")[0] for line in lines] == list(CHANGED)
        assert {name: round(served.copter.parameters[name], 6) for name in CHANGED} == CHANGED
        take_off(time, link)
        position, velocity = served.true_state()
        assert link.state.position == pytest.approx(position, abs=0.05)
        assert link.state.velocity == pytest.approx(velocity, abs=0.05)
        assert link.status.is_estimator_ready
        assert link.status.landed is False

        desired = np.array([0.8, -0.4, 0.3])
        stream(time, link, 2.0, lambda s: VelocitySetpoint(desired, 0.3))
        assert served.true_state()[1] == pytest.approx(desired, abs=0.15)
        desired = np.array([0.5, 0.3, -0.1])
        start = served.true_state()[1]
        stream(time, link, 1.0, lambda s: AccelerationSetpoint(desired, s.velocity, s.position, 0.3))
        assert served.true_state()[1] - start == pytest.approx(desired, abs=0.15)
        stream(time, link, 0.4, lambda s: RatesSetpoint(G, np.zeros(3)))
        stream(time, link, 0.3, lambda s: RatesSetpoint(G, np.array([0.0, 0.0, 1.0])))
        assert link.state.omega == pytest.approx([0, 0, 1.0], abs=0.1)
        link.order(Order.HOLD, time())
        time.run(link, 1.5)
        assert np.linalg.norm(served.true_state()[1]) < 0.15
        assert link.status.obeys

        link.order(Order.LAND, time())
        time.run(link, 8.0, step_s=0.02)
        assert link.status.landed
        assert link.status.armed is False
    assert {name: served.copter.parameters[name] for name in CHANGED} == before


def test_px4_that_misses_a_ground_station_says_so_when_it_is_to_be_armed():
    with flight(served=ServedPx4(parameters={"NAV_DLL_ACT": 2.0})) as (served, time, link):
        link.order(Order.ARM, time())
        time.run(link, 2.0)
        ((order, why),) = link.status.refusals
        assert order is Order.ARM
        assert "temporarily rejected" in why
        assert "Preflight Fail: No connection to the ground control station" in link.status.texts
        assert not served.copter.is_armed


def test_control_is_not_asked_for_too_early_nor_refused():
    with flight(served=ServedPx4()) as (served, time, link):
        link.order(Order.TAKE_CONTROL, time())
        time.run(link, 2.0)
        assert served.copter.flown is Px4Mode.OFFBOARD
        assert not link.status.refusals
        assert not any("Offboard" in text for text in link.status.texts)


def test_silence_lands_px4_and_control_is_not_taken_back():
    with flight(served=ServedPx4()) as (served, time, link):
        take_off(time, link)
        stream(time, link, 0.5, lambda s: VelocitySetpoint(np.array([1.0, 0, 0]), 0.0))
        time.run(link, 0.25)
        assert link.status.obeys
        time.run(link, 0.5)
        assert served.copter.flown is Px4Mode.LAND
        assert link.status.is_failsafe
        assert not link.status.obeys
        time.run(link, 2.0)
        assert served.copter.flown is Px4Mode.LAND
        assert link.status.mode == "AUTO.LAND"


def test_odometry_is_turned_from_the_body_and_asked_for_again_when_it_ends():
    with flight(served=ServedPx4()) as (served, time, link):
        take_off(time, link)
        desired = np.array([1.0, 0.5, 0.2])
        stream(time, link, 1.5, lambda s: VelocitySetpoint(desired, 1.0))
        position, velocity = served.true_state()
        assert link.state.velocity == pytest.approx(velocity, abs=0.05)
        assert link.state.position == pytest.approx(position, abs=0.05)
        served.vehicle.telemetry.set_interval("ODOMETRY", None)
        stream(time, link, 0.5, lambda s: VelocitySetpoint(0 * desired, 1.0))
        assert time() - link.state.received_s > 0.45  # never a mixture of two sources
        stream(time, link, 2.0, lambda s: VelocitySetpoint(0 * desired, 1.0))
        assert time() - link.state.received_s < 0.05


def test_with_motion_capture_alone_px4_arms_and_without_its_parameters_it_is_refused():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        place = probe.getsockname()
    options = {"mocap": f"udp:127.0.0.1:{place[1]}"}
    with pytest.raises(LinkError, match="EKF2_EV_CTRL is 0, not 9"), flight(served=ServedPx4(), **options):
        pass
    indoors = ServedPx4(options=QUICK, parameters={"EKF2_EV_CTRL": 15.0, "EKF2_GPS_CTRL": 0.0})
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as camera,
        flight(served=indoors, **options) as (served, time, link),
    ):

        def watch():
            position, velocity = served.true_state()
            quat = FRAME.attitude_from_ned(np.array(served.copter.airframe.truth.attitude))
            camera.sendto(sample(time(), position, quat.tolist(), velocity_m_s=velocity.tolist()), place)

        time.run(link, 3.0, step_s=0.02, each=watch)
        assert link.status.is_estimator_ready
        assert link.state.position == pytest.approx(served.true_state()[0], abs=0.05)
        link.order(Order.ARM, time())
        time.run(link, 1.5, each=watch)
        assert link.status.armed, (link.status.refusals, link.status.texts)
        time.run(link, 0.35)
        assert time() - link.state.received_s > 0.15


def test_the_hover_throttle_of_a_flight_by_rates_is_learnt_from_what_was_sent():
    """Its ATTITUDE_TARGET keeps the thrust of the last attitude, here that of a climb."""
    with flight(served=ServedPx4(), flies_rates=True) as (served, time, link):
        take_off(time, link)
        up = np.array([0.0, 0.0, 2.0])
        stream(time, link, 0.4, lambda s: AccelerationSetpoint(up, s.velocity, s.position, 0.0))
        stream(time, link, 6.0, lambda s: RatesSetpoint(G - 0.6 * s.velocity[2], np.zeros(3)))
        assert link.hover.newest == pytest.approx(served.copter.attitude.throttle_command, abs=0.01)
        assert link.hover.value == pytest.approx(served.copter.hover_throttle, rel=0.02)
