"""The filters of sticks: the geofence, which also keeps out of a cover, and backup-qp."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.parameters.filter_options import FILTERS, GeofenceParameters
from alula.stages.filtering.bridge import NativeFilter
from alula.stages.filtering.protocol import FilterWorld

_OUT_OF_COVERS = "geofence"


def fence_filter(name: str, world: FilterWorld, given: Mapping[str, Any]) -> NativeFilter:
    """Build the geofence, or backup-qp.

    Args:
        world: with a fence, or for the geofence with an image and its polytopes; and with a racer.
        given: some of `GeofenceParameters`.

    Raises:
        UsageError: a parameter is unknown, of the wrong type or without meaning, or there is no racer.
    """
    try:
        parameters = msgspec.convert({"tick_s": world.dt_s} | dict(given), GeofenceParameters)
    except msgspec.ValidationError as error:
        raise UsageError(f"{name}: {error}") from error
    keeps_out = name == _OUT_OF_COVERS
    native = native_geofence(name, world, parameters, has_regulation=keeps_out, keeps_out=keeps_out)
    try:
        made = _core.FenceFilter(native, None if keeps_out else parameters.alpha)
    except ValueError as error:
        raise UsageError(f"{name}: {error}") from error
    return NativeFilter(made, msgspec.structs.asdict(parameters))


def native_geofence(
    name: str, world: FilterWorld, parameters: GeofenceParameters, *, has_regulation: bool, keeps_out: bool
) -> _core.Geofence:
    """Build the native geofence of a filter, or of a judge.

    Args:
        world: with a racer.
        parameters: all but the radius.
        has_regulation: without a regulation function beta has no meaning; one that is too high is lowered.
        keeps_out: it also keeps out of the hulls of the cover, where the world has their image.

    Raises:
        UsageError: a parameter is without meaning, or there is no racer.
    """
    if world.racer is None:
        raise UsageError(f"{name}: flying by throttle and rates needs a vehicle with a table [throttle]")
    values = msgspec.structs.asdict(parameters)
    del values["alpha"]
    has_cover = keeps_out and bool(world.image)
    try:
        where = _core.Fence(
            box=world.fence_box,
            faces=np.ascontiguousarray(world.fence_faces) if len(world.fence_faces) else None,
            image=world.image if has_cover else None,
            keep_out=world.polytopes if has_cover else None,
        )
        if not has_regulation:
            values["beta"] = min(values["beta"], _core.Geofence.conditions(world.racer, values)["most_beta"])
        options = values | {"radius_m": world.keeps_m("fence")}
        return _core.Geofence(where, world.racer, options)
    except (ValueError, TypeError, OverflowError) as error:
        raise UsageError(f"{name}: {error}") from error


def _factory(name: str) -> Callable[[FilterWorld, Mapping[str, Any]], NativeFilter]:
    return lambda world, given: fence_filter(name, world, given)


FENCE_FILTERS = {name: _factory(name) for name, kind in FILTERS.items() if kind is GeofenceParameters}
