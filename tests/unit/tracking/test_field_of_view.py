"""Which positions a sensor sees."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from alula import _core
from support.effort import examples


@settings(deadline=None, max_examples=examples(200))
@given(st.integers(0, 2**32 - 1), st.floats(0, 3))
def test_a_field_holds_what_is_within_its_angles_and_range(seed, margin):
    rng = np.random.default_rng(seed)
    p, yaw = rng.normal(size=3) * [20, 20, 4], rng.uniform(-3, 3)
    factor = 0.3 * rng.normal(size=(3, 3))
    field = _core.FieldOfView(position=(0, 0, 0), yaw=yaw, max_range_m=25.0)

    def polar(x):
        c, s = np.cos(yaw), np.sin(yaw)
        u, v = c * x[0] + s * x[1], c * x[1] - s * x[0]
        return np.array([np.linalg.norm(x), np.arctan2(v, u), np.arctan2(x[2], np.hypot(u, v))])

    steps = 1e-6 * np.eye(3)
    slopes = np.array([(polar(p + h) - polar(p - h)) / 2e-6 for h in steps]).T
    sigma = np.linalg.norm(slopes @ factor, axis=1)
    reach = np.abs(polar(p)) + margin * sigma
    left = np.array([25.0, np.radians(40), np.radians(10)]) - reach
    if np.abs(left).min() > 1e-4:
        assert field.holds(p, factor @ factor.T, margin) == bool((left > 0).all())
