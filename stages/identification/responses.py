"""Responses to velocity steps: how long a rise and a stop take, from the recorded speed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from alula.schemas.arrays import FloatArray
from alula.stages.identification.recording import Phase, Recording
from alula.stages.identification.steps import Step

FALLEN = 1 - math.exp(-1)  # 63 %
STEADY_S = 0.4  # mean at the end of a step
_RESPONDS = 0.05  # part of a step that counts as the first response
_SMOOTHED_S = 0.1  # centred mean of velocities: shorter than any response to them
_BEFORE_S = 0.15  # mean before a stop
_BRAKING = (0.8, 0.2)  # parts of a speed between which a stop's deceleration is measured


@dataclass(frozen=True, slots=True, kw_only=True)
class Response:
    """Response to a velocity step or to its end.

    Attributes:
        axis: of the world; 2 is vertical.
        sign: direction, 1 or -1.
        asked_m_s: speed of the set-point [m/s].
        kind: rise, or stop.
        speed_m_s: speed reached, or speed before the stop [m/s].
        delay_s: time to 5 % [s].
        time_s: time to 63 % [s].
        deceleration_m_s2: mean between 80 % and 20 % of a stop; NaN of a rise [m/s^2].
    """

    axis: int
    sign: float
    asked_m_s: float
    kind: Literal["rise", "stop"]
    speed_m_s: float
    delay_s: float
    time_s: float
    deceleration_m_s2: float


def step_responses(recording: Recording, number: int, step: Step) -> list[Response]:
    """Responses to a velocity step and to its end; those that cannot be measured are left out."""
    rest, out, back = (recording.rows(number, phase) for phase in (Phase.REST, Phase.OUT, Phase.BACK))
    if min(len(rest), len(out), len(back)) < 5:
        return []
    sign, asked = math.copysign(1.0, step.size), abs(step.size)
    rows = np.concatenate([rest, out, back])
    times = recording.time_s[rows]
    speed = smoothed(times, sign * recording.velocity[rows, step.axis])
    begin_s, end_s = recording.begins[number][Phase.OUT], recording.begins[number][Phase.BACK]
    found = []
    still = _mean(times, speed, begin_s - _BEFORE_S, begin_s)
    reached = _mean(times, speed, end_s - STEADY_S, end_s)
    axis = step.axis
    if reached - still > 0.3 * asked:
        share = (speed - still) / (reached - still)
        during = (times >= begin_s) & (times <= end_s)
        delay = crossing(times[during] - begin_s, share[during], _RESPONDS)
        time = crossing(times[during] - begin_s, share[during], FALLEN)
        if delay is not None and time is not None:
            found.append(
                Response(
                    axis=axis,
                    sign=sign,
                    asked_m_s=asked,
                    kind="rise",
                    speed_m_s=reached,
                    delay_s=delay,
                    time_s=time,
                    deceleration_m_s2=math.nan,
                )
            )
    before = _mean(times, speed, end_s - _BEFORE_S, end_s)
    if before > 0.3 * asked:
        since = times >= end_s
        after_s, fallen = times[since] - end_s, 1 - speed[since] / before
        delay, time = crossing(after_s, fallen, _RESPONDS), crossing(after_s, fallen, FALLEN)
        high, low = (crossing(after_s, fallen, 1 - part) for part in _BRAKING)
        if delay is not None and time is not None and high is not None and low is not None and low > high:
            found.append(
                Response(
                    axis=axis,
                    sign=sign,
                    asked_m_s=asked,
                    kind="stop",
                    speed_m_s=before,
                    delay_s=delay,
                    time_s=time,
                    deceleration_m_s2=(_BRAKING[0] - _BRAKING[1]) * before / (low - high),
                )
            )
    return found


def crossing(times: FloatArray, values: FloatArray, level: float) -> float | None:
    """When values first pass a level from below, interpolated; None if they do not.

    Args:
        times: increasing, shape (T,) [s].
        values: shape (T,).
    """
    above = np.flatnonzero(values >= level)
    if len(above) == 0:
        return None
    first = int(above[0])
    if first == 0:
        return float(times[0])
    low, high = values[first - 1], values[first]
    return float(times[first - 1] + (level - low) / (high - low) * (times[first] - times[first - 1]))


def smoothed(times: FloatArray, values: FloatArray) -> FloatArray:
    """Centred means over 0.1 s, over fewer values at both ends.

    Args:
        times: increasing, shape (T,) [s].
        values: shape (T,).
    """
    total = np.concatenate([[0.0], np.cumsum(values)])
    low = np.searchsorted(times, times - _SMOOTHED_S / 2 - 1e-9)
    high = np.searchsorted(times, times + _SMOOTHED_S / 2 + 1e-9, side="right")
    index = np.arange(len(times))
    half = np.minimum(index - low, high - 1 - index)  # as many on both sides
    result: FloatArray = (total[index + half + 1] - total[index - half]) / (2 * half + 1)
    return result


def _mean(times: FloatArray, values: FloatArray, begin_s: float, end_s: float) -> float:
    inside = (times >= begin_s) & (times <= end_s)
    return float(values[inside].mean()) if inside.any() else math.nan
