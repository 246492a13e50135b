"""Half-spaces n . a <= b in a box that are hard to project on, and independent answers."""

import numpy as np

LIMIT = 6.0
MARGIN = 2e-5 * LIMIT
KINDS = ("random", "nearly parallel", "axes", "nearly coplanar", "thin slabs", "box corners")


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def half_spaces(rng, kind, count):
    """Rows (count, 4), in single precision, around a point that may lie outside the box."""
    normal = unit(rng.normal(size=(count, 3)))
    small = 10.0 ** rng.uniform(-6, -1)
    if kind == "nearly parallel":
        normal = unit(normal[0] + small * rng.normal(size=(count, 3)))
    elif kind == "axes":
        normal = unit(rng.choice([-1.0, 0.0, 1.0], size=(count, 3)) + 1e-9 * rng.normal(size=(count, 3)))
    elif kind == "nearly coplanar":
        normal = unit(normal * [1, 1, small])
    elif kind == "thin slabs":
        normal[1::2] = unit(-normal[0] + small * rng.normal(size=(len(normal[1::2]), 3)))
    elif kind == "box corners":
        normal = unit(rng.choice([-1.0, 1.0], size=(count, 3)) + small * rng.normal(size=(count, 3)))
    bound = normal @ rng.uniform(-8, 8, 3) + 10.0 ** rng.uniform(-5, 1) * rng.uniform(-0.3, 1, count)
    if kind == "box corners":
        bound = normal @ np.full(3, LIMIT) * rng.uniform(0.5, 1.0)
    return np.c_[normal, bound].astype(np.float32).astype(float)


def violation(rows, a):
    return float((rows[:, :3] @ a - rows[:, 3]).max())


def roomiest(rows, limit=LIMIT):
    """Radius of the largest ball within the rows, its centre in the box; negative: the least violation."""
    from scipy.optimize import linprog

    box = np.vstack([np.eye(3), -np.eye(3)])
    found = linprog(
        [0, 0, 0, -1],
        A_ub=np.vstack([np.c_[rows[:, :3], np.ones(len(rows))], np.c_[box, np.zeros(6)]]),
        b_ub=np.r_[rows[:, 3], np.full(6, limit)],
        bounds=[(None, None)] * 4,
    )
    return float(-found.fun)
