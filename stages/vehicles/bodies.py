"""Native bodies, plants and gains from a vehicle file."""

from __future__ import annotations

import math

from alula._core import (
    DoubleIntegrator,
    Plant,
    PlantOptions,
    Quadrotor,
    SensorOptions,
    TrackingGains,
)
from alula.schemas.errors import UsageError
from alula.schemas.scenarios.vehicle import Vehicle


def quadrotor(vehicle: Vehicle) -> Quadrotor:
    """Rigid body of the vehicle, the model of filters and controllers.

    Args:
        vehicle: a quadrotor.

    Raises:
        UsageError: the vehicle is no quadrotor, or its rotors cannot make every wrench.
    """
    if vehicle.model != "quadrotor" or vehicle.rotors is None:
        raise UsageError(f"{vehicle.name} is a {vehicle.model}; a quadrotor is needed")
    assert vehicle.body.mass_kg is not None
    assert vehicle.body.inertia_kg_m2 is not None
    x, y = zip(*vehicle.rotors.positions_m, strict=True)
    try:
        return Quadrotor(
            mass=vehicle.body.mass_kg,
            inertia=vehicle.body.inertia_kg_m2,
            rotor_x=x,
            rotor_y=y,
            spin=vehicle.rotors.spins,
            torque_ratio=vehicle.rotors.torque_ratio_m,
            f_min=vehicle.rotors.min_thrust_n,
            f_max=vehicle.rotors.max_thrust_n,
            gravity=vehicle.body.gravity_m_s2,
        )
    except ValueError as error:
        raise UsageError(f"vehicle {vehicle.name}: `$.rotors`: {error}") from error


def tracking_gains(vehicle: Vehicle, catch_up_m_s: float | None = None) -> TrackingGains:
    """Gains and limits of the geometric controller; of a double integrator those of the translation.

    Args:
        vehicle: quadrotor or double integrator.
        catch_up_m_s: speed above the reference's at which a delayed vehicle catches up [m/s]; default: the
            file's.
    """
    table = vehicle.tracking
    attitude, rate = vehicle.attitude_gains() if vehicle.model == "quadrotor" else ((0.0,) * 3, (0.0,) * 3)
    return TrackingGains(
        kp=table.kp_per_s2,
        kv=table.kv_per_s,
        k_r=attitude,
        k_omega=rate,
        catch_up_m_s=_or_infinity(table.catch_up_m_s if catch_up_m_s is None else catch_up_m_s),
        max_tilt_rad=_or_infinity(table.max_tilt_rad),
        max_thrust_share=_or_infinity(table.max_thrust_share),
        uses_acceleration=table.uses_acceleration,
    )


def sensor_options(vehicle: Vehicle) -> SensorOptions:
    """Noise and delay of measurements.

    Args:
        vehicle: quadrotor or double integrator.
    """
    table = vehicle.disturbance
    return SensorOptions(
        position_noise_m=table.position_noise_m,
        velocity_noise_m_s=table.velocity_noise_m_s,
        attitude_noise_rad=table.attitude_noise_rad,
        rate_noise_rad_s=table.rate_noise_rad_s,
        delay_s=table.delay_s,
    )


def plant_options(vehicle: Vehicle) -> PlantOptions:
    """Disturbances of a quadrotor.

    Args:
        vehicle: a quadrotor.
    """
    table = vehicle.disturbance
    return PlantOptions(
        motor_time_constant_s=table.motor_time_constant_s,
        linear_drag=table.linear_drag_n_s_m,
        quadratic_drag=table.quadratic_drag_n_s2_m2,
        wind_m_s=table.wind_m_s,
        gust_m_s=table.gust_m_s,
        gust_time_s=table.gust_time_s,
        sensor=sensor_options(vehicle),
    )


def plant(vehicle: Vehicle, *, seed: int = 0, trial: int = 0) -> Plant | DoubleIntegrator:
    """Simulated plant; noise and gusts are a function of seed, trial and step.

    Args:
        vehicle: quadrotor or double integrator.

    Raises:
        UsageError: the vehicle is a single integrator, which has no plant: its position follows the command.
    """
    if vehicle.model == "double-integrator":
        return DoubleIntegrator(
            max_acceleration_m_s2=_or_infinity(vehicle.limits.max_acceleration_m_s2),
            sensor=sensor_options(vehicle),
            seed=seed,
            trial=trial,
        )
    return Plant(quadrotor(vehicle), plant_options(vehicle), seed=seed, trial=trial)


def _or_infinity(value: float | None) -> float:
    return math.inf if value is None else value
