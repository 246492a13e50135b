"""Hand that moves the simulated vehicle, as `alula fly --frame-check hand` needs."""

from __future__ import annotations

import math

from alula.stages.sim_vehicle.common.quaternions import Vector

_WAITS_S = 5.0  # from a client's first heartbeat until it is lifted: the client's checks must have begun
_NEW_S = 5.0  # after this long without heartbeats a client counts as a new one
_MOVE_S, _REST_S = 1.5, 1.0
# Way-points, east, north, up from where it stood [m].
_WAYPOINTS = (
    (0.0, 0.0, 0.0),
    (0.4, 0.0, 0.0),
    (0.4, 0.4, 0.0),
    (0.4, 0.4, 0.4),
    (0.0, 0.0, 0.4),
    (0.0, 0.0, 0.0),
)


class Hand:
    """Hand that moves the vehicle 0.4 m east, north and up, rests after each, and puts it back.

    It does so once for each client.
    """

    def __init__(self) -> None:
        self._begin_s: float | None = None
        self._client_s = -math.inf

    def attend(self, time_s: float, client_s: float | None, *, is_ready: bool) -> None:
        """Wait for a client and for a valid estimate of the vehicle.

        Args:
            client_s: time of the last heartbeat of a client; None before the first [s].
        """
        if client_s is None:
            return
        if client_s - self._client_s > _NEW_S:
            self._begin_s = client_s + _WAITS_S
        self._client_s = client_s
        if self._begin_s is not None and time_s < self._begin_s and not is_ready:
            self._begin_s = max(self._begin_s, time_s + 0.5 * _WAITS_S)

    def motion(self, time_s: float) -> tuple[Vector, Vector, Vector] | None:
        """Displacement from where it stood [m], velocity [m/s] and acceleration [m/s^2], NED.

        Each move covers the fraction s - sin(2 pi s) / (2 pi) of its distance at the fraction s of its time,
        so it begins and ends at rest.

        Returns:
            The motion; None while the hand does not hold the vehicle.
        """
        if self._begin_s is None or time_s < self._begin_s:
            return None
        number, since_s = divmod(time_s - self._begin_s, _MOVE_S + _REST_S)
        if number >= len(_WAYPOINTS) - 1:
            self._begin_s = None
            return None
        start, end = _WAYPOINTS[int(number)], _WAYPOINTS[int(number) + 1]
        path = (end[1] - start[1], end[0] - start[0], start[2] - end[2])
        phase = 2 * math.pi * min(since_s / _MOVE_S, 1.0)
        fraction = (phase - math.sin(phase)) / (2 * math.pi)
        rate = (1 - math.cos(phase)) / _MOVE_S
        bend = 2 * math.pi * math.sin(phase) / _MOVE_S**2
        origin = (start[1], start[0], -start[2])
        position = tuple(o + fraction * p for o, p in zip(origin, path, strict=True))
        return (
            (position[0], position[1], position[2]),
            (rate * path[0], rate * path[1], rate * path[2]),
            (bend * path[0], bend * path[1], bend * path[2]),
        )
