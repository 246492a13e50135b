"""Ticks that a log shows."""

import numpy as np
import pytest

from alula.stages.simulation.result import logged_ticks


@pytest.mark.parametrize(
    ("last", "dt_s", "rate_hz", "ticks"),
    [
        (0, 0.01, 20.0, [0]),
        (4, 0.01, 20.0, [0, 4]),
        (5, 0.01, 20.0, [0, 5]),
        (12, 0.01, 20.0, [0, 5, 10, 12]),
        (3, 0.01, 1000.0, [0, 1, 2, 3]),  # as often as there are ticks, not more
    ],
)
def test_a_log_has_ticks_at_its_rate_and_the_last_one_once(last, dt_s, rate_hz, ticks):
    found = logged_ticks(last, dt_s, rate_hz)
    assert found.dtype == np.int64
    assert found.tolist() == ticks
