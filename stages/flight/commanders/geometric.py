"""Commander of rates or accelerations: the geometric controller behind a filter among ellipsoids."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.filtering.splat_protocol import FlightState, Nominal, SplatFilter, is_input
from alula.stages.flight.commanders.protocol import Decision
from alula.stages.flight.links.protocol import (
    AccelerationSetpoint,
    RatesSetpoint,
    Setpoint,
    VehicleState,
)


class _Predicted(NamedTuple):
    """Predicted state as the 12 numbers of the model and as the filter takes it, and the nominal command."""

    x: FloatArray
    state: FlightState
    nominal: Nominal


@dataclass(slots=True)
class GeometricCommander:
    """Geometric controller behind a filter among ellipsoids, or without a filter.

    The filter's output is sent as an acceleration or, through the controller's attitude loop, as thrust and
    body rates, depending on what the link accepts.

    Attributes:
        filter: safety filter; None sends the nominal command.
        body, gains: of the vehicle and of its controller.
        actuators: lag of the rotors and of the rate loop, and the maximum age of a state that the model
            predicts forward.
        delay_s: assumed age of a state when it arrives; a longer measured latency replaces it [s].
        dt_s: duration of a tick [s].
        max_rate_rad_s: maximum body rates of a command, body x, y, z [rad/s].
        rate_lead_s: a torque is sent as the body rate that it leads to after this time [s]. A first-order
            rate loop with this time constant turns that rate into the torque now.
        setpoint: kind of set-point to send, `RatesSetpoint` or `AccelerationSetpoint`.
    """

    filter: SplatFilter | None
    body: _core.Quadrotor
    gains: _core.TrackingGains
    actuators: _core.ActuatorModel
    delay_s: float
    dt_s: float
    max_rate_rad_s: tuple[float, float, float]
    rate_lead_s: float
    setpoint: type[Setpoint] = RatesSetpoint
    _predictor: _core.StatePredictor = field(init=False)
    _thrust: float = field(init=False)
    _thrust_rate: float = field(init=False, default=0.0)
    _thrust_differs: bool = field(init=False, default=False)
    _computed: RatesSetpoint | None = field(init=False, default=None)
    _flown: float = field(init=False, default=0.0)
    _acceleration: FloatArray = field(init=False)
    _torque: FloatArray = field(init=False)
    _now: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Start from a hover."""
        if self.setpoint is AccelerationSetpoint and self.filter is not None and self.filter.kind == "wrench":
            raise ValueError("thrust and torque cannot be sent as an acceleration")
        self._predictor = _core.StatePredictor(self.body, self.actuators, tick_s=self.dt_s)
        self.reset()

    def reset(self) -> None:
        """See `Commander`."""
        if self.filter is not None:
            self.filter.reset()
        self._predictor.reset()
        self._thrust, self._thrust_rate, self._thrust_differs = self.body.hover_thrust, 0.0, False
        self._acceleration, self._torque, self._now = np.zeros(3), np.zeros(3), np.zeros(12)

    def decide(self, state: VehicleState, age_s: float, target: FloatArray) -> Decision:
        """See `Commander`."""
        predicted = self._predicted(state, age_s, target)
        status, margin, active, infeasible, certified = FilterStatus.OK, math.inf, -1, False, False
        kind, u = "acceleration", predicted.nominal.acceleration
        if self.filter is not None:
            result = self.filter(predicted.state, predicted.nominal)
            kind, status, margin, active = (
                self.filter.kind,
                FilterStatus(result.status),
                result.margin,
                result.active,
            )
            infeasible, certified = result.infeasible, result.certified
            u = np.ascontiguousarray(result.u, np.float64)
            if status is not FilterStatus.REFUSED and not is_input(u, self.filter.kind):
                raise ValueError(f"the filter returned {result.u!r}, which is not a valid {kind}")
        setpoint: Setpoint | None = None
        safe = u[:3] if kind == "acceleration" else self._acceleration_of(predicted, float(u[0]))
        if status is not FilterStatus.REFUSED:
            thrust_rate = result.thrust_rate if self.filter is not None and kind == "wrench" else math.nan
            setpoint = self._setpoint(predicted, kind, u, target, thrust_rate)
        error = predicted.nominal.position_error
        return Decision(
            setpoint=setpoint,
            status=status,
            margin=float(margin),
            nominal=predicted.nominal.acceleration,
            safe=safe,
            error_m=math.sqrt(float(error @ error)),
            active=int(active),
            infeasible=bool(infeasible),
            certified=bool(certified),
            thrust_nominal_n=float(predicted.nominal.wrench[0]),
        )

    def sent(self, setpoint: Setpoint) -> None:
        """See `Commander`; the rotor model follows the set-point that was sent, also one of the geofence."""
        if isinstance(setpoint, RatesSetpoint):
            thrust = setpoint.thrust_m_s2 * self.body.mass
            self._thrust = self._flown if setpoint is self._computed else thrust
            self._predictor.fly(np.array([thrust, *self._torque]), setpoint.omega.tolist(), self._now)
        elif isinstance(setpoint, AccelerationSetpoint):
            self._acceleration = setpoint.acceleration

    def _predicted(self, state: VehicleState, age_s: float, target: FloatArray) -> _Predicted:
        age = age_s + max(self.delay_s, state.latency_s)
        sigma = _core.shadowed(_mrp(state.attitude_wxyz)[None])[0]
        if self.setpoint is RatesSetpoint:
            x = np.concatenate([state.position, sigma, state.velocity, state.omega])
            x = self._now = self._predictor.now(x, age)
        else:  # the acceleration that was sent is known, but no wrench
            position = state.position + age * state.velocity + 0.5 * age * age * self._acceleration
            x = np.concatenate([position, sigma, state.velocity + age * self._acceleration, state.omega])
        applied = np.array([self._thrust]) if self._thrust_differs else None
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
        return _Predicted(
            x,
            FlightState(x[:3], x[3:6], x[6:9], x[9:], self._thrust, self._thrust_rate, rotors),
            nominal,
        )

    def _setpoint(
        self, predicted: _Predicted, kind: str, u: FloatArray, target: FloatArray, thrust_rate: float
    ) -> Setpoint:
        if self.setpoint is AccelerationSetpoint:
            yaw = float(target[0, 15])
            return AccelerationSetpoint(u, predicted.state.velocity, predicted.state.position, yaw)
        x = predicted.x[None]
        if kind == "acceleration":
            u = _core.realise(self.body, self.gains, x, target, np.ascontiguousarray(u[None]))[0]
        flown = self.body.limited(u[None])
        led = self._predictor.lead(flown[0])
        rates = _core.body_rates(
            self.body, x, flown, dt_s=self.rate_lead_s, max_rate_rad_s=self.max_rate_rad_s
        )[0]
        self._flown, self._torque = float(flown[0, 0]), led[1:]
        change = (self._flown - self._thrust) / self.dt_s
        self._thrust_rate = change if math.isnan(thrust_rate) else thrust_rate
        self._thrust_differs = self._flown != float(predicted.nominal.wrench[0])
        self._computed = RatesSetpoint(float(led[0]) / self.body.mass, rates)
        return self._computed

    def _acceleration_of(self, predicted: _Predicted, thrust: float) -> FloatArray:
        """Acceleration by a thrust [N] along the predicted body z axis, shape (3,), world frame [m/s^2]."""
        axis = _core.rotation_of(predicted.x[None, 3:6])[0].T @ np.array([0.0, 0.0, 1.0])
        acceleration: FloatArray = thrust / self.body.mass * axis - np.array([0.0, 0.0, self.body.gravity])
        return acceleration


def _mrp(quat_wxyz: FloatArray) -> FloatArray:
    """Modified Rodrigues Parameters of a quaternion of either sign: v / (1 + w) for w >= 0."""
    quat = quat_wxyz if quat_wxyz[0] >= 0 else -quat_wxyz
    sigma: FloatArray = quat[1:] / (1.0 + quat[0])
    return sigma
