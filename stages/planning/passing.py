"""Which waypoints and gates a path passed, in their order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.schemas.artifacts.manifest import PlanPass
from alula.schemas.log.run import PassResult
from alula.stages.planning.passes import laps_of, name_of

_TIMING_S = 1e-6  # that a time at a waypoint may be short of it


class _Met(NamedTuple):
    """A pass that was met: the first chord that may meet it, and the first one for those behind it."""

    number: int
    begin: int
    end: int


def passed_of(
    passes: Sequence[PlanPass], allowed_m: Sequence[float], path: FloatArray, time_s: FloatArray | None
) -> tuple[list[PassResult], list[float]]:
    """Judge how a path passed waypoints and gates: as many of them in their order as possible.

    A gate is passed by a chord that crosses its plane in its direction, where the vehicle fits into the
    opening. A waypoint where the plan holds is passed by a time within its tolerance without leaving it.

    Args:
        passes: of the plan, of all laps.
        allowed_m: distance within which each counts as passed [m].
        path: shape (T, 3), T >= 1, joined by chords, world frame [m].
        time_s: of its points, shape (T,) [s]; None: times at waypoints are not judged.

    Returns:
        Each pass, and the minimum distance to its point, between those before and behind it that were passed.
    """
    begin, end = path[: max(len(path) - 1, 1)], path[min(1, len(path) - 1) :]
    known: dict[tuple[object, ...], _Waypoint | _Gate] = {}
    meets: list[_Waypoint | _Gate] = []
    for each, allowed in zip(passes, allowed_m, strict=True):
        key = (each.kind, *each.point_m, *each.normal, each.hold_s, allowed)  # laps are alike
        if key not in known:
            kind = _Gate if each.kind == "gate" else _Waypoint
            known[key] = kind(each, allowed, begin, end, time_s)
        meets.append(known[key])
    met = {each.number: each for each in _most_met(meets)}
    results, closest = [], []
    first = 0
    for number, (each, meet) in enumerate(zip(passes, meets, strict=True)):
        behind = [other.begin for other in met.values() if other.number > number]
        last = len(begin) if number in met else min(behind, default=len(begin))
        window = slice(min(first, len(begin) - 1), max(last, first + 1))
        closest.append(float(meet.distance[window].min()))
        name = name_of(each, laps_of(passes))
        results.append(meet.result(name, window, is_passed=number in met))
        first = met[number].end if number in met else first
    return results, closest


def _most_met(meets: Sequence[_Waypoint | _Gate]) -> list[_Met]:
    """The most passes that a path meets in their order; if possible, each where it is met first."""
    greedy: list[_Met] = []
    for number, meet in enumerate(meets):
        found = meet.next(greedy[-1].end if greedy else 0)
        if found is not None:
            greedy.append(_Met(number, *found))
    if len(greedy) == len(meets):
        return greedy
    # best[m]: a way to meet m of the passes so far whose end is the earliest
    best: list[tuple[_Met, ...]] = [()]
    for number, meet in enumerate(meets):
        longest = len(best)
        for m in range(longest - 1, -1, -1):
            found = meet.next(best[m][-1].end if m else 0)
            if found is None:
                continue
            way = (*best[m], _Met(number, *found))
            if m + 1 == len(best):
                best.append(way)
            elif found[1] < best[m + 1][-1].end:
                best[m + 1] = way
    return list(best[-1]) if len(best) - 1 > len(greedy) else greedy


class _Waypoint:
    """Where a path is within the tolerance of a waypoint."""

    def __init__(
        self, each: PlanPass, allowed: float, begin: FloatArray, end: FloatArray, time_s: FloatArray | None
    ) -> None:
        self.allowed, self.hold_s = allowed, each.hold_s
        self.time_s = time_s if each.hold_s else None
        self.distance = chord_distances(begin, end, np.array(each.point_m))
        near = np.concatenate([[False], self.distance <= allowed, [False]])
        edge = np.flatnonzero(np.diff(near.astype(np.int8)))
        self.into, self.out = edge[::2], edge[1::2]  # chords of each stay, and one past its last

    def next(self, first: int) -> tuple[int, int] | None:
        for i in range(int(np.searchsorted(self.out, first, side="right")), len(self.out)):
            begin = max(int(self.into[i]), first)
            if self.time_s is None:
                return begin, begin
            if self._stay(begin, i) >= self.hold_s - _TIMING_S:
                since = self.time_s[begin] + self.hold_s
                return begin, min(int(np.searchsorted(self.time_s, since)), int(self.out[i]))
        return None

    def _stay(self, begin: int, i: int) -> float:
        assert self.time_s is not None
        return float(self.time_s[min(int(self.out[i]), len(self.time_s) - 1)] - self.time_s[begin])

    def result(self, name: str, window: slice, *, is_passed: bool) -> PassResult:
        held = None
        if self.time_s is not None:
            inside = (self.out > window.start) & (self.into < window.stop)
            stays = [self._stay(max(int(self.into[i]), window.start), int(i)) for i in np.flatnonzero(inside)]
            held = max(stays, default=0.0)
        off = float(self.distance[window].min())
        return PassResult(name=name, passed=is_passed, allowed_m=self.allowed, off_m=off, held_s=held)


class _Gate:
    """Where a path crosses the plane of a gate."""

    def __init__(
        self, each: PlanPass, allowed: float, begin: FloatArray, end: FloatArray, time_s: FloatArray | None
    ) -> None:
        self.allowed = allowed
        normal, centre = np.array(each.normal), np.array(each.point_m)
        self.distance = chord_distances(begin, end, centre)
        before, after = (begin - centre) @ normal, (end - centre) @ normal

        def off(chords: NDArray[np.int64]) -> FloatArray:
            share = (before[chords] / (before[chords] - after[chords]))[:, None]
            met = (1 - share) * begin[chords] + share * end[chords] - centre
            apart: FloatArray = np.linalg.norm(met - (met @ normal)[:, None] * normal, axis=1)
            return apart

        self.along = np.flatnonzero((before <= 0) & (after > 0))
        self.off = off(self.along)
        against = np.flatnonzero((before >= 0) & (after < 0))
        self.good, self.backwards = self.along[self.off <= allowed], against[off(against) <= allowed]

    def next(self, first: int) -> tuple[int, int] | None:
        i = int(np.searchsorted(self.good, first))
        return (int(self.good[i]), int(self.good[i]) + 1) if i < len(self.good) else None

    def result(self, name: str, window: slice, *, is_passed: bool) -> PassResult:
        here = (self.along >= window.start) & (self.along < window.stop)
        off = self.off[here]
        if is_passed:
            off = off[off <= self.allowed][:1]
        wrong_way = ((self.backwards >= window.start) & (self.backwards < window.stop)).any()
        return PassResult(
            name=name,
            passed=is_passed,
            allowed_m=self.allowed,
            off_m=float(off.min()) if len(off) else None,
            backwards=not is_passed and bool(wrong_way),
        )


def chord_distances(begin: FloatArray, end: FloatArray, point: FloatArray) -> FloatArray:
    """Distances of chords to a point.

    Args:
        begin: shape (S, 3) [m].
        end: shape (S, 3) [m].
        point: shape (3,) [m].

    Returns:
        Shape (S,) [m].
    """
    chord, to = end - begin, point - begin
    length2 = np.einsum("ij,ij->i", chord, chord)
    along = np.einsum("ij,ij->i", to, chord) / np.where(length2 > 0, length2, 1)
    apart: FloatArray = np.linalg.norm(to - np.clip(along, 0, 1)[:, None] * chord, axis=1)
    return apart
