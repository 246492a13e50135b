"""Histogram of durations: its quantiles beside numpy's, and its constant size."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.stages.durations import Durations
from support.effort import examples


@given(
    st.lists(st.floats(1e-8, 100.0), min_size=1, max_size=300), st.sampled_from([0.01, 0.5, 0.9, 0.99, 1.0])
)
@settings(max_examples=examples(100))
def test_quantiles_are_those_of_numpy_to_1_2_percent(seconds, fraction):
    times = Durations()
    for each in seconds:
        times.append(each)
    exact = np.quantile(seconds, fraction, method="inverted_cdf")
    assert exact * (1 - 1e-12) <= times.quantile(fraction) <= exact * 1.012
    assert len(times) == len(seconds)
    assert times.max_s == max(seconds)


def test_it_takes_any_number_in_constant_memory():
    times = Durations()
    size = sys.getsizeof(times._counts)
    for each in (0.0, -1.0, 1e-12, 1e9, *np.linspace(0, 1, 5000)):
        times.append(float(each))
    assert sys.getsizeof(times._counts) == size
    assert times.quantile(1.0) == times.max_s == 1e9
    with pytest.raises(ValueError, match="no durations"):
        Durations().quantile(0.5)
