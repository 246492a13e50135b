"""From thrust to throttle: what share of it carries the weight."""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from alula.stages.flight.links.protocol import VehicleState
from alula.stages.rotation import matrix_from_quat_wxyz

_WINDOW_S = 0.25  # over which velocities are compared
_RISE_S = 0.06  # from a throttle to its thrust
_FASTEST_PER_S = 0.02  # how much of itself a hover throttle may change in a second
_ALLOWED = (0.05, 0.9)
_RANGE = 1.5  # of what it began with


def throttle_of(thrust_m_s2: float, hover: float, gravity_m_s2: float) -> float:
    """Thr = (T / g) hover, T per mass; not limited."""
    return thrust_m_s2 / gravity_m_s2 * hover


def hover_from(throttle: float, thrust_m_s2: float, gravity_m_s2: float) -> float:
    """The hover throttle with which a flown throttle gives a measured thrust per mass."""
    return throttle * gravity_m_s2 / thrust_m_s2


def measured_thrust(
    velocity_before: NDArray[np.float64],
    velocity_after: NDArray[np.float64],
    dt_s: float,
    attitude_wxyz: NDArray[np.float64],
    gravity_m_s2: float,
) -> float:
    """(dv / dt + g e_z) along the body's z axis: thrust per mass of a body without drag [m/s^2]."""
    acceleration = (velocity_after - velocity_before) / dt_s
    acceleration[2] += gravity_m_s2
    return float(acceleration @ matrix_from_quat_wxyz(attitude_wxyz)[:, 2])


class HoverThrottle:
    """Follows the hover throttle in flight, slowly and within bounds.

    The mean throttle over a quarter of a second, 60 ms ago, is compared with the thrust that the change of
    velocity shows: hover' = hover g / T. Each comparison moves the estimate by time / tau of the way in
    the logarithm, and never by more than 2 % in a second; it stays within a factor of 1.5 of what it began
    with and between 0.05 and 0.9. Windows with less than half or more than twice the weight of thrust or
    more than 45 degrees of tilt do not count: there drag and the rotors' own curve are not small.

    Args:
        initial: what the autopilot has learned.
        gravity_m_s2: of the vehicle's file.
        tau_s: time in which an error falls to a third.
    """

    def __init__(self, initial: float, gravity_m_s2: float = 9.81, *, tau_s: float = 10.0) -> None:
        low, high = _ALLOWED
        if not low <= initial <= high:
            raise ValueError(f"a hover throttle is between {low:g} and {high:g}, not {initial:g}")
        self.value = initial
        self.gravity_m_s2 = gravity_m_s2
        self._tau_s = tau_s
        self._bounds = (max(low, initial / _RANGE), min(high, initial * _RANGE))
        self._sent: deque[tuple[float, float]] = deque(maxlen=512)
        self._start: VehicleState | None = None

    def throttle(self, thrust_m_s2: float) -> float:
        """`throttle_of` with the present estimate."""
        return throttle_of(thrust_m_s2, self.value, self.gravity_m_s2)

    def sent(self, throttle: float, now_s: float) -> None:
        """A throttle that was sent."""
        self._sent.append((now_s, throttle))

    def seen(self, state: VehicleState) -> None:
        """A newer state."""
        start = self._start
        if start is None or state.received_s - start.received_s > 2 * _WINDOW_S:
            self._start = state
            return
        dt_s = state.received_s - start.received_s
        if dt_s < _WINDOW_S:
            return
        self._start = state
        throttle = self._mean(start.received_s - _RISE_S, state.received_s - _RISE_S)
        thrust = measured_thrust(start.velocity, state.velocity, dt_s, state.attitude_wxyz, self.gravity_m_s2)
        upright = float(matrix_from_quat_wxyz(state.attitude_wxyz)[2, 2])
        if throttle is None or upright < math.sqrt(0.5):
            return
        if not 0.5 < thrust / self.gravity_m_s2 < 2.0:
            return
        step = math.log(hover_from(throttle, thrust, self.gravity_m_s2) / self.value) * dt_s / self._tau_s
        most = _FASTEST_PER_S * dt_s
        low, high = self._bounds
        self.value = min(max(self.value * math.exp(min(max(step, -most), most)), low), high)

    def _mean(self, begin_s: float, end_s: float) -> float | None:
        """Time-weighted, each throttle held until the next; None where nothing was sent all the way."""
        while len(self._sent) > 1 and self._sent[1][0] <= begin_s:
            self._sent.popleft()
        if not self._sent or self._sent[0][0] > begin_s or end_s - self._sent[-1][0] > _WINDOW_S / 2:
            return None
        total = 0.0
        times = [max(at, begin_s) for at, _ in self._sent if at < end_s]
        for (_, throttle), at, then in zip(self._sent, times, [*times[1:], end_s], strict=False):
            total += throttle * (then - at)
        mean = total / (end_s - begin_s)
        return mean if mean > 0 else None
