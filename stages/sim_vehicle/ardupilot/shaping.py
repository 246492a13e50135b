"""Shaped commands: a position, velocity and acceleration that approach a target with bounded jerk."""

from __future__ import annotations

import math

from alula.stages.sim_vehicle.common.airframe import TICK_S

_CROSS_SHARE = 1 / math.sqrt(2)  # of the acceleration, at most this much is across the wanted velocity

Pair = tuple[float, float]


def square_root(error: float, gain: float, limit: float) -> float:
    """Rate that removes an error and can still be slowed down with a bounded derivative.

    rate = gain error within limit / gain^2, else the root of 2 limit (|error| - limit / (2 gain^2)), which
    continues it with a continuous slope.

    Args:
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


class LevelProfile:
    """Shaped horizontal motion: north and east.

    In each tick it first moves on with its acceleration. Then the acceleration turns towards the command, its
    change bounded by the jerk.
    """

    def __init__(self) -> None:
        self.position: Pair = (0.0, 0.0)
        self.velocity: Pair = (0.0, 0.0)
        self.acceleration: Pair = (0.0, 0.0)

    def start(self, position: Pair, velocity: Pair) -> None:
        """Start from a motion without acceleration."""
        self.position, self.velocity, self.acceleration = position, velocity, (0.0, 0.0)

    def advance(self) -> None:
        """Move on by one tick."""
        (x, y), (u, v), (a, b) = self.position, self.velocity, self.acceleration
        self.position = (
            x + (u * TICK_S + a * TICK_S * TICK_S / 2),
            y + (v * TICK_S + b * TICK_S * TICK_S / 2),
        )
        self.velocity = (u + a * TICK_S, v + b * TICK_S)

    def to_acceleration(self, command: Pair, jerk: float) -> None:
        """Change the acceleration towards a command.

        Args:
            command: acceleration [m/s^2].
            jerk: its largest change [m/s^3].
        """
        a, b = self.acceleration
        x, y = command[0] - a, command[1] - b
        size, most = math.hypot(x, y), jerk * TICK_S
        if size <= most:
            self.acceleration = (a + x, b + y)
        else:
            share = most / size
            self.acceleration = (a + x * share, b + y * share)

    def to_velocity(self, command: Pair, ahead: Pair, limit: float, jerk: float) -> None:
        """Change the acceleration towards that which reaches a velocity.

        Args:
            command: velocity [m/s].
            ahead: acceleration added to it [m/s^2].
            limit: largest acceleration [m/s^2].
            jerk: its largest change [m/s^3].
        """
        x, y = command[0] - self.velocity[0], command[1] - self.velocity[1]
        size = math.hypot(x, y)
        if size > 0:
            share = min(square_root(size, jerk / limit, jerk), size / TICK_S) / size
            x, y = _within((x * share, y * share), command, limit)
        else:
            x = y = 0.0
        self.to_acceleration((x + ahead[0], y + ahead[1]), jerk)

    def to_position(
        self, point: Pair, velocity: Pair, ahead: Pair, speed: float, limit: float, jerk: float
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
        x, y = point[0] - self.position[0], point[1] - self.position[1]
        size = math.hypot(x, y)
        if size > 0:
            share = min(square_root(size, jerk / (2 * limit), limit / 2), size / TICK_S, speed) / size
            velocity = (velocity[0] + x * share, velocity[1] + y * share)
        self.to_velocity(velocity, ahead, limit, jerk)

    def keep_near(self, position: Pair, limit: float) -> Pair:
        """Error to an actual position [m]; move the profile if that is beyond a limit [m]."""
        x, y = error = (self.position[0] - position[0], self.position[1] - position[1])
        kept = _limited(error, limit)
        if kept != error:
            x, y = kept
            self.position = (position[0] + x, position[1] + y)
        return kept


class VerticalProfile:
    """Shaped vertical motion, as the `LevelProfile` along one axis: down."""

    def __init__(self) -> None:
        self.position = 0.0
        self.velocity = 0.0
        self.acceleration = 0.0

    def start(self, position: float, velocity: float) -> None:
        """Start from a motion without acceleration."""
        self.position, self.velocity, self.acceleration = position, velocity, 0.0

    def advance(self) -> None:
        """Move on by one tick."""
        v, a = self.velocity, self.acceleration
        self.position += v * TICK_S + a * TICK_S * TICK_S / 2
        self.velocity = v + a * TICK_S

    def to_acceleration(self, command: float, jerk: float) -> None:
        """Change the acceleration towards a command; see `LevelProfile.to_acceleration`."""
        change = command - self.acceleration
        size, most = abs(change), jerk * TICK_S
        self.acceleration += change if size <= most else change * (most / size)

    def to_velocity(self, command: float, ahead: float, limit: float, jerk: float) -> None:
        """Change the acceleration towards that which reaches a velocity; see `LevelProfile.to_velocity`."""
        wanted = command - self.velocity
        size = abs(wanted)
        if size > 0:
            wanted *= min(square_root(size, jerk / limit, jerk), size / TICK_S) / size
            if abs(wanted) > limit:
                wanted = math.copysign(limit, wanted) if command else wanted * (limit / abs(wanted))
        else:
            wanted = 0.0
        self.to_acceleration(wanted + ahead, jerk)

    def to_position(
        self, point: float, velocity: float, ahead: float, speed: float, limit: float, jerk: float
    ) -> None:
        """Change the acceleration towards that which reaches a position; see `LevelProfile.to_position`."""
        error = point - self.position
        size = abs(error)
        if size > 0:
            rate = min(square_root(size, jerk / (2 * limit), limit / 2), size / TICK_S, speed)
            velocity += error * (rate / size)
        self.to_velocity(velocity, ahead, limit, jerk)

    def keep_near(self, position: float, limit: float) -> float:
        """Error to an actual position [m]; move the profile if that is beyond a limit [m]."""
        error = self.position - position
        size = abs(error)
        if size <= limit:
            return error
        kept = error * (limit / size)
        if kept != error:
            self.position = position + kept
        return kept


def _limited(vector: Pair, length: float) -> Pair:
    size = math.hypot(*vector)
    if size <= length:
        return vector
    share = length / size
    return vector[0] * share, vector[1] * share


def _within(wanted: Pair, velocity: Pair, limit: float) -> Pair:
    """Limit an acceleration; along the wanted velocity it yields to that across."""
    if math.hypot(*wanted) <= limit:
        return wanted
    speed = math.hypot(*velocity)
    if speed == 0:
        return _limited(wanted, limit)
    (x, y), u, v = wanted, velocity[0] / speed, velocity[1] / speed
    along = u * x + v * y
    across = (x - along * u, y - along * v)
    if abs(along) <= math.hypot(*across):
        return _limited(wanted, limit)
    x, y = _limited(across, _CROSS_SHARE * limit)
    most = math.sqrt(limit * limit - (x * x + y * y))
    along = max(-most, min(most, along))
    return x + along * u, y + along * v
