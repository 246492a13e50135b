"""Set-points: the commands sent to a vehicle, in the world frame with z up and the body frame x forward."""

from __future__ import annotations

from dataclasses import dataclass

from alula.schemas.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class RatesSetpoint:
    """Thrust per mass along body z [m/s^2] and body rates, shape (3,) [rad/s]."""

    thrust_m_s2: float
    omega: FloatArray


@dataclass(frozen=True, slots=True)
class AccelerationSetpoint:
    """Translational acceleration [m/s^2] with its reference velocity [m/s] and position [m] and the yaw.

    The three vectors have shape (3,) and are in the world frame.
    """

    acceleration: FloatArray
    velocity: FloatArray
    position: FloatArray
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class VelocitySetpoint:
    """Velocity, shape (3,), world frame [m/s], and yaw."""

    velocity: FloatArray
    yaw_rad: float


Setpoint = RatesSetpoint | AccelerationSetpoint | VelocitySetpoint
