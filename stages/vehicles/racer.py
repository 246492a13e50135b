"""Racing drones and their geofence filter as native models, from vehicle files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from alula._core import Fence, Geofence, RacerModel, RacerOptions
from alula.schemas.errors import UsageError
from alula.schemas.scenarios.vehicle import Vehicle


def racer_model(vehicle: Vehicle) -> RacerModel:
    """The geofence's model of the drone: thrust by throttle, rates as a first-order lag.

    Args:
        vehicle: a quadrotor with a table `[throttle]`.

    Raises:
        UsageError: the vehicle has no map from throttle to thrust.
    """
    if vehicle.model != "quadrotor" or vehicle.throttle is None:
        raise UsageError(f"vehicle {vehicle.name}: `$.throttle`: flying by throttle and rates needs it")
    return RacerModel(
        gravity=vehicle.body.gravity_m_s2,
        thrust=vehicle.throttle.acceleration_m_s2,
        rate_gain=1 / vehicle.rates.tilting_s,
        max_rate=vehicle.rates.max_rad_s,
    )


def racer_options(vehicle: Vehicle, **changed: Any) -> RacerOptions:
    """Properties of the plant that the model does not have: the file's drag, wind, gusts, delay and sag.

    Args:
        vehicle: one that `racer_model` takes.
        changed: options by name that replace the file's, as `mass_scale`, `thrust_scale`, `rate_gain_scale`.

    Raises:
        UsageError: the vehicle has no map from throttle to thrust, wind has no drag to act through, or an
            option is unknown or out of range.
    """
    if vehicle.throttle is None or vehicle.body.mass_kg is None:
        raise UsageError(f"vehicle {vehicle.name}: `$.throttle`: flying by throttle and rates needs it")
    table = vehicle.disturbance
    options: dict[str, Any] = {
        "mass": vehicle.body.mass_kg,
        "delay_s": table.delay_s,
        "linear_drag": table.linear_drag_n_s_m,
        "quadratic_drag": table.quadratic_drag_n_s2_m2,
        "wind_m_s": table.wind_m_s,
        "gust_m_s": table.gust_m_s,
        "gust_time_s": table.gust_time_s,
        "sag_share": vehicle.throttle.sag_share,
        "sag_time_s": vehicle.throttle.sag_time_s,
    } | changed
    drag = (*options["linear_drag"], *options["quadratic_drag"])
    if not any(drag) and any((*options["wind_m_s"], *options["gust_m_s"])):
        raise UsageError("wind and gusts act through drag, but the drag is zero")
    try:
        return RacerOptions(**options)
    except (TypeError, ValueError) as error:
        raise UsageError(f"vehicle {vehicle.name}: {error}") from error


def geofence(vehicle: Vehicle, where: Fence, parameters: Mapping[str, float] | None = None) -> Geofence:
    """Onboard filter for a vehicle.

    Args:
        vehicle: one that `racer_model` takes; its radius is the default of `radius_m`.

    Raises:
        UsageError: the vehicle has no map from throttle to thrust, or a parameter is unknown or out of range.
    """
    given = {"radius_m": vehicle.body.radius_m} | dict(parameters or {})
    try:
        return Geofence(where, racer_model(vehicle), given)
    except (TypeError, ValueError) as error:
        raise UsageError(f"geofence: {error}") from error
