"""Set-points and address options of a Crazyflie, without a vehicle."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.schemas.errors import LinkError, UsageError
from alula.stages.flight.links.crazyflie.setpoints import LEAD_S, SetpointEncoder
from alula.stages.flight.links.open_link import open_link
from alula.stages.flight.links.options import Limits, LinkOptions
from alula.stages.rotation import matrix_from_quat_wxyz
from alula.stages.vehicles.frames import LocalFrame
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, VelocitySetpoint

G = 9.81


def encoder(frame: LocalFrame | None = None, **limits) -> SetpointEncoder:
    return SetpointEncoder(frame or LocalFrame(), Limits(**limits), G)


def request(acceleration=(0, 0, 0), velocity=(0, 0, 0), position=(0, 0, 0), yaw=0.0) -> AccelerationSetpoint:
    return AccelerationSetpoint(np.array(acceleration), np.array(velocity), np.array(position), yaw)


vectors = st.tuples(*3 * [st.floats(-6, 6)])


@given(vectors, st.floats(-3, 3), st.floats(-3, 3))
@settings(deadline=None)
def test_the_attitude_pushes_along_the_acceleration_and_has_the_heading(push, yaw, turn) -> None:
    frame = LocalFrame(turn, (1.0, -2.0, 0.5))
    sent = encoder(frame).full_state(request(push, yaw=yaw), 0.0)
    quat = np.array(sent.attitude_wxyz)
    assert np.linalg.norm(quat) == pytest.approx(1)
    axes = matrix_from_quat_wxyz(quat)
    there = Rotation.from_euler("z", turn).apply(push)
    assert np.allclose(sent.acceleration, there)
    thrust = there + np.array([0, 0, G])
    assert np.allclose(axes[:, 2], thrust / np.linalg.norm(thrust), atol=1e-9)
    along = np.array([math.cos(yaw + turn), math.sin(yaw + turn), 0])
    assert axes[:, 1] @ along == pytest.approx(0, abs=1e-9)  # y is perpendicular to the heading
    assert axes[:, 0] @ along > 0
    assert np.allclose(
        sent.position,
        Rotation.from_euler("z", turn).apply(0.5 * LEAD_S**2 * np.array(push)) + np.array([1.0, -2.0, 0.5]),
    )


def test_position_and_velocity_are_taken_on_to_when_they_are_flown() -> None:
    sent = encoder().full_state(request((2, 0, 1), (3, 0, 0), (1, 1, 1)), 0.0)
    assert np.allclose(sent.velocity, (3 + 2 * LEAD_S, 0, LEAD_S))
    assert np.allclose(sent.position, (1 + 3 * LEAD_S + LEAD_S**2, 1, 1 + 0.5 * LEAD_S**2))


def test_rates_are_those_of_the_attitude_that_turns() -> None:
    steps, dt = encoder(), 0.01
    before = None
    for k in range(200):
        angle = 1.5 * k * dt
        sent = steps.full_state(
            request((2 * math.cos(angle), 2 * math.sin(angle), 0.5 * math.sin(angle))), k * dt
        )
        now = Rotation.from_quat(np.array(sent.attitude_wxyz)[[1, 2, 3, 0]])
        if before is not None and k > 100:
            true = (before.inv() * now).as_rotvec() / dt
            assert np.allclose(sent.omega[:2], true[:2], atol=0.05)  # smoothed over 50 ms
        before = now


def test_what_does_not_fit_16_bits_is_refused() -> None:
    with pytest.raises(LinkError, match=r"position\.y is -33 m; a Crazyflie takes up to 32\.767"):
        encoder().full_state(request(position=(0, -33, 0)), 0.0)
    moved = LocalFrame(0.0, (30.0, 0.0, 0.0))
    with pytest.raises(LinkError, match=r"position\.x is 35 m"):
        encoder(moved).full_state(request(position=(5, 0, 0)), 0.0)
    with pytest.raises(LinkError, match=r"acceleration\.z is 33 m/s\^2"):
        encoder(acceleration_m_s2=40.0).full_state(request((0, 0, 33)), 0.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused(bad: float) -> None:
    for field in ("acceleration", "velocity", "position"):
        with pytest.raises(LinkError, match=f"{field}.y is {bad}"):
            encoder().full_state(request(**{field: (0, bad, 0)}), 0.0)
    with pytest.raises(LinkError, match="yaw_rad"):
        encoder().full_state(request(yaw=bad), 0.0)
    with pytest.raises(LinkError, match=r"velocity\.x"):
        encoder().velocity(VelocitySetpoint(np.array([bad, 0, 0]), 0.0), 0.0, 0.0)


def test_limits_clip_slow_down_and_refuse() -> None:
    steps = encoder(acceleration_m_s2=5.0, acceleration_slew_m_s3=100.0)
    assert np.allclose(steps.full_state(request((8, 0, 0)), 0.0).acceleration, (5, 0, 0))
    assert np.allclose(steps.full_state(request((-4, 0, 0)), 0.01).acceleration, (4, 0, 0))
    assert steps.clipped == 2
    with pytest.raises(LinkError, match=r"acceleration\.x is 11, the limit 5"):
        steps.full_state(request((11, 0, 0)), 0.02)


def test_a_velocity_turns_towards_the_heading_by_the_short_way() -> None:
    frame = LocalFrame(math.pi / 2)
    sent, rate = encoder(frame).velocity(VelocitySetpoint(np.array([1.0, 0, 0.5]), -3.0), 3.0, 0.0)
    assert np.allclose(sent, (0, 1, 0.5))
    assert rate == pytest.approx(math.degrees(2 * (2 * math.pi - 6)))


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("udp://127.0.0.1", "HOST:PORT"),
        ("udp://10.0.0.1:19850", "--allow-remote"),
        ("radio://0/80/2M?controller=best", "controller=best"),
        ("radio://0/80/2M?controller=9", "controller=9"),
        ("radio://0/80/2M?setpoints=fast", "setpoints=fast"),
        ("radio://0/80/2M?controller=pid&setpoints=full-state", "does not follow"),
        ("radio://0/80/2M?watchdog=yes", "watchdog=yes"),
        ("radio://0/80/2M?alula.radius=wide", "alula.radius=wide"),
        ("radio://0/80/2M?colour=red", "colour"),
    ],
)
def test_addresses_that_mean_nothing_are_refused(address: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        open_link(address)


def test_what_a_controller_flies_is_what_the_link_accepts() -> None:
    for options, kind in (
        ("", AccelerationSetpoint),
        ("?controller=lee", AccelerationSetpoint),
        ("?controller=oot", VelocitySetpoint),
        ("?controller=7&setpoints=velocity", VelocitySetpoint),
    ):
        link = open_link(f"radio://0/80/2M/E7E7E7E7E7{options}", LinkOptions())
        assert link.accepts == {kind}
        with pytest.raises(LinkError):
            link.send(RatesSetpoint(9.8, np.zeros(3)), 0.0)


def test_without_cflib_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "cflib", None)
    with pytest.raises(UsageError, match=r"pip install 'alula\[crazyflie\]'"):
        open_link("udp://127.0.0.1:19850")
