"""Histograms of durations: quantiles beside numpy's, constant size, sums of several."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.stages.durations import Durations, Times
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


@given(st.lists(st.floats(1e-7, 1e-2), min_size=1, max_size=60), st.lists(st.floats(1e-7, 1e-2), max_size=60))
def test_quantiles_of_times_are_close_however_they_are_joined(a, b):
    seconds = np.array(a + b, np.float32)
    parts = [Times.of(np.array(part, np.float32), 0.0025) for part in (a, b)]
    times = Times.joined(parts)
    assert times.calls == len(seconds)
    assert times.max_s == float(seconds.max())
    assert times.overruns == int((seconds > 0.0025).sum())
    exact = seconds.astype(np.float64)
    assert times.total_s == pytest.approx(exact.sum(), rel=1e-12)
    assert times.mean_s == pytest.approx(exact.mean(), rel=1e-12)
    assert times.std_s == pytest.approx(exact.std(), rel=1e-6, abs=1e-6 * exact.max())
    for share in (0.01, 0.5, 0.99, 1.0):
        least = float(np.sort(seconds)[max(0, int(np.ceil(share * len(seconds))) - 1)])
        assert least * (1 - 1e-6) <= times.quantile(share) <= least * 1.0117


def test_no_times_have_neither_mean_nor_quantile():
    none = Times.of(np.empty(0, np.float32), 0.01)
    assert (none.calls, none.mean_s, none.std_s, none.max_s) == (0, 0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="no durations"):
        none.quantile(0.5)
