"""The filters among ellipsoids that run natively."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from alula import _core
from alula.schemas.errors import UsageError
from alula.schemas.filter_options import FILTERS, PARTS
from alula.schemas.filters.values import Part, complaint, defaults, entries
from alula.stages.filtering.protocol import FilterStatus
from alula.stages.filtering.qp import clarabel_backend
from alula.stages.filtering.splat_protocol import (
    FlightState,
    InputKind,
    Nominal,
    SplatFilter,
    SplatFilterResult,
    SplatWorld,
)

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


class NativeSplatFilter:
    """A native filter behind the common protocol; `fly` takes `native` itself.

    Attributes:
        native: the filter.
        parameters: all of its parameters, defaults included.
    """

    def __init__(self, native: _core.SafetyFilter, parameters: Mapping[str, Any]) -> None:
        self.native = native
        self.parameters = dict(parameters)

    @property
    def kind(self) -> InputKind:
        """The kind of input that the filter returns."""
        return self.native.kind  # type: ignore[return-value]

    def __call__(self, state: FlightState, nominal: Nominal) -> SplatFilterResult:
        """Filter one tick; see `SplatFilter`."""
        report = self.native.filter(
            np.concatenate([state.position, state.sigma, state.velocity, state.omega]).tolist(),
            nominal.acceleration.tolist(),
            wrench=nominal.wrench.tolist(),
            thrust=state.thrust,
            thrust_rate=state.thrust_rate,
            nominal_thrust_rate=nominal.thrust_rate,
            nominal_thrust_acceleration=nominal.thrust_acceleration,
            position_error=nominal.position_error.tolist(),
            velocity_error=nominal.velocity_error.tolist(),
            reference_acceleration=nominal.reference_acceleration.tolist(),
            rotors=state.rotors,
        )
        return SplatFilterResult(
            u=np.array(report[self.kind]),
            status=FilterStatus(report["status"]),
            margin=report["margin"],
            active=report["active"],
            thrust_rate=report["thrust_rate"],
            infeasible=report["infeasible"],
            certified=report["certified"],
        )

    def reset(self) -> None:
        """Forget the flight before; see `SplatFilter`."""
        self.native.reset()


def _has_policy(name: str) -> bool:
    return any(part.argument == _POLICY for part in PARTS[name])


GUIDES = tuple(name for name in _CLASSES if not _has_policy(name))


def parameters_of(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """All parameters of a native filter: those given, else their defaults.

    Args:
        name: the filter.
        given: some of its parameters.

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
    """Obstacles that the shield of a filter certifies against; None for a filter without a shield.

    Args:
        name: the filter.
        parameters: all of its parameters.
    """
    if name not in _CLASSES or not parameters.get(SHIELD, name == SHIELD):
        return None
    return parameters.get(SHIELD_MAP)


def keeps_from_hulls(name: str, parameters: Mapping[str, Any], *, has_ellipsoids: bool) -> bool:
    """Return whether a filter keeps clear of the hulls of a cover, by its rows or its shield.

    Args:
        name: the filter.
        parameters: all of its parameters.
        has_ellipsoids: False where the hulls are all obstacles.
    """
    return not has_ellipsoids or certified_against(name, parameters) in (HULLS, BOTH)


def _surroundings(
    name: str, world: SplatWorld, parameters: Mapping[str, Any]
) -> tuple[_core.ObstacleMap, float]:
    """The map that a shield certifies against, and the radius that it keeps clear of it [m]."""
    if world.static is not None:
        return world.static, world.static_radius_m
    against = parameters[SHIELD_MAP]
    if against == ELLIPSOIDS:
        return _core.EllipsoidMap(world.index), world.index.radius
    if world.hulls is None:
        raise UsageError(
            f"{name}: {SHIELD_MAP}={against} needs the hulls of a cover, and there is none: give the cover, "
            "and the scene as --scene"
        )
    hulls = _core.HullMap(world.hulls)
    if against == HULLS:
        return hulls, world.hull_radius_m
    both = _core.MapUnion([_core.EllipsoidMap(world.index), hulls])
    return both, max(world.index.radius, world.hull_radius_m)


def _rows_of_hulls(name: str, world: SplatWorld, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments that give a filter rows of the hulls, where it keeps clear of them."""
    sees = keeps_from_hulls(name, parameters, has_ellipsoids=len(world.index) > 0)
    if name not in STEERS_AMONG_HULLS or world.hulls is None or not sees:
        return {}
    return {"near_map": _core.HullMap(world.hulls), "near_radius_m": world.hull_radius_m}


def _build(name: str, world: SplatWorld, parameters: Mapping[str, Any]) -> _core.SafetyFilter:
    """The filter itself, from all parameters."""
    given = {**parameters, "tick_s": world.dt_s, "motor_time_constant_s": world.motor_time_constant_s}
    given |= {
        "rate_time_constant_s": world.rate_time_constant_s,
        "max_rate_rad_s": world.max_rate_rad_s,
    }
    others: dict[str, Any] = {}
    if given.get("solver") == _CLARABEL:
        given["solver"] = "active-set"
        others = {"qp_backend": clarabel_backend}

    def options(part: Part, **nested: Any) -> Any:
        return getattr(_core, part.native)(**{key: given[key] for key in part.names}, **nested)

    own, *parts = PARTS[name]
    made = {part.argument: options(part) for part in parts}
    others |= _rows_of_hulls(name, world, given)
    if _POLICY not in made:
        return _CLASSES[name](world.index, options(own, **made), **others)
    policy = _core.BackupPolicy(world.body, given["policy"], made.pop(_POLICY))
    kept, radius_m = _surroundings(name, world, given)
    if name == SHIELD:
        return _CLASSES[name](policy, kept, radius_m, options(own, **made))
    return _CLASSES[name](policy, world.index, options(own, **made), map=kept, radius_m=radius_m, **others)


def _factory(name: str) -> Callable[[SplatWorld, Mapping[str, Any]], SplatFilter]:
    def make(world: SplatWorld, given: Mapping[str, Any]) -> SplatFilter:
        parameters = parameters_of(name, given)
        try:
            return NativeSplatFilter(_build(name, world, parameters), parameters)
        except (ValueError, TypeError, OverflowError) as error:
            raise UsageError(f"{name}: {' '.join(str(error).split())[:300]}") from error

    return make


SPLAT_FILTERS = {name: _factory(name) for name in _CLASSES}
