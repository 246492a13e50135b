"""Fit of a vehicle's response to recorded steps: lag, delay, limits, drag, rate loop and hover throttle.

Every value has a 95 % interval: of a mean by Student's t, of a line's coefficients by least squares and t.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from scipy import stats

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import CheckError
from alula.stages.identification.recording import Phase, Recording
from alula.stages.identification.steps import Step
from alula.stages.rotation import matrix_from_quat_wxyz

_FALLEN = 1 - math.exp(-1)  # 63 %
_RESPONDS = 0.05  # part of a step that counts as the first response
_SMOOTHED_S = 0.1  # centred mean of velocities: shorter than any response to them
_BEFORE_S, _STEADY_S = 0.15, 0.4  # means before a stop, and at the end of a step
_WINDOW_S = 0.25  # of means of accelerations
_QUANTILE = 0.99
_REACHED = 0.9  # part of an asked speed below which it counts as limited
_BRAKING = (0.8, 0.2)  # parts of a speed between which a stop's deceleration is measured
_LEVEL_S = 0.05  # of the climb before a thrust step
_CONFIDENCE = 0.95


class Estimate(NamedTuple):
    """A value and its 95 % interval; None where there are too few measurements for one."""

    value: float
    interval: tuple[float, float] | None


class Law(NamedTuple):
    """Time of 63 % of a stop from a speed v, a + b v [s], [s^2/m]."""

    a: Estimate
    b: Estimate


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Identification:
    """What the steps say about a vehicle.

    Attributes:
        responses: of all velocity steps.
        horizontal_lag, vertical_lag: laws of stops, at each speed of the slower axis or direction.
        delay_s: from a set-point to 5 % of the response [s].
        deceleration_m_s2: horizontal, of the fastest stops [m/s^2].
        max_up_m_s, max_down_m_s: speed reached where a higher one was asked; None where it was reached.
        hover_throttle: at rest; None if the throttle is not reported.
        drag_per_s: linear, along x and y of the heading and z; None where it could not be measured [1/s].
        residual_m_s2: 99 % quantile of |model - measured| acceleration, means over 0.25 s [m/s^2].
        rate_s: times to 63 % of a step in roll, pitch and yaw; None without such steps [s].
        thrust_s: time constant of the thrust; None without such steps [s].
        left_out: steps without a usable response, in words.
    """

    responses: list[Response]
    horizontal_lag: Law
    vertical_lag: Law | None
    delay_s: Estimate
    deceleration_m_s2: Estimate
    max_up_m_s: float | None = None
    max_down_m_s: float | None = None
    hover_throttle: Estimate | None = None
    drag_per_s: tuple[Estimate | None, Estimate | None, Estimate | None] = (None, None, None)
    residual_m_s2: float = math.nan
    rate_s: tuple[Estimate, Estimate, Estimate] | None = None
    thrust_s: Estimate | None = None
    left_out: list[str] = field(default_factory=list)


def fit(recording: Recording, gravity_m_s2: float) -> Identification:
    """Fit the response of a vehicle to its recorded steps.

    Args:
        recording: of the flight.
        gravity_m_s2: g [m/s^2].

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
    drag, residual = _drag_and_residual(recording, gravity_m_s2)
    return Identification(
        responses=responses,
        horizontal_lag=horizontal_lag,
        vertical_lag=_slower_law([each for each in stops if each.axis == 2], lambda each: each.sign),
        delay_s=mean_of([each.delay_s for each in responses]),
        deceleration_m_s2=_deceleration(level),
        max_up_m_s=_limit(responses, 1.0),
        max_down_m_s=_limit(responses, -1.0),
        hover_throttle=_hover(recording),
        drag_per_s=drag,
        residual_m_s2=residual,
        rate_s=_rates(recording),
        thrust_s=_thrust(recording, gravity_m_s2),
        left_out=[name for name, has_stop in usable.items() if not has_stop],
    )


def mean_of(values: Sequence[float]) -> Estimate:
    """Mean with its interval by Student's t.

    Args:
        values: independent measurements, at least one.
    """
    mean, n = float(np.mean(values)), len(values)
    if n < 2:
        return Estimate(mean, None)
    half = float(stats.t.ppf(0.5 + _CONFIDENCE / 2, n - 1)) * float(np.std(values, ddof=1)) / math.sqrt(n)
    return Estimate(mean, (mean - half, mean + half))


def line_of(x: Sequence[float] | FloatArray, y: Sequence[float] | FloatArray) -> tuple[Estimate, Estimate]:
    """Least-squares line y = a + b x, with the intervals of a and b.

    Args:
        x: at least two different values.
        y: measurements, as many.
    """
    A = np.column_stack([np.ones(len(x)), np.asarray(x, np.float64)])
    y = np.asarray(y, np.float64)
    (a, b), *_ = np.linalg.lstsq(A, y, rcond=None)
    degrees = len(y) - 2
    if degrees < 1:
        return Estimate(float(a), None), Estimate(float(b), None)
    variance = float(((y - A @ (a, b)) ** 2).sum()) / degrees
    half = float(stats.t.ppf(0.5 + _CONFIDENCE / 2, degrees)) * np.sqrt(
        variance * np.diag(np.linalg.inv(A.T @ A))
    )
    first, second = (
        Estimate(float(value), (float(value - wide), float(value + wide)))
        for value, wide in zip((a, b), half, strict=True)
    )
    return first, second


def _law(points: Sequence[tuple[float, float]]) -> Law:
    """Lag by speed; one that would fall with the speed, or be negative at rest, is a constant or a ray."""
    speeds, times = (np.array(column) for column in zip(*points, strict=True))
    a, b = line_of(speeds, times)
    if b.value < 0:
        return Law(mean_of(times.tolist()), Estimate(0.0, b.interval))
    if a.value < 0:
        slope = mean_of((times / speeds).tolist())
        return Law(Estimate(0.0, a.interval), slope)
    return Law(a, b)


def _slower_law(stops: Sequence[Response], way_of: Callable[[Response], float]) -> Law | None:
    """Law of the slower way at each speed; None with fewer than two speeds.

    Args:
        stops: stops.
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


def _deceleration(level: Sequence[Response]) -> Estimate:
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
        and each.speed_m_s < _REACHED * each.asked_m_s
    ]
    return min(limited) if limited else None


def step_responses(recording: Recording, number: int, step: Step) -> list[Response]:
    """Responses to a velocity step and to its end; those that cannot be measured are left out.

    Args:
        recording: of the flight.
        number: of the step in it.
        step: the step.
    """
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
    reached = _mean(times, speed, end_s - _STEADY_S, end_s)
    axis = step.axis
    if reached - still > 0.3 * asked:
        share = (speed - still) / (reached - still)
        during = (times >= begin_s) & (times <= end_s)
        delay = crossing(times[during] - begin_s, share[during], _RESPONDS)
        time = crossing(times[during] - begin_s, share[during], _FALLEN)
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
        delay, time = crossing(after_s, fallen, _RESPONDS), crossing(after_s, fallen, _FALLEN)
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
        level: the level.
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


def _hover(recording: Recording) -> Estimate | None:
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
                    phase is Phase.OUT and last_s - begin_s <= _STEADY_S + _WINDOW_S
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


def _drag_and_residual(
    recording: Recording, gravity: float
) -> tuple[tuple[Estimate | None, Estimate | None, Estimate | None], float]:
    """Drag by axis from the thrust that steady speeds need, and what the model with it leaves over.

    With the thrust f along the body's z axis e, a = f e - g - d (v - w): horizontally f = (g + a_z) / e_z, as
    measured; vertically f = g throttle / hover. The wind w is the constant of the line.
    """
    seen = _windows(recording)
    hover = _hover(recording)
    if len(seen.step) == 0:
        return (None, None, None), math.nan
    thrust = (gravity + seen.measured[:, 2]) / seen.lean[:, 2]
    missing = np.empty((len(thrust), 3))
    missing[:, :2] = thrust[:, None] * seen.lean[:, :2] - seen.measured[:, :2]
    lift = np.full(len(thrust), math.nan) if hover is None else gravity * seen.throttle / hover.value
    missing[:, 2] = lift * seen.lean[:, 2] - gravity - seen.measured[:, 2]
    drags, left = list[Estimate | None](), np.zeros_like(missing)
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


def _rates(recording: Recording) -> tuple[Estimate, Estimate, Estimate] | None:
    """Times to 63 % of steps of the body rates; None unless all axes have one."""

    def time_of(number: int, step: Step) -> float | None:
        out = recording.rows(number, Phase.OUT)
        begin_s = recording.begins[number][Phase.OUT]
        rows = np.concatenate([recording.rows(number, Phase.REST)[-1:], out])
        return crossing(
            recording.time_s[rows] - begin_s, recording.omega[rows, step.axis] / step.size, _FALLEN
        )

    def about(axis: int) -> Estimate | None:
        return _means_of(
            recording, "rate", lambda number, step: time_of(number, step) if step.axis == axis else None
        )

    axes = [about(axis) for axis in range(3)]
    roll, pitch, yaw = axes
    return None if roll is None or pitch is None or yaw is None else (roll, pitch, yaw)


def _thrust(recording: Recording, gravity: float) -> Estimate | None:
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
