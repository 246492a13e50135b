"""`sim:` our own vehicle in real time, in this process: for rehearsals and tests without an autopilot.

sim:?vehicle=racer.toml&start=0,0,0&yaw=0&delay_ms=20&noise=1&battery_s=600&seed=0
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import msgspec
import numpy as np

from alula.schemas.errors import LinkError, UsageError
from alula.schemas.vehicle import DisturbanceTable, Vehicle, check_vehicle, read_vehicle
from alula.stages.flight.links.addresses import Address
from alula.stages.flight.links.options import LinkOptions
from alula.stages.flight.links.protocol import (
    Order,
    RatesSetpoint,
    Setpoint,
    VehicleState,
    VehicleStatus,
    VelocitySetpoint,
    check_height,
)
from alula.stages.flight.links.simulated_body import STEP_S, Body

_SILENCE_S = 0.3  # after which a set-point no longer counts, as GUID_TIMEOUT has it
_MOST_BEHIND_S = 0.25  # of real time that one poll catches up; more is left out
_CLIMB_M_S, _SINK_M_S = 1.0, 0.5
_HEIGHT_GAIN_PER_S, _PLACE_GAIN_PER_S = 1.5, 1.0
_HARD_M_S = 2.0  # of a touch-down
# Standard deviations at noise=1: what a good estimator indoors has.
_NOISE = {
    "position_noise_m": 0.005,
    "velocity_noise_m_s": 0.02,
    "attitude_noise_rad": 0.003,
    "rate_noise_rad_s": 0.01,
}
_OPTIONS = ("vehicle", "start", "yaw", "delay_ms", "noise", "battery_s", "seed")


def make_link(address: Address, options: LinkOptions) -> SimulatedLink:
    """The link for an address.

    Raises:
        UsageError: an option is unknown or means nothing.
        InputError: the vehicle's file cannot be read.
    """
    address.only(*_OPTIONS)
    if address.place:
        raise UsageError(f"sim:{address.place}: options follow after sim:?")
    if options.mocap is not None:
        raise UsageError("sim: knows where it is and takes no motion capture")
    given = address.options
    vehicle = read_vehicle(Path(given["vehicle"])) if "vehicle" in given else options.vehicle
    table = msgspec.structs.asdict(vehicle.disturbance)
    if "delay_ms" in given:
        table["delay_s"] = _number(given, "delay_ms", 0.0, 1000.0) * 1e-3
    if "noise" in given:
        share = _number(given, "noise", 0.0, 100.0)
        kinds = _NOISE if vehicle.model == "quadrotor" else dict(list(_NOISE.items())[:2])
        table |= {name: share * value for name, value in kinds.items()}
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
    """A `Link` to a vehicle that lives in `poll`, which flies it until now.

    It arms, takes off, holds and lands by itself, obeys set-points while `GUIDED`, holds its place 0.3 s
    after the last one, and stops its motors where it lands. There is no noise in what it does by itself:
    these modes use the true state.
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
        self._flown_s: float | None = None  # how far the vehicle's life has come
        self._begin_s = 0.0
        self._setpoint: tuple[float, Setpoint] | None = None
        self._place = body.position  # where it holds, or climbs to
        self._yaw = yaw_rad

    @property
    def accepts(self) -> frozenset[type[Setpoint]]:
        """Kinds of set-points that can be sent."""
        return self.body.accepts

    @property
    def state(self) -> VehicleState | None:
        """The newest one."""
        return self._state

    @property
    def status(self) -> VehicleStatus:
        """The same object always, brought up to date by `poll`."""
        return self._status

    def open(self, timeout_s: float) -> str:
        """Begin to live; returns what it is, in words."""
        self._flown_s = self._begin_s = self._options.clock()
        self._status.is_estimator_ready = True
        self.poll(self._flown_s)
        return f"simulated {self.vehicle.name}, a {self.vehicle.model}"

    def prepare(self) -> list[str]:
        """There is nothing to change."""
        return []

    def poll(self, now_s: float) -> None:
        """Fly until now."""
        if self._flown_s is None:
            raise LinkError("sim: was not opened")
        behind = now_s - self._flown_s
        if behind > _MOST_BEHIND_S:
            self._status.texts.append(f"simulation left out {behind - _MOST_BEHIND_S:.2f} s")
            self._flown_s = now_s - _MOST_BEHIND_S
        while self._flown_s + STEP_S <= now_s + 1e-9:
            self._flown_s += STEP_S
            self._live(self._flown_s)
        status = self._status
        status.heard_s = now_s
        status.landed = self.body.is_resting
        status.battery_share = max(0.0, 1.0 - (now_s - self._begin_s) / self._battery_s)
        measured = self.body.measured()
        if self._state is None or self._flown_s > self._state.received_s:
            self._state = VehicleState(self._flown_s, *measured)

    def send(self, setpoint: Setpoint, now_s: float) -> None:
        """Send a set-point; refuses (LinkError) what is not finite."""
        if type(setpoint) not in self.accepts:
            raise LinkError(f"a {self.vehicle.model} takes no {type(setpoint).__name__}")
        for field in dataclasses.fields(setpoint):
            values = np.asarray(getattr(setpoint, field.name), np.float64)
            if values.shape not in ((), (3,)) or not np.isfinite(values).all():
                raise LinkError(f"set-point refused: {field.name} is {values.tolist()}")
        self._setpoint = now_s, setpoint

    def order(self, order: Order, now_s: float, height_m: float = 0.0) -> None:
        """Tell it something; done or refused at once.

        Raises:
            LinkError: the height of a take-off makes no sense.
        """
        status = self._status
        if order is Order.NOTHING:
            return
        if order is Order.TAKE_OFF:
            check_height(height_m)
        if order is Order.DISARM and not self.body.is_resting:
            status.refusals.append((order, "it is in the air"))
        elif order in (Order.TAKE_OFF, Order.HOLD, Order.LAND) and not status.armed:
            status.refusals.append((order, "it is not armed"))
        else:
            self._do(order, height_m)

    def close(self) -> None:
        """End its life."""
        self._flown_s = None
        self._status.heard_s = None

    def _do(self, order: Order, height_m: float) -> None:
        status = self._status
        self._setpoint = None
        self._place = self.body.position
        if order is Order.DISARM:
            status.armed = False
        elif order is Order.LAND:
            status.mode, status.obeys = "LAND", False
        elif order is not Order.HOLD:
            status.mode, status.obeys = "GUIDED", True
            status.armed = status.armed or order is Order.ARM
            if order is Order.TAKE_OFF:
                self._place[2] += height_m

    def _live(self, now_s: float) -> None:
        status, was_resting = self._status, self.body.is_resting
        if not status.armed:  # which it is only at rest
            return
        self.body.step(self._wish(now_s))
        if self.body.is_resting and not was_resting:
            if self.body.impact_m_s > _HARD_M_S:
                status.texts.append(f"hit the floor at {self.body.impact_m_s:.1f} m/s")
            if status.mode == "LAND" or self.body.impact_m_s > _HARD_M_S:
                status.armed = False
            self._place = self.body.position

    def _wish(self, now_s: float) -> Setpoint:
        """The set-point that is flown: what was sent, or what the mode makes."""
        if self._setpoint is not None:
            sent_s, setpoint = self._setpoint
            if not isinstance(setpoint, RatesSetpoint):
                self._yaw = setpoint.yaw_rad
            if now_s - sent_s <= _SILENCE_S and self._status.obeys:
                return setpoint
            self._setpoint = None
            self._place = self.body.position
        away = self._place - self.body.position
        velocity = np.clip(_PLACE_GAIN_PER_S * away, -_CLIMB_M_S, _CLIMB_M_S)
        velocity[2] = min(max(_HEIGHT_GAIN_PER_S * away[2], -_CLIMB_M_S), _CLIMB_M_S)
        if self._status.mode == "LAND":
            velocity[2] = -_SINK_M_S
        return VelocitySetpoint(velocity, self._yaw)


def _number(given: dict[str, str], name: str, least: float, most: float) -> float:
    (value,) = _numbers(given[name], name, 1)
    if not least <= value <= most:
        raise UsageError(f"sim: {name}={given[name]}: between {least:g} and {most:g}")
    return value


def _numbers(text: str, name: str, count: int) -> list[float]:
    try:
        values = [float(each) for each in text.split(",")]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        raise UsageError(f"sim: {name}={text}: expected {count} number{'s' if count > 1 else ''}")
    return values
