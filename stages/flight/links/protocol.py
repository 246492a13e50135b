"""What every link to a vehicle takes and gives; world frame z up, body frame x forward, y left, z up."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Protocol

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import LinkError

HIGHEST_M = 100.0  # of a take-off
UNANSWERED, UNDONE = "no answer", "not done"  # how reasons begin of orders that nobody declined


@dataclass(frozen=True, slots=True)
class VehicleState:
    """Where the vehicle says it is.

    Attributes:
        received_s: when the newest part of it arrived, on this host's monotonic clock [s].
        position: shape (3,), world frame [m].
        velocity: shape (3,), world frame [m/s].
        attitude_wxyz: unit quaternion that turns body vectors into the world frame, shape (4,).
        omega: angular velocity, body components, shape (3,) [rad/s].
    """

    received_s: float
    position: FloatArray
    velocity: FloatArray
    attitude_wxyz: FloatArray
    omega: FloatArray


@dataclass(frozen=True, slots=True)
class RatesSetpoint:
    """Thrust per mass along body z [m/s^2] and body rates, shape (3,) [rad/s]."""

    thrust_m_s2: float
    omega: FloatArray


@dataclass(frozen=True, slots=True)
class AccelerationSetpoint:
    """Acceleration of the translation, and the position and velocity it is given at; each (3,), world."""

    acceleration: FloatArray
    velocity: FloatArray
    position: FloatArray
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class VelocitySetpoint:
    """Velocity, shape (3,), world frame [m/s]."""

    velocity: FloatArray
    yaw_rad: float


Setpoint = RatesSetpoint | AccelerationSetpoint | VelocitySetpoint


class Order(Enum):
    """What a vehicle can be told beside set-points; the answer is seen in `VehicleStatus`.

    All but LAND are carried out in a mode that follows set-points; that of landing has "land" in its name.
    """

    TAKE_CONTROL = "take control"
    ARM = "arm"
    DISARM = "disarm"
    TAKE_OFF = "take off"
    HOLD = "hold"
    LAND = "land"
    NOTHING = "nothing"
    """Nothing is told: what is still being repeated is dropped."""


@dataclass(slots=True)
class VehicleStatus:
    """What else a vehicle says; None is unknown.

    Attributes:
        heard_s: when anything valid arrived last, monotonic clock [s].
        armed, landed: as the vehicle says.
        obeys: whether its mode follows our set-points.
        mode: the mode's own name.
        battery_share: of 1; battery_v: [V].
        is_estimator_ready: whether its own estimate of position and attitude may be flown on.
        is_failsafe: whether it is in one of its own failsafes.
        texts: what it says to people, oldest first; the reader takes them out.
        refusals: orders that it declined, with its reason, or did not do; the reader takes them out.
        bad_packets, lost_packets: counted.
        clock_jumps: how often the vehicle's own clock jumped; it started anew, and knows nothing of before.
    """

    heard_s: float | None = None
    armed: bool | None = None
    landed: bool | None = None
    obeys: bool = False
    mode: str = ""
    battery_share: float | None = None
    battery_v: float | None = None
    is_estimator_ready: bool | None = None
    is_failsafe: bool = False
    texts: list[str] = field(default_factory=list)
    refusals: list[tuple[Order, str]] = field(default_factory=list)
    bad_packets: int = 0
    lost_packets: int = 0
    clock_jumps: int = 0


def refusal_words(order: Order, reason: str) -> str:
    """A line for people; silence declines nothing."""
    is_undone = reason.startswith((UNANSWERED, UNDONE))
    return f"{'order to' if is_undone else 'vehicle declines to'} {order.value}: {reason}"


def check_height(height_m: float) -> None:
    """Refuse (LinkError) a take-off that makes no sense."""
    if not 0 < height_m <= HIGHEST_M:
        raise LinkError(
            f"take-off to {height_m:g} m is refused: heights are above 0 and up to {HIGHEST_M:g} m"
        )


class Link(Protocol):
    """A vehicle. Only `open` and `prepare` may wait; all else returns at once and is called from one thread.

    Raises of all methods: LinkError, with one line for a person.
    """

    @property
    def accepts(self) -> frozenset[type[Setpoint]]:
        """Kinds of set-points that can be sent."""
        ...

    @property
    def state(self) -> VehicleState | None:
        """The newest complete and finite one; None before the first."""
        ...

    @property
    def status(self) -> VehicleStatus:
        """The same object always, brought up to date by `poll`."""
        ...

    def open(self, timeout_s: float) -> str:
        """Find the vehicle; returns what it is, in words."""
        ...

    def prepare(self) -> list[str]:
        """Read, set and remember the parameters that flights need; a line for each that was changed."""
        ...

    def poll(self, now_s: float) -> None:
        """Take in all that has arrived, and send what is due by itself (heartbeats, repeated orders)."""
        ...

    def send(self, setpoint: Setpoint, now_s: float) -> None:
        """Send a set-point; refuses (LinkError) what is not finite or out of the vehicle's range."""
        ...

    def order(self, order: Order, now_s: float, height_m: float = 0.0) -> None:
        """Tell it something; repeated by `poll` until answered or until another order replaces it."""
        ...

    def close(self) -> None:
        """Put changed parameters back, as far as it still answers, and let go; never raises."""
        ...
