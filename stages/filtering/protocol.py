"""Protocol of the safety filters; its native twin is native/core/include/alula/filters/safety_filter.hpp."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import partial
from typing import Any, Literal, Protocol

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.stages.compression.hulls import Hulls

CommandKind = Literal["velocity", "acceleration", "wrench", "sticks"]
SIZES: dict[str, int] = {"velocity": 3, "acceleration": 3, "wrench": 4, "sticks": 4}
"""How many numbers a command has: m/s; m/s^2; N and N m; throttle and rad/s."""
_three, _four, _no_tracks, _no_faces = (partial(np.zeros, shape) for shape in (3, 4, (0, 32), (0, 4)))


class FilterStatus(IntEnum):
    """Outcome of a filter; the numbers are those of `alula_filter_status` in native/onboard."""

    OK = 0
    """The nominal input is safe and is returned unchanged, bit by bit."""
    FILTERED = 1
    """Changed by a barrier's row or the speed limit."""
    SHORTENED = 2
    """Scaled down further, so that the held step stays clear; of velocities only."""
    RECOVERING = 3
    """The vehicle is too close already: the filter drives it out and ignores the nominal input."""
    REFUSED = 4
    """No safe input is known; `u` is not read."""
    BACKUP = 5
    """The backup policy is flown."""


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
        tracks: what moves, predicted to now, shape (N, 32): id, position [m], velocity [m/s], the lower
            triangle of their covariance row by row, radius [m], acceleration [m/s^2].
        position_variance: of the estimated position, per axis, shape (3,) [m^2].
        is_known: False: there is no navigation, and the state means nothing.
    """

    position: FloatArray
    sigma: FloatArray = field(default_factory=_three)
    velocity: FloatArray = field(default_factory=_three)
    omega: FloatArray = field(default_factory=_three)
    thrust: float = 0.0
    thrust_rate: float = 0.0
    rotors: Sequence[float] | FloatArray | None = None
    tracks: FloatArray = field(default_factory=_no_tracks)
    position_variance: FloatArray = field(default_factory=_three)
    is_known: bool = True


@dataclass(frozen=True, slots=True)
class Nominal:
    """Nominal input, and errors of the tracking controller; a filter reads the command of its kind.

    Attributes:
        velocity: shape (3,) [m/s].
        acceleration: of the translation, shape (3,) [m/s^2].
        wrench: collective thrust [N] and torque in the body frame [N m], shape (4,).
        thrust_rate: derivative of that thrust [N/s].
        thrust_acceleration: second derivative [N/s^2].
        position_error: position less that of the reference, shape (3,) [m].
        velocity_error: shape (3,) [m/s].
        reference_acceleration: shape (3,) [m/s^2].
        sticks: throttle and body rates [rad/s], shape (4,); None: the pilot is silent.
    """

    velocity: FloatArray = field(default_factory=_three)
    acceleration: FloatArray = field(default_factory=_three)
    wrench: FloatArray = field(default_factory=_four)
    thrust_rate: float = 0.0
    thrust_acceleration: float = 0.0
    position_error: FloatArray = field(default_factory=_three)
    velocity_error: FloatArray = field(default_factory=_three)
    reference_acceleration: FloatArray = field(default_factory=_three)
    sticks: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class FilterResult:
    """Result of one call of a filter, held for one tick.

    Attributes:
        u: the command to fly, of the filter's kind: shape (3,), world frame, or (4,).
        status: outcome; every caller branches on it.
        margin: value of the filter's own barrier, negative when violated; infinite without an obstacle.
        active: number of the deciding obstacle, among ellipsoids and hulls that of a hull after all
            ellipsoids; -1 for none.
        thrust_rate: rate of the thrust at the end of the tick, for wrenches [N/s].
        infeasible: whether the filter's program had no solution.
        certified: whether a safe backup manoeuvre is proven to remain after the tick.
        certified_moving: whether that manoeuvre is clear of the tubes of all tracks too.
        solve_time: duration measured by the filter [s]; NaN: its caller measures.
    """

    u: FloatArray
    status: FilterStatus
    margin: float = float("inf")
    active: int = -1
    thrust_rate: float = 0.0
    infeasible: bool = False
    certified: bool = False
    certified_moving: bool = False
    solve_time: float = float("nan")


@dataclass(frozen=True, slots=True, kw_only=True)
class Kept:
    """Radius of the vehicle, and what filters keep beyond it from the parts of a world.

    Attributes:
        radius_m: of the vehicle's sphere; of a real flight with the margin that it keeps [m].
        inflation_m: error of the map that is added to it, by part: `ellipsoids`, by the alignment of the
            scene; `hulls`, what they have not grown by already. The fence is exact [m].
    """

    radius_m: float
    inflation_m: Mapping[str, float] = field(default_factory=dict)

    def keeps_m(self, *parts: str) -> float:
        """Distance to keep from some parts of the world: the radius, and the largest inflation of them [m].

        Args:
            parts: `ellipsoids`, `hulls` or `fence`.
        """
        return self.radius_m + max((self.inflation_m.get(part, 0.0) for part in parts), default=0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterWorld(Kept):
    """Obstacles, vehicle and rate that a filter is built for; what a run does not have has its default.

    Attributes:
        radius_m, inflation_m: see `Kept`; `keeps_m` is what a filter keeps.
        dt_s: time for which a command is held [s].
        hulls: the hulls of a cover.
        polytopes: the same as a native set.
        image: the cover as an onboard map with an index, which `polytope-cbf` then reads instead of `hulls`,
            and which `geofence` keeps out of.
        tiles: the cover in tiles, which `polytope-cbf` then reads instead.
        tile_load_ticks: calls of the filter between the request for a tile and its arrival.
        index: the ellipsoids at their level, and grown by what is kept from them; None: there are none.
        parts: native maps by name, ellipsoids, hulls and fence, which shields and filters among moving
            obstacles take; empty: made of `index` and `polytopes`.
        fence_box: lower and upper corner of the fence [m]; None: it has no box.
        fence_faces: its other faces, shape (L, 4), rows (n, d) with unit n and n . p <= d inside.
        extent_m: bound of the coordinates of all positions [m].
        speed_m_s: limit of velocity commands [m/s].
        max_speed_m_s, max_acceleration_m_s2, max_jerk_m_s3: limits of the vehicle among moving obstacles, per
            axis [m/s, m/s^2, m/s^3].
        body: mass, inertia and rotors; None: the vehicle is a point.
        gains: of the tracking controller.
        racer: thrust by throttle of a vehicle that is commanded by sticks.
        motor_time_constant_s: assumed time constant of the rotors; 0: they follow a command at once [s].
        rate_time_constant_s: time constant of each axis of the rate loop of a vehicle that is commanded by
            thrust and body rates; 0 for all: it is commanded by thrust and torque [s].
        max_rate_rad_s: maximum body rates of a command, body x, y, z [rad/s].
    """

    dt_s: float
    hulls: Hulls | None = None
    polytopes: _core.PolytopeSet | None = None
    image: bytes = b""
    tiles: _core.TileSet | None = None
    tile_load_ticks: int = 0
    index: _core.EllipsoidIndex | None = None
    parts: Mapping[str, _core.ObstacleMap] = field(default_factory=dict)
    fence_box: tuple[Sequence[float], Sequence[float]] | None = None
    fence_faces: FloatArray = field(default_factory=_no_faces)
    extent_m: float = 1e3
    speed_m_s: float = 1.0
    max_speed_m_s: float = 3.0
    max_acceleration_m_s2: float = 6.0
    max_jerk_m_s3: float = 60.0
    body: _core.Quadrotor | None = None
    gains: _core.TrackingGains | None = None
    racer: _core.RacerModel | None = None
    motor_time_constant_s: float = 0.0
    rate_time_constant_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    max_rate_rad_s: tuple[float, float, float] = (10.0, 10.0, 4.0)


class SafetyFilter(Protocol):
    """A safety filter of one kind of command."""

    @property
    def kind(self) -> CommandKind:
        """The kind of command that the filter changes and returns."""
        ...

    def __call__(self, state: FlightState, nominal: Nominal) -> FilterResult:
        """Filter the nominal command of one tick."""
        ...

    def reset(self) -> None:
        """Discard the state of the previous flight; called at the start of each."""
        ...


FilterFactory = Callable[[FilterWorld, Mapping[str, Any]], SafetyFilter]
