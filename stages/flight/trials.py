"""Random start-goal pairs, clear of everything, reproducible one by one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula.schemas.errors import InfeasibleError, UsageError

FloatArray = NDArray[np.float64]

_BLOCK = 256  # candidates drawn at a time
_BLOCKS = 64  # then it is hopeless
_TAIL_PERCENT = 1.0  # of the points on each side of each axis lies outside the default bounds


@dataclass(frozen=True, slots=True)
class Pairs:
    """Start and goal of each trial, shapes (N, 3), world frame [m].

    `sampled` candidates were looked at, of which `sampled_inside_hulls` lay inside a hull.
    """

    start: FloatArray
    goal: FloatArray
    sampled: int
    sampled_inside_hulls: int


def central_box(
    points: FloatArray, given: tuple[float, ...] | None, what: str
) -> tuple[FloatArray, FloatArray]:
    """The box for starts and goals: the given one, else the central 98 % of points (N, 3) per axis.

    Raises:
        UsageError: none is given and there is nothing, `what` in words, to take one from.
    """
    if given is not None:
        return np.array(given[:3]), np.array(given[3:])
    if len(points) == 0:
        raise UsageError(f"the map has no {what} to take bounds from; give --bounds")
    lower, upper = np.percentile(points, [_TAIL_PERCENT, 100 - _TAIL_PERCENT], axis=0)
    return lower, upper


def sample_pairs(
    count: int,
    seed: int,
    bounds: tuple[FloatArray, FloatArray],
    least_distance_m: float,
    clearance: Callable[[FloatArray], FloatArray],
    is_clear: Callable[[FloatArray, FloatArray], NDArray[np.bool_]],
) -> Pairs:
    """Draw pairs uniformly in a box, both points clear and far enough apart.

    Trial i has a counter-based generator of its own, keyed on (seed, i): it does not depend on how
    many trials there are, nor on who computes it.

    Args:
        count: number of trials.
        seed: of the whole run.
        bounds: lower and upper corner, each of shape (3,) [m].
        least_distance_m: between start and goal.
        clearance: psi of the map at points (M, 3), shape (M,), negative inside a hull [m].
        is_clear: which of the points, given with their psi, may be a start or a goal; shape (M,).

    Raises:
        InfeasibleError: no pair was found for a trial among 16384 candidates.
    """
    start, goal = np.empty((count, 3)), np.empty((count, 3))
    sampled = inside = 0
    lower, upper = bounds
    for i in range(count):
        generator = np.random.Generator(np.random.Philox(key=np.array([seed, i], np.uint64)))
        for _ in range(_BLOCKS):
            points = lower + generator.random((_BLOCK, 3)) * (upper - lower)
            psi = clearance(points)
            pair = _first_pair(points, is_clear(points, psi), least_distance_m)
            seen = _BLOCK if pair is None else pair[1] + 1
            sampled += seen
            inside += int((psi[:seen] < 0).sum())
            if pair is not None:
                start[i], goal[i] = points[pair[0]], points[pair[1]]
                break
        else:
            raise InfeasibleError(
                f"trial {i}: no start and goal at least {least_distance_m:.3g} m apart and clear of the map "
                f"among {_BLOCK * _BLOCKS} points; widen --bounds or lower --separation, --margin or --radius"
            )
    return Pairs(start, goal, sampled, inside)


def _first_pair(
    points: FloatArray, clear: NDArray[np.bool_], least_distance_m: float
) -> tuple[int, int] | None:
    """The first clear point, and the first clear one after it that is far enough from it."""
    index = np.flatnonzero(clear)
    if len(index) < 2:
        return None
    first = index[0]
    far = np.linalg.norm(points[index] - points[first], axis=1) >= least_distance_m
    far[0] = False
    return (int(first), int(index[np.argmax(far)])) if far.any() else None
