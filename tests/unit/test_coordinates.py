"""Coordinates far from the origin: bounds of their rounding, and origins that are nearer."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.stages.coordinates import nearer_origin, single_rounding, spacing

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
    assert single_rounding(np.array([[largest, 0.0, 0.0]]))[0] == pytest.approx(2.0**103, rel=1e-12)


def test_an_origin_is_chosen_only_along_axes_that_are_far():
    low, high = np.array([449_990.0, -5.0, 90.0]), np.array([450_020.0, 5.0, 110.0])
    assert nearer_origin(low, high, 8192.0) == (450_000.0, 0.0, 0.0)
    assert nearer_origin(low, high, 1e6) == (0.0, 0.0, 0.0)
    assert nearer_origin(np.full(3, -8192.5), np.full(3, -8192.0), 8192.0) == (-8200.0,) * 3


@pytest.mark.parametrize(("form", "bits", "least"), [(np.float16, 11, -24), (np.float32, 24, -149)])
def test_the_spacing_of_numbers_is_that_of_their_exponent_up_to_the_largest(form, bits, least):
    largest = np.finfo(form).max
    sizes = np.array([2.0**least, 2.0 ** (least + bits), 1.0, -2.5, float(largest) / 2, largest], form)
    steps = [2.0 ** max(math.frexp(abs(float(size)))[1] - bits, least) for size in sizes]
    assert spacing(sizes).tolist() == steps


def test_numbers_that_are_not_finite_have_no_spacing():
    assert np.isnan(spacing(np.array([np.inf, -np.inf, np.nan], np.float32))).all()
