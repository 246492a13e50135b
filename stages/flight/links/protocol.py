"""Interface of all links: states, set-points, commands and status.

World frame z up; body frame x forward, y left, z up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple, Protocol

from alula.schemas.arrays import FloatArray
from alula.schemas.errors import LinkError
from alula.stages.flight.links.own_safety import OwnSafety
from alula.stages.vehicles.setpoints import Setpoint

HIGHEST_M = 100.0  # maximum take-off height
UNANSWERED, UNDONE = "no answer", "not done"  # first words of the reason if no refusal was received


@dataclass(frozen=True, slots=True)
class VehicleState:
    """Estimated state that the vehicle reports.

    Attributes:
        received_s: time at which its newest part would have arrived with the smallest delay so far, on this
            host's monotonic clock [s].
        position: shape (3,), world frame [m].
        velocity: shape (3,), world frame [m/s].
        attitude_wxyz: unit quaternion that turns body vectors into the world frame, shape (4,).
        omega: angular velocity, body components, shape (3,) [rad/s].
        latency_s: upper bound of its age at `received_s`, which is also the bound of the delay until a
            set-point computed from it takes effect, measured by round trips [s]; NaN if there is no evidence.
    """

    received_s: float
    position: FloatArray
    velocity: FloatArray
    attitude_wxyz: FloatArray
    omega: FloatArray
    latency_s: float = 0.0

    def age_s(self, now_s: float) -> float:
        """Upper bound of the age of this state [s]; NaN if the latency of the link was not measured."""
        return now_s - self.received_s + self.latency_s


class Order(Enum):
    """A command to the vehicle other than a set-point; its outcome shows in `VehicleStatus`.

    All but LAND are executed in a mode that follows set-points. The name of the landing mode contains "land".
    """

    TAKE_CONTROL = "take control"
    ARM = "arm"
    DISARM = "disarm"
    STOP = "stop the motors"
    """Disarms also a vehicle that reports that it is in the air; after a crash only."""
    TAKE_OFF = "take off"
    HOLD = "hold"
    LAND = "land"
    SETTLE = "lean less"
    """Helps a vehicle that lands to notice the ground; it cancels no other command. Not all need it."""
    NOTHING = "nothing"
    """Sends nothing; cancels the command that is still being repeated."""


@dataclass(slots=True)
class VehicleStatus:
    """Reported status of a vehicle besides its state; None means unknown.

    Attributes:
        heard_s: when the last valid packet arrived, monotonic clock [s].
        landed: whether the vehicle reports that it is on the ground.
        obeys: whether its mode follows this program's set-points.
        battery_share: remaining charge, a fraction from 0 to 1.
        is_estimator_ready: whether its own estimate of position and attitude is good enough to fly.
        estimator: why `is_estimator_ready` is False, in words; may be empty.
        strayed_m: distance of its position from the way by its satellites' velocities since the take-off; 0
            where there are none [m].
        sinks: whether it lands without a position, in the mode that follows set-points.
        without_position: what its position needs and lacks, in words; empty if it reports one, or not known.
        clock: why the age of its states is not known, in words; may be empty.
        is_failsafe: whether one of its own failsafes has triggered, whether it acts or not.
        failsafe: cause of its newest failsafe in its own words; empty if it reported none.
        can_arm: whether its own checks before arming hold; None if it does not report or make them.
        arming: why they do not hold, in its own words; may be empty.
        settles: whether it can be ordered to lean less, so that it notices the ground (`Order.SETTLE`).
        own_safety: its failsafes and its fence; `Link.prepare` reads them. None if they are not known.
        changed: parameters that the flight relies on and another station has changed, in words.
        texts: its messages for people, oldest first; the reader removes them.
        refusals: commands that it refused or did not execute, with the reason; the reader removes them.
        bad_packets: number of packets that were refused.
        clock_jumps: how often the vehicle's clock jumped: it restarted and lost its earlier settings.
    """

    heard_s: float | None = None
    armed: bool | None = None
    landed: bool | None = None
    obeys: bool = False
    mode: str = ""
    battery_share: float | None = None
    battery_v: float | None = None
    is_estimator_ready: bool | None = None
    estimator: str = ""
    strayed_m: float = 0.0
    sinks: bool = False
    without_position: str = ""
    clock: str = ""
    is_failsafe: bool = False
    failsafe: str = ""
    can_arm: bool | None = None
    arming: str = ""
    settles: bool = False
    own_safety: OwnSafety | None = None
    changed: str = ""
    texts: list[str] = field(default_factory=list)
    refusals: list[tuple[Order, str]] = field(default_factory=list)
    bad_packets: int = 0
    lost_packets: int = 0
    clock_jumps: int = 0


class Place(NamedTuple):
    """Where a vehicle is reached, for another process.

    Attributes:
        file: descriptor of the line; None while it is lost.
        kind: "udp" (connected), "udp to" (with `peer`), or "stream".
        peer: address of the vehicle, for "udp to".
    """

    file: int | None
    kind: str
    peer: Any = None


@dataclass(frozen=True, slots=True)
class Ward:
    """What a watchdog process needs to stop and land a vehicle without this program.

    Attributes:
        settings: as for `flight.watchdog.companion.Takeover`, or for `crazyflie_companion.Takeover`.
        place: returns where the vehicle is reached now.
        reported: returns the mode as the vehicle encodes it (custom_mode), when that report arrived [s],
            minus infinity for none, and the newest time stamp of a signature.
        speaks_crtp: whether the vehicle is a Crazyflie; then the process has a line of its own.
    """

    settings: dict[str, Any]
    place: Callable[[], Place]
    reported: Callable[[], tuple[int, float, int]]
    speaks_crtp: bool = False


def refusal_words(order: Order, reason: str) -> str:
    """One line for the user about a failed command; a missing answer is not called a refusal."""
    is_undone = reason.startswith((UNANSWERED, UNDONE))
    return f"{'command to' if is_undone else 'vehicle refuses to'} {order.value}: {reason}"


def check_height(height_m: float) -> None:
    """Reject a take-off height that is not above 0 and at most `HIGHEST_M`.

    Raises:
        LinkError: the height is out of this range.
    """
    if not 0 < height_m <= HIGHEST_M:
        raise LinkError(
            f"take-off to {height_m:g} m is refused: heights are above 0 and up to {HIGHEST_M:g} m"
        )


class Link(Protocol):
    """A connection to one vehicle.

    A link may also have a method `guarded() -> Ward`. Then flights are watched by a process that lands the
    vehicle when this program ends or stalls (`flight.watchdog`).

    Only `open` and `prepare` may block. All other methods return at once; one thread calls them. Every method
    may raise LinkError with a message of one line.
    """

    @property
    def accepts(self) -> frozenset[type[Setpoint]]:
        """Kinds of set-points that can be sent."""
        ...

    @property
    def state(self) -> VehicleState | None:
        """The newest complete and finite state; None before the first."""
        ...

    @property
    def status(self) -> VehicleStatus:
        """The status, always the same object; `poll` updates it."""
        ...

    def open(self, timeout_s: float) -> str:
        """Connect to the vehicle within `timeout_s` [s]; returns a description of it."""
        ...

    def prepare(self) -> list[str]:
        """Set the parameters that flights need and remember their old values; a line for each change."""
        ...

    def poll(self, now_s: float) -> None:
        """Receive all that has arrived, and send periodic messages (heartbeats, repeated commands)."""
        ...

    def send(self, setpoint: Setpoint, now_s: float) -> None:
        """Send a set-point.

        Raises:
            LinkError: it is not finite or out of the vehicle's range.
        """
        ...

    def order(self, order: Order, now_s: float, height_m: float = 0.0) -> None:
        """Send a command; `poll` repeats it until it is answered or replaced by another command."""
        ...

    def close(self) -> None:
        """Restore changed parameters as far as the vehicle still answers, and disconnect; never raises."""
        ...
