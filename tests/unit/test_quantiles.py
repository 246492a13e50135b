"""Quantiles against those of `scipy.stats`."""

import pytest
from scipy import stats

from alula.stages.quantiles import fisher_quantile, student_quantile

DEGREES = [1, 2.5, 5, 173, 1e6]


@pytest.mark.parametrize("degrees", DEGREES)
@pytest.mark.parametrize("probability", [0.9, 0.95, 0.975])
def test_quantiles_are_those_of_scipy_bit_by_bit(degrees, probability):
    assert student_quantile(degrees, probability) == stats.t.ppf(probability, degrees)
    assert fisher_quantile((7, degrees), probability) == stats.f.ppf(probability, 7, degrees)
