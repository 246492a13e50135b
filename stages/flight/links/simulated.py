"""`sim:`, a link to a vehicle simulated in this process in real time, for rehearsals and tests.

sim:?vehicle=racer.toml&start=0,0,0&yaw=0&delay_ms=20&noise=1&battery_s=600&seed=0
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import msgspec
import numpy as np

from alula.schemas.errors import LinkError, UsageError
from alula.schemas.scenarios.vehicle import DisturbanceTable, Vehicle, check_vehicle, read_vehicle
from alula.stages.flight.links.addresses import Address
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import Order, VehicleState, VehicleStatus, check_height
from alula.stages.vehicles.setpoints import RatesSetpoint, Setpoint, VelocitySetpoint
from alula.stages.vehicles.simulated_body import STEP_S, Body

_SILENCE_S = 0.3  # a set-point expires after this time, as with GUID_TIMEOUT
_MAX_BEHIND_S = 0.25  # real time that one poll catches up; more is skipped
_CLIMB_M_S, _SINK_M_S = 1.0, 0.5
_HEIGHT_GAIN_PER_S, _POSITION_GAIN_PER_S = 1.5, 1.0
_HARD_M_S = 2.0  # a faster touch-down stops the motors
# Standard deviations at noise=1, those of a good estimator indoors.
_NOISE = {
    "position_noise_m": 0.005,
    "velocity_noise_m_s": 0.02,
    "attitude_noise_rad": 0.003,
    "rate_noise_rad_s": 0.01,
}
_OPTIONS = ("vehicle", "start", "yaw", "delay_ms", "noise", "battery_s", "seed")


def make_link(address: Address, options: LinkOptions) -> SimulatedLink:
    """Make the link for an address `sim:?name=value&...`.

    Args:
        options: options of the link; `mocap` must be None.

    Raises:
        UsageError: an option is unknown or has an invalid value.
        InputError: the vehicle file cannot be read.
    """
    address.only(*_OPTIONS)
    if address.place:
        raise UsageError(f"sim:{address.place}: write the options after sim:?")
    if options.mocap is not None:
        raise UsageError("sim: does not use motion capture; leave it out")
    given = address.options
    vehicle = read_vehicle(Path(given["vehicle"])) if "vehicle" in given else options.vehicle
    table = msgspec.structs.asdict(vehicle.disturbance)
    if "delay_ms" in given:
        table["delay_s"] = _number(given, "delay_ms", 0.0, 1000.0) * 1e-3
    if "noise" in given:
        scale = _number(given, "noise", 0.0, 100.0)
        kinds = _NOISE if vehicle.model == "quadrotor" else dict(list(_NOISE.items())[:2])
        table |= {name: scale * value for name, value in kinds.items()}
    if "delay_ms" in given or "noise" in given:
        vehicle = msgspec.structs.replace(vehicle, disturbance=DisturbanceTable(**table))
    check_vehicle(vehicle)
    start = _numbers(given.get("start", "0,0,0"), "start", 3)
    (yaw,) = _numbers(given.get("yaw", "0"), "yaw", 1)
    battery_s = _number(given, "battery_s", 1.0, 1e6) if "battery_s" in given else 600.0
    seed = round(_number(given, "seed", 0, 2**31)) if "seed" in given else 0
    return SimulatedLink(
        vehicle, Body(vehicle, np.array(start), yaw, seed), options, yaw_rad=yaw, battery_s=battery_s
    )


class SimulatedLink:
    """A `Link` to a vehicle that `poll` simulates up to the present time.

    The vehicle arms, takes off, holds and lands by itself. It follows set-points while its mode is `GUIDED`,
    holds its position 0.3 s after the last one, and stops its motors after landing. Its own modes use the
    true state, without noise.
    """

    def __init__(
        self, vehicle: Vehicle, body: Body, options: LinkOptions, *, yaw_rad: float, battery_s: float
    ) -> None:
        self.vehicle, self.body = vehicle, body
        self._options, self._battery_s = options, battery_s
        self._status = VehicleStatus(
            armed=False, landed=True, mode="STANDBY", battery_share=1.0, is_estimator_ready=False
        )
        self._state: VehicleState | None = None
        self._flown_s: float | None = None  # simulated up to this time
        self._begin_s = 0.0
        self._setpoint: tuple[float, Setpoint] | None = None
        self._goal = body.position  # position that it holds or climbs to
        self._yaw = yaw_rad

    @property
    def accepts(self) -> frozenset[type[Setpoint]]:
        """Kinds of set-points that can be sent."""
        return self.body.accepts

    @property
    def state(self) -> VehicleState | None:
        """The newest state; None before `open`."""
        return self._state

    @property
    def status(self) -> VehicleStatus:
        """The status, always the same object; `poll` updates it."""
        return self._status

    def open(self, timeout_s: float) -> str:
        """Make the ground and start the simulation; returns a description of the vehicle."""
        if self._options.ground is not None:
            self.body.stand_on(self._options.ground())
        self._flown_s = self._begin_s = self._options.clock()
        self._status.is_estimator_ready = True
        self.poll(self._flown_s)
        return f"simulated {self.vehicle.name}, a {self.vehicle.model}"

    def prepare(self) -> list[str]:
        """Return no lines: this link changes no parameters."""
        return []

    def poll(self, now_s: float) -> None:
        """Simulate up to `now_s` and update state and status."""
        if self._flown_s is None:
            raise LinkError("sim: was not opened")
        behind = now_s - self._flown_s
        if behind > _MAX_BEHIND_S:
            self._status.texts.append(f"simulation skipped {behind - _MAX_BEHIND_S:.2f} s")
            self._flown_s = now_s - _MAX_BEHIND_S
        while self._flown_s + STEP_S <= now_s + 1e-9:
            self._flown_s += STEP_S
            self._step(self._flown_s)
        status = self._status
        status.heard_s = now_s
        status.landed = self.body.is_resting
        status.battery_share = max(0.0, 1.0 - (now_s - self._begin_s) / self._battery_s)
        measured = self.body.measured()
        if self._state is None or self._flown_s > self._state.received_s:
            self._state = VehicleState(self._flown_s, *measured, latency_s=self.body.delay_s)

    def send(self, setpoint: Setpoint, now_s: float) -> None:
        """Follow a set-point from now on.

        Raises:
            LinkError: the vehicle's model does not take its kind, or a field is not finite.
        """
        if type(setpoint) not in self.accepts:
            raise LinkError(f"a {self.vehicle.model} takes no {type(setpoint).__name__}")
        for field in dataclasses.fields(setpoint):
            values = np.asarray(getattr(setpoint, field.name), np.float64)
            if values.shape not in ((), (3,)) or not np.isfinite(values).all():
                raise LinkError(f"set-point refused: {field.name} is {values.tolist()}")
        self._setpoint = now_s, setpoint

    def order(self, order: Order, now_s: float, height_m: float = 0.0) -> None:
        """Execute or refuse a command at once.

        Args:
            height_m: take-off height above the present position [m].

        Raises:
            LinkError: the height of a take-off is out of range.
        """
        status = self._status
        if order in (Order.NOTHING, Order.SETTLE):
            return
        if order is Order.TAKE_OFF:
            check_height(height_m)
        if order in (Order.DISARM, Order.STOP) and not self.body.is_resting:
            status.refusals.append((order, "it is in the air"))
        elif order in (Order.TAKE_OFF, Order.HOLD, Order.LAND) and not status.armed:
            status.refusals.append((order, "it is not armed"))
        else:
            self._do(order, height_m)

    def close(self) -> None:
        """End the simulation."""
        self._flown_s = None
        self._status.heard_s = None

    def _do(self, order: Order, height_m: float) -> None:
        status = self._status
        self._setpoint = None
        self._goal = self.body.position
        if order in (Order.DISARM, Order.STOP):
            status.armed = False
        elif order is Order.LAND:
            status.mode, status.obeys = "LAND", False
        elif order is not Order.HOLD:
            status.mode, status.obeys = "GUIDED", True
            status.armed = status.armed or order is Order.ARM
            if order is Order.TAKE_OFF:
                self._goal[2] += height_m

    def _step(self, now_s: float) -> None:
        status, was_resting = self._status, self.body.is_resting
        if not status.armed:  # it is disarmed only at rest
            return
        self.body.step(self._flown_setpoint(now_s))
        if self.body.is_resting and not was_resting:
            if self.body.impact_m_s > _HARD_M_S:
                status.texts.append(f"hit the ground at {self.body.impact_m_s:.1f} m/s")
            if status.mode == "LAND" or self.body.impact_m_s > _HARD_M_S:
                status.armed = False
            self._goal = self.body.position

    def _flown_setpoint(self, now_s: float) -> Setpoint:
        """The set-point that is flown: the one that was sent, or the one that the mode computes."""
        if self._setpoint is not None:
            sent_s, setpoint = self._setpoint
            if not isinstance(setpoint, RatesSetpoint):
                self._yaw = setpoint.yaw_rad
            if now_s - sent_s <= _SILENCE_S and self._status.obeys:
                return setpoint
            self._setpoint = None
            self._goal = self.body.position
        error = self._goal - self.body.position
        velocity = np.clip(_POSITION_GAIN_PER_S * error, -_CLIMB_M_S, _CLIMB_M_S)
        velocity[2] = min(max(_HEIGHT_GAIN_PER_S * error[2], -_CLIMB_M_S), _CLIMB_M_S)
        if self._status.mode == "LAND":
            velocity[2] = -_SINK_M_S
        return VelocitySetpoint(velocity, self._yaw)


def _number(given: dict[str, str], name: str, minimum: float, maximum: float) -> float:
    (value,) = _numbers(given[name], name, 1)
    if not minimum <= value <= maximum:
        raise UsageError(f"sim: {name}={given[name]}: must be between {minimum:g} and {maximum:g}")
    return value


def _numbers(text: str, name: str, count: int) -> list[float]:
    try:
        values = [float(each) for each in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise UsageError(f"sim: {name}={text}: expected {count} number{'s' if count > 1 else ''}")
    return values
