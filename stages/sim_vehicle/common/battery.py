"""Battery that the flight discharges, and the vehicle's assessment of it."""

from __future__ import annotations

from enum import IntEnum

from alula.stages.sim_vehicle.common.parameters import Parameters

_FULL_V, _EMPTY_V = 12.6, 9.9
_IDLE_A, _HOVER_A = 0.5, 12.0
_OHM = 0.01


class Charge(IntEnum):
    """Level of the battery, worst last."""

    GOOD = 0
    LOW = 1
    CRITICAL = 2


class Battery:
    """Battery of three cells with BATT_CAPACITY.

    The voltage is linear in the charge, minus the drop at the internal resistance.

    Args:
        parameters: capacity and thresholds, read at every use.

    Attributes:
        charge: level; it never improves.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.used_mah = 0.0
        self.current_a = _IDLE_A
        self._below_s = {Charge.LOW: 0.0, Charge.CRITICAL: 0.0}
        self.charge = Charge.GOOD

    @property
    def remaining(self) -> float:
        """Remaining fraction of the charge, 0 to 1."""
        return max(0.0, 1 - self.used_mah / max(self._parameters["BATT_CAPACITY"], 1.0))

    @property
    def voltage(self) -> float:
        """Voltage at the terminals [V]."""
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * self.remaining - _OHM * self.current_a

    def drain_to(self, remaining: float) -> None:
        """Apply a fault: set the remaining fraction of the charge."""
        self.used_mah = (1 - remaining) * self._parameters["BATT_CAPACITY"]

    def use(self, duration_s: float, hover_fraction: float) -> Charge:
        """Discharge the battery for a while and update its level.

        Args:
            hover_fraction: throttle relative to the hover throttle.

        Returns:
            The level.
        """
        self.current_a = _IDLE_A + _HOVER_A * max(0.0, hover_fraction) ** 1.5
        self.used_mah += self.current_a * duration_s / 3.6
        for level, name in ((Charge.LOW, "LOW"), (Charge.CRITICAL, "CRT")):
            volts, mah = self._parameters[f"BATT_{name}_VOLT"], self._parameters[f"BATT_{name}_MAH"]
            below = 0 < self.voltage < volts
            self._below_s[level] = self._below_s[level] + duration_s if below else 0.0
            left_mah = self._parameters["BATT_CAPACITY"] - self.used_mah
            long = below and self._below_s[level] >= self._parameters["BATT_LOW_TIMER"]
            if long or (mah > 0 and left_mah < mah):
                self.charge = max(self.charge, level)
        return self.charge
