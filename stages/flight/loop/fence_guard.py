"""Geofence behind every filter: passes or changes each set-point, and takes over near the fence."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from alula._core import Fence, Geofence, RacerModel
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import UsageError
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.flight.links.protocol import VehicleState
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, Setpoint, VelocitySetpoint

# For a fence around a room rather than an airfield: it pushes the vehicle off walls at short distances only.
# beta is the one wanted, so that commands a few decimetres away from the limit do not change; ticks that are
# too long for it get the largest one that the geofence's conditions allow.
PARAMETERS = {"beta": 8.0, "push_distance_m": 0.2, "push_gain": 0.5, "push_speed_m_s": 0.3}
_LOOP_S = 0.04  # minimum assumed time constant of the rate loop, if the vehicle's file has a faster one
_RETURN_M = 0.05  # h_I above which a take-over ends


class Guarded(NamedTuple):
    """Result of the geofence for one tick.

    Attributes:
        setpoint: allowed set-point; None when the geofence must take over and the link accepts no rates.
        h_m: h_I, minimum distance to the fence along the flow of the backup controller, less all margins [m].
        regulation: value of the regulation function lambda, the weight of the given set-point in the allowed
            one, from 0 to 1.
        takes_over: the backup controller flies.
    """

    setpoint: Setpoint | None
    h_m: float
    regulation: float
    takes_over: bool


def rates_model(vehicle: Vehicle) -> RacerModel:
    """Model of a vehicle behind its rate loop, for the geofence.

    The map from throttle to thrust is the one in the vehicle's file, else linear up to the maximum thrust of
    the rotors.

    Raises:
        UsageError: the vehicle has no rotors.
    """
    if vehicle.rotors is None or vehicle.body.mass_kg is None:
        raise UsageError(f"{vehicle.name} is a {vehicle.model}; the geofence needs a quadrotor")
    max_thrust_m_s2 = sum(vehicle.rotors.max_thrust_n) / vehicle.body.mass_kg
    thrust = (0.0, max_thrust_m_s2, 0.0) if vehicle.throttle is None else vehicle.throttle.acceleration_m_s2
    return RacerModel(
        gravity=vehicle.body.gravity_m_s2,
        thrust=thrust,
        rate_gain=1 / vehicle.rates.tilting_s,
        max_rate=vehicle.rates.max_rad_s,
    )


class FenceGuard:
    """Geofence for set-points of any kind.

    Rates are blended with the backup controller: u = lambda u_des + (1 - lambda) u_B. For velocities and
    accelerations the geofence evaluates h_I at the state, and at the state to which the set-point can lead
    before a take-over acts. When one of the two is not positive, the backup controller flies by rates. It
    ends when both exceed 0.05 m. If the link accepts no rates, no set-point is allowed then and the loop must
    hold the vehicle.

    Args:
        vehicle: contents of the vehicle's file; its radius is kept from the fence.
        reserve_m: distance kept beyond the radius, for errors of the model [m].
        latency_s: assumed latency of state and command; the state is predicted over what a longer measured
            one exceeds it by [s].

    Raises:
        UsageError: the geofence rejects the fence or a number.
    """

    def __init__(
        self,
        fence: Fence,
        vehicle: Vehicle,
        *,
        dt_s: float,
        takes_rates: bool,
        reserve_m: float = 0.0,
        latency_s: float = 0.0,
    ) -> None:
        self.fence = fence
        self.radius_m = vehicle.body.radius_m
        self.takes_rates = takes_rates
        self._model = rates_model(vehicle)
        a, b, c = self._model.thrust
        self._max_thrust_m_s2 = a + b + c
        given = {"radius_m": self.radius_m, "tick_s": dt_s, "reserve_m": reserve_m, "latency_s": latency_s}
        given = PARAMETERS | given
        try:
            given["beta"] = min(given["beta"], Geofence.conditions(self._model, given)["most_beta"])
            self._filter = Geofence(fence, self._model, given)
        except (TypeError, ValueError) as error:
            raise UsageError(f"geofence: {error}") from error
        self._flies = False
        self._latency_s = latency_s
        self._lead_s = latency_s + dt_s + max(vehicle.rates.tilting_s, _LOOP_S)

    def reset(self) -> None:
        """Return to the condition before the first tick."""
        self._filter.reset()
        self._flies = False

    def distance(self, state: VehicleState, floor_m: float = -math.inf) -> float:
        """Distance from the vehicle's sphere to the fence; negative outside [m].

        Args:
            floor_m: a vehicle below this height counts as being at it, so that the sides and the top of the
                fence count and its bottom does not [m].
        """
        x, y, z = state.position.tolist()
        z = floor_m if z < floor_m else z
        return self.fence.clearance((x, y, z), (x, y, z)) - self.radius_m

    def guard(self, state: VehicleState, age_s: float, setpoint: Setpoint) -> Guarded:
        """Compute the allowed set-point."""
        ahead_s = age_s + max(0.0, state.latency_s - self._latency_s)
        row = np.concatenate(
            [state.position + ahead_s * state.velocity, state.velocity, state.attitude_wxyz, state.omega]
        )
        if isinstance(setpoint, RatesSetpoint):
            pilot = np.array([self._model.throttle_for(setpoint.thrust_m_s2), *setpoint.omega])
            return self._answer(row, pilot, setpoint)
        values, _ = self._filter.evaluate(np.stack([row, self._led(row, setpoint)]))
        h = float(values[:, 0].min())  # NaN leads to a take-over
        if self._flies and h > _RETURN_M:
            self._flies = False
        if not self._flies and h > 0:
            return Guarded(setpoint, h, 1.0, takes_over=False)
        if not self.takes_rates:
            return Guarded(None, h, 0.0, takes_over=True)
        if not self._flies:
            self._filter.reset()
            self._flies = True
        return self._answer(row, None, setpoint)

    def _led(self, row: FloatArray, setpoint: VelocitySetpoint | AccelerationSetpoint) -> FloatArray:
        """State to which a set-point can lead before a take-over acts, shape (13,)."""
        if isinstance(setpoint, AccelerationSetpoint):
            change, fastest = setpoint.acceleration * self._lead_s, self._max_thrust_m_s2
        else:  # a vehicle that follows velocities tilts by at most 45 degrees
            change, fastest = setpoint.velocity - row[3:6], self._model.gravity
        size, max_size = math.sqrt(float(change @ change)), fastest * self._lead_s
        if size > max_size:
            change = change * (max_size / size)
        led = row.copy()
        led[3:6] += change
        led[:3] += self._lead_s * (row[3:6] + 0.5 * change)
        return led

    def _answer(self, row: FloatArray, pilot: FloatArray | None, setpoint: Setpoint) -> Guarded:
        command, status, detail = self._filter.filter(row, pilot)
        h = float(detail["h_i"])
        if status == "passed":
            return Guarded(setpoint, h, 1.0, takes_over=False)
        if status == "refused" or not np.isfinite(command).all():
            return Guarded(None, h, 0.0, takes_over=True)
        throttle = float(command[0])
        a, b, c = self._model.thrust
        allowed = RatesSetpoint(a + throttle * (b + throttle * c), command[1:])
        regulation = float(detail["lambda"]) if status == "blended" else 0.0
        return Guarded(
            allowed, h if math.isfinite(h) else -math.inf, regulation, takes_over=status != "blended"
        )
