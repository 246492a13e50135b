"""The filters of sticks: the geofence, which also keeps out of a cover, and backup-qp."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import numpy as np

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.filter_options import FILTERS, GeofenceParameters
from alula.stages.filtering.bridge import NativeFilter
from alula.stages.filtering.protocol import FilterWorld

_OUT_OF_COVERS = "geofence"


def fence_filter(name: str, world: FilterWorld, given: Mapping[str, Any]) -> NativeFilter:
    """Build the geofence, or backup-qp.

    Args:
        name: of the filter.
        world: with a fence, or for the geofence with an image and its polytopes; and with a racer.
        given: some of `GeofenceParameters`.

    Raises:
        UsageError: a parameter is unknown, of the wrong type or without meaning, or there is no racer.
    """
    try:
        parameters = msgspec.convert({"tick_s": world.dt_s} | dict(given), GeofenceParameters)
    except msgspec.ValidationError as error:
        raise UsageError(f"{name}: {error}") from error
    if world.racer is None:
        raise UsageError(f"{name}: flying by throttle and rates needs a vehicle with a table [throttle]")
    values = msgspec.structs.asdict(parameters)
    alpha = values.pop("alpha")
    keeps_out = name == _OUT_OF_COVERS and bool(world.image)
    try:
        where = _core.Fence(
            box=world.fence_box,
            faces=np.ascontiguousarray(world.fence_faces) if len(world.fence_faces) else None,
            image=world.image if keeps_out else None,
            keep_out=world.polytopes if keeps_out else None,
        )
        if name != _OUT_OF_COVERS:  # it has no regulation function
            values["beta"] = min(values["beta"], _core.Geofence.conditions(world.racer, values)["most_beta"])
        options = values | {"radius_m": world.keeps(world.fence_radius_m)}
        native = _core.Geofence(where, world.racer, options)
        made = _core.FenceFilter(native, None if name == _OUT_OF_COVERS else alpha)
    except (ValueError, TypeError, OverflowError) as error:
        raise UsageError(f"{name}: {error}") from error
    return NativeFilter(made, msgspec.structs.asdict(parameters))


def _factory(name: str) -> Callable[[FilterWorld, Mapping[str, Any]], NativeFilter]:
    return lambda world, given: fence_filter(name, world, given)


FENCE_FILTERS = {name: _factory(name) for name, kind in FILTERS.items() if kind is GeofenceParameters}
