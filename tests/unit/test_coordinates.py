"""Coordinates far from the origin: bounds of their rounding, and origins that are nearer."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.stages.coordinates import nearer_origin, single_rounding

coordinate = st.floats(-1e8, 1e8)


@given(st.tuples(coordinate, coordinate, coordinate))
def test_a_point_is_within_the_bound_of_its_single_precision_number(point):
    exact = [Fraction(x) for x in point]
    stored = np.array([point], np.float32)
    (bound,) = single_rounding(stored)
    square = sum((x - Fraction(float(y))) ** 2 for x, y in zip(exact, stored[0], strict=True))
    assert square <= Fraction(float(bound)) ** 2 * (1 + Fraction(1, 10**12))


def test_finer_numbers_have_no_rounding():
    points = np.array([[450000.3, 4500000.7, 100.0], [1.0, 2.0, 3.0]])
    assert single_rounding(points).tolist() == [0.0, 0.0]
    assert single_rounding(points.astype(np.float32).astype(np.float64))[0] == pytest.approx(0.2505, abs=1e-3)


def test_numbers_beyond_single_precision_do_not_warn():
    assert single_rounding(np.array([[1e300, 0.0, 0.0]])).tolist() == [0.0]
    largest = float(np.finfo(np.float32).max)
    assert single_rounding(np.array([[largest, 0.0, 0.0]]))[0] >= largest * 2.0**-24


def test_an_origin_is_chosen_only_along_axes_that_are_far():
    low, high = np.array([449_990.0, -5.0, 90.0]), np.array([450_020.0, 5.0, 110.0])
    assert nearer_origin(low, high, 8192.0) == (450_000.0, 0.0, 0.0)
    assert nearer_origin(low, high, 1e6) == (0.0, 0.0, 0.0)
    assert nearer_origin(np.full(3, -8192.5), np.full(3, -8192.0), 8192.0) == (-8200.0,) * 3
