"""Parameters of all flights on a real vehicle."""

from __future__ import annotations

from dataclasses import dataclass

from alula.schemas.parameters.configs.config import Config, option


@dataclass(frozen=True, kw_only=True)  # without slots, so that a configuration may have a second base
class FlightConfig(Config):
    """Parameters of all commands that fly."""

    rate_hz: float = option(100.0, "Rate of the control loop [Hz].", group="Control loop", within=(10, 500))
    latency_s: float = option(
        0.03, "Latency of states and commands, for the geofence [s].", group="Control loop", within=(0, 0.3)
    )
    near_m: float = option(
        0.5,
        "Maximum horizontal distance at take-off from where the flight starts [m].",
        group="Checks of the vehicle",
        within=(0.01, 100),
    )
    battery: float = option(
        0.3,
        "Minimum charge at take-off, from 0 to 1; the vehicle lands at two thirds of it.",
        group="Checks of the vehicle",
        within=(0, 0.9),
    )
    stale_s: float = option(
        0.15, "Maximum age of a state in flight [s].", group="Checks of the vehicle", within=(0.02, 2)
    )

    @property
    def landing_share(self) -> float:
        """Charge at which the vehicle lands, from 0 to 1."""
        return self.battery * 2 / 3
