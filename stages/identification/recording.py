"""What `identify` records of a flight, and its fit reads: states, set-points and phases."""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from alula.schemas.arrays import FloatArray
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.identification.steps import Step


class Phase(IntEnum):
    """Part of a step that a tick belongs to."""

    GO = 0
    REST = 1
    OUT = 2
    BACK = 3


_COLUMNS = 14


@dataclass(frozen=True, slots=True)
class Recording:
    """Ticks of a flight of steps, one row for each new state; world frame, SI units.

    Attributes:
        steps: those that were begun; `step` numbers them.
        time_s: time of the state, monotonic [s].
        velocity: shape (T, 3).
        attitude_wxyz: shape (T, 4).
        omega: body components, shape (T, 3).
        throttle: throttle that the vehicle commanded, a fraction; NaN where it is not reported.
        step, phase: shape (T,); the number of a step counts its flights, so that one begun again has another.
        begins: when the first set-point of each phase of each step was sent, on the same clock [s].
    """

    steps: Sequence[Step]
    begins: Sequence[Mapping[Phase, float]]
    time_s: FloatArray
    velocity: FloatArray
    attitude_wxyz: FloatArray
    omega: FloatArray
    throttle: FloatArray
    step: NDArray[np.int64]
    phase: NDArray[np.int64]

    def rows(self, step: int, *phases: Phase) -> NDArray[np.int64]:
        """Indices of the rows of a step in some phases."""
        found: NDArray[np.int64] = np.flatnonzero((self.step == step) & np.isin(self.phase, phases))
        return found


class Tape:
    """Growing recording of a flight."""

    def __init__(self) -> None:
        self._rows = array("d")
        self._newest_s = -np.inf
        self.steps: list[Step] = []
        self._begins: list[dict[Phase, float]] = []

    def begin(self, step: Step) -> None:
        """Begin a step."""
        self.steps.append(step)
        self._begins.append({})

    def enter(self, phase: Phase, now_s: float) -> None:
        """Enter a phase of the newest step.

        Args:
            now_s: when its first set-point is sent, monotonic clock [s].
        """
        self._begins[-1][phase] = now_s

    def add(self, state: VehicleState, throttle: float, phase: Phase) -> None:
        """Record a tick, the newest step being flown; a state that was recorded is left out.

        Args:
            throttle: that the vehicle commands, a fraction; NaN if unknown.
        """
        if state.received_s <= self._newest_s:
            return
        self._newest_s = state.received_s
        self._rows.extend((state.received_s, *state.velocity, *state.attitude_wxyz))
        self._rows.extend((*state.omega, throttle, len(self.steps) - 1, phase))

    def recording(self) -> Recording:
        """The recording so far."""
        rows = np.array(self._rows, np.float64).reshape(-1, _COLUMNS)
        return Recording(
            steps=list(self.steps),
            begins=[dict(each) for each in self._begins],
            time_s=rows[:, 0],
            velocity=rows[:, 1:4],
            attitude_wxyz=rows[:, 4:8],
            omega=rows[:, 8:11],
            throttle=rows[:, 11],
            step=rows[:, 12].astype(np.int64),
            phase=rows[:, 13].astype(np.int64),
        )
