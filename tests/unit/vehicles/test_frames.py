"""Frames of autopilots, held against scipy's rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from alula.stages.vehicles.frames import LocalFrame, flipped_body

angles = st.floats(-10, 10)
lengths = st.floats(-1e3, 1e3)
triples = st.tuples(lengths, lengths, lengths)
NED_FROM_ENU = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_FROM_FLU = Rotation.from_matrix(np.diag([1, -1, -1]))


def _quat(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat()[[3, 0, 1, 2]]


def _rotation(quat: np.ndarray) -> Rotation:
    return Rotation.from_quat(quat[[1, 2, 3, 0]])


@given(angles, triples, triples)
def test_positions_and_vectors_agree_with_scipy_and_come_back(yaw, origin, p):
    frame = LocalFrame(yaw, origin)
    enu_from_world = Rotation.from_euler("z", yaw)
    np.testing.assert_allclose(
        frame.position_to_ned(p), NED_FROM_ENU.apply(enu_from_world.apply(p) + origin), atol=1e-9
    )
    np.testing.assert_allclose(frame.vector_to_ned(p), NED_FROM_ENU.apply(enu_from_world.apply(p)), atol=1e-9)
    np.testing.assert_allclose(frame.position_from_ned(frame.position_to_ned(p)), p, atol=1e-9)
    np.testing.assert_allclose(frame.vector_from_ned(frame.vector_to_ned(p)), p, atol=1e-9)


@given(angles, st.integers(0, 2**32 - 1))
def test_attitudes_agree_with_scipy_and_come_back(yaw, seed):
    attitude = Rotation.random(random_state=seed)
    frame = LocalFrame(yaw)
    ned = frame.attitude_to_ned(_quat(attitude))
    expected = NED_FROM_ENU * Rotation.from_euler("z", yaw) * attitude * FRD_FROM_FLU
    assert ned[0] >= 0
    assert (_rotation(ned).inv() * expected).magnitude() < 1e-12
    assert (_rotation(frame.attitude_from_ned(ned)).inv() * attitude).magnitude() < 1e-12


@given(angles, st.floats(-math.pi, math.pi))
def test_yaw_is_the_heading_of_the_nose(frame_yaw, yaw):
    frame = LocalFrame(frame_yaw)
    north, east, _ = frame.vector_to_ned([math.cos(yaw), math.sin(yaw), 0.0])
    heading = frame.yaw_to_ned(yaw)
    assert -math.pi <= heading <= math.pi
    assert math.isclose(math.cos(heading), north, abs_tol=1e-9)
    assert math.isclose(math.sin(heading), east, abs_tol=1e-9)


@given(triples, st.integers(0, 2**32 - 1))
def test_body_vectors_turn_into_the_same_world_vector(omega, seed):
    """A body vector in either convention is one vector in the local frame."""
    attitude = Rotation.random(random_state=seed)
    frame = LocalFrame(0.3)
    ours = frame.vector_to_ned(attitude.apply(omega))
    theirs = _rotation(frame.attitude_to_ned(_quat(attitude))).apply(flipped_body(omega))
    np.testing.assert_allclose(theirs, ours, atol=1e-9)


@pytest.mark.parametrize(
    ("ours", "ned"), [((1, 0, 0), (0, 1, 0)), ((0, 1, 0), (1, 0, 0)), ((0, 0, 1), (0, 0, -1))]
)
def test_east_north_up_is_what_it_says(ours, ned):
    np.testing.assert_array_equal(LocalFrame().position_to_ned(ours), ned)


def test_many_at_once():
    points = np.random.default_rng(0).normal(size=(4, 5, 3))
    frame = LocalFrame(1.0, (1.0, 2.0, 3.0))
    many = frame.position_to_ned(points)
    np.testing.assert_allclose(many[2, 3], frame.position_to_ned(points[2, 3]))
