"""Every single mark against rational arithmetic: never missing, never farther than the stated margin."""

import itertools
from fractions import Fraction

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from alula import _core

OUTWARD = Fraction(5 * 512, 2**53)  # 5 q / E of voxelize.hpp: no voxel farther than this is marked


def rotation(q):
    w, x, y, z = (Fraction(float(v)) for v in q)
    n = w * w + x * x + y * y + z * z
    return [
        [1 - 2 * (y * y + z * z) / n, 2 * (x * y - w * z) / n, 2 * (x * z + w * y) / n],
        [2 * (x * y + w * z) / n, 1 - 2 * (x * x + z * z) / n, 2 * (y * z - w * x) / n],
        [2 * (x * z - w * y) / n, 2 * (y * z + w * x) / n, 1 - 2 * (x * x + y * y) / n],
    ]


def form_of(scale, quat):
    """inv(Sigma), exactly."""
    r = rotation(quat)
    inverse = [1 / Fraction(float(s)) ** 2 for s in scale]
    return [[sum(r[i][k] * inverse[k] * r[j][k] for k in range(3)) for j in range(3)] for i in range(3)]


def touches(form, centre, cell, g, grown=Fraction(0)):
    """Whether the least value of the form over the cell, grown on all sides, is at most 1."""
    lower = [cell[i] * Fraction(g) - centre[i] - grown for i in range(3)]
    upper = [(cell[i] + 1) * Fraction(g) - centre[i] + grown for i in range(3)]
    for state in itertools.product((0, 1, 2), repeat=3):
        free = [i for i in range(3) if state[i] == 2]
        x = [(lower[i], upper[i], Fraction(0))[state[i]] for i in range(3)]
        rhs = [-sum(form[f][j] * x[j] for j in range(3)) for f in free]
        if len(free) == 1:
            x[free[0]] = rhs[0] / form[free[0]][free[0]]
        elif len(free) == 2:
            f, h = free
            det = form[f][f] * form[h][h] - form[f][h] ** 2
            x[f] = (rhs[0] * form[h][h] - rhs[1] * form[f][h]) / det
            x[h] = (rhs[1] * form[f][f] - rhs[0] * form[f][h]) / det
        if all(lower[i] <= x[i] <= upper[i] for i in free):
            value = sum(form[i][j] * x[i] * x[j] for i in range(3) for j in range(3))
            if value <= 1:
                return True
    return False


AXES = st.sampled_from([1e-12, 1e-6, 1e-3, 0.0078125, 0.03125, 0.05, 0.11, 0.25, 100.0])
TURNS = st.one_of(
    st.sampled_from(
        [
            (1, 0, 0, 0),
            (1, 1, 0, 0),
            (1, 0, 1, 0),
            (1, 0, 0, 1),
            (1, 1, 1, 1),
            (0, 1, 0, 0),
            (1, 1e-8, 0, 1e-5),
        ]
    ),
    st.tuples(*[st.floats(-1, 1, width=32)] * 4).filter(lambda q: sum(v * v for v in q) > 1e-3),
)
PLACES = st.one_of(  # on the lattice, within a voxel, far away
    st.integers(-3, 3).map(lambda i: i * 0.0625), st.floats(-0.25, 0.25, width=32), st.just(1e4)
)


@settings(max_examples=120, deadline=None)
@given(
    mean=st.tuples(PLACES, PLACES, PLACES),
    scale=st.tuples(AXES, AXES, AXES),
    quat=TURNS,
    g=st.sampled_from([0.0625, 0.05]),
    seed=st.integers(0, 2**32 - 1),
)
@example(mean=(0.0625, 0.0, 0.0), scale=(0.0625, 0.0625, 0.0625), quat=(1, 0, 0, 0), g=0.0625, seed=0)
@example(mean=(0.03125,) * 3, scale=(0.03125, 0.25, 1e-6), quat=(1, 0, 0, 0), g=0.0625, seed=0)
@example(mean=(0.0, 0.0, 0.0), scale=(0.25, 1e-12, 1e-12), quat=(1, 0, 0, 1), g=0.0625, seed=0)
@example(mean=(0.1, 0.0, 0.0), scale=(100.0, 100.0, 1e-12), quat=(1, 1, 1, 1), g=0.05, seed=0)
def test_no_touched_voxel_is_missing_and_no_other_is_farther_than_stated(mean, scale, quat, g, seed):
    mean, scale, quat = (np.array([v], np.float32) for v in (mean, scale, quat))
    rng = np.random.default_rng(seed)
    # Near the centre, or near the tip of one semi-axis: there surfaces are most curved.
    r = np.array([[float(v) for v in row] for row in rotation(quat[0])])
    axis = int(rng.integers(-3, 3))
    place = mean[0].astype(float) + (r[:, axis] * scale[0, axis] if axis >= 0 else 0)
    middle = np.floor(place / g).astype(int) + rng.integers(-1, 2, 3)
    lower, upper = middle - 1, middle + 1
    crop = (*((lower - 1) * g), *((upper + 2) * g))  # 100 m are too many voxels without
    index, *_ = _core.voxelize(mean, scale, quat, 1.0, g, 0.0, crop, (lower.tolist(), upper.tolist()))
    marked = set(map(tuple, index.tolist()))
    form, centre = form_of(scale[0], quat[0]), [Fraction(float(c)) for c in mean[0]]
    extent = Fraction(float(np.abs(mean).max() + scale.sum() + g))
    for cell in itertools.product(
        *(range(a, b + 1) for a, b in zip(lower.tolist(), upper.tolist(), strict=True))
    ):
        if cell in marked:
            assert touches(form, centre, cell, g, OUTWARD * extent), cell
        else:
            assert not touches(form, centre, cell, g), cell
