"""What a safety filter among ellipsoids takes and gives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.stages.filtering.protocol import FilterStatus

InputKind = Literal["acceleration", "wrench"]


@dataclass(frozen=True, slots=True)
class FlightState:
    """What a filter sees of the vehicle, world frame z up, body frame x forward, y left, z up.

    Attributes:
        position: shape (3,) [m].
        sigma: attitude, Modified Rodrigues Parameters of the body in the world, shape (3,), |sigma| <= 1.
        velocity: shape (3,) [m/s].
        omega: angular velocity of the body, body components, shape (3,) [rad/s].
        thrust: collective thrust that was flown last [N].
        thrust_rate: its rate [N/s].
        rotors: what each rotor gives now, shape (4,), as the model has it [N]; None: they hover.
    """

    position: FloatArray
    sigma: FloatArray
    velocity: FloatArray
    omega: FloatArray
    thrust: float
    thrust_rate: float
    rotors: Sequence[float] | None = None


@dataclass(frozen=True, slots=True)
class Nominal:
    """What the tracking controller asks for, and the errors that it saw.

    Attributes:
        acceleration: of the translation, shape (3,) [m/s^2].
        wrench: collective thrust [N] and torque in the body frame [N m], shape (4,).
        thrust_rate: derivative of that thrust [N/s].
        thrust_acceleration: second derivative [N/s^2].
        position_error: position less that of the reference, shape (3,) [m].
        velocity_error: shape (3,) [m/s].
        reference_acceleration: shape (3,) [m/s^2].
    """

    acceleration: FloatArray
    wrench: FloatArray
    thrust_rate: float
    thrust_acceleration: float
    position_error: FloatArray
    velocity_error: FloatArray
    reference_acceleration: FloatArray


@dataclass(frozen=True, slots=True)
class SplatFilterResult:
    """A filter's answer, held for one tick.

    Attributes:
        u: the acceleration, shape (3,) [m/s^2], or the wrench, shape (4,) [N, N m], as `kind` says.
        status: what was done; `REFUSED` ends the flight.
        margin: value of the filter's own barrier, negative when violated; infinite without an obstacle.
        active: ellipsoid that decides, -1 for none.
        thrust_rate: rate of the thrust at the end of the tick, for wrenches [N/s].
        infeasible: whether the filter's program had no solution.
        certified: whether a safe backup manoeuvre is proven to remain after the tick.
    """

    u: FloatArray
    status: FilterStatus
    margin: float = float("inf")
    active: int = -1
    thrust_rate: float = 0.0
    infeasible: bool = False
    certified: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class SplatWorld:
    """What a filter among ellipsoids is built for.

    Attributes:
        index: the ellipsoids at their level, and grown by `radius_m`.
        body: mass, inertia and rotors of the vehicle.
        gains: of the tracking controller.
        radius_m: of the vehicle's sphere, with what the alignment of the scene leaves open [m].
        dt_s: how long an input is held [s].
        motor_time_constant_s: of the rotors, as filters believe it; 0: they obey at once [s].
    """

    index: _core.EllipsoidIndex
    body: _core.Quadrotor
    gains: _core.TrackingGains
    radius_m: float
    dt_s: float
    motor_time_constant_s: float = 0.0


class SplatFilter(Protocol):
    """A safety filter whose input is an acceleration or a wrench, as `kind` says."""

    @property
    def kind(self) -> InputKind:
        """What the filter returns."""
        ...

    def __call__(self, state: FlightState, nominal: Nominal) -> SplatFilterResult:
        """Filter what the controller asks for."""
        ...

    def reset(self) -> None:
        """Forget the flight before: called at the start of each."""
        ...


SplatFilterFactory = Callable[[SplatWorld, Mapping[str, Any]], SplatFilter]


def is_input(u: Any, kind: InputKind) -> bool:
    """Whether a value can be flown."""
    array = np.asarray(u, np.float64)
    return array.shape == ((3,) if kind == "acceleration" else (4,)) and bool(np.isfinite(array).all())
