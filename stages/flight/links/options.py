"""Options of a link besides its address."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from alula.schemas.scenarios.vehicle import FASTBRIDGE, Vehicle
from alula.stages.vehicles.frames import LocalFrame
from alula.stages.vehicles.ground import Ground


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of set-points and of their rate of change, per axis.

    A set-point beyond a limit is clipped. One beyond twice a limit is refused, because it is more likely an
    error of units or signs than a large command. Throttles are fractions of full throttle.
    """

    rates_rad_s: tuple[float, float, float] = (10.0, 10.0, 4.0)
    rates_slew_rad_s2: float = 500.0
    throttle: tuple[float, float] = (0.02, 1.0)
    throttle_slew_per_s: float = 20.0
    speed_m_s: float = 15.0
    speed_slew_m_s2: float = 40.0
    acceleration_m_s2: float = 30.0
    acceleration_slew_m_s3: float = 1000.0


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkOptions:
    """Options of all links; each link reads those that apply to it.

    Attributes:
        frame: the world frame relative to the vehicle's local frame.
        vehicle: the vehicle file; gives the body of `sim:`, gravity, and the limits of body rates.
        limits: limits of set-points; None for the vehicle's body rates and otherwise the defaults.
        flies_rates: set-points are body rates. A link then sets further parameters: the vehicle follows rates
            at once, and lands soon after this program ended. It also estimates the hover throttle in flight.
        watches_throttle: request the throttle that the vehicle commands, whatever set-points are.
        key: 32 bytes that sign packets; unsigned packets are then refused.
        signing_file: file that stores the newest signature time stamp between runs; required with a key.
        mocap: `udp:HOST:PORT` to receive motion capture on, which is forwarded to the vehicle.
        origin: latitude, longitude [deg] and height [m] sent as the origin to a vehicle without satellites.
        ground: makes the ground of `sim:` in the world frame, when the link is opened; None for a flat floor.
    """

    frame: LocalFrame = field(default_factory=LocalFrame)
    vehicle: Vehicle = FASTBRIDGE
    state_rate_hz: float = 100.0
    limits: Limits | None = None
    flies_rates: bool = False
    watches_throttle: bool = False
    key: bytes | None = None
    signing_file: Path | None = None
    mocap: str | None = None
    origin: tuple[float, float, float] = (47.3977, 8.5456, 488.0)
    allow_remote: bool = False
    ground: Callable[[], Ground] | None = None
    clock: Callable[[], float] = time.monotonic
    wall_clock: Callable[[], float] = time.time
    sleep: Callable[[float], None] = time.sleep

    def all_limits(self) -> Limits:
        """`limits`, or by default those of the vehicle."""
        return self.limits or Limits(rates_rad_s=self.vehicle.rates.max_rad_s)
