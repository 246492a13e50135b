"""Whether positions, velocities and attitudes of a vehicle are in one frame, and in the map's."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from alula.stages.flight.links.protocol import VehicleState
from alula.stages.rotation import matrix_from_quat_wxyz

FloatArray = NDArray[np.float64]

_AXES = (("+x", (1.0, 0.0, 0.0)), ("+y", (0.0, 1.0, 0.0)), ("+z", (0.0, 0.0, 1.0)))


@dataclass(slots=True)
class HandCheck:
    """The operator moves the vehicle along +x, +y and +z; its positions must move the same way.

    A mirrored frame, a rotated one and swapped axes all show. A move counts once it is `far_m` long and the
    vehicle rests again.
    """

    far_m: float = 0.3
    most_rad: float = 0.6
    rest_m_s: float = 0.05
    moved: list[FloatArray] = field(default_factory=list)
    _from: FloatArray | None = None

    @property
    def prompt(self) -> str:
        """What to do next; empty when all is done."""
        if len(self.moved) == len(_AXES):
            return ""
        return f"move the vehicle by hand at least {self.far_m:g} m along {_AXES[len(self.moved)][0]} of the map"

    def update(self, state: VehicleState) -> None:
        """Look at where it is now."""
        if len(self.moved) == len(_AXES):
            return
        if self._from is None:
            self._from = state.position.copy()
        step = state.position - self._from
        if np.linalg.norm(step) >= self.far_m and np.linalg.norm(state.velocity) < self.rest_m_s:
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


@dataclass(slots=True)
class MotionCheck:
    """In flight: velocities against positions, and accelerations against where the thrust points.

    Over windows of `window_s`, the displacement must be the integral of the velocity, and the change of the
    horizontal velocity that of g tan(tilt) in the direction of the tilt, which holds where the height hardly
    changes. Each comparison is decided once there was enough motion, by the correlation of the two: 1 when
    they agree, 0 for a frame turned by a right angle, negative for one turned further. A mirror shows as soon
    as there is motion along the mirrored axis.
    """

    window_s: float = 0.2
    least: float = 0.5
    path_m: float = 0.3
    speed_m_s: float = 0.6
    gravity_m_s2: float = 9.81
    _start: tuple[float, FloatArray, FloatArray] | None = None
    _last_s: float = 0.0
    _travel: FloatArray = field(default_factory=lambda: np.zeros(3))
    _push: FloatArray = field(default_factory=lambda: np.zeros(2))
    _position: FloatArray = field(default_factory=lambda: np.zeros(3))  # sums: a.b, a.a, b.b
    _velocity: FloatArray = field(default_factory=lambda: np.zeros(3))
    _moved: float = 0.0
    _pushed: float = 0.0

    def update(self, state: VehicleState) -> None:
        """Take in a state; older ones and gaps begin a new window."""
        now = state.received_s
        if self._start is None or now - self._last_s > 2 * self.window_s:
            self._begin(state)
            return
        dt = now - self._last_s
        if dt <= 0:
            return
        self._last_s = now
        axis = matrix_from_quat_wxyz(state.attitude_wxyz)[:, 2]
        self._travel += dt * state.velocity
        if axis[2] > 0.3:
            self._push += dt * self.gravity_m_s2 * axis[:2] / axis[2]
        begin, position, velocity = self._start
        if now - begin < self.window_s:
            return
        self._moved += _add(self._position, self._travel, state.position - position)
        self._pushed += _add(self._velocity, self._push, (state.velocity - velocity)[:2])
        self._begin(state)

    def verdict(self) -> str:
        """What is wrong, in words; empty so far."""
        for moved, needed, sums, words in (
            (self._moved, self.path_m, self._position, "positions do not move as velocities say"),
            (self._pushed, self.speed_m_s, self._velocity, "it does not accelerate to where it tilts"),
        ):
            if moved >= needed:
                found = float(sums[0]) / math.sqrt(float(sums[1] * sums[2]) + 1e-12)
                if found < self.least:
                    return f"{words} (correlation {found:.2f}): the frame is turned or mirrored"
        return ""

    def _begin(self, state: VehicleState) -> None:
        self._start = (state.received_s, state.position.copy(), state.velocity.copy())
        self._last_s = state.received_s
        self._travel = np.zeros(3)
        self._push = np.zeros(2)


def _add(sums: FloatArray, expected: FloatArray, found: FloatArray) -> float:
    """Add a window to the sums; the size of what was expected in it, or found, whichever is larger."""
    sums += (float(expected @ found), float(expected @ expected), float(found @ found))
    return max(float(np.linalg.norm(expected)), float(np.linalg.norm(found)))
