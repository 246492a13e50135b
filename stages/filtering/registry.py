"""Filters by name: those of this package, then those of others through entry points."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import entry_points
from typing import Any

from alula.schemas.errors import UsageError
from alula.stages.filtering.polytope_cbf import no_filter, polytope_cbf
from alula.stages.filtering.protocol import Filter, FilterFactory, World

ENTRY_POINTS = "alula.filters"
_BUILT_IN: dict[str, FilterFactory] = {"none": no_filter, "polytope-cbf": polytope_cbf}


def filter_names() -> list[str]:
    """All filters there are; the built-in ones first."""
    others = {point.name for point in entry_points(group=ENTRY_POINTS)} - _BUILT_IN.keys()
    return [*_BUILT_IN, *sorted(others)]


def make_filter(name: str, world: World, parameters: Mapping[str, Any]) -> Filter:
    """Build a filter; a package that provides one is imported only now.

    Its entry point in the group `alula.filters` names a callable (world, parameters) -> Filter.

    Raises:
        UsageError: there is no such filter, its package cannot be imported, or a parameter is wrong.
    """
    factory = _BUILT_IN.get(name)
    if factory is None:
        points = [point for point in entry_points(group=ENTRY_POINTS) if point.name == name]
        if not points:
            raise UsageError(f"no filter is called {name!r}; known: {', '.join(filter_names())}")
        try:
            factory = points[0].load()
        except (ImportError, AttributeError) as error:
            raise UsageError(f"filter {name!r} cannot be loaded from {points[0].value}: {error}") from error
    return factory(world, parameters)
