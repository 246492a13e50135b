"""Loops and limits of rates, and thrust, from short steps of the body rates and of the thrust."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from alula.stages.identification.estimates import Measured, mean_of
from alula.stages.identification.recording import Phase, Recording
from alula.stages.identification.responses import FALLEN, crossing
from alula.stages.identification.steps import Step

_LEVEL_S = 0.05  # of the climb before a thrust step
_LAST = 0.25  # part of a fast step over whose end the rate is averaged
_RISES = 1.05  # factor from the quarter before: the rate had not settled
_WHOLE = 0.9  # a fast step that ended before this part of its duration shows no rate
_RISING = (0.2, 0.6)  # parts of the reached rate between which its acceleration is measured
REACHED = 0.9  # part of an asked value below which it counts as limited


class RateLimit(NamedTuple):
    """How fast the vehicle rotated about an axis when it was asked to rotate fast.

    Attributes:
        asked_rad_s: rate of the set-points [rad/s].
        reached_rad_s: mean rate at the end of the steps [rad/s].
        has_settled: the rate no longer rose at the end of the steps.
        acceleration_rad_s2: mean from 20 to 60 % of the reached rate [rad/s^2].
    """

    asked_rad_s: float
    reached_rad_s: Measured
    has_settled: bool
    acceleration_rad_s2: Measured | None

    @property
    def is_limited(self) -> bool:
        """Whether the vehicle stayed below the rate that was asked, and not for want of time."""
        return self.has_settled and self.reached_rad_s.value < REACHED * self.asked_rad_s


RateLimits = tuple[RateLimit | None, RateLimit | None, RateLimit | None]


def rate_lags(recording: Recording) -> tuple[Measured, Measured, Measured] | None:
    """Times to 63 % of steps of the body rates; None unless all axes have one."""

    def about(axis: int) -> Measured | None:
        return _means_of(
            recording,
            "rate",
            lambda number, step: (
                _rises_at(recording, number, step, FALLEN) if step.axis == axis and not step.is_fast else None
            ),
        )

    roll, pitch, yaw = (about(axis) for axis in range(3))
    return None if roll is None or pitch is None or yaw is None else (roll, pitch, yaw)


def rate_limits(recording: Recording) -> RateLimits:
    """How fast the vehicle rotated in fast steps, about x, y, z of the body."""

    def is_about(step: Step, axis: int) -> bool:
        return step.is_fast and step.axis == axis

    def reached(number: int, step: Step, quarter: int = 1) -> float | None:
        """Mean rate over a quarter of a step, counted from its end."""
        begins = recording.begins[number]
        lasted_s = begins.get(Phase.BACK, begins[Phase.OUT]) - begins[Phase.OUT]
        rows = recording.rows(number, Phase.OUT)
        part = (recording.time_s[rows] - begins[Phase.OUT]) / step.out_s
        rows = rows[(part >= 1 - quarter * _LAST) & (part <= 1 - (quarter - 1) * _LAST)]
        if lasted_s < _WHOLE * step.out_s or len(rows) < 2:
            return None
        return float(np.sign(step.size) * recording.omega[rows, step.axis].mean())

    def rising(number: int, step: Step) -> float | None:
        rate = reached(number, step)
        if rate is None or rate <= 0:
            return None
        low, high = (_rises_at(recording, number, step, part * rate / abs(step.size)) for part in _RISING)
        if low is None or high is None or high <= low:
            return None
        return (_RISING[1] - _RISING[0]) * rate / (high - low)

    def over(axis: int, measure: Callable[[int, Step], float | None]) -> Measured | None:
        return _means_of(
            recording, "rate", lambda number, step: measure(number, step) if is_about(step, axis) else None
        )

    def about(axis: int) -> RateLimit | None:
        rate = over(axis, reached)
        before = over(axis, lambda number, step: reached(number, step, 2))
        gained = over(axis, rising)
        if rate is None:
            return None
        asked = max(abs(step.size) for step in recording.steps if is_about(step, axis))
        has_settled = before is not None and rate.value <= _RISES * before.value
        return RateLimit(asked, rate, has_settled, gained)

    return about(0), about(1), about(2)


def _rises_at(recording: Recording, number: int, step: Step, level: float) -> float | None:
    """When the rate of a step first passes a part of what was asked [s]."""
    out = recording.rows(number, Phase.OUT)
    rows = np.concatenate([recording.rows(number, Phase.REST)[-1:], out])
    times = recording.time_s[rows] - recording.begins[number][Phase.OUT]
    return crossing(times, recording.omega[rows, step.axis] / step.size, level)


def thrust_lag(recording: Recording, gravity: float) -> Measured | None:
    """First-order lag of the thrust: the best fit of v = k (t - tau (1 - exp(-t / tau))) to the climb."""

    def lag_of(number: int, step: Step) -> float | None:
        out = recording.rows(number, Phase.OUT)
        begin_s, rest = recording.begins[number][Phase.OUT], recording.rows(number, Phase.REST)
        before = recording.time_s[rest] >= begin_s - _LEVEL_S
        still = float(recording.velocity[rest[before], 2].mean()) if before.any() else 0.0
        t, v = recording.time_s[out] - begin_s, recording.velocity[out, 2] - still
        t, v = t[t > 0], v[t > 0]
        if len(t) < 8:
            return None
        taus = np.linspace(1e-3, 0.3, 300)
        errors = []
        for tau in taus:
            shape = t - tau * (1 - np.exp(-t / tau))
            k = float(shape @ v) / float(shape @ shape)
            errors.append(float(((v - k * shape) ** 2).sum()))
        return float(taus[int(np.argmin(errors))])

    return _means_of(recording, "thrust", lag_of)


def _means_of(
    recording: Recording, kind: str, measure: Callable[[int, Step], float | None]
) -> Measured | None:
    """Mean over the steps of a kind that could be measured."""
    complete: Iterable[tuple[int, Step]] = (
        (number, step)
        for number, step in enumerate(recording.steps)
        if step.kind == kind and len(recording.rows(number, Phase.OUT)) > 3
    )
    values = [found for number, step in complete if (found := measure(number, step)) is not None]
    return mean_of(values) if values else None
