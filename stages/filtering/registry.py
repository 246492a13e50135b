"""Filters by name: those of this package, then those of other packages through entry points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from alula.schemas.errors import UsageError
from alula.schemas.parameters.flight_defaults import NO_FILTER
from alula.schemas.parameters.foreign_filters import foreign_filter, foreign_names, kind_of
from alula.schemas.scenarios.check import FILTER_COMMANDS
from alula.schemas.scenarios.tables import default_shield_map
from alula.stages.filtering.ellipsoid_filters import (
    ELLIPSOID_FILTERS,
    HULLS,
    SHIELD,
    SHIELD_MAP,
    STEERS_AMONG_HULLS,
    certified_against,
    parameters_of,
)
from alula.stages.filtering.fence_filters import FENCE_FILTERS
from alula.stages.filtering.moving_filters import MOVING_FILTERS
from alula.stages.filtering.polytope_cbf import polytope_cbf
from alula.stages.filtering.protocol import FilterFactory, FilterWorld, SafetyFilter

FLIES_AMONG_HULLS = (SHIELD, *STEERS_AMONG_HULLS)  # of the filters among ellipsoids, those that need none
_BUILT_IN: dict[str, FilterFactory] = {"polytope-cbf": polytope_cbf}
_BUILT_IN |= ELLIPSOID_FILTERS | MOVING_FILTERS | FENCE_FILTERS


def filter_names() -> list[str]:
    """All filters; `none` and the built-in ones first."""
    own = [NO_FILTER, *_BUILT_IN]
    return [*own, *(name for name in foreign_names() if name not in own)]


def filter_kind(name: str) -> str:
    """The kind of command that a filter takes and gives; a package that provides one is imported only now.

    Args:
        name: not `none`.

    Raises:
        UsageError: there is no such filter, its package cannot be imported, or it does not say its kind.
    """
    return FILTER_COMMANDS[name] if name in FILTER_COMMANDS else kind_of(name, _factory(name))


def make_filter(name: str, world: FilterWorld, parameters: Mapping[str, Any]) -> SafetyFilter | None:
    """Build a filter; None for `none`. A package that provides one is imported only now.

    Its entry point in the group `alula.filters` names a callable (world, parameters) -> SafetyFilter with an
    attribute `kind`, such as a class.

    Raises:
        UsageError: there is no such filter, its package cannot be imported, the world lacks what it needs, or
            a parameter is wrong.
    """
    if name == NO_FILTER:
        return None
    return _factory(name)(world, parameters)


def _factory(name: str) -> FilterFactory:
    found: FilterFactory = _BUILT_IN.get(name) or foreign_filter(name, filter_names())
    return found


def complete_parameters(
    name: str, given: Mapping[str, Any], *, has_ellipsoids: bool = True, has_hulls: bool = False
) -> dict[str, Any]:
    """All parameters of a filter among ellipsoids, defaults included; of other packages' filters those given.

    Args:
        has_ellipsoids: False where the hulls of a cover are all obstacles.
        has_hulls: whether the flight has hulls. Shields certify against all that the flight has.

    Raises:
        UsageError: a parameter is unknown or of the wrong type, or the filter needs ellipsoids.
    """
    if not has_ellipsoids and name not in FLIES_AMONG_HULLS:
        raise UsageError(
            f"{name} needs a scene, for its ellipsoids; in a cover alone a quadrotor flies behind "
            f"{', '.join(FLIES_AMONG_HULLS)}"
        )
    if name == NO_FILTER and given:
        raise UsageError("the filter none has no parameters")
    if name not in ELLIPSOID_FILTERS:
        return dict(given)
    if not certified_against(name, parameters_of(name, {}) | dict(given)):
        return parameters_of(name, given)
    against = default_shield_map(has_ellipsoids=has_ellipsoids, has_hulls=has_hulls or not has_ellipsoids)
    found = parameters_of(name, {SHIELD_MAP: against} | dict(given))
    if not has_ellipsoids and found[SHIELD_MAP] != HULLS:
        raise UsageError(
            f"{name}: {SHIELD_MAP}={found[SHIELD_MAP]} needs a scene, for its ellipsoids; in a cover "
            f"alone it is {HULLS}"
        )
    return found
