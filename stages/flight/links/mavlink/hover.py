"""Hover throttle: conversion between thrust and throttle, and its estimate in flight."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from alula.stages.flight.links.protocol import VehicleState
from alula.stages.rotation import matrix_from_quat_wxyz

_WINDOW_S = 0.25  # velocities are compared over this time
_RISE_S = 0.06  # delay from a throttle to its thrust
_FASTEST_PER_S = 0.02  # maximum relative change of the hover throttle in a second
# Before the first set-point with a throttle nothing depends on the estimate, so that it may follow quickly.
_FIRST_TAU_S, _FIRST_PER_S = 0.3, 1.0
_FIRST_M_S = 0.8  # there, faster vertical motion is skipped for its drag
_FIRST_RISE_S = 0.14  # there, the throttle passes a low-pass of 2 Hz
_ALLOWED = (0.05, 0.9)
_RANGE = 1.5  # maximum factor between the estimate and its initial value


def throttle_of(thrust_m_s2: float, hover: float, gravity_m_s2: float) -> float:
    """Throttle of a thrust, throttle = (T / g) hover; not clipped.

    Args:
        thrust_m_s2: thrust per mass T [m/s^2].
        hover: hover throttle, a fraction of full throttle.
    """
    return thrust_m_s2 / gravity_m_s2 * hover


def hover_from(throttle: float, thrust_m_s2: float, gravity_m_s2: float) -> float:
    """Hover throttle that explains a measured thrust; the inverse of `throttle_of`.

    Args:
        throttle: throttle that was sent, a fraction of full throttle.
        thrust_m_s2: measured thrust per mass [m/s^2].
    """
    return throttle * gravity_m_s2 / thrust_m_s2


def measured_thrust(
    velocity_before: NDArray[np.float64],
    velocity_after: NDArray[np.float64],
    dt_s: float,
    attitude_wxyz: NDArray[np.float64],
    gravity_m_s2: float,
) -> float:
    """Thrust per mass of a body without drag: (dv / dt + g e_z) along the body's z axis [m/s^2].

    Args:
        velocity_before: velocity at the start, shape (3,), world frame, z up [m/s].
        velocity_after: velocity at the end, likewise.
        dt_s: time between them [s].
        attitude_wxyz: unit quaternion that turns body vectors into the world frame, shape (4,).
    """
    acceleration = (velocity_after - velocity_before) / dt_s
    acceleration[2] += gravity_m_s2
    return float(acceleration @ matrix_from_quat_wxyz(attitude_wxyz)[:, 2])


class HoverThrottle:
    """Estimator of the hover throttle in flight, slow and bounded.

    It compares the mean throttle over a quarter of a second, 60 ms ago, with the thrust measured from the
    change of velocity: hover' = hover g / T. Each comparison moves the logarithm of the estimate by the
    fraction time / tau of its error, and by at most 2 % in a second. Until a throttle is asked for, as in a
    take-off that the vehicle flies itself, tau is 0.3 s and the bound 100 %. The estimate stays within a
    factor of 1.5 of its initial value and between 0.05 and 0.9. Windows with a thrust below half or above
    twice the weight, or with more than 45 degrees of tilt, are skipped: there drag and the rotors' thrust
    curve are not negligible.

    Args:
        gravity_m_s2: gravity from the vehicle file [m/s^2].
        tau_s: time in which an error falls to a third [s].

    Raises:
        ValueError: `initial` is not between 0.05 and 0.9.
    """

    def __init__(self, initial: float, gravity_m_s2: float = 9.81, *, tau_s: float = 10.0) -> None:
        low, high = _ALLOWED
        if not low <= initial <= high:
            raise ValueError(f"the hover throttle must be between {low:g} and {high:g}, not {initial:g}")
        self.value = initial
        self.gravity_m_s2 = gravity_m_s2
        self._tau_s = tau_s
        self._bounds = (max(low, initial / _RANGE), min(high, initial * _RANGE))
        self._throttles: deque[tuple[float, float]] = deque(maxlen=512)
        self._start: VehicleState | None = None
        self._is_used = False

    @property
    def newest(self) -> float:
        """Throttle that the vehicle commanded last; NaN if it was not reported."""
        return self._throttles[-1][1] if self._throttles else math.nan

    def throttle(self, thrust_m_s2: float) -> float:
        """Throttle of a thrust per mass [m/s^2], by `throttle_of` with the present estimate."""
        self._is_used = True
        return throttle_of(thrust_m_s2, self.value, self.gravity_m_s2)

    def record(self, throttle: float, now_s: float) -> None:
        """Record the throttle that the vehicle commanded at `now_s` [s]."""
        self._throttles.append((now_s, throttle))

    def update(self, state: VehicleState) -> None:
        """Update the estimate with a newer state."""
        start = self._start
        if start is None or state.received_s - start.received_s > 2 * _WINDOW_S:
            self._start = state
            return
        dt_s = state.received_s - start.received_s
        if dt_s < _WINDOW_S:
            return
        self._start = state
        rise_s = _RISE_S if self._is_used else _FIRST_RISE_S
        throttle = self._mean(start.received_s - rise_s, state.received_s - rise_s)
        thrust = measured_thrust(start.velocity, state.velocity, dt_s, state.attitude_wxyz, self.gravity_m_s2)
        upright = float(matrix_from_quat_wxyz(state.attitude_wxyz)[2, 2])
        if throttle is None or upright < math.sqrt(0.5):
            return
        if not 0.5 < thrust / self.gravity_m_s2 < 2.0:
            return
        if not self._is_used and abs(state.velocity[2]) > _FIRST_M_S:
            return
        tau_s, most_per_s = (self._tau_s, _FASTEST_PER_S) if self._is_used else (_FIRST_TAU_S, _FIRST_PER_S)
        step = math.log(hover_from(throttle, thrust, self.gravity_m_s2) / self.value) * dt_s / tau_s
        max_step = most_per_s * dt_s
        low, high = self._bounds
        self.value = min(max(self.value * math.exp(min(max(step, -max_step), max_step)), low), high)

    def _mean(self, begin_s: float, end_s: float) -> float | None:
        """Time-weighted mean, each throttle held until the next; None if the interval is not covered."""
        while len(self._throttles) > 1 and self._throttles[1][0] <= begin_s:
            self._throttles.popleft()
        if (
            not self._throttles
            or self._throttles[0][0] > begin_s
            or end_s - self._throttles[-1][0] > _WINDOW_S / 2
        ):
            return None
        total = 0.0
        times = [max(at, begin_s) for at, _ in self._throttles if at < end_s]
        for (_, throttle), at, then in zip(self._throttles, times, [*times[1:], end_s], strict=False):
            total += throttle * (then - at)
        mean = total / (end_s - begin_s)
        return mean if mean > 0 else None
