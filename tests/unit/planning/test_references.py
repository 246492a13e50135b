"""References: straight septics, and that the native curve flies them."""

import numpy as np
import pytest

from alula._core import ReferenceCurve
from alula.schemas.errors import InputError
from alula.stages.planning.rest_to_rest import rest_to_rest
from alula.stages.planning.trajectory import evaluate


@pytest.mark.parametrize("speed", [0.3, 2.0, 8.0])
def test_a_straight_septic_peaks_at_the_asked_speed_and_rests_at_its_ends(speed):
    start, goal = np.array([1.0, -2.0, 0.5]), np.array([4.0, 2.0, 1.5])
    time, coefficient = rest_to_rest(start, goal, speed, yaw_rad=0.7)
    t = np.linspace(0, time[-1], 2001)
    rows = ReferenceCurve(time, coefficient).at(t)
    assert np.linalg.norm(rows[:, 3:6], axis=1).max() == pytest.approx(speed, rel=1e-12)
    assert time[-1] == pytest.approx(2.1875 * np.linalg.norm(goal - start) / speed)
    assert rows[0, :3] == pytest.approx(start)
    assert rows[-1, :3] == pytest.approx(goal)
    for order in (1, 2, 3):
        ends = evaluate(time, coefficient, time, order)
        assert np.abs(ends).max() < 1e-9 * speed ** (order + 1)
    along = (goal - start) / np.linalg.norm(goal - start)
    assert np.abs(np.cross(rows[:, :3] - start, along)).max() < 1e-12
    assert (rows[:, 15] == 0.7).all()
    assert not rows[:, 16:].any()


def test_references_without_meaning_are_refused():
    with pytest.raises(InputError, match="distinct"):
        rest_to_rest([1, 2, 3], [1, 2, 3], 1.0)
    with pytest.raises(InputError, match="finite"):
        rest_to_rest([0, 0, 0], [0, np.nan, 0], 1.0)
    with pytest.raises(InputError, match="peak speed"):
        rest_to_rest([1, 2, 3], [1, 2, 4], -1.0)
