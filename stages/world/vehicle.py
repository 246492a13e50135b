"""Vehicle of a scenario as a native specification: as modelled, and as it truly is."""

from __future__ import annotations

import math
from typing import Any

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.scenarios.scenario import Scenario
from alula.schemas.scenarios.tables import VehicleTable
from alula.schemas.scenarios.vehicle import FASTBRIDGE, Vehicle
from alula.schemas.scenarios.vehicles import CATCH_UP_FACTOR
from alula.stages.vehicles.bodies import quadrotor, tracking_gains
from alula.stages.vehicles.following import following_options
from alula.stages.vehicles.racer import racer_model, racer_options
from alula.stages.vehicles.velocity_lag import filter_lags_s

_SQRT_3 = math.nextafter(math.sqrt(3), 2.0)
_NOISE = ("position_noise_m", "velocity_noise_m_s", "attitude_noise_rad", "rate_noise_rad_s", "delay_s")
_AIR = ("linear_drag_n_s_m", "quadratic_drag_n_s2_m2", "wind_m_s", "gust_m_s", "gust_time_s")
_NATIVE = {"linear_drag_n_s_m": "linear_drag", "quadratic_drag_n_s2_m2": "quadratic_drag"}
_SCALES = ("mass_scale", "thrust_scale", "rate_gain_scale")


def vehicle_spec(
    scenario: Scenario,
    vehicle: Vehicle,
    *,
    peak_m_s: float,
    max_speed_m_s: float,
    lag_s: tuple[float, float, float],
) -> _core.VehicleSpec:
    """Make the native vehicle.

    A true thrust that differs from the model's acts as a mass that differs inversely, which is exact without
    drag; a racer has both.

    Args:
        peak_m_s: peak speed of the references [m/s].
        max_speed_m_s: limit of velocity commands, and of a point's speed [m/s].
        lag_s: see `velocity_lags_s` [s].

    Raises:
        UsageError: values are inconsistent; the message has the path of their key.
    """
    table, known = scenario.vehicle, scenario.estimation
    own = table.disturbance
    air = {_NATIVE.get(key, key): getattr(own, key) for key in _AIR}
    sensor = {key: getattr(known, key) for key in _NOISE}
    sensor["noise_time_s"] = known.noise_time_s
    lag = own.motor_time_constant_s or 0.0
    given = known_vehicle(scenario, vehicle, peak_m_s=peak_m_s, max_speed_m_s=max_speed_m_s, lag_s=lag_s) | {
        "model": vehicle.model,
        "plant": _core.PlantOptions(
            motor_time_constant_s=lag,
            sensor=_core.SensorOptions(**{key: value for key, value in sensor.items() if value is not None}),
            **{key: value for key, value in air.items() if value is not None},
        ),
        "rate_gain_scale": table.rate_gain_scale,
        "radius_m": table.radius_m,
        "mass_scale": table.mass_scale / table.thrust_scale,
    }
    if table.velocity_gain_per_s is not None:
        given["velocity_gain_per_s"] = table.velocity_gain_per_s
    if table.autopilot:
        given["following"] = following_options(vehicle)
    if table.max_acceleration_m_s2 is not None:
        given["max_acceleration_m_s2"] = table.max_acceleration_m_s2
    if table.max_jerk_m_s3 is not None:
        given |= {"max_jerk_m_s3": table.max_jerk_m_s3, "actuation_delay_s": table.actuation_delay_s or 0.0}
    if vehicle.throttle is not None:
        given["racer"] = racer_model(vehicle)
    if table.interface == "sticks":
        given["model"] = "racer"
        changed = {key: getattr(table, key) for key in _SCALES}
        changed |= {_NATIVE.get(key, key): getattr(own, key) for key in (*_AIR, "sag_share", "sag_time_s")}
        changed["delay_s"] = known.delay_s
        try:
            given["racer_options"] = racer_options(
                vehicle, **{key: value for key, value in changed.items() if value is not None}
            )
        except UsageError as error:
            raise UsageError(f"`$.vehicle`: {error}") from error
        given["plant"] = _core.PlantOptions()  # the racer has its own delay, and its pilot sees the truth
    try:
        return _core.VehicleSpec(body_of(vehicle), **given)
    except (TypeError, ValueError) as error:
        raise UsageError(f"`$.vehicle`: {error}") from error


def known_vehicle(
    scenario: Scenario,
    vehicle: Vehicle,
    *,
    peak_m_s: float,
    max_speed_m_s: float,
    lag_s: tuple[float, float, float],
) -> dict[str, Any]:
    """What the computer on board knows of the vehicle, as arguments of `_core.VehicleSpec`.

    Args:
        peak_m_s: peak speed of the references [m/s].
        max_speed_m_s: limit of velocity commands [m/s].
        lag_s: see `velocity_lags_s` [s].
    """
    table = scenario.vehicle
    return {
        "interface": table.interface,
        "gains": controller_gains(scenario, vehicle, peak_m_s),
        "assumed": _core.ActuatorModel(
            motor_time_constant_s=table.assumed.motor_time_constant_s or 0.0,
            delay_s=table.assumed.delay_s or 0.0,
        ),
        "max_rate_rad_s": vehicle.rates.max_rad_s,
        "rate_time_constant_s": vehicle.rates.axes_s,
        "max_speed_m_s": max_speed_m_s,
        "velocity_lag_s": lag_s,
    }


def body_of(vehicle: Vehicle) -> _core.Quadrotor:
    """Rigid body of a quadrotor; any for a point, whose controller and filters use only the translation.

    Raises:
        UsageError: the rotors of the quadrotor cannot make every wrench.
    """
    return quadrotor(vehicle if vehicle.model == "quadrotor" else FASTBRIDGE)


def controller_gains(scenario: Scenario, vehicle: Vehicle, peak_m_s: float) -> _core.TrackingGains:
    """Gains of the tracking controller, with its speed to catch up; a single integrator has none.

    Args:
        peak_m_s: peak speed of the references [m/s].
    """
    if vehicle.model == "single-integrator":
        return _core.TrackingGains()
    return tracking_gains(vehicle, catch_up_m_s(vehicle, peak_m_s, scenario.mission.controller.catch_up_m_s))


def velocity_lags_s(scenario: Scenario, vehicle: Vehicle, max_speed_m_s: float) -> tuple[float, float, float]:
    """Lags along x, y, z that filters of velocities assume, with an autopilot as in `fly` [s].

    Args:
        max_speed_m_s: limit of velocity commands [m/s].
    """
    table = scenario.vehicle
    if table.autopilot and table.velocity_lag_s is None:
        return filter_lags_s(vehicle.following, max_speed_m_s)
    lag = table.velocity_lag_s or 0.0
    return lag, lag, lag


def catch_up_m_s(vehicle: Vehicle, peak_m_s: float, given: float | None = None) -> float:
    """Speed above the reference's at which a delayed vehicle catches up [m/s].

    Args:
        vehicle: its value counts where none is given; without either, half of the peak speed.
        peak_m_s: peak speed of the references [m/s].
        given: by the user, if so [m/s].
    """
    return given or vehicle.tracking.catch_up_m_s or CATCH_UP_FACTOR * peak_m_s


def box_of_accelerations(vehicle: Vehicle, table: VehicleTable) -> float:
    """Largest |a| per axis that a vehicle can fly in all directions at once [m/s^2].

    Of a quadrotor: for every a with |a_i| at most this, the force m (a + g e3) is within the largest thrust
    and the largest tilt of its controller; rounded down to 1 %. Of a point whose limit is that of the length
    of its acceleration: the limit over sqrt(3).
    """
    limit_m_s2 = table.max_acceleration_m_s2
    if vehicle.model != "quadrotor" or vehicle.rotors is None:
        most = 6.0 if limit_m_s2 is None else limit_m_s2
        # of each axis where the speed or the jerk has a limit too: see has_inner_limits
        by_axis = table.max_jerk_m_s3 is not None or table.max_speed_m_s is not None
        return most if by_axis or vehicle.model != "double-integrator" else most / _SQRT_3
    assert vehicle.body.mass_kg is not None
    tracking, g = vehicle.tracking, vehicle.body.gravity_m_s2
    thrust = (tracking.max_thrust_share or 1.0) * sum(vehicle.rotors.max_thrust_n) / vehicle.body.mass_kg
    slope = math.tan(min(tracking.max_tilt_rad or 1.2, 1.5))

    def is_flown(a: float) -> bool:
        sideways = math.sqrt(2) * a
        return math.hypot(sideways, g + a) <= thrust and sideways <= slope * (g - a)

    low, high = 0.0, g
    while high - low > 0.01 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if is_flown(middle) else (low, middle)
    return low if limit_m_s2 is None else min(low, limit_m_s2)
