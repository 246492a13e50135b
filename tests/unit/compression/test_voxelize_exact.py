"""Each mark compared with rational arithmetic: none is missing, none is beyond the stated margin."""

import itertools
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from alula import _core
from support.effort import examples
from support.models.exact_voxels import AXES, PLACES, TURNS, form_of, rotation, touches

OUTWARD = Fraction(5 * 512, 2**53)  # 5 q / E of voxelize.hpp: no voxel farther than this is marked


@pytest.mark.slow
@settings(max_examples=examples(120), deadline=None)
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
