"""Numbers as a person reads them: few digits, a fitting unit, and never a rounding that flatters."""

import math
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from alula.stages.reporting import plain

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0.08416, "8.4 cm"),
        (0.0034, "3.4 mm"),
        (0.247, "25 cm"),
        (1.234, "1.2 m"),
        (12.34, "12.3 m"),
        (250.3, "250 m"),
        (0.0, "0 mm"),
        (-0.031, "-3.1 cm"),
        (1234.0, "1,234 m"),
    ],
)
def test_a_length_has_two_digits_and_a_unit_that_fits(value, words):
    assert plain.length(value) == words


def length_of(words):
    value, unit = re.fullmatch(r"(-?[\d,.]+) (mm|cm|m)", words).groups()
    return float(value.replace(",", "")) * UNITS[unit]


@given(st.floats(1e-6, 1e5))
def test_a_clearance_never_looks_larger_than_it_is(value):
    shown = length_of(plain.length(value, down=True))
    assert shown <= value * (1 + 1e-8)
    assert shown >= 0.89 * value - 1e-5  # and little smaller


@given(st.integers(0, 3000), st.integers(1, 3000))
def test_only_none_is_nothing_and_only_all_is_everything(part, whole):
    part = min(part, whole)
    assert (plain.share(part, whole) == "0 %") == (part == 0)
    assert (plain.share(part, whole) == "100 %") == (part == whole)


def test_speeds_times_sizes_and_counts():
    assert plain.share(1, 0) == "–"
    assert plain.speed(1.2345) == "1.2 m/s"
    assert [plain.duration(t) for t in (3.46, 42.0, 312.0)] == ["3.5 s", "42 s", "5 min 12 s"]
    assert [plain.size(n) for n in (512, 9849, 117_000, 2_417_741)] == [
        "512 bytes",
        "9.8 kB",
        "117 kB",
        "2.4 MB",
    ]
    assert plain.count(93, 1000) == "93 of 1,000"
    assert not math.isnan(length_of(plain.length(9.99e-3)))
