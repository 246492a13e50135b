"""Geofencing, eqs. 16 and 18 and Theorem 1: the box, the backup set, and the continuity of the filter."""

import numpy as np
import pytest

from alula import _core
from support.models import racer_model as model


def filter_in(**parameters):
    return _core.Geofence(_core.Fence(box=model.BOX), _core.RacerModel(), parameters)


def test_the_distance_is_that_of_a_box_by_its_side_lengths_and_centre():
    states = model.random_states(100, 0)
    lower, upper = map(np.array, model.BOX)
    expected = ((upper - lower) / 2 - np.abs(states[:, :3] - (lower + upper) / 2)).min(axis=1)
    values, _ = filter_in().evaluate(states)
    np.testing.assert_allclose(values[:, 3], expected, atol=1e-4)
    kept, _ = filter_in(reserve_m=0.5).evaluate(states)
    np.testing.assert_allclose(kept[:, 3], expected - 0.5, atol=1e-4)


@pytest.mark.slow
def test_the_backup_set_is_that_of_slow_ends_of_the_flow():
    states = model.random_states(8, 1, speed=15)
    values, _ = filter_in().evaluate(states)
    exact = np.array([40 * (1 - np.linalg.norm(model.flow(x, 3.0)[-1, 3:6])) for x in states])
    assert (values[:, 4] <= exact + 1e-2).all()  # a lower bound,
    assert (exact - values[:, 4]).max() < 4  # within 0.1 m/s of the speed at the end


def test_the_command_is_a_continuous_function_of_the_position():
    """Towards a face in small steps: no jump where lambda reaches 0."""
    x = np.r_[0, 0, 30.0, 12, 0, 0, 1, 0, 0, 0, 0, 0, 0]
    pilot = np.array([0.5, 0.0, 2.0, 0.0])
    geofence = filter_in()
    commands, weights = [], []
    for place in np.arange(15.0, 39.5, 5e-3):
        x[0] = place
        geofence.reset()
        u, _, detail = geofence.filter(x, pilot)
        commands.append(u)
        weights.append(detail["lambda"])
    assert max(weights) > 0.9
    assert min(weights) == 0
    assert np.abs(np.diff(weights)).max() < 0.02
    assert np.abs(np.diff(commands, axis=0)).max() < 0.2
