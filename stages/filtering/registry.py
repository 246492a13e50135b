"""Filters by name: those of this package, then those of other packages through entry points."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import Any

from alula.schemas.errors import UsageError
from alula.stages.filtering.polytope_cbf import no_filter, polytope_cbf
from alula.stages.filtering.protocol import Filter, FilterFactory, World
from alula.stages.filtering.splat_filters import (
    HULLS,
    SHIELD,
    SHIELD_MAP,
    SPLAT_FILTERS,
    STEERS_AMONG_HULLS,
    certified_against,
    parameters_of,
)
from alula.stages.filtering.splat_protocol import SplatFilter, SplatFilterFactory, SplatWorld

ENTRY_POINTS = "alula.filters"
SPLAT_ENTRY_POINTS = "alula.splat_filters"
NO_FILTER = "none"
FLIES_AMONG_HULLS = (SHIELD, *STEERS_AMONG_HULLS)  # of the filters among ellipsoids, those that need none
_BUILT_IN: dict[str, FilterFactory] = {NO_FILTER: no_filter, "polytope-cbf": polytope_cbf}


def filter_names() -> list[str]:
    """All filters among the hulls of a cover; the built-in ones first."""
    return _names(_BUILT_IN, ENTRY_POINTS)


def splat_filter_names() -> list[str]:
    """All filters among the ellipsoids of a scene; the built-in ones first."""
    return _names({NO_FILTER: None, **SPLAT_FILTERS}, SPLAT_ENTRY_POINTS)


def _names(built_in: Mapping[str, Any], group: str) -> list[str]:
    others = {point.name for point in entry_points(group=group)} - built_in.keys()
    return [*built_in, *sorted(others)]


def make_filter(name: str, world: World, parameters: Mapping[str, Any]) -> Filter:
    """Build a filter; a package that provides one is imported only now.

    Its entry point in the group `alula.filters` names a callable (world, parameters) -> Filter.

    Raises:
        UsageError: there is no such filter, its package cannot be imported, or a parameter is wrong.
    """
    factory = _BUILT_IN.get(name) or _load(name, ENTRY_POINTS, filter_names())
    made: Filter = factory(world, parameters)
    return made


def make_splat_filter(name: str, world: SplatWorld, parameters: Mapping[str, Any]) -> SplatFilter | None:
    """Build a filter among ellipsoids; None for `none`.

    The entry point of another package in the group `alula.splat_filters` names a callable
    (world, parameters) -> SplatFilter.

    Raises:
        UsageError: there is no such filter, its package cannot be imported, or a parameter is wrong.
    """
    if name == NO_FILTER:
        return None
    factory: SplatFilterFactory = SPLAT_FILTERS.get(name) or _load(
        name, SPLAT_ENTRY_POINTS, splat_filter_names()
    )
    return factory(world, parameters)


def complete_parameters(
    name: str, given: Mapping[str, Any], *, has_ellipsoids: bool = True
) -> dict[str, Any]:
    """All parameters of a filter among ellipsoids, defaults included; of other packages' filters those given.

    Args:
        name: of the filter.
        given: some of its parameters.
        has_ellipsoids: False where the hulls of a cover are all obstacles; shields certify against them.

    Raises:
        UsageError: a parameter is unknown or of the wrong type, or the filter needs ellipsoids.
    """
    if not has_ellipsoids:
        if name not in FLIES_AMONG_HULLS:
            raise UsageError(
                f"{name} needs a scene, for its ellipsoids; in a cover alone a quadrotor flies behind "
                f"{', '.join(FLIES_AMONG_HULLS)}"
            )
        against = HULLS if certified_against(name, parameters_of(name, {}) | dict(given)) else None
        found = parameters_of(name, ({SHIELD_MAP: HULLS} if against else {}) | dict(given))
        if against and found[SHIELD_MAP] != HULLS:
            raise UsageError(
                f"{name}: {SHIELD_MAP}={found[SHIELD_MAP]} needs a scene, for its ellipsoids; in a cover "
                f"alone it is {HULLS}"
            )
        return found
    if name == NO_FILTER and given:
        raise UsageError("the filter none has no parameters")
    return parameters_of(name, given) if name in SPLAT_FILTERS else dict(given)


def _load(name: str, group: str, known: list[str]) -> Any:
    points = [point for point in entry_points(group=group) if point.name == name]
    if not points:
        raise UsageError(f"no filter is called {name!r}; known: {', '.join(known)}")
    try:
        return points[0].load()
    except (ImportError, AttributeError) as error:
        raise UsageError(f"filter {name!r} cannot be loaded from {points[0].value}: {error}") from error
