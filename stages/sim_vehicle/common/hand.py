"""Somebody who moves the simulated vehicle by hand, as `alula fly --frame-check hand` asks for."""

from __future__ import annotations

import math

from alula.stages.sim_vehicle.common.quaternions import Vector

_WAITS_S = 5.0  # from the first word of a client until it is lifted: its checks must have begun
_NEW_S = 5.0  # a client that was silent for that long is a new one
_MOVE_S, _REST_S = 1.5, 1.0
# East, north, up, and back to where it stood [m].
_PLACES = (
    (0.0, 0.0, 0.0),
    (0.4, 0.0, 0.0),
    (0.4, 0.4, 0.0),
    (0.4, 0.4, 0.4),
    (0.0, 0.0, 0.4),
    (0.0, 0.0, 0.0),
)


class Hand:
    """Moves it 0.4 m east, north and up, resting after each, and puts it back; once for each client."""

    def __init__(self) -> None:
        self._begin_s: float | None = None
        self._heard_s = -math.inf

    def attend(self, time_s: float, heard_s: float | None, *, is_ready: bool) -> None:
        """Wait for a client, last heard at a time, and for the vehicle to know where it is."""
        if heard_s is None:
            return
        if heard_s - self._heard_s > _NEW_S:
            self._begin_s = heard_s + _WAITS_S
        self._heard_s = heard_s
        if self._begin_s is not None and time_s < self._begin_s and not is_ready:
            self._begin_s = max(self._begin_s, time_s + 0.5 * _WAITS_S)

    def motion(self, time_s: float) -> tuple[Vector, Vector, Vector] | None:
        """Where it is held from where it stood, its velocity and acceleration, NED; None when it is not.

        Each move is p(s) = s - sin(2 pi s) / (2 pi) of its way: it begins and ends at rest.
        """
        if self._begin_s is None or time_s < self._begin_s:
            return None
        number, since_s = divmod(time_s - self._begin_s, _MOVE_S + _REST_S)
        if number >= len(_PLACES) - 1:
            self._begin_s = None
            return None
        start, end = _PLACES[int(number)], _PLACES[int(number) + 1]
        way = (end[1] - start[1], end[0] - start[0], start[2] - end[2])
        turn = 2 * math.pi * min(since_s / _MOVE_S, 1.0)
        share = (turn - math.sin(turn)) / (2 * math.pi)
        speed = (1 - math.cos(turn)) / _MOVE_S
        push = 2 * math.pi * math.sin(turn) / _MOVE_S**2
        origin = (start[1], start[0], -start[2])
        place = tuple(o + share * w for o, w in zip(origin, way, strict=True))
        return (
            (place[0], place[1], place[2]),
            (speed * way[0], speed * way[1], speed * way[2]),
            (push * way[0], push * way[1], push * way[2]),
        )
