"""Hover throttle, drag, and what a model with them leaves over, from steps of the velocity."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.identification.estimates import Measured, line_of, mean_of
from alula.stages.identification.recording import Phase, Recording
from alula.stages.identification.responses import STEADY_S
from alula.stages.rotation import matrix_from_quat_wxyz

_WINDOW_S = 0.25  # of means of accelerations
_QUANTILE = 0.99


def hover_throttle(recording: Recording) -> Measured | None:
    """Mean throttle of each rest before a velocity step."""
    means = []
    for number, step in enumerate(recording.steps):
        rows = recording.rows(number, Phase.REST)
        values = recording.throttle[rows]
        if step.kind == "velocity" and np.isfinite(values).any():
            means.append(float(np.nanmean(values)))
    return mean_of(means) if means else None


class _Windows(NamedTuple):
    """Means over windows of the velocity steps: accelerations, velocities and thrust directions by heading.

    Attributes:
        step: number of the step, shape (W,).
        is_steady: 1 where the speed was kept, or zero.
        measured: acceleration, x and y along the heading, shape (W, 3) [m/s^2].
        velocity: likewise [m/s].
        lean: body z axis, likewise.
        throttle: shape (W,); NaN where it is not reported.
    """

    step: FloatArray
    is_steady: FloatArray
    measured: FloatArray
    velocity: FloatArray
    lean: FloatArray
    throttle: FloatArray


def _windows(recording: Recording) -> _Windows:
    rows = list[tuple[float, ...]]()
    for number, step in enumerate(recording.steps):
        if step.kind != "velocity":
            continue
        for phase in (Phase.REST, Phase.OUT, Phase.BACK):
            index = recording.rows(number, phase)
            if len(index) < 3:
                continue
            rotation = matrix_from_quat_wxyz(recording.attitude_wxyz[index])
            heading = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
            velocity, lean = recording.velocity[index], rotation[:, :, 2]
            times, last_s = recording.time_s[index], recording.time_s[index[-1]]
            for begin_s in np.arange(times[0], last_s - _WINDOW_S + 1e-9, _WINDOW_S):
                inside = np.flatnonzero((times >= begin_s - 1e-9) & (times <= begin_s + _WINDOW_S + 1e-9))
                if len(inside) < 3:
                    continue
                first, last = inside[0], inside[-1]
                change = (velocity[last] - velocity[first]) / (times[last] - times[first])
                turn = -float(heading[inside].mean())
                is_steady = phase is Phase.REST or (
                    phase is Phase.OUT and last_s - begin_s <= STEADY_S + _WINDOW_S
                )
                vectors = (change, _level_mean(velocity[inside]), _level_mean(lean[inside]))
                flat = [value for vector in vectors for value in _turned(vector, turn)]
                rows.append((number, is_steady, *flat, _mean_known(recording.throttle[index[inside]])))
    table = np.array(rows, np.float64).reshape(-1, 12)
    return _Windows(table[:, 0], table[:, 1], table[:, 2:5], table[:, 5:8], table[:, 8:11], table[:, 11])


def _level_mean(vectors: FloatArray) -> FloatArray:
    """Mean over time of samples at equal intervals, by trapezoids, shape (3,)."""
    result: FloatArray = (vectors.sum(axis=0) - 0.5 * (vectors[0] + vectors[-1])) / (len(vectors) - 1)
    return result


def _turned(vector: FloatArray, angle_rad: float) -> tuple[float, float, float]:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return float(c * vector[0] - s * vector[1]), float(s * vector[0] + c * vector[1]), float(vector[2])


def _mean_known(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


def drag_and_residual(
    recording: Recording, gravity: float
) -> tuple[tuple[Measured | None, Measured | None, Measured | None], float]:
    """Drag by axis from the thrust that steady speeds need, and what the model with it leaves over.

    With the thrust f along the body's z axis e, a = f e - g - d (v - w): horizontally f = (g + a_z) / e_z, as
    measured; vertically f = g throttle / hover. The wind w is the constant of the line.
    """
    seen = _windows(recording)
    hover = hover_throttle(recording)
    if len(seen.step) == 0:
        return (None, None, None), math.nan
    thrust = (gravity + seen.measured[:, 2]) / seen.lean[:, 2]
    missing = np.empty((len(thrust), 3))
    missing[:, :2] = thrust[:, None] * seen.lean[:, :2] - seen.measured[:, :2]
    lift = np.full(len(thrust), math.nan) if hover is None else gravity * seen.throttle / hover.value
    missing[:, 2] = lift * seen.lean[:, 2] - gravity - seen.measured[:, 2]
    drags, left = list[Measured | None](), np.zeros_like(missing)
    for axis in range(3):
        x, y = _by_step(seen, missing[:, axis], axis)
        if len(x) < 3 or np.ptp(x) < 0.2:
            drags.append(None)
            left[:, axis] = missing[:, axis] if np.isfinite(missing[:, axis]).all() else 0.0
            continue
        a, b = line_of(x, y)
        drags.append(b)
        left[:, axis] = np.nan_to_num(missing[:, axis] - a.value - b.value * seen.velocity[:, axis])
    size = np.linalg.norm(left, axis=1)
    return (drags[0], drags[1], drags[2]), float(np.quantile(size, _QUANTILE))


def _by_step(seen: _Windows, missing: FloatArray, axis: int) -> tuple[list[float], list[float]]:
    """Speed and missing acceleration of each step along an axis: of its rest, and of its steady speed."""
    x, y = list[float](), list[float]()
    for number in np.unique(seen.step):
        for moves in (False, True):
            rows = (seen.step == number) & (seen.is_steady > 0) & np.isfinite(missing)
            fast = np.abs(seen.velocity[:, axis]) > 0.2
            rows &= fast if moves else ~fast
            if rows.any():
                x.append(float(seen.velocity[rows, axis].mean()))
                y.append(float(missing[rows].mean()))
    return x, y
