"""Commander by the native flight, the object that `simulate` calls, too: what was simulated is what flies."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.flight.commanders.protocol import Decision, TickInputs
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, Setpoint, VelocitySetpoint

INTERFACES: dict[type[Setpoint], str] = {
    VelocitySetpoint: "velocity",
    AccelerationSetpoint: "acceleration",
    RatesSetpoint: "body-rates",
}
_DOWN = np.array([0.0, 0.0, -1.0])


@dataclass(slots=True)
class FlightCommander:
    """Set-points of a `_core.Flight` by given reference points.

    Prediction, nominal command, filter, and the way from its command to the set-point are native:
    `native/core/include/alula/flight/flight.hpp`, for velocities `alula/filters/chord_filter.hpp`. A
    torque is sent as a body rate.

    Attributes:
        flight: vehicle, mission `given`, and filters.
        setpoint: kind of set-point to send, the flight's interface.
        delay_s: assumed age of a state when it arrives; a longer measured latency replaces it [s].
        command: kind of command that the last filter returns; None without a filter.
    """

    flight: _core.Flight
    setpoint: type[Setpoint]
    body: _core.Quadrotor
    delay_s: float
    dt_s: float
    command: str | None
    _ticks: int = field(init=False, default=0)  # since the last reset
    _times: int = field(init=False, default=0)  # that the set-point of the last tick was sent
    _decided: Setpoint | None = field(init=False, default=None)

    def reset(self) -> None:
        """See `Commander`."""
        self.flight.reset()
        self._ticks, self._times, self._decided = 0, 0, None

    def decide(self, state: VehicleState, age_s: float, target: FloatArray, slip_m: float = 0.0) -> Decision:
        """See `Commander`."""
        measured = np.concatenate(
            [state.position, _mrp(state.attitude_wxyz), state.velocity, state.omega], dtype=np.float64
        )
        return self.step(
            TickInputs(
                measured=measured,
                age_s=age_s + max(self.delay_s, state.latency_s),
                slip_m=slip_m,
                target=np.array(target[0], np.float64),
                number=self._ticks,
                repeats=max(0, self._times - 1),
            )
        )

    def step(self, inputs: TickInputs) -> Decision:
        """Decide from the inputs of a tick, which are those of a logged one in a replay."""
        self._decided, self._times = None, 0
        now_s = self._ticks * self.dt_s
        self._ticks += 1
        self.flight.observe(
            now_s, inputs.measured, target=inputs.target, age_s=inputs.age_s, slip_m=inputs.slip_m
        )
        found = self.flight.decide()
        estimate, nominal = found["estimate"], found["nominal"]
        is_velocity = self.setpoint is VelocitySetpoint
        wanted = np.array(nominal["velocity" if is_velocity else "acceleration"])
        report = found["filters"][-1] if found["filters"] else None
        status = FilterStatus.OK if report is None else FilterStatus(report["status"])
        if found["is_refused"]:
            status = FilterStatus.REFUSED
        else:
            self._decided = self._setpoint(found, float(inputs.target[15]))
        error = estimate[:3] - inputs.target[:3]
        return Decision(
            setpoint=self._decided,
            status=status,
            margin=math.inf if report is None else report["margin"],
            nominal=wanted,
            safe=wanted if report is None else self._safe(report, estimate),
            error_m=math.sqrt(float(error @ error)),
            active=-1 if report is None else report["active"],
            infeasible=report is not None and report["infeasible"],
            certified=report is not None and report["certified"],
            thrust_nominal_n=None if is_velocity else float(nominal["wrench"][0]),
            inputs=inputs,
            disturbance=np.array(found["disturbance"]),
            disturbance_bound=found["disturbance_bound"],
            added_margin_m=found["added_margin_m"],
        )

    def sent(self, setpoint: Setpoint) -> None:
        """See `Commander`; predictions follow the set-point that was sent, also one of the geofence."""
        self._times += 1
        if setpoint is self._decided:
            self.flight.sent()
            return
        if isinstance(setpoint, RatesSetpoint):
            values = (setpoint.thrust_m_s2 * self.body.mass, *setpoint.omega.tolist())
        elif isinstance(setpoint, AccelerationSetpoint):
            values = (*setpoint.acceleration.tolist(), 0.0)
        else:
            values = (*setpoint.velocity.tolist(), 0.0)
        self.flight.sent(INTERFACES[type(setpoint)], values)

    def _setpoint(self, found: dict[str, Any], yaw_rad: float) -> Setpoint:
        command, estimate = found["command"], found["estimate"]
        if self.setpoint is VelocitySetpoint:
            return VelocitySetpoint(command[:3].copy(), yaw_rad)
        if self.setpoint is AccelerationSetpoint:
            velocity, position = estimate[6:9].copy(), estimate[:3].copy()
            return AccelerationSetpoint(command[:3].copy(), velocity, position, yaw_rad)
        return RatesSetpoint(float(command[3]) / self.body.mass, command[:3].copy())

    def _safe(self, report: dict[str, Any], estimate: FloatArray) -> FloatArray:
        """Velocity or acceleration of the filter, shape (3,); of a wrench along the estimated body z axis."""
        if self.command is not None and self.command != "wrench":
            return np.array(report[self.command])
        up = -_core.rotation_of(estimate[None, 3:6])[0].T @ _DOWN
        acceleration: FloatArray = report["thrust"] / self.body.mass * up + self.body.gravity * _DOWN
        return acceleration


def _mrp(quat_wxyz: FloatArray) -> FloatArray:
    """Modified Rodrigues Parameters of a quaternion of either sign, norm at most 1, shape (3,)."""
    quat = quat_wxyz if quat_wxyz[0] >= 0 else -quat_wxyz
    sigma: FloatArray = _core.shadowed((quat[1:] / (1.0 + quat[0]))[None])[0]
    return sigma
