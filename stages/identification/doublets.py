"""Loops of rates and thrust, from short steps of the body rates and of the thrust."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from alula.stages.identification.estimates import Estimate, mean_of
from alula.stages.identification.recording import Phase, Recording
from alula.stages.identification.responses import FALLEN, crossing
from alula.stages.identification.steps import Step

_LEVEL_S = 0.05  # of the climb before a thrust step


def rate_lags(recording: Recording) -> tuple[Estimate, Estimate, Estimate] | None:
    """Times to 63 % of steps of the body rates; None unless all axes have one."""

    def time_of(number: int, step: Step) -> float | None:
        out = recording.rows(number, Phase.OUT)
        begin_s = recording.begins[number][Phase.OUT]
        rows = np.concatenate([recording.rows(number, Phase.REST)[-1:], out])
        return crossing(
            recording.time_s[rows] - begin_s, recording.omega[rows, step.axis] / step.size, FALLEN
        )

    def about(axis: int) -> Estimate | None:
        return _means_of(
            recording, "rate", lambda number, step: time_of(number, step) if step.axis == axis else None
        )

    axes = [about(axis) for axis in range(3)]
    roll, pitch, yaw = axes
    return None if roll is None or pitch is None or yaw is None else (roll, pitch, yaw)


def thrust_lag(recording: Recording, gravity: float) -> Estimate | None:
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
) -> Estimate | None:
    """Mean over the steps of a kind that could be measured."""
    complete: Iterable[tuple[int, Step]] = (
        (number, step)
        for number, step in enumerate(recording.steps)
        if step.kind == kind and len(recording.rows(number, Phase.OUT)) > 3
    )
    values = [found for number, step in complete if (found := measure(number, step)) is not None]
    return mean_of(values) if values else None
