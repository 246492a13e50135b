"""Whether positions, velocities and attitudes of a vehicle are in one frame, and in the map's."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.rotation import matrix_from_quat_wxyz

_GRAVITY = 9.81
_AXES = (("+x", (1.0, 0.0, 0.0)), ("+y", (0.0, 1.0, 0.0)), ("+z", (0.0, 0.0, 1.0)))


@dataclass(slots=True)
class HandCheck:
    """The operator moves the vehicle along +x, +y and +z; its positions must move the same way.

    A mirrored frame, a rotated one and swapped axes all show. A move counts once it is `far_m` long and the
    vehicle rests again. Afterwards it must rest at the height that it was lifted from, to `down_m`: a vehicle
    in a hand believes that it is on the ground, and must not be armed there.
    """

    far_m: float = 0.3
    most_rad: float = 0.6
    rest_m_s: float = 0.05
    down_m: float = 0.2
    is_down: bool = False
    moved: list[FloatArray] = field(default_factory=list)
    _from: FloatArray | None = None
    _lifted_m: float = 0.0

    @property
    def prompt(self) -> str:
        """What to do next; empty when all is done."""
        if len(self.moved) == len(_AXES):
            return "" if self.is_down else "put the vehicle back on the ground, where it is to take off"
        return (
            f"move the vehicle by hand at least {self.far_m:g} m along {_AXES[len(self.moved)][0]} of the map"
        )

    def update(self, state: VehicleState) -> None:
        """Look at where it is now."""
        rests = float(np.linalg.norm(state.velocity)) < self.rest_m_s
        if len(self.moved) == len(_AXES):
            self.is_down = rests and abs(float(state.position[2]) - self._lifted_m) < self.down_m
            return
        if self._from is None:
            self._from = state.position.copy()
            self._lifted_m = float(state.position[2])
        step = state.position - self._from
        if np.linalg.norm(step) >= self.far_m and rests:
            self.moved.append(step)
            self._from = state.position.copy()

    def verdict(self) -> str:
        """What is wrong, in words; empty when the moves so far are right."""
        for (name, axis), step in zip(_AXES, self.moved, strict=False):
            along = float(np.dot(step, axis)) / float(np.linalg.norm(step))
            if math.acos(max(-1.0, min(1.0, along))) > self.most_rad:
                seen = ", ".join(f"{value:+.2f}" for value in step)
                mirrored = " (mirrored)" if self._is_mirrored() else ""
                return f"a move along {name} was seen as ({seen}) m{mirrored}"
        return ""

    def _is_mirrored(self) -> bool:
        return len(self.moved) == len(_AXES) and float(np.linalg.det(np.array(self.moved))) < 0


class _Pairs:
    """Expected and found motion over windows, without their means: a steady wind is none of the frame's."""

    def __init__(self, floor: float) -> None:
        self.floor = floor
        self.expected: list[FloatArray] = []
        self.found: list[FloatArray] = []
        self.amount = 0.0

    def add(self, expected: FloatArray, found: FloatArray) -> None:
        """Take in a window; only what really moved counts as motion."""
        self.expected.append(expected)
        self.found.append(found)
        moved = float(np.linalg.norm(found))
        self.amount += moved if moved >= self.floor else 0.0

    def correlation(self) -> float:
        """Of both, over all windows and axes, less the means: 1 when they agree."""
        a, b = np.array(self.expected), np.array(self.found)
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        return float((a * b).sum()) / math.sqrt(float((a * a).sum() * (b * b).sum()) + 1e-12)


class MotionCheck:
    """In flight: velocities against positions, and accelerations against where the thrust points.

    Over windows of `window_s`, the displacement must be the integral of the velocity, and the change of the
    horizontal velocity that of g tan(tilt) in the direction of the tilt, which holds where the height hardly
    changes. Each comparison is decided once, when there was enough motion, by the correlation of the two: 1
    when they agree, 0 for a frame turned by a right angle, negative for one turned further. A mirror shows as
    soon as there is motion along the mirrored axis. What can be seen of a frame in a hover is nothing.
    """

    def __init__(
        self, *, window_s: float = 0.2, path_m: float = 0.3, speed_m_s: float = 0.6, least: float = 0.3
    ) -> None:
        self.window_s, self.least = window_s, least
        self._displacement = _Pairs(0.02)
        self._acceleration = _Pairs(0.1)
        self._open = [
            (self._displacement, path_m, "positions do not move as velocities say"),
            (self._acceleration, speed_m_s, "it does not accelerate to where it tilts"),
        ]
        self.wrong = ""
        self._start: tuple[float, FloatArray, FloatArray] | None = None
        self._last_s = 0.0
        self._travel, self._push = np.zeros(3), np.zeros(2)

    @property
    def is_decided(self) -> bool:
        """Whether both comparisons are made, or one was wrong."""
        return not self._open or bool(self.wrong)

    def update(self, state: VehicleState) -> None:
        """Take in a state; a gap begins a new window."""
        now = state.received_s
        if self.is_decided or (self._start is not None and now <= self._last_s):
            return
        if self._start is None or now - self._last_s > 2 * self.window_s:
            self._begin(state)
            return
        dt, self._last_s = now - self._last_s, now
        axis = matrix_from_quat_wxyz(state.attitude_wxyz)[:, 2]
        self._travel += dt * state.velocity
        if axis[2] > 0.3:
            self._push += dt * _GRAVITY * axis[:2] / axis[2]
        begin, position, velocity = self._start
        if now - begin < self.window_s:
            return
        self._displacement.add(self._travel, state.position - position)
        self._acceleration.add(self._push, (state.velocity - velocity)[:2])
        self._begin(state)
        for item in list(self._open):
            pairs, needed, words = item
            if pairs.amount >= needed and len(pairs.found) > 2:
                self._open.remove(item)
                if (found := pairs.correlation()) < self.least:
                    self.wrong = f"{words} (correlation {found:.2f}): the frame is turned or mirrored"

    def _begin(self, state: VehicleState) -> None:
        self._start = (state.received_s, state.position.copy(), state.velocity.copy())
        self._last_s = state.received_s
        self._travel, self._push = np.zeros(3), np.zeros(2)


class Jump:
    """How far positions jump: the distance from where the velocities lead from the state before.

    What an acceleration of 20 m/s^2 may do between the two is taken off.
    """

    def __init__(self) -> None:
        self._last: VehicleState | None = None

    def of(self, state: VehicleState) -> float:
        """Of a state, against the one before; 0 for the same one, infinite for what is not a number [m]."""
        last, self._last = self._last, state
        if last is None or last is state:
            return 0.0
        dt = max(0.0, state.received_s - last.received_s)
        away = state.position - last.position - 0.5 * dt * (state.velocity + last.velocity)
        jump = math.sqrt(float(away @ away)) - 10.0 * dt * dt
        return max(0.0, jump) if math.isfinite(jump) else math.inf
