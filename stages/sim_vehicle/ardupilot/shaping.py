"""Shaped commands: a position, velocity and acceleration that approach a target with bounded jerk."""

from __future__ import annotations

import math

from alula.stages.sim_vehicle.common.airframe import TICK_S

_CROSS_SHARE = 1 / math.sqrt(2)  # of the acceleration, at most this much is across the wanted velocity


def square_root(error: float, gain: float, limit: float) -> float:
    """Rate that removes an error and can still be slowed down with a bounded derivative.

    rate = gain error within limit / gain^2, else the root of 2 limit (|error| - limit / (2 gain^2)), which
    continues it with a continuous slope.

    Args:
        error: the error.
        gain: proportional gain of small errors [1/s].
        limit: bound of the rate's derivative; not positive for none.
    """
    if limit <= 0 or abs(error) * gain * gain <= limit:
        return gain * error
    if gain <= 0:
        return math.copysign(math.sqrt(2 * limit * abs(error)), error)
    return math.copysign(math.sqrt(2 * limit * (abs(error) - limit / (2 * gain * gain))), error)


def largest_error(rate: float, gain: float, limit: float) -> float:
    """Error at which `square_root` reaches a positive rate; infinite without a gain."""
    if gain <= 0:
        return math.inf
    if limit <= 0 or rate * gain <= limit:
        return rate / gain
    return limit / (2 * gain * gain) + rate * rate / (2 * limit)


def low_pass_weight(cutoff_hz: float) -> float:
    """Weight of the newest value in a first-order low-pass of one tick; 1 without a cutoff."""
    if cutoff_hz <= 0:
        return 1.0
    return TICK_S / (TICK_S + 1 / (2 * math.pi * cutoff_hz))


class Profile:
    """Shaped motion along some axes; all lists have one number for each.

    In each tick it first moves on with its acceleration. Then the acceleration turns towards the command, its
    change bounded by the jerk.

    Args:
        axes: number of axes.

    Attributes:
        position: [m].
        velocity: [m/s].
        acceleration: [m/s^2].
    """

    def __init__(self, axes: int) -> None:
        self.position = [0.0] * axes
        self.velocity = [0.0] * axes
        self.acceleration = [0.0] * axes

    def start(self, position: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        """Start from a motion without acceleration."""
        self.position, self.velocity = list(position), list(velocity)
        self.acceleration = [0.0] * len(position)

    def advance(self) -> None:
        """Move on by one tick."""
        for i, (v, a) in enumerate(zip(self.velocity, self.acceleration, strict=True)):
            self.position[i] += v * TICK_S + a * TICK_S * TICK_S / 2
            self.velocity[i] += a * TICK_S

    def to_acceleration(self, command: list[float], jerk: float) -> None:
        """Change the acceleration towards a command.

        Args:
            command: acceleration [m/s^2].
            jerk: its largest change [m/s^3].
        """
        change = _limited([c - a for c, a in zip(command, self.acceleration, strict=True)], jerk * TICK_S)
        self.acceleration = [a + d for a, d in zip(self.acceleration, change, strict=True)]

    def to_velocity(self, command: list[float], ahead: tuple[float, ...], limit: float, jerk: float) -> None:
        """Change the acceleration towards that which reaches a velocity.

        Args:
            command: velocity [m/s].
            ahead: acceleration added to it [m/s^2].
            limit: largest acceleration [m/s^2].
            jerk: its largest change [m/s^3].
        """
        error = [c - v for c, v in zip(command, self.velocity, strict=True)]
        size = math.hypot(*error)
        rate = min(square_root(size, jerk / limit, jerk), size / TICK_S)
        wanted = [e * (rate / size) if size > 0 else 0.0 for e in error]
        wanted = _within(wanted, command, limit)
        self.to_acceleration([w + a for w, a in zip(wanted, ahead, strict=True)], jerk)

    def to_position(
        self,
        point: tuple[float, ...],
        velocity: tuple[float, ...],
        ahead: tuple[float, ...],
        speed: float,
        limit: float,
        jerk: float,
    ) -> None:
        """Change the acceleration towards that which reaches a position.

        Args:
            point: position [m].
            velocity: velocity there [m/s].
            ahead: acceleration there [m/s^2].
            speed: largest speed towards the point, in addition to `velocity` [m/s].
            limit: largest acceleration [m/s^2].
            jerk: its largest change [m/s^3].
        """
        error = [p - q for p, q in zip(point, self.position, strict=True)]
        size = math.hypot(*error)
        rate = min(square_root(size, jerk / (2 * limit), limit / 2), size / TICK_S, speed)
        command = [v + (e * (rate / size) if size > 0 else 0.0) for v, e in zip(velocity, error, strict=True)]
        self.to_velocity(command, ahead, limit, jerk)

    def keep_near(self, position: tuple[float, ...], limit: float) -> list[float]:
        """Error to an actual position [m]; move the profile if that is beyond a limit [m]."""
        error = [p - q for p, q in zip(self.position, position, strict=True)]
        kept = _limited(error, limit)
        if kept != error:
            self.position = [q + e for q, e in zip(position, kept, strict=True)]
        return kept


def _limited(vector: list[float], length: float) -> list[float]:
    size = math.hypot(*vector)
    return vector if size <= length else [v * (length / size) for v in vector]


def _within(wanted: list[float], velocity: list[float], limit: float) -> list[float]:
    """Limit an acceleration; along the wanted velocity it yields to that across."""
    speed = math.hypot(*velocity)
    if speed == 0 or math.hypot(*wanted) <= limit:
        return _limited(wanted, limit)
    unit = [v / speed for v in velocity]
    along = sum(u * w for u, w in zip(unit, wanted, strict=True))
    across = [w - along * u for u, w in zip(unit, wanted, strict=True)]
    if abs(along) <= math.hypot(*across):
        return _limited(wanted, limit)
    across = _limited(across, _CROSS_SHARE * limit)
    most = math.sqrt(limit * limit - sum(a * a for a in across))
    along = max(-most, min(most, along))
    return [a + along * u for a, u in zip(across, unit, strict=True)]
