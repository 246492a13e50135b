"""What shells complete beside the names of files."""

from __future__ import annotations

import click
from click.shell_completion import CompletionItem


def filters(_context: click.Context, _parameter: click.Parameter, given: str) -> list[CompletionItem]:
    """Names of filters that continue a list with commas."""
    from alula.stages.filtering.registry import filter_names

    before, comma, begun = given.rpartition(",")
    taken = before.split(",")
    names = [name for name in filter_names() if name.startswith(begun) and name not in taken]
    return [CompletionItem(f"{before}{comma}{name}") for name in names]


def vehicles(_context: click.Context, _parameter: click.Parameter, given: str) -> list[CompletionItem]:
    """Names of built-in vehicles, and files."""
    from typing import get_args

    from alula.schemas.scenarios.tables import VehicleName

    names = [name for name in get_args(VehicleName) if name.startswith(given)]
    return [*(CompletionItem(name) for name in names), CompletionItem(given, type="file")]
