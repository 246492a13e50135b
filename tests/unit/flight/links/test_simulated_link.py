"""Addresses, the registry, and `sim:` on the clock of the test."""

from __future__ import annotations

import math
from importlib.metadata import EntryPoint

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.schemas.errors import LinkError, UsageError
from alula.schemas.scenarios.vehicle import BodyTable, LimitsTable, Vehicle
from alula.stages.flight.links import open_link as registry
from alula.stages.flight.links.addresses import check_address, parse_address
from alula.stages.flight.links.mavlink.hover import HoverThrottle, hover_from, throttle_of
from alula.stages.flight.links.open_link import link_schemes, open_link
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order, VehicleState
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, VelocitySetpoint

G = 9.81


@pytest.mark.parametrize(
    "text",
    [
        "udpin:127.0.0.1:14550",
        "udpout:127.9.8.7:14540",
        "tcp:localhost:5760",
        "tcp:[::1]:5760",
        "udp:127.0.0.1:9763",
        "serial:/dev/ttyACM0:921600",
        "sim:",
        "sim:?delay_ms=3",
        "radio://0/80/2M",
    ],
)
def test_what_stays_here_needs_no_permission(text):
    check_address(text, allow_remote=False)


@pytest.mark.parametrize(
    "text",
    [
        "udpin:0.0.0.0:14550",
        "udpin:[::]:14550",
        "udpout:192.168.1.5:14540",
        "tcp:127.0.0.1.example.org:5760",
        "tcp:drone:5760",
        "udpout:2130706433:14540",
        "udpout:[fe80::1]:14540",
        "pigeon:127.0.0.1:1",
    ],
)
def test_what_leaves_this_machine_needs_permission(text):
    with pytest.raises(UsageError, match="allow-remote"):
        check_address(text, allow_remote=False)
    check_address(text, allow_remote=True)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not a vehicle address"),
        ("/dev/ttyACM0", "not a vehicle address"),
        ("udpin:127.0.0.1", "HOST:PORT"),
        ("udpin:127.0.0.1:0", "HOST:PORT"),
        ("udpin:127.0.0.1:99999", "HOST:PORT"),
        ("tcp:127.0.0.1:http", "HOST:PORT"),
        ("sim:?delay_ms", "name=value"),
        ("sim:?seed=1&seed=2", "given twice"),
        ("sim:?colour=red", "no option 'colour'"),
        ("sim:?noise=much", "expected 1 number"),
        ("sim:?delay_ms=-1", "between 0 and 1000"),
        ("sim:?start=1,2", "expected 3 numbers"),
        ("sim:here", "write the options after"),
        ("udpout:127.0.0.1:1?colour=red", "no option 'colour'"),
        ("pigeon:post", "no link is called 'pigeon'"),
    ],
)
def test_a_wrong_address_is_one_line(text, words):
    with pytest.raises(UsageError, match=words) as caught:
        open_link(text)
    assert "\n" not in str(caught.value)


@settings(deadline=None)
@given(st.text(max_size=40))
def test_no_text_breaks_the_parser(text):
    for function in (parse_address, lambda each: check_address(each, False)):
        try:
            function(text)
        except UsageError:
            continue


def test_the_rule_holds_for_links_and_for_motion_capture():
    with pytest.raises(UsageError, match="allow-remote"):
        open_link("udpin:0.0.0.0:14550")
    with pytest.raises(UsageError, match="allow-remote"):
        open_link("udpin:127.0.0.1:14550", LinkOptions(mocap="udp:0.0.0.0:9763"))
    open_link("udpin:0.0.0.0:14550", LinkOptions(allow_remote=True))


def test_other_packages_provide_links(monkeypatch):
    point = EntryPoint("pigeon", "collections:OrderedDict", registry.ENTRY_POINTS)
    broken = EntryPoint("owl", "no_such_module:make", registry.ENTRY_POINTS)
    monkeypatch.setattr(registry, "entry_points", lambda group: [point, broken])
    assert link_schemes() == [
        "udpin",
        "udpout",
        "tcp",
        "serial",
        "sim",
        "radio",
        "usb",
        "udp",
        "owl",
        "pigeon",
    ]
    with pytest.raises(UsageError, match="cannot be loaded"):
        open_link("owl:", LinkOptions(allow_remote=True))
    with pytest.raises(TypeError):  # it was called, with an address and options
        open_link("pigeon:", LinkOptions(allow_remote=True))


class Clock:
    def __init__(self):
        self.now = 50.0

    def __call__(self):
        return self.now


def sim(query="", **options):
    clock = Clock()
    link = open_link(f"sim:{query}", LinkOptions(clock=clock, **options))
    link.open(1.0)
    assert link.prepare() == []
    return clock, link


def run(clock, link, seconds, setpoint=None):
    for _ in range(round(seconds * 100)):
        clock.now += 0.01
        link.poll(clock.now)
        if setpoint is not None:
            link.send(setpoint(link.state) if callable(setpoint) else setpoint, clock.now)


def airborne(query="", **options):
    clock, link = sim(query, **options)
    link.order(Order.ARM, clock.now)
    link.order(Order.TAKE_OFF, clock.now, 1.5)
    run(clock, link, 5.0)
    return clock, link


@pytest.mark.parametrize("query", ["?start=1,2,0.5&yaw=0.7", "?start=1,2,0.5&yaw=0.7&noise=1&delay_ms=10"])
def test_it_takes_off_flies_holds_and_lands(query):
    clock, link = airborne(query)
    assert link.status.landed is False
    assert link.state.position == pytest.approx([1, 2, 2.0], abs=0.08)
    link.order(Order.TAKE_CONTROL, clock.now)
    assert link.status.obeys
    run(clock, link, 2.0, VelocitySetpoint(np.array([1.0, 0, 0]), 0.7))
    assert link.state.velocity == pytest.approx([1, 0, 0], abs=0.15)
    run(clock, link, 3.0)
    assert np.linalg.norm(link.state.velocity) < 0.2
    link.order(Order.LAND, clock.now)
    assert not link.status.obeys
    run(clock, link, 8.0)
    assert link.status.landed
    assert link.status.armed is False
    assert link.body.impact_m_s < 0.8
    assert link.state.position[2] == 0.5


def test_rates_turn_it_as_asked_and_thrust_carries_it():
    clock, link = airborne("?yaw=1.0")
    link.order(Order.TAKE_CONTROL, clock.now)
    before = link.state
    run(clock, link, 0.2, RatesSetpoint(G, np.array([0.5, 0.0, 0.0])))
    assert link.state.omega == pytest.approx([0.5, 0, 0], abs=0.02)
    turned = Rotation.from_quat(np.roll(before.attitude_wxyz, -1)).inv() * Rotation.from_quat(
        np.roll(link.state.attitude_wxyz, -1)
    )
    assert turned.as_rotvec() == pytest.approx([0.5 * 0.18, 0, 0], abs=0.012)
    right = Rotation.from_euler("z", 1.0).apply([0, -1.0, 0])  # rolled to the right it goes right
    assert link.state.velocity @ right > 0.02


def test_accelerations_are_flown():
    clock, link = airborne()
    link.order(Order.TAKE_CONTROL, clock.now)
    desired = np.array([0.5, -0.3, 0.2])
    run(clock, link, 0.5, lambda s: AccelerationSetpoint(desired, s.velocity, s.position, 0.0))
    start = link.state.velocity
    run(clock, link, 1.0, lambda s: AccelerationSetpoint(desired, s.velocity, s.position, 0.0))
    assert link.state.velocity - start == pytest.approx(desired, abs=0.05)


def test_points_fly_what_they_can():
    body = BodyTable(radius_m=0.1)
    slow = Vehicle(name="p", model="single-integrator", body=body, limits=LimitsTable(max_speed_m_s=2.0))
    clock, link = airborne(vehicle=slow)
    assert link.accepts == {VelocitySetpoint}
    assert link.state.position == pytest.approx([0, 0, 1.5], abs=0.02)
    run(clock, link, 1.0, VelocitySetpoint(np.array([1.0, 0, 0]), 0.0))
    assert link.state.position[0] == pytest.approx(1.0, abs=0.02)
    with pytest.raises(LinkError, match="takes no RatesSetpoint"):
        link.send(RatesSetpoint(G, np.zeros(3)), clock.now)
    point = Vehicle(
        name="q", model="double-integrator", body=body, limits=LimitsTable(max_acceleration_m_s2=5.0)
    )
    clock, link = airborne(vehicle=point)
    assert link.accepts == {VelocitySetpoint, AccelerationSetpoint}
    assert link.state.position == pytest.approx([0, 0, 1.5], abs=0.05)


def test_what_is_no_number_is_refused_and_orders_that_make_no_sense_too():
    clock, link = sim()
    with pytest.raises(LinkError, match="omega"):
        link.send(RatesSetpoint(G, np.array([0, math.nan, 0])), clock.now)
    link.order(Order.TAKE_OFF, clock.now, 1.0)
    assert link.status.refusals == [(Order.TAKE_OFF, "it is not armed")]
    with pytest.raises(LinkError, match="heights are above 0"):
        link.order(Order.TAKE_OFF, clock.now, math.nan)
    clock, link = airborne()
    link.order(Order.DISARM, clock.now)
    assert link.status.refusals == [(Order.DISARM, "it is in the air")]
    assert link.status.armed


def test_a_late_poll_catches_up_only_so_far():
    clock, link = airborne()
    clock.now += 3.0
    link.poll(clock.now)
    assert any("skipped 2.75 s" in text for text in link.status.texts)
    assert link.state.received_s == pytest.approx(clock.now, abs=0.003)


def test_equal_seeds_give_equal_flights_and_noise_is_as_large_as_told():
    states = [airborne("?noise=2&seed=7")[1].state.position for _ in range(2)]
    assert (states[0] == states[1]).all()
    clock, link = airborne("?noise=2&seed=8")
    errors = []
    for _ in range(300):
        run(clock, link, 0.01)
        errors.append(link.state.position - link.body.position)
    assert np.std(errors) == pytest.approx(0.01, rel=0.15)


def test_hover_throttle_is_found_in_flight_slowly_and_within_bounds():
    assert throttle_of(2 * G, 0.35, G) == 0.7
    assert hover_from(0.7, 2 * G, G) == pytest.approx(0.35)
    for true, initial, expected in ((0.40, 0.35, 0.40), (0.6, 0.35, 0.525), (0.25, 0.4, 0.4 / 1.5)):
        hover = HoverThrottle(initial, G, tau_s=5.0)
        assert hover.throttle(G) == pytest.approx(initial)  # it is used from now on
        velocity, last = np.zeros(3), hover.value
        for k in range(12000):
            now = k * 0.01
            throttle = hover.value * (1 + 0.1 * math.sin(now))
            hover.record(throttle, now)
            velocity = velocity + np.array([0, 0, (throttle / true - 1) * G]) * 0.01
            quat = np.array([1.0, 0, 0, 0])
            hover.update(VehicleState(now, np.zeros(3), velocity.copy(), quat, np.zeros(3)))
            assert abs(hover.value - last) <= 0.02 * 0.3 * hover.value
            last = hover.value
        assert hover.value == pytest.approx(expected, rel=0.03)
    with pytest.raises(ValueError, match="between"):
        HoverThrottle(0.0)
