"""Quantiles of distributions, without `scipy.stats`, which takes most of a second to import."""

from __future__ import annotations


def student_quantile(degrees: float, probability: float) -> float:
    """Quantile of Student's t.

    Args:
        probability: of a smaller value.
    """
    from scipy.special import stdtrit

    return float(stdtrit(degrees, probability))


def fisher_quantile(degrees: tuple[float, float], probability: float) -> float:
    """Quantile of Fisher's F.

    Args:
        degrees: degrees of freedom of the numerator and of the denominator.
        probability: of a smaller value.
    """
    from scipy.special import fdtri

    return float(fdtri(*degrees, probability))
