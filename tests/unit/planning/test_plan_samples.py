"""Samples of a plan are values of its polynomials."""

import numpy as np
import pytest

from alula.stages.planning.plan_samples import sample_plan
from support.scenes.small_scenes import line_plan


def test_plan_samples_are_the_polynomials():
    plan = line_plan([0.0, 1.0, 2.0], [3.0, 1.0, 2.0], duration_s=2.0)
    position = sample_plan(plan, 0.3)
    time = np.minimum(np.arange(8) * 0.3, 2.0)
    tau = time / 2
    assert position[:, 0] == pytest.approx(
        3 * (35 * tau**4 - 84 * tau**5 + 70 * tau**6 - 20 * tau**7), abs=1e-12
    )
    assert position[-1] == pytest.approx([3, 1, 2])
