"""What a caller tells every link beside its address."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from alula.schemas.vehicle import FASTBRIDGE, Vehicle
from alula.stages.vehicles.frames import LocalFrame


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What set-points are clipped to, per axis, and how fast they may change; twice a limit is refused.

    A number so far out is a mistake of units or signs, not a large command.
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
    """All that a link may need; each link takes what it has a use for.

    Attributes:
        frame: where the world lies in the vehicle's local frame.
        vehicle: its file: the body of `sim:`, gravity, and the limits of rates.
        state_rate_hz: how often state is asked for.
        limits: of set-points; None takes the rates from the vehicle and the defaults for the rest.
        learns_hover: whether the throttle at hover is followed in flight, not only read beforehand.
        key: 32 bytes that packets are signed with; unsigned ones are then refused.
        signing_file: where the newest time stamp of signatures is kept from run to run; needed with a key.
        mocap: `udp:HOST:PORT` where motion capture is listened to, and forwarded to the vehicle.
        origin: latitude, longitude [deg] and height [m] that a vehicle without satellites is told to be at.
        allow_remote: whether other machines may be spoken to.
        clock: monotonic [s]; wall_clock: since 1970 [s]; sleep: waits for seconds.
    """

    frame: LocalFrame = field(default_factory=LocalFrame)
    vehicle: Vehicle = FASTBRIDGE
    state_rate_hz: float = 100.0
    limits: Limits | None = None
    learns_hover: bool = False
    key: bytes | None = None
    signing_file: Path | None = None
    mocap: str | None = None
    origin: tuple[float, float, float] = (47.3977, 8.5456, 488.0)
    allow_remote: bool = False
    clock: Callable[[], float] = time.monotonic
    wall_clock: Callable[[], float] = time.time
    sleep: Callable[[float], None] = time.sleep

    def all_limits(self) -> Limits:
        """Those given, or those of the vehicle."""
        return self.limits or Limits(rates_rad_s=self.vehicle.rates.max_rad_s)
