"""Start-goal pairs of trials: random ones clear of all obstacles, or those of another run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import InfeasibleError, UsageError
from alula.schemas.log.run import TrialResult

_BLOCK = 256  # candidates drawn at a time
_BLOCKS = 64  # blocks per trial before giving up
_TAIL_PERCENT = 1.0  # of the points on each side of each axis are outside the default bounds


@dataclass(frozen=True, slots=True)
class Pairs:
    """Start and goal of each trial, with the counts of the sampling.

    Attributes:
        start, goal: shapes (N, 3), world frame [m].
        sampled: number of points drawn.
        sampled_inside_hulls: number of those inside a hull.
        candidates: number of pairs formed from them.
    """

    start: FloatArray
    goal: FloatArray
    sampled: int
    sampled_inside_hulls: int
    candidates: int = 0


def pairs_flown(trials: Sequence[TrialResult], count: int | None) -> Pairs:
    """Take the starts and goals of another run.

    Args:
        count: number of first trials to take; None for all.

    Raises:
        UsageError: there are fewer.
    """
    if count is not None and count > len(trials):
        raise UsageError(f"`$.rules.trials`: {count}, but the run of mission.pairs_from has {len(trials)}")
    first = sorted(trials, key=lambda trial: trial.index)[:count]
    start, goal = (np.array([getattr(t, key) for t in first], np.float64) for key in ("start_m", "goal_m"))
    return Pairs(start.reshape(-1, 3), goal.reshape(-1, 3), 0, 0)


def check_clear(pairs: Pairs, is_clear: Callable[[FloatArray], NDArray[np.bool_]]) -> None:
    """Check the starts and goals of another run.

    Args:
        is_clear: which of the points, shape (M, 3), are clear of this run's map; shape (M,).

    Raises:
        UsageError: one is not clear.
    """
    for what, points in (("starts", pairs.start), ("ends", pairs.goal)):
        if not (clear := is_clear(points)).all():
            i = int(np.argmin(clear))
            where = " ".join(f"{value:.3f}" for value in points[i])
            raise UsageError(
                f"`$.mission.pairs_from`: trial {i} {what} at ({where}), closer to an obstacle than this run "
                "allows, or outside of the mapped box; take the pairs of a run in the same map with at "
                "least this clearance"
            )


def central_box(
    points: FloatArray, given: tuple[float, ...] | None, what: str
) -> tuple[FloatArray, FloatArray]:
    """Box for starts and goals: the given one, else the central 98 % of points per axis.

    Args:
        points: shape (N, 3), world frame [m].
        given: XMIN YMIN ZMIN XMAX YMAX ZMAX [m].
        what: the points in words.

    Returns:
        Lower and upper corner, shapes (3,) [m].

    Raises:
        UsageError: no box is given and there are no points.
    """
    if given is not None:
        return np.array(given[:3]), np.array(given[3:])
    if len(points) == 0:
        raise UsageError(f"the map has no {what} to take bounds from; set mission.bounds_m")
    lower, upper = np.percentile(points, [_TAIL_PERCENT, 100 - _TAIL_PERCENT], axis=0)
    return lower, upper


def sample_pairs(
    count: int,
    seed: int,
    bounds: tuple[FloatArray, FloatArray],
    min_distance_m: float,
    clearance: Callable[[FloatArray], FloatArray],
    is_clear: Callable[[FloatArray, FloatArray], NDArray[np.bool_]],
    is_wanted: Callable[[FloatArray, FloatArray], NDArray[np.bool_]] | None = None,
    is_inside: Callable[[FloatArray], NDArray[np.bool_]] | None = None,
) -> Pairs:
    """Draw pairs uniformly in a box, both points clear and far enough apart.

    Trial i has a counter-based generator of its own, keyed on (seed, i): its pair does not depend on the
    number of trials or on threads. A pair that `is_wanted` rejects is replaced by the next pair of the same
    generator, so the pairs are drawn under the condition that they are wanted.

    Args:
        bounds: lower and upper corner, each of shape (3,) [m].
        min_distance_m: minimum distance from start to goal [m].
        clearance: psi of the map at points (M, 3), shape (M,), negative inside a hull [m].
        is_clear: which of the points, given with their psi, may be a start or a goal; shape (M,).
        is_wanted: which of the pairs, starts and goals of shape (P, 3), may be flown; shape (P,). All by
            default.
        is_inside: which of the points, shape (P, 3), may be a start or a goal besides; it is asked for as few
            points as decide, because it takes long. All by default.

    Raises:
        InfeasibleError: no pair was found for a trial among 16384 points.
    """
    start, goal = np.empty((count, 3)), np.empty((count, 3))
    sampled = inside = candidates = 0
    lower, upper = bounds
    for i in range(count):
        generator = np.random.Generator(np.random.Philox(key=np.array([seed, i], np.uint64)))
        for _ in range(_BLOCKS):
            points = lower + generator.random((_BLOCK, 3)) * (upper - lower)
            psi = clearance(points)
            clear = is_clear(points, psi)
            if is_wanted is None:
                found = _first_pair(points, clear, min_distance_m, is_inside)
            else:
                if is_inside is not None and clear.any():
                    clear[clear] = is_inside(points[clear])
                found = _pairs(points, clear, min_distance_m, _BLOCK)
            wanted = np.ones(len(found), np.bool_)
            if is_wanted is not None and len(found):
                wanted = is_wanted(points[found[:, 0]], points[found[:, 1]])
            pair = found[np.argmax(wanted)] if wanted.any() else None
            candidates += len(found) if pair is None else int(np.argmax(wanted)) + 1
            seen = _BLOCK if pair is None else int(pair[1]) + 1
            sampled += seen
            inside += int((psi[:seen] < 0).sum())
            if pair is not None:
                start[i], goal[i] = points[pair[0]], points[pair[1]]
                break
        else:
            raise InfeasibleError(
                f"trial {i}: no start and goal at least {min_distance_m:.3g} m apart and clear of the map "
                f"{'' if is_wanted is None else 'with a blocked line between them '}"
                f"among {_BLOCK * _BLOCKS} points; widen mission.bounds_m, beyond the map with "
                "mission.beyond_map_m, or lower mission.separation, mission.margin_m or vehicle.radius_m"
            )
    return Pairs(start, goal, sampled, inside, candidates)


def _first_pair(
    points: FloatArray,
    clear: NDArray[np.bool_],
    min_distance_m: float,
    is_inside: Callable[[FloatArray], NDArray[np.bool_]] | None,
) -> NDArray[np.int64]:
    """Indices of the first pair of points that are clear and inside, shape (1, 2); (0, 2) without one."""
    left = clear.copy()
    while len(found := _pairs(points, left, min_distance_m, 1)):
        if is_inside is None or (inside := is_inside(points[found[0]])).all():
            break
        left[found[0, ~inside]] = False
    return found


def _pairs(
    points: FloatArray, clear: NDArray[np.bool_], min_distance_m: float, limit: int
) -> NDArray[np.int64]:
    """Indices of at most `limit` pairs, shape (P, 2), each after the one before.

    A pair is the first clear point and the first clear point after it that is far enough away.
    """
    found: list[tuple[int, int]] = []
    index = np.flatnonzero(clear)
    while len(index) > 1 and len(found) < limit:
        far = np.linalg.norm(points[index] - points[index[0]], axis=1) >= min_distance_m
        far[0] = False
        if not far.any():
            break
        goal = int(np.argmax(far))
        found.append((int(index[0]), int(index[goal])))
        index = index[goal + 1 :]
    return np.array(found, np.int64).reshape(-1, 2)
