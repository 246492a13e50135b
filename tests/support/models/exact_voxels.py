"""Which voxels an ellipsoid touches, in rational arithmetic."""

import itertools
from fractions import Fraction

from hypothesis import strategies as st


def rotation(q):
    w, x, y, z = (Fraction(float(v)) for v in q)
    n = w * w + x * x + y * y + z * z
    return [
        [1 - 2 * (y * y + z * z) / n, 2 * (x * y - w * z) / n, 2 * (x * z + w * y) / n],
        [2 * (x * y + w * z) / n, 1 - 2 * (x * x + z * z) / n, 2 * (y * z - w * x) / n],
        [2 * (x * z - w * y) / n, 2 * (y * z + w * x) / n, 1 - 2 * (x * x + y * y) / n],
    ]


def form_of(scale, quat):
    """inv(Sigma), exactly."""
    r = rotation(quat)
    inverse = [1 / Fraction(float(s)) ** 2 for s in scale]
    return [[sum(r[i][k] * inverse[k] * r[j][k] for k in range(3)) for j in range(3)] for i in range(3)]


def touches(form, centre, cell, g, grown=Fraction(0)):
    """Whether the least value of the form over the cell, grown on all sides, is at most 1."""
    lower = [cell[i] * Fraction(g) - centre[i] - grown for i in range(3)]
    upper = [(cell[i] + 1) * Fraction(g) - centre[i] + grown for i in range(3)]
    for state in itertools.product((0, 1, 2), repeat=3):
        free = [i for i in range(3) if state[i] == 2]
        x = [(lower[i], upper[i], Fraction(0))[state[i]] for i in range(3)]
        rhs = [-sum(form[f][j] * x[j] for j in range(3)) for f in free]
        if len(free) == 1:
            x[free[0]] = rhs[0] / form[free[0]][free[0]]
        elif len(free) == 2:
            f, h = free
            det = form[f][f] * form[h][h] - form[f][h] ** 2
            x[f] = (rhs[0] * form[h][h] - rhs[1] * form[f][h]) / det
            x[h] = (rhs[1] * form[f][f] - rhs[0] * form[f][h]) / det
        if all(lower[i] <= x[i] <= upper[i] for i in free):
            value = sum(form[i][j] * x[i] * x[j] for i in range(3) for j in range(3))
            if value <= 1:
                return True
    return False


AXES = st.sampled_from([1e-12, 1e-6, 1e-3, 0.0078125, 0.03125, 0.05, 0.11, 0.25, 100.0])


TURNS = st.one_of(
    st.sampled_from(
        [
            (1, 0, 0, 0),
            (1, 1, 0, 0),
            (1, 0, 1, 0),
            (1, 0, 0, 1),
            (1, 1, 1, 1),
            (0, 1, 0, 0),
            (1, 1e-8, 0, 1e-5),
        ]
    ),
    st.tuples(*[st.floats(-1, 1, width=32)] * 4).filter(lambda q: sum(v * v for v in q) > 1e-3),
)


PLACES = st.one_of(  # on the lattice, within a voxel, far away
    st.integers(-3, 3).map(lambda i: i * 0.0625), st.floats(-0.25, 0.25, width=32), st.just(1e4)
)
