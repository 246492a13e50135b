"""Numbers in guarantees: an exact one reads back as itself, a bound is never rounded inward."""

from decimal import Decimal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from alula.schemas.decimals import at_least, at_most, exact
from support.effort import examples

FINITE = st.floats(allow_nan=False, allow_infinity=False)


@settings(max_examples=examples(300), deadline=None)
@given(FINITE)
def test_an_exact_number_reads_back_as_itself(value):
    assert float(exact(value)) == value


@settings(max_examples=examples(300), deadline=None)
@given(FINITE, st.integers(1, 12))
def test_a_bound_is_never_rounded_inward(value, digits):
    for text, is_outward in (
        (at_most(value, digits), Decimal.__ge__),
        (at_least(value, digits), Decimal.__le__),
    ):
        assert len(Decimal(text).normalize().as_tuple().digits) <= digits
        assert float(text) == value or is_outward(Decimal(text), Decimal(value))


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.0, "1"), (0.05, "0.05"), (0.9999996, "0.9999996"), (1000005.4, "1000005.4"), (3, "3"), (-0.0, "-0")],
)
def test_numbers_have_no_needless_digits(value, text):
    assert exact(value) == text


def test_several_numbers_stand_in_one_line():
    assert exact([0.0, 1000005.4]) == "0 1000005.4"


def test_bounds_have_three_digits():
    assert (at_most(0.12341), at_least(0.12349), at_most(0.1), at_least(-0.12341)) == (
        *("0.124", "0.123", "0.1", "-0.124"),
    )
    assert (at_most(float("inf")), at_least(float("nan"))) == ("inf", "nan")
