"""Safety filters of other packages, by their entry points."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import entry_points
from typing import Any

from alula.schemas.errors import UsageError
from alula.schemas.scenarios.tables import COMMANDS

ENTRY_POINTS = "alula.filters"
_provided: dict[str, Any] = {}


@contextmanager
def provided(filters: Mapping[str, Any]) -> Iterator[None]:
    """Context in which filters exist that no package provides, such as classes of a notebook.

    Args:
        filters: callables (world, parameters) by name.
    """
    before = dict(_provided)
    _provided.update(filters)
    try:
        yield
    finally:
        _provided.clear()
        _provided.update(before)


def foreign_names() -> list[str]:
    """Names of the filters that other packages provide, without loading them."""
    return sorted({*_provided, *(point.name for point in entry_points(group=ENTRY_POINTS))})


def foreign_filter(name: str, known: Sequence[str] = ()) -> Any:
    """Import what an entry point in the group `alula.filters` names: a callable (world, parameters).

    Args:
        known: names of all filters, for the message.

    Raises:
        UsageError: there is no such entry point, or its package cannot be imported.
    """
    if name in _provided:
        return _provided[name]
    points = [point for point in entry_points(group=ENTRY_POINTS) if point.name == name]
    if not points:
        raise UsageError(f"no filter is called {name!r}" + (f"; known: {', '.join(known)}" if known else ""))
    try:
        return points[0].load()
    except (ImportError, AttributeError) as error:
        raise UsageError(f"filter {name!r} cannot be loaded from {points[0].value}: {error}") from error


def kind_of(name: str, factory: Any) -> str:
    """The kind of command that a filter takes and gives, before it is built.

    It is the attribute `kind` of its factory: a class of filters has it, a function needs it.

    Raises:
        UsageError: there is no such attribute.
    """
    kind = getattr(factory, "kind", None)
    if kind not in COMMANDS:
        raise UsageError(f"filter {name!r}: its factory needs an attribute `kind`, of {', '.join(COMMANDS)}")
    return str(kind)
