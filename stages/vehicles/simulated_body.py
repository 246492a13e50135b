"""The body simulated by `sim:`: a rigid body with a rate loop, or a point, above the ground."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.scenarios.vehicle import Vehicle
from alula.stages.vehicles.bodies import plant, quadrotor, tracking_gains
from alula.stages.vehicles.ground import Footing, Ground
from alula.stages.vehicles.setpoints import AccelerationSetpoint, RatesSetpoint, Setpoint, VelocitySetpoint

STEP_S = 0.0025
_VELOCITY_GAIN_PER_S = 4.0  # from a velocity error to an acceleration
_MAX_M_S2 = 20.0


class Measured(NamedTuple):
    """The vehicle's own estimate: position, velocity, attitude (w, x, y, z), body rates."""

    position: FloatArray
    velocity: FloatArray
    attitude_wxyz: FloatArray
    omega: FloatArray


class Body:
    """The body of a vehicle file, resting or flying; `step` holds a set-point for 2.5 ms.

    A quadrotor follows rates by tau = omega x J omega + J (omega_set - omega) / tau_rate, with the values of
    the vehicle file and within the limits of its rotors; it follows accelerations and velocities through the
    geometric controller. A double integrator follows accelerations and velocities, a single integrator only
    velocities.

    Args:
        start: initial position, shape (3,), world frame [m]; it rests there, on a flat floor.

    Attributes:
        floor_m: height of the ground below it [m].
        is_resting: whether it is on the ground.
        impact_m_s: speed of the last touch-down [m/s].
    """

    def __init__(self, vehicle: Vehicle, start: FloatArray, yaw_rad: float, seed: int) -> None:
        self._vehicle = vehicle
        self.floor_m = float(start[2])
        self._footing: Footing | None = None
        self.is_resting, self.impact_m_s = True, 0.0
        self._x = np.zeros(12)
        self._x[:3] = start
        self._yaw = yaw_rad
        self._x[5] = math.tan(yaw_rad / 4)  # sigma = axis tan(angle / 4)
        self._has_rotors = vehicle.model == "quadrotor"
        self._plant = None if vehicle.model == "single-integrator" else plant(vehicle, seed=seed)
        if self._plant is not None:
            self._plant.reset(self._x)
        if self._has_rotors:
            self._quadrotor, self._gains = quadrotor(vehicle), tracking_gains(vehicle)
            assert vehicle.body.inertia_kg_m2 is not None
            self._inertia = np.array(vehicle.body.inertia_kg_m2)

    @property
    def accepts(self) -> frozenset[type[Setpoint]]:
        """Kinds of set-points that the model can follow."""
        if self._has_rotors:
            return frozenset({RatesSetpoint, AccelerationSetpoint, VelocitySetpoint})
        point: frozenset[type[Setpoint]] = frozenset({VelocitySetpoint})
        return point if self._plant is None else point | {AccelerationSetpoint}

    @property
    def position(self) -> FloatArray:
        """True position, shape (3,), world frame [m]."""
        return self._x[:3].copy()

    @property
    def velocity(self) -> FloatArray:
        """True velocity, shape (3,), world frame [m/s]."""
        return self._x[6:9].copy()

    @property
    def delay_s(self) -> float:
        """Age of the measured state [s]."""
        return 0.0 if self._plant is None else self._vehicle.disturbance.delay_s

    def stand_on(self, ground: Ground) -> None:
        """From now on have a ground in place of the flat floor; it stays at rest where it is."""
        self._footing = Footing(ground, self._x[:3])

    def measured(self) -> Measured:
        """State with the noise and delay of the vehicle file; the true state at rest."""
        x = self._x if self._plant is None or self.is_resting else np.asarray(self._plant.measured)
        if self._has_rotors:
            return Measured(x[:3].copy(), x[6:9].copy(), _quat_wxyz(x[3:6]), x[9:12].copy())
        half = 0.5 * self._yaw
        attitude = np.array([math.cos(half), 0.0, 0.0, math.sin(half)])
        return Measured(x[:3].copy(), x[6:9].copy(), attitude, np.zeros(3))

    def step(self, setpoint: Setpoint) -> None:
        """Follow a set-point for `STEP_S`; a vehicle at rest leaves the ground only with enough thrust."""
        if self._footing is not None and not self.is_resting:
            self.floor_m = self._footing.height(self._x[:3])
        if self._has_rotors:
            self._step_quadrotor(setpoint)
        else:
            self._step_point(setpoint)
        if self._x[2] < self.floor_m and self._x[8] < 0:
            self._touch_down()

    def _touch_down(self) -> None:
        self.impact_m_s = float(np.linalg.norm(self._x[6:9]))
        yaw = _yaw_of(_quat_wxyz(self._x[3:6]))
        position = [self._x[0], self._x[1], self.floor_m]
        self._x[:] = 0.0
        self._x[:3], self._x[5] = position, math.tan(yaw / 4)
        self.is_resting = True
        if self._plant is not None:
            self._plant.reset(self._x)

    def _step_quadrotor(self, setpoint: Setpoint) -> None:
        assert isinstance(self._plant, _core.Plant)
        wrench = self._wrench(setpoint)
        if self.is_resting:
            if wrench[0] <= self._quadrotor.hover_thrust * 1.01:
                return
            self.is_resting = False
        self._plant.step(STEP_S, wrench)
        self._x = np.array(self._plant.state)

    def _wrench(self, setpoint: Setpoint) -> FloatArray:
        x = self._x[None]
        if isinstance(setpoint, RatesSetpoint):
            max_rates = np.array(self._vehicle.rates.max_rad_s)
            rates, omega = np.clip(setpoint.omega, -max_rates, max_rates), self._x[9:12]
            gyroscopic = np.cross(omega, self._inertia * omega)
            torque = gyroscopic + self._inertia * (rates - omega) / np.array(self._vehicle.rates.axes_s)
            wrench = np.array([[self._quadrotor.mass * setpoint.thrust_m_s2, *torque]])
        else:
            reference = np.zeros((1, 18))
            command = self._acceleration(setpoint)[None]
            reference[0, :3], reference[0, 3:6], reference[0, 6:9] = self._x[:3], self._x[6:9], command
            reference[0, 15] = setpoint.yaw_rad
            wrench = _core.realise(self._quadrotor, self._gains, x, reference, command)
        return np.ascontiguousarray(self._quadrotor.limited(np.ascontiguousarray(wrench))[0])

    def _step_point(self, setpoint: Setpoint) -> None:
        assert not isinstance(setpoint, RatesSetpoint)
        if self.is_resting:
            up = setpoint.acceleration if isinstance(setpoint, AccelerationSetpoint) else setpoint.velocity
            if up[2] <= 0:
                return
            self.is_resting = False
        self._yaw = setpoint.yaw_rad
        if self._plant is None:
            self._x[6:9] = setpoint.velocity
            self._x[:3] += STEP_S * self._x[6:9]
            return
        assert isinstance(self._plant, _core.DoubleIntegrator)
        self._plant.step(STEP_S, self._acceleration(setpoint).tolist())
        self._x = np.array(self._plant.state)

    def _acceleration(self, setpoint: AccelerationSetpoint | VelocitySetpoint) -> FloatArray:
        if isinstance(setpoint, AccelerationSetpoint):
            command = np.asarray(setpoint.acceleration, np.float64)
        else:
            command = _VELOCITY_GAIN_PER_S * (np.asarray(setpoint.velocity) - self._x[6:9])
        return np.clip(command, -_MAX_M_S2, _MAX_M_S2)


def _quat_wxyz(sigma: FloatArray) -> FloatArray:
    """Quaternion of modified Rodrigues parameters, with w >= 0."""
    square = float(sigma @ sigma)
    quat = np.array([1 - square, *(2 * sigma)]) / (1 + square)
    return quat if quat[0] >= 0 else -quat


def _yaw_of(quat: FloatArray) -> float:
    w, x, y, z = quat.tolist()
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
