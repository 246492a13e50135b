"""Quadratic programs that are hard on a solver, and proofs of answers that share no code with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from fractions import Fraction

import numpy as np

UNIT = 2.0**-53
FEASIBLE, STATIONARY, CERTAIN = 32 * UNIT, 256 * UNIT, 32 * UNIT
LOOSE = 128.0  # what rows that contradict each other by rounding may take
OPTIMAL, INFEASIBLE, FAILED = 0, 1, 2
_LOOSER = 1 + 1e-3  # than what the solver promises: these sums are rounded too


@dataclass
class Stack:
    """k programs of one size: min 1/2 x^T hessian x + gradient^T x with rows x >= bounds.

    `truth` is +1 where a feasible point is known, -1 where there is none by a clear margin, else 0.
    """

    hessian: np.ndarray
    gradient: np.ndarray
    rows: np.ndarray
    bounds: np.ndarray
    truth: np.ndarray

    @property
    def problem(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        return self.hessian, self.gradient, self.rows, self.bounds

    def __len__(self) -> int:
        return len(self.truth)

    def __getitem__(self, which) -> Stack:
        return Stack(**{f.name: np.ascontiguousarray(getattr(self, f.name)[which]) for f in fields(self)})


def _positive(rng, k, n, condition=None):
    """Symmetric positive definite matrices; `condition` is a range of decades."""
    basis = np.linalg.qr(rng.normal(size=(k, n, n)))[0]
    low, high = condition or (0, 2)
    spread = rng.uniform(low, high, (k, 1)) * rng.uniform(0, 1, (k, n))
    hessian = np.einsum("kij,kj,klj->kil", basis, 10**spread, basis)
    return (hessian + hessian.transpose(0, 2, 1)) / 2


def _at(rows, point):
    return np.einsum("kmn,kn->km", rows, point)


def _stack(rng, rows, bounds, truth, *, pull=3.0, condition=None):
    k, _, n = rows.shape
    gradient = pull * rng.normal(size=(k, n))
    return Stack(_positive(rng, k, n, condition), gradient, rows, bounds, np.broadcast_to(truth, k).copy())


def generic(rng, k, n, m):
    rows, point = rng.normal(size=(k, m, n)), rng.normal(size=(k, n))
    return _stack(rng, rows, _at(rows, point) - np.abs(rng.normal(size=(k, m))), 1)


def undecided(rng, k, n, m):
    rows = rng.normal(size=(k, m, n))
    return _stack(rng, rows, rng.normal(size=(k, m)) - rng.uniform(0, 4, (k, 1)), 0)


def vertex(rng, k, n, m):
    """Whole numbers: all rows meet exactly in one point, which the gradient pulls through."""
    rows, point = rng.integers(-4, 5, (k, m, n)) * 1.0, rng.integers(-9, 10, (k, n)) * 1.0
    stack = _stack(rng, rows, _at(rows, point), 1, pull=30.0)
    cone = rows.sum(axis=1)  # the rows' side of the point has to have an inside
    stack.rows *= np.where(_at(rows, cone) < 0, -1.0, 1.0)[..., None]
    stack.bounds = _at(stack.rows, point)
    return stack


def rounded_vertex(rng, k, n, m):
    rows, point = rng.normal(size=(k, m, n)), rng.normal(size=(k, n))
    rows *= np.where(rows[..., :1] < 0, -1.0, 1.0)
    return _stack(rng, rows, _at(rows, point), 1, pull=30.0)


def nearly_parallel(rng, k, n, m):
    """Bundles of rows 1e-6 to 1e-12 rad apart, through or near one point."""
    heads = rng.normal(size=(k, max(1, min(n, m)), n))
    which = rng.integers(0, heads.shape[1], (k, m))
    tilt = 10 ** rng.uniform(-12, -6, (k, m, 1)) * rng.normal(size=(k, m, n))
    rows = np.take_along_axis(heads, which[..., None], axis=1) + tilt
    point = rng.normal(size=(k, n))
    slack = np.where(rng.random((k, m)) < 0.6, 0, 10 ** rng.uniform(-12, 0, (k, m)))
    return _stack(rng, rows, _at(rows, point) - slack, 1, pull=30.0)


def slabs(rng, k, n, m):
    """Nearly opposite rows, a hair's breadth apart; half of them overlap by as little, so meet far off."""
    rows = rng.normal(size=(k, m, n))
    half = m // 2
    tilt = 10 ** rng.uniform(-12, -4, (k, half, 1)) * rng.normal(size=(k, half, n))
    rows[:, half : 2 * half] = -rows[:, :half] + tilt
    gap = 10 ** rng.uniform(-12, 0, (k, m)) * np.where(rng.random((k, 1)) < 0.5, 1, -1)
    point = rng.normal(size=(k, n))
    bounds = _at(rows, point) - np.where(np.arange(m) < 2 * half, gap, 1.0)
    return _stack(rng, rows, bounds, np.where((gap > 0).all(axis=1), 1, 0))


def duplicates(rng, k, n, m):
    few = generic(rng, k, n, max(1, m // 4)) if m else generic(rng, k, n, 0)
    which = rng.integers(0, max(1, few.rows.shape[1]), (k, m))
    factor = np.where(rng.random((k, m)) < 0.5, 1.0, 10 ** rng.uniform(-3, 3, (k, m)))
    few.rows = np.take_along_axis(few.rows, which[..., None], axis=1) * factor[..., None]
    few.bounds = np.take_along_axis(few.bounds, which, axis=1) * factor
    few.bounds -= 4 * UNIT * np.abs(few.bounds)
    return few


def _balanced(rng, k, n, m, margin):
    """Rows with y^T rows = 0 for a positive y of some of them; their bounds are beyond a common point."""
    q = min(n + 1, m)
    rows, point = rng.normal(size=(k, m, n)), rng.normal(size=(k, n))
    weight = rng.uniform(0.2, 1, (k, q))
    if q:
        rows[:, q - 1] = -np.einsum("kq,kqn->kn", weight[:, :-1], rows[:, : q - 1])
    bounds = _at(rows, point) - np.abs(rng.normal(size=(k, m)))
    bounds[:, :q] = _at(rows, point)[:, :q] + margin
    order = rng.permuted(np.tile(np.arange(m), (k, 1)), axis=1)
    return np.take_along_axis(rows, order[..., None], axis=1), np.take_along_axis(bounds, order, axis=1)


def infeasible(rng, k, n, m):
    margin = 10 ** rng.uniform(-11, 1, (k, 1))
    return _stack(rng, *_balanced(rng, k, n, m, margin), np.where(margin[:, 0] > 1e-10, -1, 0) * (m > 1))


def by_a_hair(rng, k, n, m):
    """Feasible sets 1e-12 to 1 wide."""
    return _stack(rng, *_balanced(rng, k, n, m, -(10 ** rng.uniform(-12, 0, (k, 1)))), 1)


def point(rng, k, n, m):
    """Whole numbers: pairs of opposite rows that leave exactly one point, or a flat of them."""
    rows, centre = rng.integers(-5, 6, (k, m, n)) * 1.0, rng.integers(-9, 10, (k, n)) * 1.0
    half = m // 2
    rows[:, half : 2 * half] = -rows[:, :half]
    return _stack(rng, rows, _at(rows, centre), 1, pull=30.0)


def zero_rows(rng, k, n, m):
    stack = undecided(rng, k, n, m)
    zero = rng.random((k, m)) < 0.3
    stack.rows[zero] = 0
    stack.bounds -= 4
    stack.bounds[zero] = -rng.integers(0, 3, zero.sum()) * 1.0
    wrong = zero & (rng.random((k, m)) < 0.3 / max(1, m))
    stack.bounds[wrong] = 10 ** rng.uniform(-8, 8, wrong.sum())
    stack.truth = np.where(wrong.any(axis=1), -1, 0)
    return stack


def far_pull(rng, k, n, m):
    """The unconstrained minimiser is 1e4 to 1e10 away."""
    stack = generic(rng, k, n, m)
    stack.gradient *= 10 ** rng.uniform(4, 10, (k, 1))
    return stack


def ill_conditioned(rng, k, n, m):
    rows, point = rng.normal(size=(k, m, n)), rng.normal(size=(k, n))
    bounds = _at(rows, point) - np.abs(rng.normal(size=(k, m)))
    return _stack(rng, rows, bounds, 1, condition=(4, 11))


def flight(rng, k, n, m):
    """As filters pose them: weights decades apart, limits of the inputs, barrier rows of all sizes."""
    rows = rng.normal(size=(k, m, n)) * 10 ** rng.uniform(-2, 3, (k, 1, n))
    limits = np.vstack([np.eye(n), -np.eye(n)])[: min(m, 2 * n)]
    rows[:, : len(limits)] = limits
    point = rng.uniform(-1, 1, (k, n))
    bounds = _at(rows, point) - np.abs(rng.normal(size=(k, m))) * np.where(rng.random((k, m)) < 0.2, 1e-6, 1)
    bounds[:, : len(limits)] = -1 - 10 ** rng.uniform(-3, 1, (k, len(limits)))
    hessian = np.zeros((k, n, n))
    hessian[:, np.arange(n), np.arange(n)] = 10 ** rng.uniform(-4, 8, (k, n))
    return Stack(
        hessian, rng.normal(size=(k, n)) * hessian.max(axis=(1, 2))[:, None], rows, bounds, np.ones(k, int)
    )


def lattice(rng, k, n, m):
    """Rows and bounds of -1, 0 and 1, some tilted or shifted by 1e-16 to 1e-6, any condition: undecided."""
    rows, bounds = rng.integers(-1, 2, (k, m, n)) * 1.0, rng.integers(-1, 2, (k, m)) * 1.0
    bounds -= rng.integers(0, 3, (k, 1))
    rows += np.where(rng.random((k, m, 1)) < 0.3, 10 ** rng.uniform(-16, -6, (k, m, 1)), 0) * rng.normal(
        size=(k, m, n)
    )
    bounds += np.where(rng.random((k, m)) < 0.3, 10 ** rng.uniform(-16, -6, (k, m)), 0) * rng.normal(
        size=(k, m)
    )
    return _stack(rng, rows, bounds, 0, condition=(0, 13))


FAMILIES: dict[str, Callable[..., Stack]] = {
    family.__name__: family
    for family in (
        generic,
        undecided,
        vertex,
        rounded_vertex,
        nearly_parallel,
        slabs,
        duplicates,
        infeasible,
        by_a_hair,
        point,
        zero_rows,
        far_pull,
        ill_conditioned,
        flight,
        lattice,
    )
}


def scaled(rng, stack: Stack, *, exactly: bool) -> Stack:
    """Rows, variables and objective scaled by 1e-8 to 1e8; by powers of two if `exactly`."""
    k, m, n = stack.rows.shape

    def factor(*shape):
        if exactly:
            return 2.0 ** rng.integers(-26, 27, shape)
        return 10 ** rng.uniform(-8, 8, shape)

    row, variable, objective = factor(k, m), factor(k, n), factor(k, 1)
    hessian = stack.hessian * variable[:, :, None] * variable[:, None, :] * objective[..., None]
    return Stack(
        (hessian + hessian.transpose(0, 2, 1)) / 2,
        stack.gradient * variable * objective,
        stack.rows * row[..., None] * variable[:, None, :],
        stack.bounds * row,
        stack.truth,
    )


def proved(stack: Stack, answer: dict[str, np.ndarray], loose: float = 1.0) -> np.ndarray:
    """Whether each verdict is proved by its own numbers, in extended precision, shape (k,)."""
    feasible, stationary = FEASIBLE * loose * _LOOSER, STATIONARY * loose * _LOOSER
    wide = np.longdouble
    hessian, gradient, rows, bounds = (part.astype(wide) for part in stack.problem)
    hessian = (hessian + hessian.transpose(0, 2, 1)) / 2
    k, m, _ = rows.shape
    x, y = answer["x"].astype(wide), np.zeros((k, m), wide)
    which, slot = np.nonzero(answer["active"] >= 0)
    y[which, answer["active"][which, slot]] = answer["multipliers"][which, slot]
    slack = _at(rows, x) - bounds
    size = _at(np.abs(rows), np.abs(x)) + np.abs(bounds)
    holds = (slack >= -feasible * size).all(axis=1)
    tight = ((y == 0) | (np.abs(slack) <= feasible * size)).all(axis=1)
    pull = np.einsum("kmn,km->kn", rows, y)
    sizes = np.einsum("kmn,km->kn", np.abs(rows), y)
    force = np.einsum("kij,kj->ki", hessian, x) + gradient - pull
    forces = np.einsum("kij,kj->ki", np.abs(hessian), np.abs(x)) + np.abs(gradient) + sizes
    still = (np.abs(force) <= stationary * forces).all(axis=1)
    signs = (y >= 0).all(axis=1) & (answer["multipliers"] >= 0).all(axis=1)
    gain, gains = (y * bounds).sum(axis=1), (y * np.abs(bounds)).sum(axis=1)
    balanced = (np.abs(pull) <= CERTAIN * _LOOSER * sizes).all(axis=1)
    optimal = holds & tight & still & signs
    certain = balanced & signs & (gain * _LOOSER > CERTAIN * gains)
    return np.where(answer["status"] == OPTIMAL, optimal, (answer["status"] == INFEASIBLE) & certain)


def proved_exactly(stack: Stack, answer: dict[str, np.ndarray], i: int) -> bool:
    """The same for one program in rational numbers."""
    hessian, gradient, rows, bounds = (
        np.vectorize(Fraction, otypes=[object])(part[i]) for part in stack.problem
    )
    hessian = (hessian + hessian.T) / 2
    x = np.array([Fraction(v) for v in answer["x"][i]])
    used = [slot for slot in range(answer["active"].shape[1]) if answer["active"][i, slot] >= 0]
    active = [int(answer["active"][i, slot]) for slot in used]
    y = np.array([Fraction(float(answer["multipliers"][i, slot])) for slot in used], dtype=object)
    if any(v < 0 for v in y) or len(set(active)) != len(active):
        return False
    a, b = rows[active].reshape(len(active), len(x)), bounds[active]
    pull, size = a.T @ y, np.abs(a).T @ y
    if answer["status"][i] == INFEASIBLE:
        balanced = all(abs(p) <= Fraction(CERTAIN) * s for p, s in zip(pull, size, strict=True))
        return balanced and y @ b > Fraction(CERTAIN) * (y @ np.abs(b))
    force, forces = hessian @ x + gradient - pull, np.abs(hessian) @ np.abs(x) + np.abs(gradient) + size
    if any(abs(f) > Fraction(STATIONARY) * s for f, s in zip(force, forces, strict=True)):
        return False
    for k, row in enumerate(rows):
        slack, terms = row @ x - bounds[k], np.abs(row) @ np.abs(x) + abs(bounds[k])
        if slack < -Fraction(FEASIBLE) * terms or (k in active and abs(slack) > Fraction(FEASIBLE) * terms):
            return False
    return answer["status"][i] == OPTIMAL
