"""The geofence underneath every filter: what it lets through, and when it flies itself."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from alula._core import Fence, Geofence, RacerModel
from alula.schemas.arrays import FloatArray
from alula.schemas.errors import UsageError
from alula.schemas.vehicle import Vehicle
from alula.stages.flight.links.protocol import (
    AccelerationSetpoint,
    RatesSetpoint,
    Setpoint,
    VehicleState,
    VelocitySetpoint,
)

# Of a fence around a room rather than an airfield: it pushes off walls from nearby only, and lets a command
# through that is farther than a few decimetres from mattering.
PARAMETERS = {"beta": 8.0, "push_distance_m": 0.2, "push_gain": 0.5, "push_speed_m_s": 0.3}
_LOOP_S = 0.04  # of an autopilot's rate loop, where the vehicle's file knows a faster one
_BACK_M = 0.05  # h_I that ends a take-over


class Guarded(NamedTuple):
    """One tick of the fence.

    Attributes:
        setpoint: what may be sent; None when the fence would have to fly and the link takes no rates.
        h_m: h_I: least distance to the fence along the flow of the backup controller, all margins off [m].
        share: of the set-point in what may be sent, from 0 to 1.
        takes_over: whether the backup controller flies.
    """

    setpoint: Setpoint | None
    h_m: float
    share: float
    takes_over: bool


def rates_model(vehicle: Vehicle) -> RacerModel:
    """A vehicle behind its rate loop: its map from throttle to thrust, or a straight one up to its rotors'.

    Raises:
        UsageError: it has no rotors.
    """
    if vehicle.rotors is None or vehicle.body.mass_kg is None:
        raise UsageError(f"{vehicle.name} is a {vehicle.model}; the geofence needs a quadrotor")
    most = sum(vehicle.rotors.max_thrust_n) / vehicle.body.mass_kg
    thrust = (0.0, most, 0.0) if vehicle.throttle is None else vehicle.throttle.acceleration_m_s2
    return RacerModel(
        gravity=vehicle.body.gravity_m_s2,
        thrust=thrust,
        rate_gain=1 / vehicle.rates.time_constant_s,
        max_rate=vehicle.rates.max_rad_s,
    )


class FenceGuard:
    """A geofence over set-points of any kind.

    Rates pass through it: u = lambda u_des + (1 - lambda) u_B. Of others it knows the state, and how far they
    can lead while a take-over is on its way; from h_I <= 0 of either on its backup controller flies by rates,
    until both are positive again; a link that takes no rates
    gets nothing then, and the flight is to be held.

    Args:
        fence: where to fly.
        vehicle: what flies; its radius is kept from the fence.
        dt_s: of a tick.
        takes_rates: whether the link does.
        reserve_m: kept beyond the radius, for what the model leaves out.
        latency_s: of state and command.

    Raises:
        UsageError: the fence or the numbers mean nothing to the geofence.
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
        most = self._model.thrust
        self._top = most[0] + most[1] + most[2]
        given = {"radius_m": self.radius_m, "tick_s": dt_s, "reserve_m": reserve_m, "latency_s": latency_s}
        try:
            self._filter = Geofence(fence, self._model, PARAMETERS | given)
        except (TypeError, ValueError) as error:
            raise UsageError(f"geofence: {error}") from error
        self._flies = False
        self._lead_s = latency_s + dt_s + max(vehicle.rates.time_constant_s, _LOOP_S)

    def reset(self) -> None:
        """To before the first tick."""
        self._filter.reset()
        self._flies = False

    def distance(self, state: VehicleState, least_m: float = -math.inf) -> float:
        """From the vehicle's sphere to the fence; negative outside [m].

        Below the height `least_m` it is taken to be there: so the sides and the top count, the bottom not.
        """
        x, y, z = state.position.tolist()
        z = least_m if z < least_m else z
        return self.fence.clearance((x, y, z), (x, y, z)) - self.radius_m

    def guard(self, state: VehicleState, age_s: float, setpoint: Setpoint) -> Guarded:
        """What may be sent instead of a set-point."""
        row = np.concatenate(
            [state.position + age_s * state.velocity, state.velocity, state.attitude_wxyz, state.omega]
        )
        if isinstance(setpoint, RatesSetpoint):
            pilot = np.array([self._model.throttle_for(setpoint.thrust_m_s2), *setpoint.omega])
            return self._answer(row, pilot, setpoint)
        values, _ = self._filter.evaluate(np.stack([row, self._led(row, setpoint)]))
        h = float(values[:, 0].min())  # what is not a number is no distance, and taken over
        if self._flies and h > _BACK_M:
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
        """Where a set-point leads before a take-over acts, as far as the vehicle can follow, shape (13,)."""
        if isinstance(setpoint, AccelerationSetpoint):
            change, fastest = setpoint.acceleration * self._lead_s, self._top
        else:  # who follows velocities leans by 45 degrees at most
            change, fastest = setpoint.velocity - row[3:6], self._model.gravity
        size, most = math.sqrt(float(change @ change)), fastest * self._lead_s
        if size > most:
            change = change * (most / size)
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
        made = RatesSetpoint(a + throttle * (b + throttle * c), command[1:])
        share = float(detail["lambda"]) if status == "blended" else 0.0
        return Guarded(made, h if math.isfinite(h) else -math.inf, share, takes_over=status != "blended")
