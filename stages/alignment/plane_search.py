"""Search for the floor among the planes that are nearly level: branch and bound, then a fit by MLESAC.

A random triple lies in a floor that holds 14 % of the points in 1 of 364 draws. Branch and bound draws
nothing. It bounds the score of all planes of a box of tilts at once, so its result depends on the points
only. No plane has a score more than 10 % above that of the result, or above the larger bound that is returned
where the search ended at its limit of boxes.
Source: Breuel 2003 (branch and bound for geometric matching); Torr and Zisserman 2000 (MLESAC).
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from math import sqrt, tan

import numpy as np

from alula.schemas.arrays import FloatArray

GAP = 0.1  # the search ends when no plane has a score above 1 + GAP of the best found
BELOW_COST = 0.5  # of a point below a floor, relative to the gain of a point in it
_MAX_BOXES = 2500
_FIRST_CELLS = 8  # boxes of tilts per axis at the start
_BIN = 0.25  # of the tolerance, in the histograms of heights
_TAIL = 0.005  # fraction of the heights at either end that share one bin
_ROUNDS = 60
SLAB = 2.0  # half width of the slab of a fit, in tolerances
_THINNEST = 1e-3  # sigma of an exact plane, in tolerances
_SETTLED = 1e-4  # of the tolerance: the fit has converged


@dataclass(frozen=True, slots=True)
class Plane:
    """A fitted plane {p : normal . p = offset} with the distribution of the points around it.

    Attributes:
        normal: unit normal, shape (3,); points up.
        offset: height along the normal [m].
        sigma: standard deviation of the distances of its points [m].
        weight: probability that a point belongs to the plane, shape (n,).
    """

    normal: FloatArray
    offset: float
    sigma: float
    weight: FloatArray


def best_level_plane(
    points: FloatArray, tolerance: float, max_tilt: float
) -> tuple[FloatArray, float, float] | None:
    """Plane z = a x + b y + c with the highest score among those tilted by at most `max_tilt`.

    The score is the number of points within the tolerance minus half the number of points more than two
    tolerances below. For a box of slopes (a, b) with half width d, a point's height z - a x - b y changes by
    at most d (|x| + |y|). The largest number of intervals of that width that share one height therefore
    bounds the score of every plane in the box. The box with the largest bound is divided next.

    Args:
        points: shape (n, 3), z up [m].
        tolerance: half the thickness of a plane [m].
        max_tilt: largest angle to the horizontal [rad].

    Returns:
        Unit normal, offset, and the bound of the scores of all planes relative to the score found (1.1 means
        that no plane is better by more than 10 %); None when no plane has a score above zero.
    """
    centre = np.median(points, axis=0)
    x, y, z = (points - centre).T
    reach = np.abs(x) + np.abs(y)
    limit = tan(max_tilt)

    def scored(a: float, b: float) -> tuple[float, float]:
        """Score of the best plane of these slopes and its height."""
        heights = np.sort(z - a * x - b * y)
        half = tolerance * sqrt(1 + a * a + b * b)
        inside = np.searchsorted(heights, heights + 2 * half, "right") - np.arange(len(heights))
        score = inside - BELOW_COST * np.searchsorted(heights, heights - half)
        k = int(score.argmax())
        return float(score[k]), float(heights[k] + half)

    def bound(a: float, b: float, d: float) -> float:
        """Bound of the scores of all planes with slopes in the box around (a, b)."""
        heights = z - a * x - b * y
        half = tolerance * sqrt(1 + (abs(a) + d) ** 2 + (abs(b) + d) ** 2)
        margin = half + d * reach
        low, high = np.partition(heights, [tail, len(heights) - 1 - tail])[[tail, len(heights) - 1 - tail]]
        width = _BIN * tolerance
        low, bins = low - 4 * half, int((high - low + 8 * half) / width) + 3
        # All roundings go outward, and what lies beyond the bins counts in the first or last one.
        first = np.clip(np.floor((heights - margin - low) / width), 0, bins - 1).astype(np.intp)
        last = np.clip(np.floor((heights + margin - low) / width), 0, bins - 1).astype(np.intp)
        under = np.clip(np.ceil((heights + d * reach + 2 * half - low) / width) + 1, 1, bins).astype(np.intp)
        inside = np.cumsum(np.bincount(first, minlength=bins + 1) - np.bincount(last + 1, minlength=bins + 1))
        below = np.cumsum(np.bincount(under, minlength=bins + 1))
        return float((inside - BELOW_COST * below)[:bins].max())

    tail = int(_TAIL * len(points))
    best, found = 0.0, None
    step = limit / _FIRST_CELLS
    starts = np.linspace(-limit + step, limit - step, _FIRST_CELLS).tolist()
    waiting = [(-bound(a, b, step), a, b, step) for a in starts for b in starts]
    heapq.heapify(waiting)
    for a in starts:
        for b in starts:
            score, height = scored(a, b)
            if score > best and a * a + b * b <= limit * limit:
                best, found = score, (a, b, height)
    boxes = len(waiting)
    while waiting and boxes < _MAX_BOXES and -waiting[0][0] > (1 + GAP) * best:
        _, a, b, d = heapq.heappop(waiting)
        d /= 2
        for left in (a - d, a + d):
            for front in (b - d, b + d):
                if max(abs(left) - d, 0.0) ** 2 + max(abs(front) - d, 0.0) ** 2 > limit * limit:
                    continue
                score, height = scored(left, front)
                if score > best and left * left + front * front <= limit * limit:
                    best, found = score, (left, front, height)
                highest = bound(left, front, d)
                boxes += 1
                if highest > (1 + GAP) * best:
                    heapq.heappush(waiting, (-highest, left, front, d))
    if found is None:
        return None
    a, b, height = found
    normal = np.array([-a, -b, 1.0]) / sqrt(1 + a * a + b * b)
    offset = float(normal @ (centre + np.array([0.0, 0.0, height])))
    return normal, offset, max(-waiting[0][0] / best, 1 + GAP) if waiting else 1 + GAP


def fit_plane(points: FloatArray, normal: FloatArray, offset: float, sigma: float, tolerance: float) -> Plane:
    """Fit a plane by MLESAC: normal distances of its points, uniform heights of all others in the slab.

    Expectation maximisation alternates between the probability that a point belongs to the plane and
    weighted least squares. So furniture and walls in the slab neither shift nor thicken the plane.

    Args:
        points: shape (n, 3) [m].
        normal: first normal, unit length, shape (3,).
        offset: first offset [m].
        sigma: first standard deviation of the distances [m].
        tolerance: half the thickness of a plane [m]; the slab of the fit has twice that.
    """
    share = 0.5
    weight = np.zeros(len(points))
    for _ in range(_ROUNDS):
        distance = points @ normal - offset
        inside = np.abs(distance) <= SLAB * tolerance
        if inside.sum() < 4:
            break
        bell = share / (sqrt(2 * np.pi) * sigma) * np.exp(-0.5 * (distance[inside] / sigma) ** 2)
        even = (1 - share) / (2 * SLAB * tolerance)
        belongs = bell / (bell + even)
        weight = np.zeros(len(points))
        weight[inside] = belongs
        total = float(belongs.sum())
        if total < 3:
            break
        held = points[inside]
        centre = belongs @ held / total
        _, vectors = np.linalg.eigh((held - centre).T @ (belongs[:, None] * (held - centre)))
        turned = vectors[:, 0] * np.sign(vectors[:, 0] @ normal or 1.0)
        height = float(turned @ centre)
        spread = sqrt(float(belongs @ (held @ turned - height) ** 2) / total)
        share = min(total / len(held), 1 - 1e-6)
        change = float(np.abs(held @ turned - height - distance[inside]).mean()) + abs(spread - sigma)
        normal, offset, sigma = turned, height, max(spread, _THINNEST * tolerance)
        if change < _SETTLED * tolerance:
            break
    return Plane(normal, offset, sigma, weight)
