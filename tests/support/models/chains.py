"""Corridors of overlapping boxes, and exact arithmetic on pieces of curves."""

from fractions import Fraction
from math import factorial

import numpy as np

from alula.stages.planning.corridor import Corridor


def box_chain(seed, cells=3, via=False):
    """A corridor around a random walk along the axes, its corners as joints."""
    rng = np.random.default_rng(seed)
    corner = [rng.uniform(-1, 1, 3)]
    last = -1
    for _ in range(cells):
        axis = rng.choice([a for a in range(3) if a != last])
        last = axis
        corner.append(corner[-1] + rng.choice([-1, 1]) * rng.uniform(0.6, 2.5) * np.eye(3)[axis])
    corner = np.array(corner)
    normal = np.tile(np.concatenate([-np.eye(3), np.eye(3)]), (cells, 1))
    width = rng.uniform(0.15, 0.5, cells)[:, None]
    low = np.minimum(corner[:-1], corner[1:]) - width
    high = np.maximum(corner[:-1], corner[1:]) + width
    return Corridor(
        normal=np.ascontiguousarray(normal),
        offset=np.concatenate([-low, high], axis=1).ravel(),
        start=6 * np.arange(cells + 1),
        point=corner,
        joint=corner[1:-1].copy(),
        is_open=np.ones(cells - 1, np.bool_),
        is_via=np.full(cells - 1, via),
        is_free=np.ones(cells, np.bool_),
    )


def exact_derivatives(coefficient, local, orders=5):
    """Derivatives of one piece at a local time, exactly: a list of rational vectors.

    Args:
        coefficient: shape (D, 8).
        local: a float.
    """
    # Floats are integers over powers of two: Horner's rule in integers needs no greatest common divisors.
    numerator, denominator = float(local).as_integer_ratio()
    result = []
    for order in range(orders):
        vector = []
        for row in coefficient.tolist():
            ratios = [c.as_integer_ratio() for c in row]
            common = max(d for _, d in ratios)
            value, power = 0, 1
            for j in range(7, order - 1, -1):
                n, d = ratios[j]
                value = value * numerator + factorial(j) // factorial(j - order) * n * (common // d) * power
                power *= denominator
            vector.append(Fraction(value, common * (power // denominator)))
        result.append(vector)
    return result
