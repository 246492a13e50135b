"""Intervals over trials against exact cases and their coverage."""

import numpy as np
import pytest

from alula.schemas.errors import InputError
from alula.stages.reporting.statistics import difference_estimate, mean_estimate, ratio_estimate


def test_constant_values_have_an_interval_of_no_width() -> None:
    found = mean_estimate([2.0] * 7)
    assert found is not None
    assert (found.value, found.low, found.high, found.n) == (2.0, 2.0, 2.0, 7)


def test_a_ratio_that_all_pairs_share_is_found_exactly() -> None:
    theirs = np.array([1.0, 2.0, 5.0])
    found = ratio_estimate(theirs / 2, theirs)
    assert found is not None
    assert (found.value, found.low, found.high) == pytest.approx((0.5, 0.5, 0.5), rel=1e-15)


def test_pairs_are_resampled_together() -> None:
    """The pairs differ by a factor of 100 from one another, but hardly within a pair."""
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
