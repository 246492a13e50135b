"""Checks that positions, velocities and attitudes of a vehicle are in one frame, and that it is the map's.

A frame cannot be checked on a vehicle at rest. `HandCheck` compares positions with moves by hand before
take-off; `MotionCheck` compares positions, velocities and tilt with each other in flight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.rotation import matrix_from_quat_wxyz

_GRAVITY = 9.81
_LEAST_M, _LEAST_M_S = 0.02, 0.02  # smaller values of a window do not count as motion
_LEVEL = 0.5  # world z of the thrust's direction below which the vehicle falls or has crashed: 60 degrees
_EXPLAINED = 0.7  # correlation from which on a rotation or a reflection explains the motion
_AXES = (("+x", (1.0, 0.0, 0.0)), ("+y", (0.0, 1.0, 0.0)), ("+z", (0.0, 0.0, 1.0)))


@dataclass(slots=True)
class HandCheck:
    """Comparison of reported positions with moves of the vehicle by hand along +x, +y and +z of the map.

    The check detects mirrored and rotated frames and swapped axes. A move counts when it is at least `far_m`
    long and the vehicle is at rest again. After the last move the vehicle must rest within `down_m` of the
    height that it was lifted from: an autopilot held in a hand reports that it is on the ground, and must not
    be armed there.

    Attributes:
        far_m: minimum length of a move [m].
        max_angle_rad: maximum angle between a move and its axis [rad].
        rest_m_s: maximum speed of a vehicle at rest [m/s].
        down_m: maximum difference of the final height from the initial one [m].
        is_down: the vehicle is back on the ground.
        moved: reported displacements so far, each of shape (3,), world frame [m].
    """

    far_m: float = 0.3
    max_angle_rad: float = 0.6
    rest_m_s: float = 0.05
    down_m: float = 0.2
    is_down: bool = False
    moved: list[FloatArray] = field(default_factory=list)
    _from: FloatArray | None = None
    _lifted_m: float = 0.0

    @property
    def prompt(self) -> str:
        """Next instruction for the operator; empty when all moves are made."""
        if len(self.moved) == len(_AXES):
            return "" if self.is_down else "put the vehicle back on the ground, where it is to take off"
        return (
            f"move the vehicle by hand at least {self.far_m:g} m along {_AXES[len(self.moved)][0]} of the map"
        )

    def update(self, state: VehicleState) -> None:
        """Register a state; call it once per received state."""
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
        """Description of the first wrong move; empty when all moves so far are right."""
        for (name, axis), step in zip(_AXES, self.moved, strict=False):
            along = float(np.dot(step, axis)) / float(np.linalg.norm(step))
            if math.acos(max(-1.0, min(1.0, along))) > self.max_angle_rad:
                seen = ", ".join(f"{value:+.2f}" for value in step)
                mirrored = " (mirrored)" if self._is_mirrored() else ""
                return f"a move along {name} was seen as ({seen}) m{mirrored}"
        return ""

    def _is_mirrored(self) -> bool:
        return len(self.moved) == len(_AXES) and float(np.linalg.det(np.array(self.moved))) < 0


class _Displacements:
    """Expected and measured displacements over windows, compared once there are enough."""

    words = "positions do not move as the velocities predict"

    def __init__(self, path_m: float, min_correlation: float) -> None:
        self._path_m, self._min_correlation = path_m, min_correlation
        self._expected: list[FloatArray] = []
        self._measured: list[FloatArray] = []
        self._moved_m = 0.0

    def add(self, expected: FloatArray, measured: FloatArray) -> None:
        """Add a window."""
        self._expected.append(expected)
        self._measured.append(measured)
        moved = float(np.linalg.norm(measured))
        self._moved_m += moved if moved >= _LEAST_M else 0.0

    def verdict(self) -> tuple[bool, float] | None:
        """Whether the two agree, and their correlation less the means; None while undecided."""
        if self._moved_m < self._path_m or len(self._measured) < 3:
            return None
        a, b = np.array(self._expected), np.array(self._measured)
        a, b = a - a.mean(axis=0), b - b.mean(axis=0)
        found = float((a * b).sum()) / math.sqrt(float((a * a).sum() * (b * b).sum()) + 1e-12)
        return found >= self._min_correlation, found


class _Accelerations:
    """Changes of the horizontal velocity, expected from the tilt and measured, over windows.

    A wind pushes without a tilt, and a tilt holds against it without an acceleration; both change slowly. So
    only the differences between a window and the one before are compared, and only once the tilt itself has
    changed. Written as complex numbers, a rotated frame gives measured = c expected, and a mirrored one
    measured = c conj(expected), with |c| = 1. The frame is wrong if one of these explains the differences,
    and c = 1 does not. Differences that nothing explains, those of a gust, decide nothing.
    """

    words = "it does not accelerate in the direction of its tilt"

    def __init__(self, change_m_s: float, min_correlation: float) -> None:
        self._change_m_s, self._min_correlation = change_m_s, min_correlation
        self._last: tuple[complex, complex] | None = None
        self._moved_m_s = 0.0
        self._expected = self._measured = 0.0  # sums of squares
        self._turned = self._mirrored = 0j

    def add(self, expected: FloatArray, measured: FloatArray) -> None:
        """Add a window."""
        now = complex(*expected), complex(*measured)
        if self._last is not None:
            e, m = now[0] - self._last[0], now[1] - self._last[1]
            self._moved_m_s += abs(e) if abs(e) >= _LEAST_M_S else 0.0
            self._expected += abs(e) ** 2
            self._measured += abs(m) ** 2
            self._turned += e.conjugate() * m
            self._mirrored += e * m
        self._last = now

    def interrupt(self) -> None:
        """Compare the next window with none before."""
        self._last = None

    def verdict(self) -> tuple[bool, float] | None:
        """Whether the two agree, and their correlation; None while undecided."""
        if self._moved_m_s < self._change_m_s:
            return None
        scale = math.sqrt(self._expected * self._measured) + 1e-12
        found = self._turned.real / scale
        if found >= self._min_correlation:
            return True, found
        is_explained = max(abs(self._turned), abs(self._mirrored)) >= _EXPLAINED * scale
        return (False, found) if is_explained else None


class MotionCheck:
    """Comparison of velocities with positions, and of accelerations with the thrust direction, in flight.

    Over windows of `window_s`, the displacement must equal the integral of the velocity, and the change of
    the horizontal velocity must equal the integral of g tan(tilt) in the direction of the tilt. The second
    relation holds while the height is almost constant, up to wind. Each comparison is decided once, after
    enough motion, by the correlation of the two sides: 1 when they agree, 0 for a frame rotated by a right
    angle, negative for a larger rotation. A mirrored axis is detected as soon as there is motion along it. A
    hover gives no information about the frame.

    Args:
        path_m: displacement after which the positions are compared [m].
        change_m_s: sum of the changes, from window to window, of the velocity that the tilt gives in one,
            after which the accelerations are compared [m/s].
        min_correlation: correlation below which the frame is wrong.

    Attributes:
        wrong: description of what is wrong; empty while nothing is.
    """

    def __init__(
        self,
        *,
        window_s: float = 0.2,
        path_m: float = 0.3,
        change_m_s: float = 0.3,
        min_correlation: float = 0.3,
    ) -> None:
        self.window_s = window_s
        self._displacement = _Displacements(path_m, min_correlation)
        self._acceleration = _Accelerations(change_m_s, min_correlation)
        self._open: list[_Displacements | _Accelerations] = [self._displacement, self._acceleration]
        self.wrong = ""
        self._start: tuple[float, FloatArray, FloatArray] | None = None
        self._last_s = 0.0
        self._expected_step, self._expected_change = np.zeros(3), np.zeros(2)

    @property
    def is_decided(self) -> bool:
        """True after both comparisons, or after one that failed."""
        return not self._open or bool(self.wrong)

    def update(self, state: VehicleState) -> None:
        """Add a state; a gap of more than two windows begins a new window."""
        now = state.received_s
        if self.is_decided or (self._start is not None and now <= self._last_s):
            return
        if self._start is None or now - self._last_s > 2 * self.window_s:
            self._begin(state)
            return
        dt, self._last_s = now - self._last_s, now
        axis = matrix_from_quat_wxyz(state.attitude_wxyz)[:, 2]
        if not axis[2] > _LEVEL:
            self._acceleration.interrupt()
            self._begin(state)
            return
        self._expected_step += dt * state.velocity
        self._expected_change += dt * _GRAVITY * axis[:2] / axis[2]
        begin, position, velocity = self._start
        if now - begin < self.window_s:
            return
        self._displacement.add(self._expected_step, state.position - position)
        self._acceleration.add(self._expected_change, (state.velocity - velocity)[:2])
        self._begin(state)
        for each in list(self._open):
            if (verdict := each.verdict()) is None:
                continue
            self._open.remove(each)
            agrees, found = verdict
            if not agrees:
                self.wrong = f"{each.words} (correlation {found:.2f}): the frame is rotated or mirrored"

    def _begin(self, state: VehicleState) -> None:
        self._start = (state.received_s, state.position.copy(), state.velocity.copy())
        self._last_s = state.received_s
        self._expected_step, self._expected_change = np.zeros(3), np.zeros(2)
