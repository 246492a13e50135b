"""Proportional, integral and derivative control with ArduPilot's filters and parameters."""

from __future__ import annotations

from alula.stages.sim_vehicle.ardupilot.shaping import low_pass_weight
from alula.stages.sim_vehicle.common.airframe import TICK_S
from alula.stages.sim_vehicle.common.parameters import Parameters


class Pid:
    """Controller of one axis: P e + I integral of e + D derivative of e, where e is low-passed.

    Args:
        parameters: values NAME_P, _I, _D, _IMAX and the cutoffs _FLTT (of the target), _FLTE (of the error)
            and _FLTD (of its derivative) [Hz], read at every tick; missing ones are 0.
        name: their prefix.
        unit: factor of _IMAX.

    Attributes:
        integral: the integral's part of the output.
    """

    def __init__(self, parameters: Parameters, name: str, unit: float = 1.0) -> None:
        self._parameters = parameters
        self._name = name
        self._unit = unit
        self.integral = 0.0
        self._last: tuple[float, float, float] | None = None  # target, error, derivative, all filtered
        parameters.follow(self._tune)

    def _tune(self) -> None:
        parts = ("P", "I", "D", "IMAX", "FLTT", "FLTE", "FLTD")
        names = [f"{self._name}_{part}" for part in parts]
        gains = [self._parameters.get(name, 0.0) for name in names]
        self._gains = (*gains[:3], abs(gains[3]) * self._unit, *map(low_pass_weight, gains[4:]))

    def reset(self, integral: float = 0.0) -> None:
        """Forget the past; the next target and error pass unfiltered."""
        self.integral, self._last = integral, None

    def run(self, target: float, measured: float, *, held: bool = False) -> float:
        """Compute the output of one tick.

        Args:
            held: the actuator is at its limit, so the integral must not grow.
        """
        p, i, d, most, of_target, of_error, of_derivative = self._gains
        if self._last is None:
            error, derivative = target - measured, 0.0
        else:
            before, last, slope = self._last
            target = before + of_target * (target - before)
            error = last + of_error * (target - measured - last)
            derivative = slope + of_derivative * ((error - last) / TICK_S - slope)
        self._last = (target, error, derivative)
        integral = self.integral
        if not held or integral * error < 0:
            integral += i * error * TICK_S
            # Comparisons, as everywhere in a tick, because calls of min and max take longer.
            integral = integral if integral < most else most
            self.integral = integral = integral if integral > -most else -most
        return p * error + integral + d * derivative
