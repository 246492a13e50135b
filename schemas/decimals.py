"""Numbers in guarantees: exact, or rounded so that the sentence remains true."""

from __future__ import annotations

import math
from collections.abc import Iterable
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

DIGITS = 3  # significant digits of a bound


def exact(value: float | Iterable[float]) -> str:
    """Write a number, or several joined by spaces, so that reading returns the same double.

    Returns:
        The shortest such decimal, without a trailing ".0": 1, 0.05, 0.9999996, 1000005.4.
    """
    if isinstance(value, int | float):
        return repr(float(value)).removesuffix(".0")
    return " ".join(exact(item) for item in value)


def at_most(value: float, digits: int = DIGITS) -> str:
    """Write an upper bound: rounded up, so that the printed decimal is never below the value.

    Args:
        digits: significant digits.
    """
    return _rounded(value, digits, ROUND_CEILING)


def at_least(value: float, digits: int = DIGITS) -> str:
    """Write a lower bound: rounded down, so that the printed decimal is never above the value.

    Args:
        digits: significant digits.
    """
    return _rounded(value, digits, ROUND_FLOOR)


def _rounded(value: float, digits: int, rounding: str) -> str:
    if not math.isfinite(value):
        return str(value)
    short = Context(prec=digits, rounding=rounding).create_decimal(Decimal(value))
    # A number that has few digits anyway is not rounded: the double nearest to 0.1 is above 0.1.
    return exact(value) if Decimal(exact(value)) == Decimal(f"{value:.{digits}g}") else exact(float(short))
