"""The filters of accelerations and wrenches among ellipsoids, and among the hulls of a cover."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.parameters.filter_options import FILTERS, NATIVE_STRUCTS
from alula.schemas.parameters.filters.values import NativeStruct, complaint, defaults, entries
from alula.stages.filtering.bridge import NativeFilter
from alula.stages.filtering.obstacles import ellipsoid_index, union_of
from alula.stages.filtering.protocol import FilterWorld
from alula.stages.filtering.qp import clarabel_backend

_CLASSES: dict[str, Callable[..., _core.SafetyFilter]] = {
    "cone-di": _core.ConeDi,
    "cone-ecbf": _core.ConeEcbf,
    "cone-backup": _core.ConeBackup,
    "safer-splat": _core.SaferSplat,
    "shield": _core.ShieldFilter,
}
_POLICY = "backup_policy"  # the part of filters of wrenches that is their first argument
_CLARABEL = "clarabel"  # the solver that runs in Python
SHIELD = "shield"  # the filter that needs no ellipsoids, and the parameter that switches a shield on
SHIELD_MAP = "shield_map"
STEERS_AMONG_HULLS = ("cone-ecbf", "cone-backup", "safer-splat")  # whose rows take hulls of a cover
ELLIPSOIDS, HULLS, BOTH = "ellipsoids", "hulls", "both"  # its values
_PARTS = {
    ELLIPSOIDS: ("ellipsoids", "fence"),
    HULLS: ("hulls", "fence"),
    BOTH: ("ellipsoids", "hulls", "fence"),
}


def parameters_of(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """All parameters of a native filter: those given, else their defaults.

    Raises:
        UsageError: a parameter is unknown, of the wrong type or beyond its limits.
    """
    known = entries(FILTERS[name])
    for key, value in given.items():
        if key not in known:
            raise UsageError(f"{name}: unknown parameter {key!r}; it has {', '.join(sorted(known))}")
        if wrong := complaint(known[key], value):
            raise UsageError(f"{name}: {key} {wrong}")
    if given.get(SHIELD) is False and SHIELD_MAP in given and given[SHIELD_MAP] != ELLIPSOIDS:
        raise UsageError(f"{name}: {SHIELD_MAP} is for {SHIELD}=true")
    typed = {key: float(value) if known[key].type is float else value for key, value in given.items()}
    return defaults(FILTERS[name]) | typed


def certified_against(name: str, parameters: Mapping[str, Any]) -> str | None:
    """Obstacles that the shield of a filter certifies against; None for a filter without a shield."""
    if name not in _CLASSES or not parameters.get(SHIELD, name == SHIELD):
        return None
    return parameters.get(SHIELD_MAP)


def keeps_from_hulls(name: str, parameters: Mapping[str, Any], *, has_ellipsoids: bool) -> bool:
    """Return whether a filter keeps clear of the hulls of a cover, by its rows or its shield.

    Args:
        has_ellipsoids: False where the hulls are all obstacles.
    """
    return not has_ellipsoids or certified_against(name, parameters) in (HULLS, BOTH)


def _surroundings(
    name: str, world: FilterWorld, index: _core.EllipsoidIndex, against: str
) -> tuple[_core.ObstacleMap, float]:
    """The map that a shield certifies against, and the radius that it keeps clear of it [m]."""
    names = [name for name in _PARTS[against] if name in world.parts]
    if (given := union_of(world.parts, *names)) is not None:
        return given, world.keeps_m(*names)
    if against == ELLIPSOIDS:
        return _core.EllipsoidMap(index), index.radius
    if world.polytopes is None:
        raise UsageError(
            f"{name}: {SHIELD_MAP}={against} needs the hulls of a cover, and there is none: give the cover, "
            "and the scene as --scene"
        )
    hulls, radius_m = _core.HullMap(world.polytopes), world.keeps_m("hulls")
    if against == HULLS:
        return hulls, radius_m
    return _core.MapUnion([_core.EllipsoidMap(index), hulls]), max(index.radius, radius_m)


def _rows_of_hulls(
    name: str, world: FilterWorld, index: _core.EllipsoidIndex, parameters: Mapping[str, Any]
) -> dict[str, Any]:
    """Arguments that give a filter rows of the hulls, where it keeps clear of them."""
    sees = keeps_from_hulls(name, parameters, has_ellipsoids=len(index) > 0)
    if name not in STEERS_AMONG_HULLS or world.polytopes is None or not sees:
        return {}
    return {"near_map": _core.HullMap(world.polytopes), "near_radius_m": world.keeps_m("hulls")}


def _build(name: str, world: FilterWorld, parameters: Mapping[str, Any]) -> _core.SafetyFilter:
    """The filter itself, from all parameters."""
    given = {**parameters, "tick_s": world.dt_s, "motor_time_constant_s": world.motor_time_constant_s}
    given |= {
        "rate_time_constant_s": world.rate_time_constant_s,
        "max_rate_rad_s": world.max_rate_rad_s,
    }
    index = ellipsoid_index(None, 1.0, world.keeps_m(ELLIPSOIDS)) if world.index is None else world.index
    others: dict[str, Any] = {}
    if given.get("solver") == _CLARABEL:
        given["solver"] = "active-set"
        others = {"qp_backend": clarabel_backend}

    def options(part: NativeStruct, **nested: Any) -> Any:
        return getattr(_core, part.native)(**{key: given[key] for key in part.names}, **nested)

    own, *parts = NATIVE_STRUCTS[name]
    made = {part.argument: options(part) for part in parts}
    others |= _rows_of_hulls(name, world, index, given)
    if _POLICY not in made:
        return _CLASSES[name](index, options(own, **made), **others)
    if world.body is None:
        raise UsageError(f"{name} gives thrust and torque, and the vehicle is a point")
    policy = _core.BackupPolicy(world.body, given["policy"], made.pop(_POLICY))
    kept, radius_m = _surroundings(name, world, index, given[SHIELD_MAP])
    if name == SHIELD:
        return _CLASSES[name](policy, kept, radius_m, options(own, **made))
    return _CLASSES[name](policy, index, options(own, **made), map=kept, radius_m=radius_m, **others)


def _factory(name: str) -> Callable[[FilterWorld, Mapping[str, Any]], NativeFilter]:
    def make(world: FilterWorld, given: Mapping[str, Any]) -> NativeFilter:
        parameters = parameters_of(name, given)
        try:
            return NativeFilter(_build(name, world, parameters), parameters)
        except (ValueError, TypeError, OverflowError) as error:
            raise UsageError(f"{name}: {' '.join(str(error).split())[:300]}") from error

    return make


ELLIPSOID_FILTERS = {name: _factory(name) for name in _CLASSES}
