"""Protocol of the safety filters among ellipsoids."""

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
    """Vehicle state for a filter; world frame z up, body frame x forward, y left, z up.

    Attributes:
        position: shape (3,) [m].
        sigma: attitude, Modified Rodrigues Parameters of the body in the world, shape (3,), |sigma| <= 1.
        velocity: shape (3,) [m/s].
        omega: angular velocity of the body, body components, shape (3,) [rad/s].
        thrust: collective thrust applied last [N].
        thrust_rate: rate of that thrust [N/s].
        rotors: thrust of each rotor now according to the model, shape (4,) [N]; None: the rotors hover.
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
    """Nominal input of the tracking controller, and its tracking errors.

    Attributes:
        acceleration: nominal acceleration of the translation, shape (3,) [m/s^2].
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
    """Result of a filter, held for one tick.

    Attributes:
        u: the acceleration, shape (3,) [m/s^2], or the wrench, shape (4,) [N, N m], as `kind` says.
        status: outcome; `REFUSED` ends the flight.
        margin: value of the filter's own barrier, negative when violated; infinite without an obstacle.
        active: index of the deciding ellipsoid, or the number of ellipsoids plus that of a hull; -1 for none.
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
    """Obstacles, vehicle and rate that a filter among ellipsoids is built for.

    Attributes:
        index: the ellipsoids at their level, and grown by `radius_m`.
        body: mass, inertia and rotors of the vehicle.
        gains: gains of the tracking controller.
        radius_m: radius of the vehicle's sphere plus the alignment error of the scene [m].
        dt_s: time for which an input is held [s].
        motor_time_constant_s: assumed time constant of the rotors; 0: they follow a command at once [s].
        rate_time_constant_s: time constant of the rate loop of a vehicle that is commanded by thrust and body
            rates; 0: it is commanded by thrust and torque [s].
        max_rate_rad_s: maximum body rates of a command, body x, y, z [rad/s].
        hulls: the hulls of a cover, for shields that certify against them and rows that steer around them.
        hull_radius_m: radius that these keep from the hulls [m].
        static: what shields certify against, in place of what `shield_map` names; None: as it names.
        static_radius_m: radius that they keep from it [m].
    """

    index: _core.EllipsoidIndex
    body: _core.Quadrotor
    gains: _core.TrackingGains
    radius_m: float
    dt_s: float
    motor_time_constant_s: float = 0.0
    rate_time_constant_s: float = 0.0
    max_rate_rad_s: tuple[float, float, float] = (10.0, 10.0, 4.0)
    hulls: _core.PolytopeSet | None = None
    hull_radius_m: float = 0.0
    static: _core.ObstacleMap | None = None
    static_radius_m: float = 0.0


class SplatFilter(Protocol):
    """A safety filter whose input is an acceleration or a wrench, as `kind` says."""

    @property
    def kind(self) -> InputKind:
        """The kind of input that the filter returns."""
        ...

    def __call__(self, state: FlightState, nominal: Nominal) -> SplatFilterResult:
        """Filter the nominal input of one tick."""
        ...

    def reset(self) -> None:
        """Discard the state of the previous flight; called at the start of each."""
        ...


SplatFilterFactory = Callable[[SplatWorld, Mapping[str, Any]], SplatFilter]


def is_input(u: Any, kind: InputKind) -> bool:
    """Return whether a value is a finite input of a kind.

    Args:
        u: any value; an input has shape (3,) [m/s^2] or (4,) [N, N m].
        kind: the kind of input.
    """
    array = np.asarray(u, np.float64)
    return array.shape == ((3,) if kind == "acceleration" else (4,)) and bool(np.isfinite(array).all())
