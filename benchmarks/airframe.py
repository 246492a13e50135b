"""Quadrotor body driven by the motor signals of a flight controller, and a cockpit that steps both together.

The body has the vehicle's mass, inertia, rotor positions and rotor directions. A motor signal m in [0, 1]
commands a quarter of the vehicle's thrust map at m, and thrust follows with a first-order lag. Sensors are
ideal.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from firmware import Firmware, FirmwareError
from numpy.typing import NDArray

from alula import _core
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.vehicles.bodies import quadrotor

FloatArray = NDArray[np.float64]
STEP_S = 0.00025  # of body and firmware: its PID loop runs at 4 kHz
LOOKS = 10  # steps per command: 400 Hz
TICK_S = STEP_S * LOOKS
IDLE = 0.055  # motor_idle: the signal at no throttle
ARM_AT_S, ARMED_S, TRIES = 6.0, 2.0, 5  # the firmware refuses for some seconds after power on
SETTLE_S = 0.5
ARMED, DISARMED = 1800, 1000  # [us] of the fifth channel
STANDING, STAND_FORCE = np.r_[np.zeros(6), 1.0, np.zeros(6)], (0.0, 0.0, 9.81)
SETTINGS = (
    "set small_angle = 180",
    "set runaway_takeoff_prevention = OFF",
    "set pid_process_denom = 2",
    "set rc_smoothing = OFF",
    "set rates_type = BETAFLIGHT",
    *(
        f"set {axis}_{name}"
        for axis in ("roll", "pitch", "yaw")
        for name in ("rc_rate = 100", "srate = 70", "expo = 0")
    ),
    "set p_yaw = 120",  # of 45: its propellers turn a light frame, not one of 0.9 kg
    "set i_yaw = 20",  # of 80
    "aux 0 0 0 1700 2100 0 0",
)


class Airframe:
    """The body in flight; a state is a row (13) of p, v, q wxyz, omega, as in the geofence."""

    def __init__(self, vehicle: Vehicle, motor_lag_s: float) -> None:
        assert vehicle.throttle is not None
        assert vehicle.body.mass_kg is not None
        self._body = quadrotor(vehicle)
        self._plant = _core.Plant(self._body, _core.PlantOptions(motor_time_constant_s=motor_lag_s))
        self._thrust = [a * vehicle.body.mass_kg / 4 for a in vehicle.throttle.acceleration_m_s2]
        self._mass = vehicle.body.mass_kg

    def reset(self, x: FloatArray) -> None:
        """Set the state, with rotors at hover thrust."""
        sigma = x[7:10] / (1 + x[6])
        self._plant.reset(np.concatenate([x[:3], sigma, x[3:6], x[10:]]))

    def step(self, motors: FloatArray) -> None:
        """Advance by `STEP_S` with motor signals in the order of the vehicle's rotors."""
        m = np.clip(motors, 0, 1)
        thrust = self._thrust[0] + m * (self._thrust[1] + m * self._thrust[2])
        self._plant.step(STEP_S, self._body.wrench(thrust[None])[0])

    def settle_attitude(self) -> None:
        """Keep the attitude parameters away from their singularity; call it between ticks."""
        self._plant.switch_shadow()

    @property
    def state(self) -> FloatArray:
        """The state (13)."""
        x = self._plant.state
        n = x[3:6] @ x[3:6]
        return np.concatenate([x[:3], x[6:9], [(1 - n) / (1 + n)], 2 / (1 + n) * x[3:6], x[9:]])

    @property
    def force(self) -> tuple[float, float, float]:
        """Specific force in the body [m/s^2]."""
        return 0.0, 0.0, self._plant.thrust / self._mass


def throttle_model(vehicle: Vehicle, rates: _core.Rates, rate_gain: float) -> _core.RacerModel:
    """Model of the vehicle behind the firmware: thrust by throttle stick, and rates that full sticks reach.

    The throttle t is the signal IDLE + (1 - IDLE) t of every motor, put into the vehicle's map a(m).
    """
    assert vehicle.throttle is not None
    a0, a1, a2 = vehicle.throttle.acceleration_m_s2
    rest = 1 - IDLE
    full = [float(rates.rate(axis, np.ones(1, np.float32))[0]) for axis in range(3)]
    return _core.RacerModel(
        gravity=vehicle.body.gravity_m_s2,
        thrust=(a0 + IDLE * (a1 + IDLE * a2), rest * (a1 + 2 * IDLE * a2), rest * rest * a2),
        rate_gain=rate_gain,
        max_rate=tuple(min(a, b) for a, b in zip(full, vehicle.rates.max_rad_s, strict=True)),
    )


class Cockpit:
    """An airframe and an armed firmware in lock-step."""

    def __init__(self, firmware: Firmware, airframe: Airframe, rates: _core.Rates) -> None:
        self._firmware, self._airframe, self._rates = firmware, airframe, rates
        self._origin_s, self._steps = 0.0, 0
        self.attempts = 0
        self.packets = 0

    def _feed(self, x: FloatArray, force: Sequence[float], until_s: float) -> None:
        self._firmware.send_state(x[10:], force, x[6:10])
        self._firmware.advance(until_s)

    def arm(self) -> None:
        """Wait on a stand until the firmware is ready, and arm it.

        Raises:
            FirmwareError: it does not turn the motors.
        """
        f = self._firmware
        while f.now_s < 1:  # no sockets yet
            f.advance(f.now_s + 0.01)
        for self.attempts in range(1, TRIES + 1):
            self._switch(DISARMED, max(ARM_AT_S, f.now_s + 1))
            if self._switch(ARMED, f.now_s + ARMED_S):
                return
        raise FirmwareError(f"the firmware did not arm in {TRIES} tries; the motors are at {f.motors}")

    def _switch(self, position: int, until_s: float) -> bool:
        """Hold the switch with the throttle down until all motors turn, or until a time."""
        f = self._firmware
        f.send_sticks([1500, 1500, 1000, 1500, position])
        while f.now_s < until_s:
            if position == ARMED and min(f.motors) > IDLE / 2:
                return True
            self._feed(STANDING, STAND_FORCE, f.now_s + 0.002)
        return False

    def start(self, x: FloatArray, command: FloatArray) -> None:
        """Hold the body at a state while the motors settle at a command; release it with rotors at hover."""
        f = self._firmware
        self.give(command)
        end = f.now_s + SETTLE_S
        while f.now_s < end:
            self._feed(x, STAND_FORCE, f.now_s + STEP_S)
        self._airframe.reset(x)
        self._origin_s, self._steps = f.now_s, 0
        self.packets = f.sent

    def give(self, command: FloatArray) -> FloatArray:
        """Set the sticks for a command (throttle, rates); return the command after rounding."""
        channels, refused = self._rates.channels(command[None])
        if refused[0]:
            raise FirmwareError(f"no sticks for {command}")
        self._firmware.send_sticks([*channels[0].tolist(), ARMED])
        return self._rates.commands(channels)[0][0]

    def steps(self) -> Iterator[FloatArray]:
        """Step through a tick and yield the state after each step."""
        f, a = self._firmware, self._airframe
        for _ in range(LOOKS):
            self._steps += 1
            self._feed(a.state, a.force, self._origin_s + self._steps * STEP_S)
            a.step(f.motors)
            yield a.state
        a.settle_attitude()

    @property
    def motors(self) -> FloatArray:
        """Signals of front right, rear right, rear left, front left."""
        return self._firmware.motors

    def motor_packets(self) -> int:
        """Number of motor packets since the start."""
        return self._firmware.sent - self.packets


@contextmanager
def configured() -> Iterator[Path]:
    """Yield a folder with the firmware's saved settings, for any number of runs.

    Raises:
        FirmwareError: the firmware did not accept its settings in any try.
    """
    with tempfile.TemporaryDirectory(prefix="alula-firmware-") as name:
        folder = Path(name)
        for left in reversed(range(TRIES)):  # its command line runs in another thread and may lose input
            try:
                with Firmware(folder) as firmware:
                    firmware.configure(SETTINGS)
                break
            except FirmwareError:
                (folder / "eeprom.bin").unlink(missing_ok=True)
                if left == 0:
                    raise
        yield folder
