"""The exponential of the decoders against forty decimal digits, and its bits, which no machine changes."""

import hashlib
from decimal import Decimal, localcontext

import numpy as np

from alula import _core


def ulps(values, exact):
    """The largest error in units of the last place of the values."""
    errors = [
        abs((Decimal(float(v)) - e) / Decimal(float(np.spacing(v))))
        for v, e in zip(values, exact, strict=True)
    ]
    return float(max(errors))


def exact_exp(x):
    with localcontext(prec=40):
        return [Decimal(float(value)).exp() for value in x]


def arguments(count):
    rng = np.random.default_rng(0)
    k = np.arange(-288, 289)
    halves = (k + 0.5) * np.log(2)  # where the reduction changes its integer
    near = np.concatenate([halves, np.nextafter(halves, 999), np.nextafter(halves, -999)])
    tiny = 2.0 ** -np.arange(1, 1075, 7)
    return np.concatenate(
        [rng.uniform(-200, 200, count), rng.normal(size=count) * 3, near, tiny, -tiny, [0.0, -0.0, 200, -200]]
    )


def test_exp_is_within_one_unit_in_the_last_place():
    x = arguments(4000)
    assert ulps(_core.portable_exp(x), exact_exp(x)) < 1.0


def test_the_logistic_function_is_within_two_units_in_the_last_place():
    x = arguments(2000)
    with localcontext(prec=60):
        exact = [1 / (1 + (-Decimal(float(value))).exp()) for value in x]
    assert ulps(_core.portable_logistic(x), exact) < 2.0


def test_single_precision_is_that_of_numpy_but_where_it_is_a_tie_by_chance():
    x = np.random.default_rng(1).normal(size=200_000) * 4
    ours, theirs = _core.portable_exp(x), np.exp(x)
    assert (ours.astype(np.float32) != theirs.astype(np.float32)).sum() <= 2
    assert np.abs(ours / theirs - 1).max() < 5e-16


def test_the_bits_are_those_of_every_other_machine():
    x = np.arange(-204_800, 204_801) / 1024
    for function, wanted in (
        (_core.portable_exp, "a759046b40eecbf02564a5657b6316e3"),
        (_core.portable_logistic, "5ec97dd65054f590830fa6d26161e349"),
    ):
        assert hashlib.sha256(function(x).astype("<f8").tobytes()).hexdigest()[:32] == wanted


def test_vectors_and_their_ends_give_the_same_bits():
    x = arguments(50)[:131]
    whole = _core.portable_exp(x)
    for begin, end in ((0, 1), (0, 3), (1, 8), (5, 12), (100, 131), (130, 131)):
        np.testing.assert_array_equal(_core.portable_exp(x[begin:end]), whole[begin:end])


def test_what_is_no_number_or_has_no_end_keeps_its_meaning():
    x = np.array([np.nan, np.inf, -np.inf, 1e300, -1e300, 250.0, -250.0, 0.0])
    single = np.array([np.nan, np.inf, 0, np.inf, 0, np.inf, 0, 1], np.float32)
    with np.errstate(over="ignore", under="ignore"):
        np.testing.assert_array_equal(_core.portable_exp(x).astype(np.float32), single)
        found = _core.portable_logistic(x).astype(np.float32)
    np.testing.assert_array_equal(found, np.array([np.nan, 1, 0, 1, 0, 1, 0, 0.5], np.float32))
    assert len(_core.portable_exp(np.empty(0))) == 0
