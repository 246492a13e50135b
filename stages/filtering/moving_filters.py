"""The filters of accelerations among moving obstacles; static obstacles are walls to them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.parameters.filter_options import (
    FILTERS,
    NATIVE_NAMES,
    NATIVE_VALUES,
    MovingFilterParameters,
)
from alula.stages.filtering.bridge import NativeFilter
from alula.stages.filtering.obstacles import union_of
from alula.stages.filtering.protocol import FilterWorld

WALL_FRACTION = 0.56
"""Fraction of the maximum acceleration that braking before a wall counts on.

Below 1 / sqrt(3), so that the box of accelerations contains what three walls at right angles require
together, in any orientation.
"""


def moving_filter(name: str, world: FilterWorld, given: Mapping[str, Any]) -> NativeFilter:
    """Build dr-acbf or one of the methods that it was compared with.

    Args:
        world: `parts` and the limits of the vehicle matter.
        given: some of `MovingFilterParameters`.

    Raises:
        UsageError: a parameter is unknown, of the wrong type or without meaning.
    """
    try:
        parameters = msgspec.convert(msgspec.to_builtins(dict(given)), MovingFilterParameters)
    except msgspec.ValidationError as error:
        raise UsageError(f"{name}: {error}") from error
    options = moving_options(world, parameters)
    try:
        native = _core.MovingSafety(
            _core.moving_filter(name.replace("-", "_"), options),
            union_of(world.parts, *world.parts),
            max_speed_m_s=world.max_speed_m_s,
            max_acceleration_m_s2=world.max_acceleration_m_s2,
            radius_m=options["radius_m"],
        )
    except (ValueError, OverflowError) as error:
        raise UsageError(f"{name}: {error}") from error
    return NativeFilter(native, msgspec.structs.asdict(parameters))


def moving_options(world: FilterWorld, parameters: MovingFilterParameters) -> dict[str, float]:
    """All options of the native filter by name: the parameters, and limits and time step of the vehicle.

    Args:
        world: `parts` and the limits of the vehicle matter.
    """
    largest = world.max_acceleration_m_s2
    options = {"wall_deceleration": WALL_FRACTION * largest} | native_options(parameters)
    options |= {
        "a_max": largest,
        "v_max": world.max_speed_m_s,
        "j_max": world.max_jerk_m_s3,
        "radius_m": world.keeps_m(*world.parts),
        "dt_s": world.dt_s,
    }
    return {key: float(value) for key, value in options.items()}


def native_options(parameters: MovingFilterParameters) -> dict[str, float]:
    """The parameters as options of `alula._core.moving_filter`.

    Args:
        parameters: of a scenario; what they leave to the vehicle is left out.

    Returns:
        Numbers by native name, those of a nested table with its name before theirs.
    """
    names, numbers = NATIVE_NAMES["dr-acbf"], NATIVE_VALUES["dr-acbf"]
    options: dict[str, float] = {}
    values: dict[str, Any] = msgspec.structs.asdict(parameters)
    for name, value in values.items():
        if isinstance(value, msgspec.Struct):
            options |= {f"{name}_{key}": float(own) for key, own in msgspec.structs.asdict(value).items()}
        elif value is not None:
            options[names.get(name, name)] = float(numbers[name][value] if name in numbers else value)
    return options


def _factory(name: str) -> Callable[[FilterWorld, Mapping[str, Any]], NativeFilter]:
    return lambda world, given: moving_filter(name, world, given)


MOVING_FILTERS = {name: _factory(name) for name, kind in FILTERS.items() if kind is MovingFilterParameters}
