"""Racing drones and the geofence around them: native models, fences and filters from artifacts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alula._core import Fence, Geofence, RacerModel, RacerOptions
from alula.schemas.artifact import Artifact
from alula.schemas.errors import UsageError
from alula.schemas.vehicle import Vehicle
from alula.stages.clearance import hull_obstacles
from alula.stages.compression.hulls import Hulls
from alula.stages.compression.onboard.layout import encode_map

Point = tuple[float, float, float]


def racer_model(vehicle: Vehicle) -> RacerModel:
    """The drone as the geofence knows it: thrust by throttle, rates as a first-order lag.

    Raises:
        UsageError: the vehicle has no map from throttle to thrust.
    """
    if vehicle.model != "quadrotor" or vehicle.throttle is None:
        raise UsageError(f"vehicle {vehicle.name}: `$.throttle`: flying by throttle and rates needs it")
    return RacerModel(
        gravity=vehicle.body.gravity_m_s2,
        thrust=vehicle.throttle.acceleration_m_s2,
        rate_gain=1 / vehicle.rates.time_constant_s,
        max_rate=vehicle.rates.max_rad_s,
    )


def racer_options(vehicle: Vehicle, **changed: Any) -> RacerOptions:
    """What the plant does beside that: the file's drag, wind, gusts, delay and sag.

    Args:
        vehicle: one that `racer_model` takes.
        changed: options by name that replace the file's, as `mass_scale`, `thrust_scale`, `rate_gain_scale`.

    Raises:
        UsageError: the vehicle has no map from throttle to thrust, wind has no drag to act through, or an
            option means nothing.
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
        raise UsageError("wind and gusts act through drag, and there is none")
    try:
        return RacerOptions(**options)
    except (TypeError, ValueError) as error:
        raise UsageError(f"vehicle {vehicle.name}: {error}") from error


def fence(
    *,
    box: tuple[Point, Point] | None = None,
    faces: NDArray[np.float64] | None = None,
    cover: Artifact | None = None,
) -> Fence:
    """Where to fly: inside the box and the polytope, outside the hulls of the cover.

    Args:
        box: lower and upper corner [m].
        faces: shape (L, 4), rows (n, d) of the polytope {p : n . p <= d} with unit n [m].
        cover: an `alula/cover`, in metres; the filter flies around its onboard map, which contains each hull,
            and flights are judged by the hulls themselves.

    Raises:
        UsageError: there is nothing to stay in or out of.
        InfeasibleError, InputError, ArtifactError: the cover has no onboard map, see `encode_map`.
    """
    if box is None and faces is None and cover is None:
        raise UsageError("a fence needs a box, faces or a cover")
    image, keep_out = None, None
    if cover is not None:
        image, keep_out = encode_map(cover, indexed=True), hull_obstacles(Hulls.from_cover(cover))
    return Fence(
        box=box,
        faces=None if faces is None else np.ascontiguousarray(faces, np.float64),
        image=image,
        keep_out=keep_out,
    )


def geofence(vehicle: Vehicle, where: Fence, parameters: Mapping[str, float] | None = None) -> Geofence:
    """The onboard filter for a vehicle: its model, its radius, and parameters by name.

    Raises:
        UsageError: the vehicle has no map from throttle to thrust, or a parameter is unknown or out of range.
    """
    given = {"radius_m": vehicle.body.radius_m} | dict(parameters or {})
    try:
        return Geofence(where, racer_model(vehicle), given)
    except (TypeError, ValueError) as error:
        raise UsageError(f"geofence: {error}") from error
