"""Intervals over trials against exact cases and their coverage."""

import numpy as np
import pytest

from alula.schemas.errors import InputError
from alula.stages.reporting.statistics import difference_estimate, mean_estimate, ratio_estimate


@pytest.mark.parametrize("values", [[2.0] * 7, [0.1] * 50, [0.0] * 3, [5.0]])
def test_equal_values_tell_nothing_of_their_spread(values) -> None:
    found = mean_estimate(values)
    assert found is not None
    assert (found.value, found.n) == (pytest.approx(values[0]), len(values))
    assert (found.low, found.high) == (None, None)


def test_a_ratio_that_all_pairs_share_is_found_exactly() -> None:
    theirs = np.array([1.0, 2.0, 5.0])
    found = ratio_estimate(theirs / 3, theirs)
    assert found is not None
    assert found.value == pytest.approx(1 / 3, rel=1e-15)
    assert (found.low, found.high) == (None, None)


@pytest.mark.parametrize("n", [1, 5, 50])
def test_successes_without_a_failure_have_the_exact_interval(n) -> None:
    """Bound of Clopper and Pearson: the failure rate at which n successes in a row have a chance of 2.5 %."""
    found = mean_estimate([1.0] * n, bounds=(0.0, 1.0))
    assert found is not None
    assert (found.value, found.high) == (1.0, 1.0)
    assert found.low is not None
    assert found.low**n == pytest.approx(0.025, rel=1e-9)
    paired = difference_estimate([1.0] * n, [1.0] * n, bounds=(-1.0, 1.0))
    assert paired is not None
    assert (paired.low, paired.high) == (pytest.approx(found.low - 1), pytest.approx(1 - found.low))


def test_bounds_do_not_widen_an_interval_that_is_wide() -> None:
    x = np.arange(50) % 2
    assert mean_estimate(x, bounds=(0.0, 1.0)) == mean_estimate(x)


def test_bounded_intervals_cover_rare_failures() -> None:
    rng = np.random.default_rng(3)
    held = [0, 0]
    for _ in range(300):
        x = (rng.random(40) < 0.98).astype(float)
        for i, bounds in enumerate(((0.0, 1.0), None)):
            found = mean_estimate(x, bounds=bounds)
            assert found is not None
            held[i] += found.low is not None and found.high is not None and found.low <= 0.98 <= found.high
    assert held[0] >= 285
    assert held[1] < 200  # nearly half of the draws have no failure


def test_pairs_are_resampled_together() -> None:
    """Pairs that differ by a factor of 100 from one another, but little within a pair."""
    rng = np.random.default_rng(0)
    theirs = 10 ** rng.uniform(-1, 1, 60)
    found = ratio_estimate(theirs * rng.uniform(0.49, 0.51, 60), theirs)
    assert found is not None
    assert found.high - found.low < 0.01


def test_intervals_cover_the_truth_about_as_often_as_they_say() -> None:
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(200):
        found = mean_estimate(rng.exponential(1.0, 50))
        assert found is not None
        held += found.low <= 1.0 <= found.high
    assert 175 <= held <= 199


def test_equal_values_give_equal_intervals() -> None:
    x = np.random.default_rng(2).random(30)
    assert difference_estimate(x, x[::-1]) == difference_estimate(x, x[::-1])


def test_nothing_to_estimate_is_none_and_bad_values_are_refused() -> None:
    assert mean_estimate([]) is None
    assert ratio_estimate([1.0], [0.0]) is None
    with pytest.raises(InputError, match="equal lengths"):
        ratio_estimate([1.0], [1.0, 2.0])
    with pytest.raises(InputError, match="finite"):
        mean_estimate([np.nan])
