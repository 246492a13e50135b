"""Distance of the ways home of a vehicle from the map, for all instants of its flight."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from alula._core import EllipsoidSet, PolytopeSet
from alula.schemas.arrays import FloatArray
from alula.stages.clearance import segment_clearance
from alula.stages.flight.links.own_safety import WayHome
from alula.stages.flight.loop.departures import Around, Departures

_FINEST_M = 0.005  # a bound that is nearer to the truth than this is taken
_SLACK = 0.25  # of the distance of sampled ways beyond the radius, that the bound for all ways keeps
_MOST_SETS = 300_000  # that are judged at once; beyond that, bounds are taken as they are


Obstacles = Sequence[tuple[str, PolytopeSet | EllipsoidSet]]


class Meeting(NamedTuple):
    """Where a way home comes closest to the map.

    Attributes:
        distance_m: distance to the obstacle; no way home comes closer [m].
        at: where on the plan the vehicle turns home, shape (3,), world frame [m].
        height_m: height of the level part above the take-off position [m].
        coast_m: how far it flies on before the way begins [m].
        share: part of the flight from which ways home were judged; elsewhere the vehicle has no room.
    """

    distance_m: float
    name: str
    at: FloatArray
    height_m: float
    coast_m: float = 0.0
    share: float = 1.0


class _Sets(NamedTuple):
    """Sets of ways home: from an interval of time, after a part of the way to rest.

    Attributes:
        interval_s: shape (N, 2), see `Departures`.
        coasted: smallest and largest part of the way to rest, shape (N, 2).
        weight: part of the flight, shape (N,).
    """

    interval_s: FloatArray
    coasted: FloatArray
    weight: FloatArray

    def only(self, rows: NDArray[Any]) -> _Sets:
        """Some of them."""
        return _Sets(*(each[rows] for each in self))

    def halves(self, is_of_time: NDArray[np.bool_]) -> _Sets:
        """Both halves of each, in time or else in the part of the way to rest."""
        parts = []
        for end in (0, 1):
            interval, coasted = self.interval_s.copy(), self.coasted.copy()
            interval[is_of_time, 1 - end] = interval[is_of_time].mean(axis=1)
            coasted[~is_of_time, 1 - end] = coasted[~is_of_time].mean(axis=1)
            parts.append(_Sets(interval, coasted, 0.5 * self.weight))
        return _Sets(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def closest_way_home(
    way: WayHome,
    departures: Departures,
    home: FloatArray,
    obstacles: Obstacles,
    *,
    radius_m: float,
    foot_m: float,
) -> Meeting:
    """Closest approach to the map of the ways home from all instants of a flight where the vehicle fits.

    The vehicle first flies on to rest, and may turn home from there, from anywhere on that way, and at once.
    Ways that begin within an interval of time and within a part of the way to rest lie about the way from the
    middles of both: where the ends of two segments differ by less than e, so do their points. The height of
    the level part does not fall where the vehicle is higher or farther, so its values for the lowest and the
    nearest, and for the highest and the farthest, bound it. A set that this does not show to be clear is
    halved, down to 5 mm.

    Args:
        departures: from which it turns home, world frame, z up.
        home: take-off position, shape (3,), world frame [m].
        radius_m: radius of the vehicle; departures that are closer to an obstacle are left out, and those
            about which 5 mm do not decide that [m].
        foot_m: the last part of the way down, to leave out the ground [m].

    Returns:
        The closest of sampled ways if it is closer than the radius, else a bound for all ways.
    """
    best = Meeting(math.inf, "", home, 0.0)
    interval = departures.interval_s
    if not len(interval) or not obstacles:
        return best

    def judge(of: _Sets, around: Around, cap_m: float) -> tuple[FloatArray, Callable[[int], Meeting]]:
        begin, end, within_m, level_m = _segments(way, of, around, home, foot_m)
        bound, named = np.full(len(of.weight), math.inf), np.zeros(len(of.weight), np.int64)
        for number, (_, each) in enumerate(obstacles):
            cap = cap_m + float(within_m.max())
            apart = segment_clearance(begin.reshape(-1, 3), end.reshape(-1, 3), each, jobs=1, cap_m=cap)
            least = (apart.reshape(within_m.shape) - within_m).min(axis=0)
            named, bound = np.where(least < bound, number, named), np.minimum(bound, least)

        def meeting(i: int) -> Meeting:
            coast_m = float(np.linalg.norm(around.coast[i]) * of.coasted[i].max())
            name = obstacles[named[i]][0]
            return Meeting(float(bound[i]), name, around.point[i], float(level_m[i]), coast_m)

        return bound, meeting

    instants = np.unique(interval)
    sampled = np.column_stack([instants, instants])
    is_moving = bool(departures.around(sampled).coast.any())
    sampled = sampled[_room(departures.around(sampled), obstacles) >= radius_m]
    if len(sampled):
        parts = np.repeat((0.0, 0.5, 1.0) if is_moving else (0.0,), len(sampled))
        times = np.tile(sampled, (len(parts) // len(sampled), 1))
        points = _Sets(times, np.column_stack([parts, parts]), np.ones(len(parts)))
        bound, meeting = judge(points, departures.around(times), math.inf)
        best = meeting(int(bound.argmin()))
        if best.distance_m < radius_m:
            return best
    far_m = best.distance_m
    enough = radius_m + _SLACK * (far_m - radius_m)
    enough = enough if math.isfinite(enough) else radius_m
    halves = np.array([(0.0, 0.5), (0.5, 1.0)] if is_moving else [(0.0, 0.0)])
    sets = _Sets(
        np.tile(interval, (len(halves), 1)),
        np.repeat(halves, len(interval), axis=0),
        np.full(len(halves) * len(interval), 1 / (len(halves) * len(interval))),
    )
    left_out = 0.0
    while len(sets.weight):
        around = departures.around(sets.interval_s)
        room = _room(around, obstacles) - radius_m
        fits = room >= around.point_m
        unsure = ~fits & (room >= -around.point_m) & (around.point_m > _FINEST_M)
        is_kept = fits | unsure
        left_out += float(sets.weight[~is_kept].sum())
        sets, unsure = sets.only(is_kept), unsure[is_kept]
        around = around.only(is_kept)
        done = np.zeros(len(unsure), np.bool_)
        of_time = around.point_m + sets.coasted[:, 1] * around.coast_m
        of_part = 0.5 * np.ptp(sets.coasted, axis=1) * np.linalg.norm(around.coast, axis=1)
        certain = np.flatnonzero(~unsure)
        if len(certain):
            bound, meeting = judge(sets.only(certain), around.only(certain), far_m)
            fine = np.maximum(of_time, of_part)[certain] <= _FINEST_M
            done[certain] = (bound >= enough) | fine | (len(sets.weight) > _MOST_SETS)
            if done.any():
                taken = np.where(done[certain], bound, math.inf)
                best = min(best, meeting(int(taken.argmin())), key=lambda each: each.distance_m)
            if best.distance_m < radius_m:
                return best
        sets = sets.only(~done).halves((unsure | (of_time >= of_part))[~done])
    return best._replace(share=1.0 - left_out)


def _room(around: Around, obstacles: Obstacles) -> FloatArray:
    """Distance of the flight in the middle of intervals from the map, shape (N,) [m]."""
    found = np.full(len(around.point), math.inf)
    for _, each in obstacles:
        found = np.minimum(found, segment_clearance(around.point, around.point, each, jobs=1))
    return found


def _segments(
    way: WayHome, sets: _Sets, around: Around, home: FloatArray, foot_m: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Segments about which the ways of N sets lie: to rest, up, down, and level where the height may be.

    Returns:
        Their ends, shape (S, N, 3) each, the distance within which the ways lie about them, shape (S, N), and
        the largest height of the level part, shape (N,) [m].
    """
    most = sets.coasted[:, 1]
    rest = around.point + sets.coasted.mean(axis=1)[:, None] * around.coast
    of_time = around.point_m + most * around.coast_m
    within = of_time + 0.5 * np.ptp(sets.coasted, axis=1) * np.linalg.norm(around.coast, axis=1)
    above, away = rest[:, 2] - home[2], np.hypot(rest[:, 0] - home[0], rest[:, 1] - home[1])
    near, far = np.maximum(away - within, 0.0), away + within
    ends = [-math.inf, *sorted(way.jumps_m), math.inf]
    lows, highs = [], []
    for a, b in pairwise(ends):  # where a part is empty, its end stands for it
        lows.append(way.heights(above - within, np.clip(np.nextafter(a, math.inf), near, far)))
        highs.append(way.heights(above + within, np.clip(b, near, far)))
    low, high = np.min(lows, axis=0), np.max(highs, axis=0)

    def over(at: FloatArray, height: FloatArray) -> FloatArray:
        return np.column_stack([np.broadcast_to(at[..., :2], (len(height), 2)), home[2] + height])

    begins = [around.point, rest, over(home, high)]
    ends_of = [
        around.point + most[:, None] * around.coast,
        over(rest, high),
        over(home, np.minimum(low, foot_m)),
    ]
    widths = [of_time, within, np.zeros_like(within)]
    for least, largest in zip(lows, highs, strict=True):
        middle = 0.5 * (least + largest)
        begins.append(over(rest, middle))
        ends_of.append(over(home, middle))
        widths.append(np.hypot(within, 0.5 * (largest - least)))
    return np.stack(begins), np.stack(ends_of), np.stack(widths), high
