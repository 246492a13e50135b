"""Parameters of all flights on a real vehicle."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from alula.schemas.errors import UsageError


@dataclass(frozen=True, kw_only=True)  # without slots, so that a configuration may have a second base
class FlightConfig:
    """Parameters of all commands that fly."""

    rate_hz: float = field(
        default=100.0,
        metadata={"group": "Control loop", "help": "Rate of the control loop [Hz].", "option": "--rate"},
    )
    latency_s: float = field(
        default=0.03,
        metadata={
            "group": "Control loop",
            "help": "Latency of states and commands, for the geofence [s].",
            "option": "--latency",
        },
    )
    near_m: float = field(
        default=0.5,
        metadata={
            "group": "Checks of the vehicle",
            "help": "Maximum horizontal distance at take-off from where the flight starts [m].",
            "option": "--near",
        },
    )
    battery: float = field(
        default=0.3,
        metadata={
            "group": "Checks of the vehicle",
            "help": "Minimum charge at take-off, from 0 to 1; the vehicle lands at two thirds of it.",
        },
    )
    stale_s: float = field(
        default=0.15,
        metadata={
            "group": "Checks of the vehicle",
            "help": "Maximum age of a state in flight [s].",
            "option": "--stale",
        },
    )

    def __post_init__(self) -> None:
        """Refuse values that are out of range."""
        for option, value, low, high in (
            ("--rate", self.rate_hz, 10.0, 500.0),
            ("--latency", self.latency_s, 0.0, 0.3),
            ("--near", self.near_m, 0.01, 100.0),
            ("--battery", self.battery, 0.0, 0.9),
            ("--stale", self.stale_s, 0.02, 2.0),
        ):
            require_between(option, value, low, high)

    @property
    def landing_share(self) -> float:
        """Charge at which the vehicle lands, from 0 to 1."""
        return self.battery * 2 / 3


def require_between(option: str, value: float, low: float, high: float) -> None:
    """Refuse a value that is out of range or not finite.

    Raises:
        UsageError: it is.
    """
    if not (low <= value <= high) or not math.isfinite(value):
        raise UsageError(f"{option} must be between {low:g} and {high:g}, not {value:g}")
