"""Commands whose help shows the options that matter first, and the others in groups with headings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

F = TypeVar("F", bound=Callable[..., Any])

COMMON = "Common options"
"""Heading of what nearly all commands have; always the last one."""

MOST = 10
"""Maximum number of options without a heading; a command with no more of them in all has no headings."""


class Option(click.Option):
    """An option with the heading under which the help shows it.

    Args:
        declarations: names, as for `click.Option`.
        group: the heading; empty for an option that matters.
        keywords: as for `click.Option`.
    """

    def __init__(self, declarations: Any = None, *, group: str = "", **keywords: Any) -> None:
        super().__init__(declarations, **keywords)
        self.group = group


def option(*names: str, group: str = "", **keywords: Any) -> Callable[[F], F]:
    """Decorator that adds an option, as `click.option` does.

    Args:
        names: of the option.
        group: heading under which the help shows it; empty for an option that matters.
        keywords: as for `click.option`; a class must be an `Option`.
    """
    return click.option(*names, **{"cls": Option, **keywords}, group=group)


class Command(click.Command):
    """A command whose help groups its options."""

    def sections(self, context: click.Context) -> dict[str, list[tuple[str, str]]]:
        """Options by heading, each with its names and its help.

        First those that matter, with the output at the head; then the groups, in the order in which their
        first options were declared; then the common ones.

        Args:
            context: of the command.
        """
        found: dict[str, list[tuple[str, str]]] = {"Options": [], COMMON: []}
        for shown in self.get_params(context):
            if not isinstance(shown, click.Option) or (record := shown.get_help_record(context)) is None:
                continue
            is_help = not {*shown.opts}.isdisjoint(context.help_option_names)
            group = COMMON if is_help else getattr(shown, "group", "") or "Options"
            records = found.setdefault(group, [])
            records.insert(0 if shown.name == "output" else len(records), record)
        found[COMMON] = found.pop(COMMON)
        if sum(map(len, found.values())) <= MOST:
            return {"Options": [record for records in found.values() for record in records]}
        return {heading: records for heading, records in found.items() if records}

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write a list for each heading."""
        for heading, records in self.sections(ctx).items():
            with formatter.section(heading):
                formatter.write_dl(records)


def command(name: str | None = None, **keywords: Any) -> Callable[[Callable[..., Any]], Command]:
    """Decorator that makes a `Command`, as `click.command` does.

    Args:
        name: of the command; None is that of the function.
        keywords: as for `click.command`.
    """
    return click.command(name, cls=Command, **keywords)
