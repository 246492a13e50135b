"""Numbers as a person reads them: 8.4 cm, 93 of 100, 12 %, 1.3 MB.

They are for the first screen of a report; its tables keep four digits, and its files all of them.
"""

from __future__ import annotations

import math

_EPSILON = 1e-9  # relative; a product such as 100 * 0.29 must not lose a digit when it is rounded down


def length(value_m: float, *, down: bool = False) -> str:
    """Write a length with two digits, three from 10 m on, in mm, cm or m.

    Args:
        down: round down, so that a clearance never looks larger than it is.
    """
    size = abs(value_m)
    for limit, factor, unit in ((0.00995, 1e3, "mm"), (0.995, 1e2, "cm"), (math.inf, 1.0, "m")):
        if size < limit or limit == math.inf:
            return f"{_digits(value_m * factor, 3 if size >= 9.95 else 2, down=down)} {unit}"
    raise AssertionError


def _digits(value: float, digits: int, *, down: bool = False) -> str:
    """Write a number with so many significant digits, at most one after the point below 10, never -0."""
    if value == 0:
        return "0"
    places = max(0, min(2, digits - 1 - math.floor(math.log10(abs(value)))))
    scaled = value * 10**places
    whole = math.floor(scaled + abs(scaled) * _EPSILON) if down else round(scaled)
    return f"{whole / 10**places + 0.0:,.{places}f}"


def share(part: float, whole: float = 1.0) -> str:
    """Write a fraction in percent; only none is 0 %, and only all is 100 %."""
    if whole == 0:
        return "–"
    value = 100 * part / whole
    if 0 < value < 1:
        return "under 1 %"
    if 99 < value < 100:
        return "over 99 %"
    return f"{value:.0f} %"


def deviations(sigma: float) -> str:
    """Write a level in standard deviations."""
    return f"{sigma:.4g} standard deviation{'' if sigma == 1 else 's'}"


def speed(value_m_s: float) -> str:
    """Write a speed [m/s] with two digits."""
    return f"{_digits(value_m_s, 2)} m/s"


def duration(value_s: float) -> str:
    """Write a time [s] with two digits, from 100 s on in minutes and seconds."""
    if abs(value_s) < 99.5:
        return f"{_digits(value_s, 2)} s"
    minutes, seconds = divmod(round(value_s), 60)
    return f"{minutes:,} min {seconds} s"


def size(count: int) -> str:
    """Write a number of bytes in bytes, kB or MB."""
    for limit, factor, unit in ((1e3, 1.0, "bytes"), (999.5e3, 1e3, "kB"), (math.inf, 1e6, "MB")):
        if count < limit:
            return f"{_digits(count / factor, 3 if count >= 9.95 * factor else 2)} {unit}"
    raise AssertionError


def count(good: int, everything: int) -> str:
    """Write how many of all."""
    return f"{good:,} of {everything:,}"
