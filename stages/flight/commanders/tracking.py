"""From a state and a plan to a set-point: the controllers and filters of `simulate`, one tick at a time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.filtering.splat_protocol import FlightState, Nominal, SplatFilter, is_input
from alula.stages.flight.links.protocol import (
    AccelerationSetpoint,
    RatesSetpoint,
    Setpoint,
    VehicleState,
)

_TURN_RAD_S = 0.7  # from the heading that it has to the plan's


@dataclass(slots=True)
class Decision:
    """What a commander wants for one tick.

    Attributes:
        setpoint: None where the filter knows no safe input.
        status: of the filter.
        margin: its barrier; in metres among hulls.
        nominal, safe: velocities or accelerations, before and after the filter, shape (3,).
        error_m: distance from the reference.
        active: obstacle that decides, -1 for none.
        infeasible, certified: as the filter says.
        thrust_nominal_n: of the controller; None without rotors.
    """

    setpoint: Setpoint | None
    status: FilterStatus
    margin: float
    nominal: FloatArray
    safe: FloatArray
    error_m: float
    active: int = -1
    infeasible: bool = False
    certified: bool = False
    thrust_nominal_n: float | None = None


class Commander(Protocol):
    """Turns a state and a row of the reference into a set-point, behind a filter."""

    @property
    def setpoint(self) -> type[Setpoint]:
        """What it sends."""
        ...

    def reset(self) -> None:
        """Forget what was flown: called before set-points are sent, at first and after a hold."""
        ...

    def decide(self, state: VehicleState, age_s: float, target: FloatArray) -> Decision:
        """The set-point for a state that is `age_s` old, and a row of `ReferenceCurve.at`, shape (1, 18)."""
        ...

    def sent(self, setpoint: Setpoint) -> None:
        """What was sent in the end."""
        ...


class _Seen(NamedTuple):
    """What filter and controller see: the state as 12 numbers, and what the controller made of it."""

    x: FloatArray
    state: FlightState
    nominal: Nominal


@dataclass(slots=True)
class SplatCommander:
    """The geometric controller behind a filter among ellipsoids, or behind none.

    What a filter returns becomes, as the link takes it, an acceleration or, through the controller's attitude
    loop, thrust and body rates.

    Attributes:
        filter: None flies what the controller asks for.
        body, gains: of the vehicle.
        actuators: lag of its rotors, and the oldest state that is taken on to now by the model.
        delay_s: how old a state is when it arrives.
        dt_s: of a tick.
        max_rate_rad_s: of a rate command.
        rate_lag_s: time constant of the loop that follows it. A torque that is asked for as the rate that it
            would lead to after this time is what a first-order loop with this lag makes of it now.
        setpoint: what to send: `RatesSetpoint` or `AccelerationSetpoint`.
    """

    filter: SplatFilter | None
    body: _core.Quadrotor
    gains: _core.TrackingGains
    actuators: _core.ActuatorModel
    delay_s: float
    dt_s: float
    max_rate_rad_s: tuple[float, float, float]
    rate_lag_s: float
    setpoint: type[Setpoint] = RatesSetpoint
    _predictor: _core.StatePredictor = field(init=False)
    _thrust: float = field(init=False)
    _thrust_rate: float = field(init=False, default=0.0)
    _is_other: bool = field(init=False, default=False)
    _made: RatesSetpoint | None = field(init=False, default=None)
    _flown: float = field(init=False, default=0.0)
    _acceleration: FloatArray = field(init=False)
    _torque: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Begin in a hover."""
        if self.setpoint is AccelerationSetpoint and self.filter is not None and self.filter.kind == "wrench":
            raise ValueError("thrust and torque cannot be sent as an acceleration")
        self._predictor = _core.StatePredictor(self.body, self.actuators, tick_s=self.dt_s)
        self.reset()

    def reset(self) -> None:
        """See `Commander`."""
        if self.filter is not None:
            self.filter.reset()
        self._predictor.reset()
        self._thrust, self._thrust_rate, self._is_other = self.body.hover_thrust, 0.0, False
        self._acceleration, self._torque = np.zeros(3), np.zeros(3)

    def decide(self, state: VehicleState, age_s: float, target: FloatArray) -> Decision:
        """See `Commander`."""
        seen = self._seen(state, age_s, target)
        status, margin, active, infeasible, certified = FilterStatus.OK, math.inf, -1, False, False
        kind, u = "acceleration", seen.nominal.acceleration
        if self.filter is not None:
            result = self.filter(seen.state, seen.nominal)
            kind, status, margin, active = (
                self.filter.kind,
                FilterStatus(result.status),
                result.margin,
                result.active,
            )
            infeasible, certified = result.infeasible, result.certified
            u = np.ascontiguousarray(result.u, np.float64)
            if status is not FilterStatus.REFUSED and not is_input(u, self.filter.kind):
                raise ValueError(f"the filter returned {result.u!r}, which is no {kind}")
        setpoint: Setpoint | None = None
        safe = u[:3] if kind == "acceleration" else self._acceleration_of(seen, float(u[0]))
        if status is not FilterStatus.REFUSED:
            thrust_rate = result.thrust_rate if self.filter is not None and kind == "wrench" else math.nan
            setpoint = self._setpoint(seen, kind, u, target, thrust_rate)
        error = seen.nominal.position_error
        return Decision(
            setpoint=setpoint,
            status=status,
            margin=float(margin),
            nominal=seen.nominal.acceleration,
            safe=safe,
            error_m=math.sqrt(float(error @ error)),
            active=int(active),
            infeasible=bool(infeasible),
            certified=bool(certified),
            thrust_nominal_n=float(seen.nominal.wrench[0]),
        )

    def sent(self, setpoint: Setpoint) -> None:
        """The model of the rotors follows what was sent, be it another's."""
        if isinstance(setpoint, RatesSetpoint):
            told = setpoint.thrust_m_s2 * self.body.mass
            self._thrust = self._flown if setpoint is self._made else told
            self._predictor.fly(np.array([told, *self._torque]))
        elif isinstance(setpoint, AccelerationSetpoint):
            self._acceleration = setpoint.acceleration

    def _seen(self, state: VehicleState, age_s: float, target: FloatArray) -> _Seen:
        age = age_s + self.delay_s
        sigma = _core.shadowed(_mrp(state.attitude_wxyz)[None])[0]
        if self.setpoint is RatesSetpoint:
            x = np.concatenate([state.position, sigma, state.velocity, state.omega])
            x = self._predictor.now(x, age)
        else:  # its acceleration is known, not its wrenches
            position = state.position + age * state.velocity + 0.5 * age * age * self._acceleration
            x = np.concatenate([position, sigma, state.velocity + age * self._acceleration, state.omega])
        applied = np.array([self._thrust]) if self._is_other else None
        terms = _core.track(self.body, self.gains, x[None], target, applied_thrust=applied)
        nominal = Nominal(
            acceleration=terms["acceleration"][0],
            wrench=terms["wrench"][0],
            thrust_rate=float(terms["thrust_rate"][0]),
            thrust_acceleration=float(terms["thrust_acceleration"][0]),
            position_error=terms["position_error"][0],
            velocity_error=terms["velocity_error"][0],
            reference_acceleration=target[0, 6:9],
        )
        rotors = self._predictor.rotors if self.setpoint is RatesSetpoint else None
        return _Seen(
            x,
            FlightState(x[:3], x[3:6], x[6:9], x[9:], self._thrust, self._thrust_rate, rotors),
            nominal,
        )

    def _setpoint(
        self, seen: _Seen, kind: str, u: FloatArray, target: FloatArray, thrust_rate: float
    ) -> Setpoint:
        if self.setpoint is AccelerationSetpoint:
            yaw = float(target[0, 15])
            return AccelerationSetpoint(u, seen.state.velocity, seen.state.position, yaw)
        x = seen.x[None]
        if kind == "acceleration":
            u = _core.realise(self.body, self.gains, x, target, np.ascontiguousarray(u[None]))[0]
        flown = self.body.limited(u[None])
        led = self._predictor.lead(flown[0])
        rates = _core.body_rates(
            self.body, x, flown, dt_s=self.rate_lag_s, max_rate_rad_s=self.max_rate_rad_s
        )[0]
        self._flown, self._torque = float(flown[0, 0]), led[1:]
        change = (self._flown - self._thrust) / self.dt_s
        self._thrust_rate = change if math.isnan(thrust_rate) else thrust_rate
        self._is_other = self._flown != float(seen.nominal.wrench[0])
        self._made = RatesSetpoint(float(led[0]) / self.body.mass, rates)
        return self._made

    def _acceleration_of(self, seen: _Seen, thrust: float) -> FloatArray:
        """Of the translation, along the true axis."""
        axis = _core.rotation_of(seen.x[None, 3:6])[0].T @ np.array([0.0, 0.0, 1.0])
        made: FloatArray = thrust / self.body.mass * axis - np.array([0.0, 0.0, self.body.gravity])
        return made


def heading_of(quat_wxyz: FloatArray) -> float:
    """The direction of body x seen from above [rad]."""
    w, x, y, z = quat_wxyz.tolist()
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _mrp(quat_wxyz: FloatArray) -> FloatArray:
    """Modified Rodrigues Parameters of a quaternion of either sign: v / (1 + w) for w >= 0."""
    quat = quat_wxyz if quat_wxyz[0] >= 0 else -quat_wxyz
    made: FloatArray = quat[1:] / (1.0 + quat[0])
    return made


class PlanClock:
    """The time along the plan: it runs with the clock, slower for a vehicle that has fallen behind.

    Its rate falls from 1 at an error of `near_m` to 0 at `far_m`, by at most `slew_per_s`; derivatives of the
    reference are those of the slowed time, its rate held.
    """

    def __init__(
        self, curve: _core.ReferenceCurve, *, near_m: float, far_m: float, slew_per_s: float = 2.0
    ) -> None:
        self.curve = curve
        self.near_m, self.far_m, self.slew_per_s = near_m, far_m, slew_per_s
        self.time_s, self.rate, self._turn = 0.0, 0.0, 0.0
        self._query = np.zeros(1)

    @property
    def is_over(self) -> bool:
        """Whether the end of the plan is reached."""
        return self.time_s >= self.curve.duration_s

    def pause(self, heading_rad: float) -> None:
        """It stands still: the flight begins anew from here, with this heading at first, then the plan's."""
        self.rate = 0.0
        self._query[0] = self.time_s
        turn = heading_rad - float(self.curve.at(self._query)[0, 15])
        self._turn = (turn + math.pi) % (2 * math.pi) - math.pi

    def advance(self, dt_s: float, error_m: float) -> None:
        """Let `dt_s` of the clock pass."""
        wanted = min(1.0, max(0.0, (self.far_m - error_m) / (self.far_m - self.near_m)))
        most = self.slew_per_s * dt_s
        self.rate += min(most, max(-most, wanted - self.rate))
        self.time_s = min(self.time_s + self.rate * dt_s, self.curve.duration_s)
        self._turn -= min(_TURN_RAD_S * dt_s, max(-_TURN_RAD_S * dt_s, self._turn))

    def target(self) -> FloatArray:
        """The reference now, a row of `ReferenceCurve.at`, shape (1, 18)."""
        self._query[0] = self.time_s
        row: Any = self.curve.at(self._query)
        s = self.rate
        for begin, factor in ((3, s), (6, s * s), (9, s**3), (12, s**4)):
            row[0, begin : begin + 3] *= factor
        row[0, 15] += self._turn
        row[0, 16] = s * row[0, 16] - (math.copysign(_TURN_RAD_S, self._turn) if self._turn else 0.0)
        row[0, 17] *= s * s
        result: FloatArray = row
        return result
