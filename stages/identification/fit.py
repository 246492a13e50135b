"""Fit of a vehicle's response to recorded steps: lag, delay, limits, drag, rate loop and hover throttle."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from alula.schemas.errors import CheckError
from alula.stages.identification.doublets import REACHED, RateLimits, rate_lags, rate_limits, thrust_lag
from alula.stages.identification.drag import drag_and_residual, hover_throttle
from alula.stages.identification.estimates import Measured, line_of, mean_of
from alula.stages.identification.recording import Recording
from alula.stages.identification.responses import Response, step_responses


class Law(NamedTuple):
    """Time of 63 % of a stop from a speed v, a + b v [s], [s^2/m]."""

    a: Measured
    b: Measured


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification:
    """What the steps say about a vehicle.

    Attributes:
        horizontal_lag, vertical_lag: laws of stops, at each speed of the slower axis or direction.
        delay_s: from a set-point to 5 % of the response [s].
        deceleration_m_s2: horizontal, of the fastest stops [m/s^2].
        max_up_m_s, max_down_m_s: speed reached where a higher one was asked; None where it was reached.
        hover_throttle: at rest; None if the throttle is not reported.
        drag_per_s: linear, along x and y of the heading and z; None where it could not be measured [1/s].
        residual_m_s2: 99 % quantile of |model - measured| acceleration, means over 0.25 s [m/s^2].
        rate_s: times to 63 % of a step in roll, pitch and yaw; None without such steps [s].
        rate_limits: how fast it rotated about x, y, z; None where no step showed it.
        thrust_s: time constant of the thrust; None without such steps [s].
        left_out: steps without a usable response, in words.
    """

    responses: list[Response]
    horizontal_lag: Law
    vertical_lag: Law | None
    delay_s: Measured
    deceleration_m_s2: Measured
    max_up_m_s: float | None = None
    max_down_m_s: float | None = None
    hover_throttle: Measured | None = None
    drag_per_s: tuple[Measured | None, Measured | None, Measured | None] = (None, None, None)
    residual_m_s2: float = math.nan
    rate_s: tuple[Measured, Measured, Measured] | None = None
    rate_limits: RateLimits = (None, None, None)
    thrust_s: Measured | None = None
    left_out: list[str] = field(default_factory=list)


def fit(recording: Recording, gravity_m_s2: float) -> Identification:
    """Fit the response of a vehicle to its recorded steps.

    Raises:
        CheckError: the horizontal steps do not determine a lag: fewer than two speeds have a stop.
    """
    responses, usable = list[Response](), dict[str, bool]()
    for number, step in enumerate(recording.steps):
        if step.kind == "velocity":
            found = step_responses(recording, number, step)
            responses += found
            has_stop = any(each.kind == "stop" for each in found)
            usable[step.name] = (
                usable.get(step.name, False) or has_stop
            )  # one that was interrupted is flown again
    stops = [each for each in responses if each.kind == "stop"]
    level = [each for each in stops if each.axis != 2]
    horizontal_lag = _slower_law(level, lambda each: each.axis)
    if horizontal_lag is None:
        raise CheckError("fewer than two speeds have a usable stop: the horizontal lag cannot be determined")
    drag, residual = drag_and_residual(recording, gravity_m_s2)
    return Identification(
        responses=responses,
        horizontal_lag=horizontal_lag,
        vertical_lag=_slower_law([each for each in stops if each.axis == 2], lambda each: each.sign),
        delay_s=mean_of([each.delay_s for each in responses]),
        deceleration_m_s2=_deceleration(level),
        max_up_m_s=_limit(responses, 1.0),
        max_down_m_s=_limit(responses, -1.0),
        hover_throttle=hover_throttle(recording),
        drag_per_s=drag,
        residual_m_s2=residual,
        rate_s=rate_lags(recording),
        rate_limits=rate_limits(recording),
        thrust_s=thrust_lag(recording, gravity_m_s2),
        left_out=[name for name, has_stop in usable.items() if not has_stop],
    )


def _law(points: Sequence[tuple[float, float]]) -> Law:
    """Lag by speed; one that would fall with the speed, or be negative at rest, is a constant or a ray."""
    speeds, times = (np.array(column) for column in zip(*points, strict=True))
    a, b = line_of(speeds, times)
    if b.value < 0:
        return Law(mean_of(times.tolist()), Measured(0.0, b.interval))
    if a.value < 0:
        slope = mean_of((times / speeds).tolist())
        return Law(Measured(0.0, a.interval), slope)
    return Law(a, b)


def _slower_law(stops: Sequence[Response], way_of: Callable[[Response], float]) -> Law | None:
    """Law of the slower way at each speed; None with fewer than two speeds.

    Args:
        way_of: the way of a stop: its axis, or its direction.
    """
    points = list[tuple[float, float]]()
    speeds = {each.asked_m_s for each in stops}
    for asked in speeds:
        ways: dict[float, list[Response]] = {}
        for each in stops:
            if each.asked_m_s == asked:
                ways.setdefault(way_of(each), []).append(each)
        slower = max(ways.values(), key=lambda way: float(np.mean([each.time_s for each in way])))
        points += [(each.speed_m_s, each.time_s) for each in slower]
    return _law(points) if len(speeds) > 1 else None


def _deceleration(level: Sequence[Response]) -> Measured:
    """Mean of the stops from each asked speed, the highest of these means."""
    speeds = {each.asked_m_s for each in level}
    means = [
        mean_of([each.deceleration_m_s2 for each in level if each.asked_m_s == asked]) for asked in speeds
    ]
    return max(means, key=lambda estimate: estimate.value)


def _limit(responses: Sequence[Response], sign: float) -> float | None:
    limited = [
        each.speed_m_s
        for each in responses
        if (each.axis, each.sign, each.kind) == (2, sign, "rise")
        and each.speed_m_s < REACHED * each.asked_m_s
    ]
    return min(limited) if limited else None
