"""Quaternions against SciPy's."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from alula.stages.rotation import matrix_from_quat_wxyz, multiply_quat_wxyz, quat_wxyz_from_matrix
from support.effort import examples

unit = (
    arrays(np.float64, (4,), elements=st.sampled_from([0.0, 1.0, -1.0, 1e-8, 0.3, -0.7]) | st.floats(-1, 1))
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: q / np.linalg.norm(q))
)


def scipy(q):
    return Rotation.from_quat(np.roll(q, -1, axis=-1))


@settings(deadline=None)
@given(unit)
def test_matrices_are_those_of_scipy(q):
    np.testing.assert_allclose(matrix_from_quat_wxyz(q), scipy(q).as_matrix(), atol=1e-15)


@settings(deadline=None, max_examples=examples(200))
@given(unit)
def test_back_from_the_matrix_up_to_sign(q):
    found = quat_wxyz_from_matrix(matrix_from_quat_wxyz(q))
    assert found[0] >= 0
    np.testing.assert_allclose(found * np.sign(found @ q), q, atol=5e-15)


@settings(deadline=None)
@given(unit, unit)
def test_products_are_those_of_matrices(p, q):
    product = multiply_quat_wxyz(p, q)
    expected = matrix_from_quat_wxyz(p) @ matrix_from_quat_wxyz(q)
    np.testing.assert_allclose(matrix_from_quat_wxyz(product), expected, atol=3e-15)


def test_many_at_once_equal_one_by_one():
    q = np.random.default_rng(0).normal(size=(5, 3, 4))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    matrices = matrix_from_quat_wxyz(q)
    assert matrices.shape == (5, 3, 3, 3)
    np.testing.assert_array_equal(matrices[2, 1], matrix_from_quat_wxyz(q[2, 1]))
    np.testing.assert_array_equal(
        quat_wxyz_from_matrix(matrices)[2, 1], quat_wxyz_from_matrix(matrices[2, 1])
    )
    np.testing.assert_array_equal(multiply_quat_wxyz(q[0, 0], q)[2, 1], multiply_quat_wxyz(q[0, 0], q[2, 1]))
