"""Bounds on polynomials in rational arithmetic, against the polynomials themselves."""

from fractions import Fraction
from math import comb

import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.stages.planning.exact import ball, half_space, holds

ORIGIN = (Fraction(0),) * 3


def at(points, t):
    """The point of a Bezier curve, from Bernstein polynomials."""
    n = len(points) - 1
    weights = [comb(n, i) * t**i * (1 - t) ** (n - i) for i in range(n + 1)]
    return tuple(sum(w * p[k] for w, p in zip(weights, points, strict=True)) for k in range(3))


@pytest.mark.parametrize("bulge", [2, 6])
def test_a_curve_that_leaves_the_set_in_one_half_alone_is_not_proven(bulge):
    points = [ORIGIN] * 9
    points[bulge] = (Fraction(10), Fraction(0), Fraction(0))
    most = max(at(points, Fraction(k, 64))[0] for k in range(65))
    other = max(at(points, Fraction(k, 64))[0] for k in (range(32, 65) if bulge == 2 else range(33)))
    assert other < Fraction(27, 10) < most
    assert not holds(points, ball(2.7))
    assert not holds(points, half_space((1, 0, 0), 2.7))
    assert holds(points, ball(float(most) * 1.001))


whole = st.integers(-8, 8).map(Fraction)


@given(st.lists(st.tuples(whole, whole, whole), min_size=4, max_size=8), st.integers(1, 12))
def test_what_is_proven_holds_at_every_sampled_time(points, radius):
    inside = ball(radius)
    if holds(points, inside, 5):
        assert all(inside(at(points, Fraction(k, 37))) for k in range(38))
