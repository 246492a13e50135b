"""Grown ellipsoids in rational arithmetic: all voxels that the true sum touches are marked; verify agrees."""

import math
from fractions import Fraction

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from alula import _core
from support.effort import examples
from support.models.exact_voxels import AXES, PLACES, TURNS, rotation

SIZES = st.sampled_from([0.0625, 0.05])
RADII = st.sampled_from([1e-12, 1e-6, 1e-3, 0.0078125, 0.03125, 0.0625, 0.11, 0.3])
SMALL = AXES.filter(lambda a: a < 1)
SHARES = st.sampled_from([0.0, 1e-9, 1e-6, 1e-3, 0.03, 0.3])


def fractions(values):
    return [Fraction(float(v)) for v in values]


def marked_by(mean, scale, quat, g, r, loss=None, sigma=1.0):
    """The voxels of one row, which verify must prove to be all."""
    rows = [np.array([v], np.float32) for v in (mean, scale, quat)]
    loss = None if loss is None else np.array([loss], np.float32)
    index, *_ = _core.voxelize(*rows, sigma, g, r, loss=loss)
    assert _core.unproven_voxels(*rows, sigma, g, r, None, 1, index, loss=loss)[0] == 0
    return set(map(tuple, index.tolist()))


def cells_at(place, g):
    """The closed voxels that hold a point, exactly."""
    found = [()]
    for x in place:
        cell = x / Fraction(g)
        last = math.floor(cell)
        found = [(*f, c) for f in found for c in ({last, last - 1} if cell == last else {last})]
    return found


def unit(a, b):
    """A rational unit vector, by stereographic projection."""
    n = 1 + a * a + b * b
    return [2 * a / n, 2 * b / n, (n - 2) / n]


@settings(max_examples=examples(150), deadline=None)
@given(
    mean=st.tuples(PLACES, PLACES, PLACES),
    radius=st.sampled_from([1e-6, 0.0078125, 0.03125, 0.11]),
    corner=st.tuples(*[st.integers(-4, 4)] * 3),
    signs=st.tuples(*[st.sampled_from([-1, 0, 1])] * 3),
    quat=TURNS,
    g=SIZES,
)
def test_a_grown_sphere_marks_the_voxel_that_it_only_just_touches(mean, radius, corner, signs, quat, g):
    centre, radius = fractions(np.array(mean, np.float32)), np.float32(radius)
    base = [math.floor(c / Fraction(g)) for c in centre]
    cell = [b + c for b, c in zip(base, corner, strict=True)]
    nearest = [min(max(c, i * Fraction(g)), (i + 1) * Fraction(g)) for c, i in zip(centre, cell, strict=True)]
    square = sum((c - n) ** 2 for c, n in zip(centre, nearest, strict=True))
    r = math.sqrt(square) - float(radius)
    assume(r > 0)
    while (Fraction(float(radius)) + Fraction(r)) ** 2 < square:
        r += math.ulp(math.sqrt(square))  # not of r, which may be far smaller than its error
    assert tuple(cell) in marked_by(mean, [radius] * 3, quat, g, r)


@settings(max_examples=examples(150), deadline=None)
@given(
    mean=st.tuples(PLACES, PLACES, PLACES),
    scale=st.tuples(SMALL, SMALL, SMALL),
    quat=TURNS,
    g=SIZES,
    axis=st.integers(0, 2),
    ahead=st.integers(1, 3),
)
def test_the_tip_of_a_sum_marks_the_plane_that_it_only_just_reaches(mean, scale, quat, g, axis, ahead):
    centre, semi = fractions(np.array(mean, np.float32)), fractions(np.array(scale, np.float32))
    turn = rotation(np.array(quat, np.float32))
    square = sum((turn[axis][j] * semi[j]) ** 2 for j in range(3))  # of the half-width
    cell = math.floor((centre[axis] + Fraction(math.sqrt(square))) / Fraction(g)) + ahead
    r = float(cell * Fraction(g) - centre[axis]) - math.sqrt(square)
    assume(r > 0)
    while (gap := cell * Fraction(g) - centre[axis] - Fraction(r)) > 0 and square < gap * gap:
        r += math.ulp(math.sqrt(square) + r)  # not of r, which may be far smaller than its error
    assert max(voxel[axis] for voxel in marked_by(mean, scale, quat, g, r)) >= cell


@settings(max_examples=examples(150), deadline=None)
@given(
    mean=st.tuples(PLACES, PLACES, PLACES),
    scale=st.tuples(SMALL, SMALL, SMALL),
    quat=TURNS,
    g=SIZES,
    r=RADII,
    loss=st.tuples(SHARES, SHARES, SHARES),
    sigma=st.sampled_from([1.0, 0.5, 2.7]),
    seed=st.integers(0, 2**32 - 1),
)
def test_whatever_a_row_may_stand_for_lies_in_its_voxels(mean, scale, quat, g, r, loss, sigma, seed):
    marked = marked_by(mean, scale, quat, g, r, loss, sigma)
    rng = np.random.default_rng(seed)
    moved, grown, turned = fractions(np.array(loss, np.float32))
    stored = rotation(np.array(quat, np.float32))
    for _ in range(6):
        a, b, c, d = (Fraction(float(v)).limit_denominator(64) for v in rng.normal(size=4) * 2)
        push, hinge = unit(a, b), unit(c, d)
        other = rotation([1, *(float(turned) / 2 * (1 - 1e-9) * float(h) for h in hinge)])
        turn = [[sum(other[i][k] * stored[k][j] for k in range(3)) for j in range(3)] for i in range(3)]
        signs = rng.choice([-1, 1, 1], 3).tolist()
        semi = [
            Fraction(sigma) * s * (1 + sign * grown)
            for s, sign in zip(fractions(np.array(scale, np.float32)), signs, strict=True)
        ]
        centre = [c + moved * p for c, p in zip(fractions(np.array(mean, np.float32)), push, strict=True)]
        for _ in range(6):
            a, b = (Fraction(float(v)).limit_denominator(64) for v in rng.normal(size=2))
            n = unit(a, b)
            pull = [semi[j] * sum(turn[i][j] * n[i] for i in range(3)) for j in range(3)]
            length = Fraction(math.sqrt(sum(float(v) ** 2 for v in pull)) or 1) * (1 + Fraction(1, 2**45))
            u = [v / length for v in pull]  # the farthest point along n, or just inside
            assert sum(v * v for v in u) <= 1
            place = [
                centre[i] + sum(turn[i][j] * semi[j] * u[j] for j in range(3)) + Fraction(r) * n[i]
                for i in range(3)
            ]
            for cell in cells_at(place, g):
                assert cell in marked, (cell, place)
