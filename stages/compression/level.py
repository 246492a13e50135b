"""The level of ellipsoids in words: the part of a Gaussian that counts as an obstacle."""

from __future__ import annotations

import math

from alula.schemas.decimals import at_least, at_most, exact


def mass_within(sigma: float) -> float:
    """Fraction of a Gaussian's mass inside its ellipsoid at a level.

    P(x' inv(Sigma) x <= k^2) = erf(k / sqrt 2) - sqrt(2 / pi) k exp(-k^2 / 2) for x normal in three
    dimensions, the chi-square distribution with three degrees of freedom.

    Args:
        sigma: k, in standard deviations, at least 0.
    """
    inside = math.erf(sigma / math.sqrt(2)) - math.sqrt(2 / math.pi) * sigma * math.exp(-(sigma**2) / 2)
    return min(max(inside, 0.0), 1.0)


def level_words(sigma: float) -> str:
    """State a level with the mass inside, rounded down: "1 sigma (19.8 % of a Gaussian's mass)".

    Args:
        sigma: k, in standard deviations.
    """
    return f"{exact(sigma)} sigma ({at_least(100 * mass_within(sigma))} % of a Gaussian's mass)"


def beyond_words(sigma: float) -> str:
    """State what a level leaves out, with its mass rounded up.

    Args:
        sigma: k, in standard deviations.
    """
    mass = at_most(100 * (1 - mass_within(sigma)))
    return f"what of each Gaussian lies beyond {exact(sigma)} sigma ({mass} % of its mass)"
