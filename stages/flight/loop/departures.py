"""From where on its flight a vehicle may turn home: points, or all instants of a plan in intervals."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.artifact import Artifact
from alula.stages.planning.trajectory import evaluate, peak_bounds
from alula.stages.vehicles.velocity_lag import stop_m, stop_slope_s

_STEP_S = 0.1  # of the first intervals
_FINE_S = 0.005  # of those for the extent


class Around(NamedTuple):
    """The flight about the middles of N intervals of time.

    Attributes:
        point: of the flight at the middle, shape (N, 3) [m].
        coast: way to rest from there, shape (N, 3) [m].
        point_m: largest distance of the flight within the interval from `point`, shape (N,) [m].
        coast_m: largest difference of ways to rest within the interval from `coast`, shape (N,) [m].
    """

    point: FloatArray
    coast: FloatArray
    point_m: FloatArray
    coast_m: FloatArray

    def only(self, rows: NDArray[Any]) -> Around:
        """Some of the intervals."""
        return Around(*(each[rows] for each in self))


@dataclass(frozen=True, slots=True)
class Departures:
    """All instants at which a vehicle may turn home.

    Attributes:
        interval_s: first intervals of time, shape (N, 2) [s]; of points that are not joined, their numbers.
        around: the flight about the middles of intervals, shape (N, 2).
    """

    interval_s: FloatArray
    around: Callable[[FloatArray], Around]

    def extent(self, home: FloatArray) -> tuple[float, float, float]:
        """Bounds of the height above a point, and of the horizontal distance from it [m].

        Args:
            home: shape (3,) [m].
        """
        parts = []
        for begin, end in self.interval_s.tolist():
            ends = np.linspace(begin, end, 1 + max(1, math.ceil((end - begin) / _FINE_S)))
            parts.append(np.column_stack([ends[:-1], ends[1:]]))
        found = self.around(np.concatenate(parts))
        off = found.point - home
        away = np.hypot(off[:, 0], off[:, 1]) + found.point_m
        low, high = off[:, 2] - found.point_m, off[:, 2] + found.point_m
        return float(low.min()), float(high.max()), float(away.max())


def departures_at(point: FloatArray, coast: FloatArray | None = None) -> Departures:
    """Points that are not joined.

    Args:
        point: shape (T, 3), world frame [m].
        coast: way to rest from each, shape (T, 3) [m]; None if the vehicle rests at once.
    """
    ways = np.zeros_like(point) if coast is None else coast

    def around(interval: FloatArray) -> Around:
        i = interval[:, 0].astype(np.int64)
        return Around(point[i], ways[i], np.zeros(len(i)), np.zeros(len(i)))

    return Departures(np.repeat(np.arange(float(len(point)))[:, None], 2, axis=1), around)


def departures_of(plan: Artifact, limit_m_s: float, law: tuple[float, float]) -> Departures:
    """All instants of a plan.

    From velocity v the vehicle comes to rest within S(|v'|) along v, where v' = min(k |v|, limit) because a
    vehicle that catches up with its plan flies faster than the plan, in proportion, up to the limit. Within
    h of an instant, with bounds V and A of speed and acceleration, the point moves by min(V h, |v| h + A h^2
    / 2) at most, and the way to rest by k S'(limit) A h: S is convex with S(0) = 0, so S' is the larger one
    of its stretches along and across v.

    Args:
        law: time of a stop, a [s] and b [s^2/m], not negative, see `stop_m`.
    """
    knots = np.asarray(plan["time"], np.float64)
    c = np.asarray(plan["coefficient"], np.float64)[:, :3]
    fastest, hardest = peak_bounds(knots, c, 1), peak_bounds(knots, c, 2)
    whole = np.linspace(0.0, knots[-1], 1 + max(1, math.ceil(knots[-1] / _STEP_S)))
    sampled = np.linalg.norm(evaluate(knots, c, np.linspace(0.0, knots[-1], 10 * len(whole)), 1), axis=1)
    factor = max(1.0, limit_m_s / max(float(sampled.max()), 1e-9))
    slope_s = factor * stop_slope_s(law, limit_m_s)

    def around(interval: FloatArray) -> Around:
        middle, half = interval.mean(axis=1), 0.5 * (interval[:, 1] - interval[:, 0])
        first = np.clip(np.searchsorted(knots, interval[:, 0], side="right") - 1, 0, len(c) - 1)
        last = np.clip(np.searchsorted(knots, interval[:, 1], side="left") - 1, first, len(c) - 1)
        v_most, a_most = (_most(bounds, first, last) for bounds in (fastest, hardest))
        velocity = evaluate(knots, c, middle, 1)
        speed = np.linalg.norm(velocity, axis=1)
        flown = np.minimum(factor * speed, limit_m_s)
        way = np.array([stop_m(law, each) for each in flown.tolist()]).reshape(-1)
        point_m = half * np.minimum(v_most, speed + 0.5 * a_most * half)
        coast = velocity * (way / np.maximum(speed, 1e-9))[:, None]
        return Around(evaluate(knots, c, middle), coast, point_m, slope_s * a_most * half)

    return Departures(np.column_stack([whole[:-1], whole[1:]]), around)


def _most(bounds: FloatArray, first: NDArray[np.intp], last: NDArray[np.intp]) -> FloatArray:
    """Largest of the bounds from one piece to another, shape (N,)."""
    return np.array([bounds[i : j + 1].max() for i, j in zip(first.tolist(), last.tolist(), strict=True)])
