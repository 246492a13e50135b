"""Native fence, filter, plant and pilot of a geofence scenario."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from alula import _core
from alula.schemas.arrays import FloatArray
from alula.schemas.decimals import exact
from alula.schemas.errors import UsageError
from alula.schemas.geofence import FenceScenario
from alula.schemas.vehicle import Vehicle
from alula.stages.compression.hulls import Hulls
from alula.stages.simulation.geofence.flights import FenceFlights
from alula.stages.vehicles.fence import KeepOut, fence, fence_faces, unit_faces
from alula.stages.vehicles.racer import racer_model, racer_options

# Native names of options that differ.
_PLANT_NAMES = {"linear_drag_n_s_m": "linear_drag", "quadratic_drag_n_s2_m2": "quadratic_drag"}

_RANDOM_PILOTS = ("sticks", "aggressive", "silent")


@dataclass(frozen=True, slots=True)
class FlownWorld:
    """Native scenario.

    Attributes:
        spec: plant, pilot, times, rule and start.
        filter: with its fence, which also judges.
        radius_m: of the vehicle.
        faces: of box and polytope together, shape (L, 4), rows (n, d) with unit n and n . p <= d inside.
        hulls: to stay out of; None without a cover.
        start_h_i_m: h_I of a fixed start; None with random starts, which all have one above 0.
        deviations: of the plant from the filter's model, in a few words each.
    """

    spec: FenceFlights
    filter: _core.Geofence
    radius_m: float
    faces: FloatArray
    hulls: Hulls | None
    start_h_i_m: float | None
    deviations: tuple[str, ...]


def native_world(scenario: FenceScenario, vehicle: Vehicle, keep_out: KeepOut | None) -> FlownWorld:
    """Make the native scenario, once for many threads.

    Args:
        scenario: all parameters.
        vehicle: that of the scenario's file.
        keep_out: cover to stay out of.

    Raises:
        UsageError: values are inconsistent; the message has the path of their key.
    """
    table = scenario.vehicle
    radius = vehicle.body.radius_m if table.radius_m is None else table.radius_m
    box = scenario.fence.box_m
    unit = unit_faces(scenario.fence.faces)
    where = fence(
        box=None if box is None else (box[:3], box[3:]), faces=unit if len(unit) else None, cover=keep_out
    )
    filter_ = _filter(scenario, vehicle, where, radius)
    start = start_state(scenario)
    start_h_i = None
    if start is not None:
        point = (float(start[0]), float(start[1]), float(start[2]))
        if (room := where.clearance(point, point) - radius) < 0:
            raise UsageError(f"`$.trials.start_m`: is {-room:.4g} m outside of the fence")
        try:
            start_h_i = float(filter_.evaluate(start[None])[0][0, 0])
        except ValueError as error:
            raise UsageError(f"`$.trials.start_m`: {error}") from error
    return FlownWorld(
        spec=_spec(scenario, vehicle, start),
        filter=filter_,
        radius_m=radius,
        faces=fence_faces(box, scenario.fence.faces),
        hulls=None if keep_out is None else keep_out.hulls,
        start_h_i_m=start_h_i,
        deviations=_deviations(scenario, vehicle),
    )


def is_random(scenario: FenceScenario, world: FlownWorld) -> bool:
    """Return whether flights of a scenario differ: by their start, the pilot, or gusts.

    Args:
        scenario: to fly.
        world: native scenario.
    """
    drawn = scenario.trials.start_m is None or scenario.pilot.kind in _RANDOM_PILOTS
    return drawn or "gust_m_s" in world.deviations


def _deviations(scenario: FenceScenario, vehicle: Vehicle) -> tuple[str, ...]:
    table = scenario.vehicle
    scales = {key: getattr(table, key) for key in ("mass_scale", "thrust_scale", "rate_gain_scale")}
    found = [f"{key} {exact(value)}" for key, value in scales.items() if value != 1]
    for key in ("delay_s", "linear_drag_n_s_m", "quadratic_drag_n_s2_m2", "wind_m_s", "gust_m_s"):
        value = getattr(table, key)
        value = getattr(vehicle.disturbance, key) if value is None else value
        if key == "delay_s" and value > scenario.filter.parameters.latency_s:
            found.append(f"delay_s {exact(value)} above latency_s")
        elif key != "delay_s" and any(value):
            found.append(key)
    sag = (
        table.sag_share
        if table.sag_share is not None or vehicle.throttle is None
        else vehicle.throttle.sag_share
    )
    return tuple(found + ([f"sag_share {exact(sag)}"] if sag else []))


def start_state(scenario: FenceScenario) -> FloatArray | None:
    """Fixed start, level: p, v, q wxyz, omega, shape (13,); None with random starts.

    Args:
        scenario: all parameters.
    """
    table = scenario.trials
    if table.start_m is None:
        return None
    half = math.radians(table.start_yaw_deg) / 2
    attitude = (math.cos(half), 0.0, 0.0, math.sin(half))
    return np.array([*table.start_m, *table.start_velocity_m_s, *attitude, 0.0, 0.0, 0.0])


def _filter(scenario: FenceScenario, vehicle: Vehicle, where: _core.Fence, radius_m: float) -> _core.Geofence:
    given = msgspec.to_builtins(scenario.filter.parameters)
    del given["alpha"]
    try:
        if scenario.filter.name != "geofence":  # it has no regulation function
            most_beta = _core.Geofence.conditions(racer_model(vehicle), given)["most_beta"]
            given["beta"] = min(given["beta"], most_beta)
        return _core.Geofence(where, racer_model(vehicle), given | {"radius_m": radius_m})
    except (TypeError, ValueError) as error:
        raise UsageError(f"`$.filter.parameters`, or the model of {vehicle.name}: {error}") from error


def _spec(scenario: FenceScenario, vehicle: Vehicle, start: FloatArray | None) -> FenceFlights:
    table, run, trials = scenario.pilot, scenario.run, scenario.trials
    values = msgspec.structs.asdict(scenario.vehicle)
    changed = {
        _PLANT_NAMES.get(key, key): value
        for key, value in values.items()
        if value is not None and key not in ("file", "radius_m")
    }
    try:
        options = racer_options(vehicle, **changed)
    except UsageError as error:
        raise UsageError(f"`$.vehicle`: {error}") from error
    pilot = _made(
        _core.Pilot,
        "pilot",
        kind=table.kind,
        heading_rad=math.radians(table.heading_deg),
        tilt_rad=math.radians(table.tilt_deg),
        climb_m_s2=table.climb_m_s2,
        silent_after_s=table.silent_after_s,
    )
    losses = _outage("", run.stale_from_s, run.stale_for_s)
    losses |= _outage("radio_", run.radio_from_s, run.radio_for_s)
    box = trials.start_box_m
    spec: FenceFlights = _made(
        FenceFlights,
        "trials",
        model=racer_model(vehicle),
        options=options,
        pilot=pilot,
        rule=scenario.filter.name,
        alpha_per_s=scenario.filter.parameters.alpha,
        duration_s=run.duration_s,
        plant_steps=run.plant_steps,
        losses=_core.Losses(**losses),
        start=start,
        start_box=None if box is None else (box[:3], box[3:]),
        start_speed_m_s=trials.start_speed_m_s,
        start_tilt_rad=math.radians(trials.start_tilt_deg),
    )
    return spec


def _outage(what: str, begins_s: float | None, lasts_s: float | None) -> dict[str, float]:
    if begins_s is None:
        return {}
    return {f"{what}from_s": begins_s, f"{what}for_s": math.inf if lasts_s is None else lasts_s}


def _made(native: Any, where: str, **values: Any) -> Any:
    try:
        return native(**values)
    except ValueError as error:
        raise UsageError(f"`$.{where}`: {error}") from error
